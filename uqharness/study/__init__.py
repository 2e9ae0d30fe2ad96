"""Run a study: from flights to a statement about performance, before and after refinement.

``spec`` reads the study file, ``stages`` plans one ``uqharness`` command per stage, ``run`` runs
what is not up to date, and ``answer`` states the result.
"""

import lazy_loader

from uqharness.callable_module import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "uqharness.api.results")
