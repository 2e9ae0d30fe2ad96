"""Model-form uncertainty: intervals of the six coefficients over the states, their coverage and what would narrow them."""
