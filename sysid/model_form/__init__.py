"""Model-form uncertainty: intervals of the six coefficients over the states, their coverage and
what would narrow them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
