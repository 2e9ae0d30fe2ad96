"""What a flight has brought: bounds before and after it, over the same mission, beside what was predicted."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from sysid.model_form import ModelForm
from sysid.units import percent
from uqharness.next_flight.mission_states import Occupancy
from uqharness.next_flight.prospects import widths_over
from uqharness.text_tables import text_table

Row = Mapping[str, float | None]


def achieved(
    before: ModelForm, after: ModelForm, mission: Occupancy, planned: Path
) -> dict[str, Row]:
    """Coefficient -> widths, narrowings and, where ``planned`` is a next-flight.json, those predicted there."""
    predicted = _planned(planned)
    then, now = widths_over(after, mission), widths_over(before, mission)
    return {
        c: {
            "width": now[c].total,
            "width_after": then[c].total,
            "narrowing": 1.0 - then[c].total / now[c].total,
            "predicted": predicted.get(c, {}).get("narrowing_redone"),
            "parameter_narrowing": 1.0 - then[c].parameter / now[c].parameter,
            "predicted_parameter": predicted.get(c, {}).get("parameter_narrowing"),
        }
        for c in now
        if c in then
    }


def as_text(rows: Mapping[str, Row]) -> str:
    """A table for a terminal."""
    return "\n".join(
        text_table(
            [
                {"coefficient": c, **{k: _cell(k, v) for k, v in row.items()}}
                for c, row in rows.items()
            ]
        )
    )


def _cell(key: str, value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}" if "width" in key else percent(value)


def _planned(path: Path) -> dict[str, dict[str, float]]:
    """Prospects of a flight planned in the same folder; empty without one."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["prospects"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return found if isinstance(found, dict) else {}
