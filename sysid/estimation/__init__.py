"""Parameter estimation: equation error, output error, filter error, stepwise regression, and what their bounds are worth."""
