"""The same flights of two models: same start, same controls in time, same air, one frame after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sysid.arrays import FloatArray
from uqharness.differences.elsewhere import (
    Channel,
    How,
    RefusedError,
    channels_of,
    flown,
    fly_elsewhere,
)
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.flight import COEFFICIENTS
from uqharness.isolation import ProcessEndedError
from uqharness.scratch import scratch_folder
from uqharness.simulator import (
    MISSIONS,
    Aircraft,
    StartSection,
    copy_beside,
    copy_folder,
    engine,
    find_aircraft,
    open_aircraft,
    read_script,
    write_own_mission,
)

# How far one model's flight varies by itself: in other air of the same kind, and within the
# bounds of its model form.


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


MOST_S = 60.0
"""Longest flight of a script [s]; a mission of one's own ends by itself."""


@dataclass(frozen=True)
class Asked:
    """What is flown: manoeuvres from a trim of A at each speed [m/s] and height [m], and run scripts of one's own.

    properties: of the simulation, compared besides the channels that every aircraft has.
    repeats: flights of A in other air, bounds: flights of A at the ends of its bounds, both beside the one that is compared.
    python_b: interpreter that flies B with the JSBSim of its own environment; None: this one.
    """

    speeds_mps: tuple[float, ...] = ()
    altitude_m: float = 200.0
    missions: tuple[str, ...] = MISSIONS
    scripts: tuple[Path, ...] = ()
    turbulence: str = "none"
    seed: int = 1
    properties: tuple[str, ...] = ()
    python_b: Path | None = None
    repeats: int = 0
    bounds: bool = False


@dataclass(frozen=True)
class Matched:
    """One flight of both models.

    name       of the manoeuvre or script; time_s (n,); a, b, nudged: channel -> (n,), nudged being A from a start one unit in the
               last place away, which tells how far rounding alone goes
    only_a, only_b  channels that one model has alone; reason: why there is no flight of B, "" where there is one
    varied     channel -> how far A varies by itself, in other air and within its bounds; empty: not flown
    jsbsim_b   version of JSBSim that flew B, "" for this process's own
    """

    name: str
    time_s: FloatArray
    a: Mapping[str, FloatArray]
    b: Mapping[str, FloatArray]
    nudged: Mapping[str, FloatArray]
    only_a: tuple[str, ...] = ()
    only_b: tuple[str, ...] = ()
    reason: str = ""
    jsbsim_b: str = ""
    varied: Mapping[str, float] = field(default_factory=dict)


def fly_matched(
    a: Aircraft, b: Aircraft, asked: Asked, on_progress: Callable[[int, int], None] | None = None
) -> tuple[list[Channel], list[Matched]]:
    """Channels of A, and every flight asked for in both models. Raises BadInputError for what A itself cannot fly.

    ``on_progress`` is told how many flights are flown in both models, of how many.
    """
    if not asked.speeds_mps and not asked.scripts:
        raise BadInputError("nothing to fly: give a speed at which the aircraft trims, or a script")
    channels = channels_of(a, open_aircraft(a), asked.properties)
    out: list[Matched] = []
    every = len(asked.speeds_mps) * len(asked.missions) + len(asked.scripts)

    def flown_in_both(flight: Matched) -> None:
        out.append(flight)
        if on_progress is not None:
            on_progress(len(out), every)

    with scratch_folder("diff") as scratch:
        one, two = _copy(a, scratch.path / "a"), _copy(b, scratch.path / "b")
        for speed in asked.speeds_mps:
            start = StartSection(V_mps=speed, altitude_m=asked.altitude_m)
            for kind in asked.missions:
                before = {p.name for p in one.folder.iterdir()}
                path, _ = write_own_mission(one, start, kind)
                for made in one.folder.iterdir():
                    if made.name not in before or made == path or made.name == "steady-start.xml":
                        write_bytes(two.folder / made.name, made.read_bytes())
                flown_in_both(
                    _both(
                        one,
                        two,
                        path,
                        two.folder / path.name,
                        f"{kind} at {speed:g} m/s",
                        channels,
                        asked,
                        1e9,
                    )
                )
        for script in asked.scripts:
            initial = read_script(script).initialize
            for source in (one.folder / initial, one.folder / f"{initial}.xml"):
                if source.is_file():
                    write_bytes(two.folder / source.name, source.read_bytes())
            flown_in_both(_both(one, two, script, script, script.stem, channels, asked, MOST_S))
    return channels, out


def _copy(aircraft: Aircraft, root: Path) -> Aircraft:
    copy_folder(aircraft.folder, root / "aircraft" / aircraft.folder.name)
    copy_beside(aircraft, root, engine.default_root())
    found = find_aircraft(root / "aircraft" / aircraft.folder.name)
    return replace(found, engine_path=aircraft.engine_path, systems_path=aircraft.systems_path)


def _both(
    one: Aircraft,
    two: Aircraft,
    path: Path,
    other: Path,
    name: str,
    channels: Sequence[Channel],
    asked: Asked,
    most_s: float,
) -> Matched:
    how = How(most_s, one.dt_s, asked.turbulence, asked.seed)
    try:
        first, near = (
            flown(one, path, channels, replace(how, one_ulp_off=nudged)) for nudged in (False, True)
        )
    except ProcessEndedError as error:
        raise BadInputError(f"{name}: A cannot be flown: {error}") from None
    try:
        second, version = _of_b(two, other, channels, how, asked.python_b)
    except RefusedError as error:
        return Matched(name, first["time_s"], first, {}, near, reason=str(error))
    others = varied(one, path, channels, how, asked.repeats, asked.bounds)
    rows = min(len(x["time_s"]) for x in (first, near, second))
    a, b, nudged = (
        {k: v[:rows] for k, v in x.items() if k != "time_s"} for x in (first, second, near)
    )
    only_a, only_b = tuple(sorted(a.keys() - b.keys())), tuple(sorted(b.keys() - a.keys()))
    lengths = len(first["time_s"]), len(second["time_s"])
    reason = "" if lengths[0] == lengths[1] else f"A flew {lengths[0]} frames and B {lengths[1]}"
    return Matched(
        name,
        first["time_s"][:rows],
        a,
        b,
        nudged,
        only_a,
        only_b,
        reason,
        version,
        spread(a, others) if others else {},
    )


def _of_b(
    two: Aircraft, script: Path, channels: Sequence[Channel], how: How, python: Path | None
) -> tuple[dict[str, FloatArray], str]:
    """B's flight and the version of JSBSim, "" for this process's own. Raises RefusedError where B is not flown."""
    if python is not None:
        return fly_elsewhere(python, two, script, channels, how)
    try:
        return flown(two, script, channels, how), ""
    except BadInputError as error:
        raise RefusedError(str(error)) from None
