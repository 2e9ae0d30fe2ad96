"""What is known of a model's parameters before a flight: mean, standard deviation and source.

A file is TOML, or the model-form.json of kind "prior" that `uqharness author` writes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import ParseError, parse_json, read_regular_text
from uqharness.errors import BadInputError
from uqharness.toml import read_toml

_KEYS = ("mean", "std", "unit", "source")


@dataclass(frozen=True)
class ParameterPrior:
    """A normal distribution of a parameter, in the unit of its property.

    Attributes
    ----------
    mean, std : float
        Mean and standard deviation.
    source : str
        Where they come from.
    """

    mean: float
    std: float
    source: str = ""


def read_prior(path: Path) -> dict[str, ParameterPrior]:
    """Read a file of priors.

    Parameters
    ----------
    path : Path
        TOML with tables ``[parameters."aero/Cm_q"]``, or JSON with an object ``parameters``. Names
        without a slash belong to ``aero/``.

    Returns
    -------
    dict
        Property to its prior.

    Raises
    ------
    BadInputError
        With file and parameter, if a number is missing or no number.
    """
    if path.suffix == ".json":
        try:
            document = parse_json(read_regular_text(path))
        except (OSError, UnicodeDecodeError, ParseError) as error:
            raise BadInputError(f"{path}: cannot be read: {error}") from None
        if not isinstance(document, dict) or document.get("kind") != "prior":
            raise BadInputError(
                f'{path}: is no file of priors: "kind" must be "prior", as `uqharness author`'
                " writes it"
            )
    else:
        document, _ = read_toml(path)
    rows = document.get("parameters")
    if not isinstance(rows, dict) or not rows:
        raise BadInputError(
            f'{path}: holds no prior; write [parameters."aero/Cm_q"] with mean = , std = ,'
            ' source = ""'
        )
    out = {}
    for name, row in rows.items():
        where = f'{path}: [parameters."{name}"]'
        if not isinstance(row, dict):
            raise BadInputError(f"{where} must be a table with mean and std; received {row!r}")
        if path.suffix != ".json" and (unknown := sorted(set(row) - set(_KEYS))):
            raise BadInputError(f"{where}: unknown keys {unknown}; allowed are {list(_KEYS)}")
        mean, std = (_number(row, key, where) for key in ("mean", "std"))
        if std <= 0.0:
            raise BadInputError(f"{where}: std = {std:g} must be above 0")
        property_name = name if "/" in name else f"aero/{name}"
        out[property_name] = ParameterPrior(mean, std, str(row.get("source", "")))
    return out


def _number(row: Mapping[str, Any], key: str, where: str) -> float:
    """Return a finite number of a table."""
    value = row.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        received = "it is missing" if value is None else f"received {value!r}"
        raise BadInputError(f"{where}: {key} must be a number; {received}")
    return float(value)
