"""Flight logs: read any supported format, check it, and turn it into a flight record.

A log passes the reader of its format (`dataflash`, `ulog`, `tlog`, `mat`, `tables`: file to
`RawLog`), `signal_map` (message fields to signals), `assemble` (signals on one grid) and
`checking` (what is wrong with them). `load.import_log` runs the whole chain and caches its result.
Public names are listed in ``__init__.pyi``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
