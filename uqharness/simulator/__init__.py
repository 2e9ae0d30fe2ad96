"""JSBSim: the engine, what is handed to it, aircraft and scripts, trim and linearisation."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
