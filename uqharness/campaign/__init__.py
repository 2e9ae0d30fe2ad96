"""Monte Carlo campaigns: aleatory inside epistemic, run, resumed, answered."""
