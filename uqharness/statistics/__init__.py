"""Statistics of campaigns: p-boxes, rates, decisions, area metric, convergence."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
