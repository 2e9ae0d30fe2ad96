"""JSBSim's flight control components as values of the intermediate form."""
