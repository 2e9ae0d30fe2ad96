"""Flights in lanes: start, streams, stepping, records."""
