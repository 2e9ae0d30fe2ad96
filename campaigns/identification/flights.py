"""The three flights of chapter 2 as DataFlash logs: one to identify from, one for bounds, one for
validation."""

from __future__ import annotations

import re
from pathlib import Path

from campaigns.library.study import uqharness_command
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.own_mission import PLANS, script
from uqharness.simulator.staging import copy_folder

FLIGHTS = ("flight-ident", "flight-bounds", "flight-validation")
FINE_STEP_S = 0.002
"""Step at which what JSBSim's integration does to a mode, (5/12)(rate x step)^2 of it, is far below
a standard error."""
PASSING_MPS = 22.2
"""Airspeed at the start of each flight (cruise.xml), at which `uqharness.flight.dryden` lets its
gusts pass from then on."""


def fly_flights(
    aircraft: str,
    folder: Path,
    seed: int,
    turbulence: str = "light",
    duration_s: float | None = None,
    suffix: str = ".bin",
    fine: bool = False,
) -> list[Path]:
    """Fly the three scripts (their first ``duration_s``) and write logs, DataFlash by default; the
    seed of flight k is seed + k.

    fine: with a step of FINE_STEP_S, by a copy of aircraft and scripts in ``folder``, in place of
    the card's. Raises BadInputError.
    """
    model = _finer(aircraft, folder / "fine") if fine else aircraft
    duration = () if duration_s is None else ("--duration-s", duration_s)
    paths = []
    for k, name in enumerate(FLIGHTS):
        path = folder / f"{aircraft}-{name}{suffix}"
        script = folder / "fine" / f"{name}.xml" if fine else name
        noise = ("--noise", "--seed", seed + k, "--turbulence", turbulence)
        words = ("fly", model, "--script", script, *noise, *duration, "--out", path)
        try:
            uqharness_command(*words, codes=(0,))
        except BadInputError as error:
            raise BadInputError(f"{aircraft}, {name}, seed {seed + k}: {error}") from error
        paths.append(path)
    return paths


def _finer(aircraft: str, folder: Path) -> str:
    """Write the aircraft and the scripts into ``folder`` for a step of FINE_STEP_S, and return the
    aircraft's folder."""
    copy = folder / aircraft
    copy_folder(find_aircraft(aircraft).folder, copy)
    card = copy / "airframe.toml"
    text, count = re.subn(
        r"(?m)^dt_s *=.*$", f"dt_s = {FINE_STEP_S}", card.read_text(encoding="utf-8")
    )
    if count != 1:
        raise BadInputError(
            f"{card}: {count} lines begin with dt_s; a flight at another step needs one"
        )
    card.write_text(text, encoding="utf-8")
    for plan in PLANS:
        (folder / f"{plan.name}.xml").write_text(script(plan, FINE_STEP_S), encoding="utf-8")
    return str(copy)
