"""One importer per log format, each `read(path, wanted, progress) -> RawLog`; `detect` finds the
format by content.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
