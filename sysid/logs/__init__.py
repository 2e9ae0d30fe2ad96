"""Flight logs: readers of each dialect, the map to the vocabulary, faults, phases, manoeuvres,
flight records.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
