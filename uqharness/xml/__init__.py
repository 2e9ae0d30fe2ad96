"""JSBSim XML: documents edited as a hand would, expressions, the aerodynamics section."""
