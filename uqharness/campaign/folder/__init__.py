"""A campaign's folder: journal, manifest, tables, digests; verified, salvaged, merged."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
