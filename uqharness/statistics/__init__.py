"""Statistics of campaigns: p-boxes, rates, decisions, area metric, convergence."""
