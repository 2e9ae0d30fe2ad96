"""Linear algebra of the estimators: solutions of block systems, and compiled loops."""
