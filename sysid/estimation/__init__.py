"""Parameter estimation from flight data: equation error, output error, filter error, stepwise
regression, and the reliability of their standard errors.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
