"""Estimation with a model that is linearised along the flight: output error in calm air,
prediction error in turbulence.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
