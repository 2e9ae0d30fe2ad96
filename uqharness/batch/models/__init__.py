"""JSBSim's own models as values of the intermediate form: earth, motion, atmosphere, winds,
forces.
"""
