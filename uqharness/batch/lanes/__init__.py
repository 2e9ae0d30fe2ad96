"""Flights, replays and evaluations of states in many lanes."""
