"""JSBSim: the engine, what is handed to it, aircraft and scripts, trim and linearisation."""
