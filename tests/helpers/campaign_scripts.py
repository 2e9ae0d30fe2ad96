"""The scripts below campaigns/, whose folders need not be names that Python could import by a
statement.
"""

from __future__ import annotations

import importlib
from types import ModuleType


def campaign_script(folder: str, name: str = "reproduce") -> ModuleType:
    """The module campaigns/<folder>/<name>.py."""
    return importlib.import_module(f"campaigns.{folder}.{name}")
