"""The evidence that a folder of results holds, laid out as those who judge a model read it.

Reads files; flies and fits nothing.
"""

import lazy_loader

from uqharness.callable_module import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "uqharness.api.results")
