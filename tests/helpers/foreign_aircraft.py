"""Small aircraft in the styles in which people publish theirs: each reads what a host provides.

All are written for these tests; `tests/foreign_aircraft` has their folders.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

from tests.helpers.places import TESTS

FOLDER = TESTS / "foreign_aircraft"
SPEEDS_MPS: Mapping[str, float] = {
    "single": 50.0,
    "glider": 28.0,
    "wing": 15.0,
    "twin": 60.0,
    "vtail": 15.0,
    "jet": 130.0,
    "turboprop": 55.0,
    "retractable": 58.0,
    "pusher": 15.0,
    "ducted": 18.0,
    "contra": 70.0,
    "biplane": 42.0,
}


def product(*factors: str | float) -> str:
    """Return a <product> of properties and numbers."""
    parts = [
        f"<property>{f}</property>" if isinstance(f, str) else f"<value>{f}</value>"
        for f in factors
    ]
    return f"<product>{''.join(parts)}</product>"


def write(style: str, parent: Path) -> Path:
    """Copy an aircraft into a folder of its name under ``parent`` and return the folder."""
    return Path(shutil.copytree(FOLDER / style, parent / style, dirs_exist_ok=True))
