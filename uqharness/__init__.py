"""Flight-model uncertainty for JSBSim: identification, bounds of what a model does not know,
campaigns, p-boxes, refinement.

    import uqharness as uq

Names are loaded at their first use, so that the import takes some milliseconds and loads no
numerical library. They stand in __init__.pyi."""

import lazy_loader

__version__ = "0.38.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
