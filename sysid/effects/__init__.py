"""Missing effects: the catalogue of candidates, their scores against flights, and the choice among
them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
