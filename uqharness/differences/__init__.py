"""Two models flown side by side: which outputs differ, when first, by how much, and which lines of
XML differ.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
