"""Batch engine: an aircraft's XML is traced to a typed intermediate form, compiled, and flown in
many lanes at once.

``translate`` and ``models`` trace a frame into the intermediate form of ``ir``, ``program`` and
``maths``, which ``passes`` simplifies. ``llvm``, ``llvm_flight`` and ``llvm_random`` compile it;
``course``, ``mission``, ``replay`` and ``streams`` fly it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
