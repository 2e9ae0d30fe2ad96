"""Identification on JSBSim replays: parameters, comparison with flights, intervals and their validation."""
