"""Models for other simulators: the aerodynamics in their terms, and what is lost on the way.

``states`` samples flight states, evaluates the source and fits the model that formats can hold;
``ardupilot_json`` and ``gazebo`` write and read a format and evaluate its program's equations;
``loss`` compares target and source.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
