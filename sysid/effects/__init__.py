"""Missing effects of a model: catalogue, score tests against flights, selection."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
