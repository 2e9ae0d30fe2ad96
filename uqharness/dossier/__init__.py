"""Evidence in a folder of results, arranged for those who assess a model.

`evidence` lists what the commands wrote and what is missing, and sorts it by the credibility
factors of NASA-STD-7009. `match` compares model and flight by the objective tests of 14 CFR Part
60. Both only read files; nothing is simulated or estimated here.
"""

import lazy_loader

from uqharness.callable_module import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "uqharness.api.results")
