"""Comparison of two models in flight: which outputs differ, when first, and by how much.

Both models fly the same manoeuvres from the same start. Differences beyond rounding are ranked by
time and by cause and effect, with the differing lines of XML that may explain them. The command
``uqharness diff`` uses it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
