"""Flights with hidden effects: an examination for `uqharness refine` whose answers it never sees.

The flights come from equations of motion of their own (motion.py, no JSBSim); effects.py hides
effects in them, cases.py lists the battery, answers.py knows what may be answered, run.py asks.
docs/hidden-effects.md tells how to use it."""
