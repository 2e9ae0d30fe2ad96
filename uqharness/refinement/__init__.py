"""Refinement: where model and flights disagree, which effect is missing, and the better model."""
