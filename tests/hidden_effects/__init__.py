"""Flights with hidden effects, on which `uqharness refine` is tested.

Flights come from equations of motion without JSBSim (motion.py, equations.py); effects.py hides
effects in them, questions.py reads cases, verdict.py and answers.py judge refinement.json, and
`python -m tests.hidden_effects` runs 40 cases."""
