"""Recorded flights flown again by JSBSim: through their controls, beside their motion."""
