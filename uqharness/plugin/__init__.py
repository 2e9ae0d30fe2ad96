"""The JSBSim system of error bounds: written, added to any aircraft, and checked in flight."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
