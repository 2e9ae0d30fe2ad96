"""From the specification of flights to their state before the first frame: JSBSim's start, then the two initialising frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray
from uqharness.batch.form.flying import Flyer, begun, slot, stepped
from uqharness.batch.lanes.mission import AIR_WIND, WIND, LaneMission, Loaded, load_start
from uqharness.batch.lanes.streams import Noise
from uqharness.batch.models.ground import TOUCHED
from uqharness.batch.models.start import CONDITIONS, start_state
from uqharness.batch.translate.scope import canonical
from uqharness.errors import BadInputError
from uqharness.flight import TURBULENCE_W20_KT, FlightSpec, first_levels
from uqharness.simulator import CHANGEABLE

_TURNS = 200
"""Turns between two looks at whether engines have come to rest."""


@dataclass(frozen=True)
class Begun:
    """``values``: slot to its value in each lane behind the initialising frames. ``noise``: by seed, drawn up to there."""

    values: dict[str, FloatArray]
    noise: Mapping[int, Noise]


def begin(lanes: LaneMission, specs: Sequence[FlightSpec]) -> Begun:
    """Initialise. Raises BadInputError for a property that cannot be set, or that initialising has overwritten."""
    count = len(specs)
    loaded = _loaded(lanes, specs)
    values = start_state(
        {name: np.array([one.conditions[name] for one in loaded]) for name in CONDITIONS}
    )
    rows = [_given(lanes, one, spec) for one, spec in zip(loaded, specs, strict=True)]
    given = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    values |= given
    values |= {
        name: np.array([one.static[name] for one in loaded])
        for name in loaded[0].static
        if name not in given
    }
    wind, blown = (
        np.array([getattr(one, which) for one in loaded]) for which in ("wind_fps", "blown_fps")
    )
    noise = {
        s: Noise(
            s, lanes.flight.draws, lanes.flight.first_draws, initialising=3 if lanes.steady else 2
        )
        for s in dict.fromkeys(spec.seed_noise for spec in specs)
    }
    for number, flyer in enumerate(
        (*lanes.initialisers, *([lanes.renewer] if lanes.renewer is not None else []))
    ):
        if number == len(lanes.initialisers):
            settle(lanes.settlers, values, count)
        if number == 0:
            values |= {
                name: speed
                for name, speed in zip(WIND, wind.T, strict=True)
                if name in flyer.program.slots
            }
        drawn = np.array([noise[spec.seed_noise].initial[number] for spec in specs])
        values |= {f"#draw/{k}": drawn[:, k] for k in range(drawn.shape[1])}
        values |= stepped(flyer, values, count)
        if number == 1 and not lanes.air:
            values |= dict(zip(WIND, blown.T, strict=True))
    if lanes.points and (values[TOUCHED] >= 0.0).any():
        raise BadInputError(
            'the flight starts on the ground, where the batch engine computes no forces; fly it with engine = "jsbsim"'
        )
    _require_kept(specs, given, values)
    return Begun(values, noise)


def settle(
    settlers: Sequence[tuple[str, Flyer]], values: dict[str, FloatArray], count: int
) -> None:
    """Bring every lane's engines to their steady state. settlers: as `compiled_settlers` gives them."""
    for going, flyer in settlers:
        program = flyer.program
        state = begun(
            program, count, {name: v for name, v in values.items() if name in program.slots}
        )
        while slot(program, state, going, count).any():
            flyer.fly(state, 1, _TURNS)
        values |= {name: slot(program, state, name, count) for name in program.slots}


def _loaded(lanes: LaneMission, specs: Sequence[FlightSpec]) -> list[Loaded]:
    """JSBSim is asked once for each start that differs."""
    found: dict[tuple[object, ...], Loaded] = {}
    out = []
    for spec in specs:
        own = tuple(
            (n, v)
            for n, v in sorted(spec.properties.items())
            if n.startswith("ic/") or n in CHANGEABLE
        )
        key = (spec.wind_mps, spec.wind_from_deg, spec.turbulence, own)
        if key not in found:
            found[key] = load_start(lanes, spec)
        out.append(found[key])
    return out


def _given(lanes: LaneMission, loaded: Loaded, spec: FlightSpec) -> dict[str, float]:
    """Properties that are set for a flight; mass and what follows from it as JSBSim has them."""
    blowing = (spec.wind_mps, spec.wind_from_deg, TURBULENCE_W20_KT[spec.turbulence])
    air = dict(zip(AIR_WIND, blowing, strict=True)) if lanes.air else {}
    asked = {**air, **first_levels(spec, lanes.dt_s), **spec.properties}
    return {
        name: loaded.static.get(name, float(value))
        for name, value in ((canonical(n), v) for n, v in asked.items())
    }


def _require_kept(
    specs: Sequence[FlightSpec], given: Mapping[str, FloatArray], values: Mapping[str, FloatArray]
) -> None:
    for name in specs[0].properties:
        if name.startswith("ic/") or name in CHANGEABLE:
            continue
        wanted, kept = given[canonical(name)], values[canonical(name)]
        moved = np.abs(kept - wanted) > 1e-9 * np.maximum(np.abs(wanted), 1.0)
        if moved.any():
            lane = int(np.argmax(moved))
            raise BadInputError(
                f"property {name} was set to {wanted[lane]:g} and stands at {kept[lane]:g} after initialising: the model computes "
                "it, so it cannot be set"
            )
