"""The compiled engine: an aircraft's XML traced to a small typed form, compiled, and flown in many
lanes at once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
