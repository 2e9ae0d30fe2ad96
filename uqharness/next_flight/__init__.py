"""Which test points narrow the answer most, and the script that flies them."""

import lazy_loader

from uqharness.callable_module import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "uqharness.api.results")
