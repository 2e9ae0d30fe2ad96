"""JSBSim side of the chain: aircraft, flights, campaigns, p-boxes and the command line."""

__version__ = "0.1.0"
