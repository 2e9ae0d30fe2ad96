"""Parameter estimation: equation error, output error, filter error, stepwise regression, and what
their bounds are worth.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
