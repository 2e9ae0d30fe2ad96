"""JSBSim: aircraft and scripts, the gate before it, trim, linearisation, mass and settling.

`engine` is the only module that imports JSBSim. Everything that JSBSim opens passes through
`staging`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
