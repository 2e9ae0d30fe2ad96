"""Flight logs: readers of each dialect, the map to the vocabulary, faults, phases, manoeuvres, flight records."""
