"""Linear algebra of the estimators: triangular and block solutions."""
