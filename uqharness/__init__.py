"""JSBSim side of the chain: aircraft, flights, campaigns, p-boxes and the command line."""

__version__ = "0.2.0.dev0"
