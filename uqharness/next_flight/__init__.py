"""Plan the test flight that narrows one coefficient's bounds most, and write its script.

``points`` defines test points and their script, ``trials`` simulates them, ``plan`` chooses among
them and predicts the narrowing.
"""

import lazy_loader

from uqharness.callable_module import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "uqharness.api.campaigns")
