"""How far one model's flight varies by itself: in other air of the same kind, and within the bounds of its model form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sysid.arrays import FloatArray
from uqharness.differences.channels import Channel
from uqharness.differences.flown import How, flown
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS
from uqharness.simulator import Aircraft, open_aircraft


def varied(
    aircraft: Aircraft,
    script: Path,
    channels: Sequence[Channel],
    how: How,
    repeats: int,
    bounds: bool,
) -> list[dict[str, FloatArray]]:
    """Flights of a model as `flown` gives them: with ``repeats`` other seeds of the air, and at either end of each bound.

    Raises BadInputError where there is no air to repeat or no bound.
    """
    if repeats and how.turbulence == "none":
        raise BadInputError(
            "--repeats: still air has no other seed; give --turbulence light, moderate or severe"
        )
    others = [replace(how, seed=how.seed + k) for k in range(1, repeats + 1)]
    others += [replace(how, properties=corner) for corner in (_ends(aircraft) if bounds else ())]
    return [flown(aircraft, script, channels, other) for other in others]


def spread(
    flight: Mapping[str, FloatArray], others: Iterable[Mapping[str, FloatArray]]
) -> dict[str, float]:
    """Largest difference of the others from the flight, by channel, over the time that both flew."""
    out = dict.fromkeys(flight, 0.0)
    for other in others:
        for name, values in flight.items():
            n = min(len(values), len(other[name]))
            out[name] = max(
                out[name], float(np.max(np.abs(other[name][:n] - values[:n]), initial=0.0))
            )
    return out


def _ends(aircraft: Aircraft) -> list[dict[str, float]]:
    """Settings for each coefficient at its lower and at its upper bound, the others without one."""
    exists = open_aircraft(aircraft).get_property_manager().hasNode
    bounded = [c for c in COEFFICIENTS if exists(f"uq/{c}/level")]
    if not bounded:
        raise BadInputError(
            f"--bounds: aircraft '{aircraft.name}' has none; add them with uqharness instrument {aircraft.name} --bounds "
            "model-form.json"
        )
    return [
        {
            "uq/active": 1.0,
            **{f"uq/{other}/active": 0.0 for other in bounded if other != c},
            f"uq/{c}/level": level,
        }
        for c in bounded
        for level in (0.0, 1.0)
    ]
