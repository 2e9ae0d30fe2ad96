"""Studies that measure the estimators against known truth."""
