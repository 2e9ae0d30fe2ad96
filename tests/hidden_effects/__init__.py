"""Flights with hidden effects, on which `uqharness refine` is tested.

Flights come from equations of motion without JSBSim (motion.py, equations.py); effects.py hides
effects in them, drawn.py draws cases, weighing.py sizes their effects, verdict.py and answers.py
judge refinement.json, and `python -m tests.hidden_effects` runs 40 cases."""
