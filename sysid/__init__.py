"""Flight logs, identification and model-form uncertainty. Knows nothing of JSBSim.

Names are loaded at their first use: what needs one small module does not wait for scipy, pandas and
pyarrow. They stand in __init__.pyi."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
