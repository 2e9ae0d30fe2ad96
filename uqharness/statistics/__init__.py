"""Statistics of simulated campaigns: p-boxes, rates and their limits, decisions, rare events."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
