"""Batch engine: an aircraft's XML is traced to a typed intermediate form, compiled, and flown in
many lanes at once.

``translate`` and ``models`` trace a frame, ``form`` holds the intermediate form and its passes,
``machine`` compiles with LLVM, ``lanes`` flies.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
