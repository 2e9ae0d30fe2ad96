"""Flight logs, parameter identification and model-form uncertainty, without JSBSim.

The package reads flight logs into records, estimates aerodynamic coefficients from them and bounds
the error of the model form. It does not import JSBSim; `uqharness` joins the two.

Public names are listed in ``__init__.pyi`` and loaded at first use, so that importing one small
module does not load scipy, pandas and pyarrow.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
