"""JSBSim's own models as values: motion, atmosphere, winds, auxiliary quantities."""
