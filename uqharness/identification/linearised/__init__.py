"""A model's fit to flights linearised about themselves: replays in calm air, one-step predictions
in turbulence.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
