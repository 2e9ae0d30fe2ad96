"""Which uncertainty widens a result most? Five methods over one stored study of any model.

    from scipy import stats
    from uqharness import sensitivity

    def sink_rate(CD0, k, mass):                     # called by name, with arrays
        ...

    study = sensitivity.run_study(
        sink_rate,
        epistemic={"CD0": (0.02, 0.03), "k": (0.05, 0.06)},
        aleatory={"mass": stats.norm(21.3, 0.5)},
    )
    print(sensitivity.analyse(study).text())

Source: L. E. Hale, dissertation, Virginia Tech, 2016, chapter 4.
"""

import lazy_loader

from uqharness.callable_module import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "uqharness.api.campaigns")
