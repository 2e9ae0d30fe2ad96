"""Report results: sentences, tables, pages and charts."""

import lazy_loader

from uqharness.callable_module import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "uqharness.api.results")
