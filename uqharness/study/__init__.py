"""A study: the whole chain from flights to a verdict about performance."""
