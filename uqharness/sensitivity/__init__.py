"""Which uncertainty is worth buying down? Five methods over one stored study of any model.

    from scipy import stats
    from uqharness import sensitivity

    def sink_rate(CD0, k, mass):                     # called by name, with arrays
        ...

    study = sensitivity.run_study(
        sink_rate, epistemic={"CD0": (0.02, 0.03), "k": (0.05, 0.06)}, aleatory={"mass": stats.norm(21.3, 0.5)}
    )
    print(sensitivity.analyse(study).text())

Source: L. E. Hale, dissertation, Virginia Tech, 2016, chapter 4.
"""

from uqharness.sensitivity.analysis import Sensitivity, analyse
from uqharness.sensitivity.repeats import average
from uqharness.sensitivity.result import Index, MethodResult, PairRange
from uqharness.sensitivity.study import METHODS, Evaluations, Study, read_study, run_study, write_study

__all__ = [
    "METHODS",
    "Evaluations",
    "Index",
    "MethodResult",
    "PairRange",
    "Sensitivity",
    "Study",
    "analyse",
    "average",
    "read_study",
    "run_study",
    "write_study",
]
