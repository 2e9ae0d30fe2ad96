"""Refinement: where model and flights disagree, which effect is missing, and the better model."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
