"""Model form: bounds on what a flight model does not represent, from residual coefficients.

`fit` makes the bounds, `components` separates model error from sensor noise, `coverage` tests them
on other flights, `information_gain` predicts what further data would do to them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
