"""What a notebook shows of a refinement, from its document."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sysid.notebook_view import rows_table, view


def refinement_view(title: str, document: Mapping[str, Any]) -> str:
    """Verdict, effects with estimate and standard deviation, and each channel's residual on the test flights."""
    effects = [
        {
            "effect": row["name"],
            "property": row["property"] or "",
            "estimate": _number(row["value"]),
            "std": _number(row["std"]),
            "unit": row["unit"],
        }
        for row in document["effects"]
    ]
    gaps = [
        {
            "channel": name,
            "before [sigma]": _ratio(row["rms_before"], row["noise_rms"]),
            "after [sigma]": _ratio(row["rms_after"], row["noise_rms"]),
        }
        for name, row in document["gap"]["test"]["channels"].items()
    ]
    residual = "<p>Residual on the test flights</p>"
    return view(
        title,
        rows_table(effects),
        residual,
        rows_table(gaps),
        facts={"verdict": document["verdict"]},
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _ratio(rms: float | None, noise: float | None) -> float:
    return math.nan if rms is None or not noise else rms / noise
