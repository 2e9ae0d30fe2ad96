"""From geometry to a JSBSim model with stated uncertainty, before the first flight.

``read`` reads derivatives of AVL, VSPAERO, XFLR5 and tables, ``slips`` names the usual mistakes in
them, ``model`` turns them to body axes about the centre of gravity, ``prior`` says how far such
derivatives are from flight, and ``write_aircraft`` writes the folder. ``performance`` computes the
performance sheet of any aircraft.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
