"""Check of the plugin: an instrumented aircraft flown against the untouched one.

Both fly the same ten seconds in mid-envelope with engines running and controls moving, and all
common properties must be identical. Then one coefficient at a time is switched on for one frame:
body force and moment must change by q S dC, q S b dC or q S c dC about the CG. `check_in_child`
runs this in a child process, because an aircraft may crash the interpreter.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS
from sysid.units import FT_M
from uqharness.child_process import describe_exit, give_answer, run_module
from uqharness.errors import BadInputError
from uqharness.simulator import (
    Aircraft,
    engine,
    find_aircraft,
    open_mid_envelope,
    staged,
    with_step,
)

DELTA = 0.02
DURATION_S = 10.0
SAMPLE_EVERY = 20
SWITCHED_AFTER = 60
"""Frames flown before a coefficient is switched on for one."""

_MAY_CHANGE = re.compile(
    r"uq/|forces/(fb[xyz]-(aero|total)-lbs|f[ws][xyz]-aero-lbs|lod-norm|hold-down|load-factor)|"
    r"moments/([lmn]-(aero|total)-lbsft|(roll|pitch|yaw)-(stab|wind)-aero-lbsft)|accelerations/"
)
_UNINITIALISED = re.compile(
    r"gear/unit(\[\d+\])?/side_friction_coeff|propulsion/engine(\[\d+\])?/engtemp-c"
)
"""Properties that JSBSim 1.3.3 does not initialise: FGLGear::FCoeff, FGTurboProp::Eng_Temperature.
"""
_AIR_OWNS = re.compile(r"atmosphere/(turb-type|severity|windspeed_at_20ft.*|psiw-rad|wind-mag-fps)")
_FORCES = tuple(f"forces/fb{axis}-{kind}-lbs" for kind in ("aero", "total") for axis in "xyz")
_MOMENTS = tuple(f"moments/{axis}-{kind}-lbsft" for kind in ("aero", "total") for axis in "lmn")


@dataclass(frozen=True)
class Verdict:
    """Result of the check.

    Attributes
    ----------
    status : str
        ``works``; ``wrong`` (the plugin is at fault); ``fails`` (the untouched aircraft does not
        load or fly).
    reason : str
        Why it does not work.
    properties, unsteady : int
        Compared properties, and those that differ between two flights of the untouched aircraft.
    worst : float
        Largest relative error of a force or moment increment.
    dt_s : float
        Step of the flights [s].
    """

    status: str
    reason: str = ""
    properties: int = 0
    unsteady: int = 0
    worst: float = math.nan
    dt_s: float = math.nan


def check(untouched: Aircraft, instrumented: Aircraft, duration_s: float = DURATION_S) -> Verdict:
    """Fly both aircraft and compare.

    A BadInputError from either aircraft is a verdict too. If the air system was added, its settings
    of the atmosphere may differ.
    """
    if not untouched.has_card:
        # The same commands move both, and both have the same host.
        card = untouched.card.model_copy(
            update={"inputs": instrumented.card.inputs, "host": instrumented.card.host}
        )
        untouched = with_step(replace(untouched, card=card), instrumented.dt_s)
    steps = max(SWITCHED_AFTER + 1, round(duration_s / untouched.dt_s))
    try:
        names, first = _fly(untouched, steps, None)
        # Properties that differ between two equal flights cannot be compared.
        repeated = _fly(untouched, steps, names)[1]
    except (BadInputError, engine.RuntimeFailure) as error:
        return Verdict("fails", " ".join(str(error).split()))
    # A flight that diverges or hits the ground proves nothing.
    height, speed = (names.index(n) for n in ("position/h-sl-ft", "velocities/vt-fps"))
    if not np.isfinite(first[:, [height, speed]]).all():
        return Verdict("fails", "the state does not stay finite")
    if first[:, height].min() <= 0.0:
        return Verdict(
            "fails",
            "reaches the ground after"
            f" {SAMPLE_EVERY * untouched.dt_s * first[:, height].argmin():.1f} s",
        )
    steady = np.all((first == repeated) | (np.isnan(first) & np.isnan(repeated)), axis=0)
    # The air system sets properties of the atmosphere.
    if _has_air(instrumented) and not _has_air(untouched):
        steady &= np.array([not _AIR_OWNS.fullmatch(name) for name in names])
    compared = [name for name, is_steady in zip(names, steady, strict=True) if is_steady]
    verdict_fields: dict[str, Any] = {
        "properties": len(compared),
        "unsteady": len(names) - len(compared),
        "dt_s": untouched.dt_s,
    }
    try:
        idle = _fly(instrumented, steps, compared)[1]
        reference = first[:, steady]
        differs = ~np.all((idle == reference) | (np.isnan(idle) & np.isnan(reference)), axis=0)
        if differs.any():
            changed = [
                name for name, is_changed in zip(compared, differs, strict=True) if is_changed
            ]
            return Verdict(
                "wrong",
                f"with uq/active 0 {len(changed)} properties differ: {', '.join(changed[:5])}",
                **verdict_fields,
            )
        return _switch_each(instrumented, compared, verdict_fields)
    except (BadInputError, engine.RuntimeFailure) as error:
        return Verdict("wrong", " ".join(str(error).split()), **verdict_fields)


def _switch_each(aircraft: Aircraft, names: Sequence[str], same: Mapping[str, Any]) -> Verdict:
    """Switch each coefficient on for one frame and check the increments."""
    all_names = [*names, *(n for n in (*_FORCES, *_MOMENTS) if n not in names)]
    idle = _frame(aircraft, all_names, None)[0]
    at = {name: k for k, name in enumerate(all_names)}
    worst = 0.0
    for index, name in enumerate(COEFFICIENTS):
        moved, delta, scales = _frame(aircraft, all_names, name)
        if not delta:
            return Verdict(
                "wrong", f"uq/{name}/delta stays 0 with uq/active and uq/{name}/active 1", **same
            )
        # Force or moment increment of the coefficient that is on.
        expected = np.zeros(6)
        expected[index] = delta * scales[index]
        for kind in (0, 1):
            keys = (*_FORCES[3 * kind : 3 * kind + 3], *_MOMENTS[3 * kind : 3 * kind + 3])
            before, after = (np.array([row[at[key]] for key in keys]) for row in (idle, moved))
            error = np.abs(after - before - expected).max()
            worst = max(worst, float(error / abs(expected[index])))
            # Rounding of two large sums may exceed the share of a small difference.
            digits = 8.0 * np.finfo(float).eps * np.abs(before).max()
            if not error <= max(1e-9 * abs(expected[index]), digits):
                return Verdict(
                    "wrong",
                    f"{name}: the increment is off by {error:.2g} of {expected[index]:.3g}",
                    worst=worst,
                    **same,
                )
        # Nothing else may change in the first frame.
        changed = moved != idle
        changed &= ~(np.isnan(moved) & np.isnan(idle))
        unexpected = [
            n
            for n, is_changed in zip(all_names, changed, strict=True)
            if is_changed and not _MAY_CHANGE.match(n)
        ]
        if unexpected:
            return Verdict(
                "wrong",
                f"{name} changes {', '.join(unexpected[:5])} in its first frame",
                worst=worst,
                **same,
            )
    return Verdict("works", worst=worst, **same)


def _frame(
    aircraft: Aircraft, names: Sequence[str], coefficient: str | None
) -> tuple[NDArray[np.float64], float, list[float]]:
    """Return properties after SWITCHED_AFTER frames with one coefficient on, its delta, and force
    or moment per unit.
    """
    fdm, step = open_mid_envelope(aircraft)
    for k in range(SWITCHED_AFTER):
        step(k)
    if coefficient is not None:
        for name in COEFFICIENTS:
            engine.set_property(fdm, f"uq/{name}/active", float(name == coefficient))
        engine.set_property(fdm, f"uq/{coefficient}/level", 1.0)
        if not fdm[f"uq/{coefficient}/upper"]:
            # Without bounds, a delta of its own.
            engine.set_property(fdm, f"uq/{coefficient}/upper", DELTA)
        engine.set_property(fdm, "uq/active", 1.0)
    step(SWITCHED_AFTER)
    row = np.array([_get(fdm, name) for name in names])
    reference = aircraft.card.reference
    # The card's reference values, as the plugin uses them.
    S = reference.S_m2 / FT_M**2 if reference.S_m2 else fdm["metrics/Sw-sqft"]
    b = reference.b_m / FT_M if reference.b_m else fdm["metrics/bw-ft"]
    c = reference.c_m / FT_M if reference.c_m else fdm["metrics/cbarw-ft"]
    pressure = fdm["aero/qbar-psf"] * S
    delta = fdm[f"uq/{coefficient}/delta"] if coefficient is not None else 0.0
    return row, delta, [pressure, pressure, pressure, pressure * b, pressure * c, pressure * b]


def _fly(
    aircraft: Aircraft, steps: int, names: Sequence[str] | None
) -> tuple[list[str], NDArray[np.float64]]:
    """Return names and rows of properties, recorded every SAMPLE_EVERY frames."""
    fdm, step = open_mid_envelope(aircraft)
    recorded_names = list(names) if names is not None else _readable(fdm)
    rows = []
    for k in range(steps):
        step(k)
        if k % SAMPLE_EVERY == 0 or k == steps - 1:
            rows.append([_get(fdm, name) for name in recorded_names])
    return recorded_names, np.array(rows)


def _has_air(aircraft: Aircraft) -> bool:
    """Return whether the aircraft has the air system."""
    return bool(
        engine.open_fdm(staged(aircraft), aircraft.dt_s)
        .get_property_manager()
        .hasNode("air/wind-mps")
    )


def _readable(fdm: Any) -> list[str]:
    """Return the properties that can be compared."""
    manager = fdm.get_property_manager()
    names = dict.fromkeys(engine.catalog(fdm))
    return [name for name in names if manager.hasNode(name) and not _UNINITIALISED.fullmatch(name)]


def _get(fdm: Any, name: str) -> float:
    """Return the value of a property."""
    return float(fdm.get_property_value(name))


def check_in_child(
    untouched: Path, instrumented: Path, duration_s: float = DURATION_S, timeout_s: float = 300.0
) -> Verdict:
    """Check in a child process.

    If the child dies or takes longer than ``timeout_s`` [s], the verdict is ``fails``.
    """
    ended = run_module(__name__, untouched, instrumented, repr(duration_s), timeout_s=timeout_s)
    if ended.code is None:
        return Verdict("fails", f"no answer within {timeout_s:g} s")
    if ended.answer:
        return Verdict(**ended.answer)
    return Verdict(
        "fails",
        f"the process ended with {describe_exit(ended.code)}: {ended.errors or 'no message'}",
    )


def _main(untouched: str, instrumented: str, duration_s: str) -> None:
    """Check and answer the parent."""
    give_answer(
        asdict(check(find_aircraft(untouched), find_aircraft(instrumented), float(duration_s)))
    )


if __name__ == "__main__":
    _main(*sys.argv[1:4])
