"""Batch engine: an aircraft's XML is traced to a typed intermediate form, compiled, and flown in
many lanes at once.

``translate``, ``motion``, ``winds``, ``atmosphere`` and ``auxiliary`` trace a frame into the
intermediate form of ``ir``, ``program`` and ``maths``, which ``passes`` simplifies. ``llvm`` and
``llvm_flight`` compile it; ``course``, ``mission``, ``replay`` and ``streams`` fly it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
