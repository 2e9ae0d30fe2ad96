"""Where a mission flies: flight states of a few flights of a campaign, or of flight records."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.aerodynamics import smooth
from sysid.aerodynamics.terms import STATES
from sysid.arrays import FloatArray
from uqharness.campaign import Case, Mission, build_cases, find_mission, make_copy, needs_copy
from uqharness.campaign.folder import (
    describe,
    has_digests,
    read_cases,
    read_complete,
    refuse_if_different,
    spec_of,
)
from uqharness.campaign.spec import CampaignSpec
from uqharness.errors import BadInputError
from uqharness.flight import FlightSpec, record_mission, staged_mission
from uqharness.replay import read_flight
from uqharness.simulator import Aircraft
from uqharness.simulator import signals as properties

RATE_HZ = 10.0
LONGEST_S = 300.0
"""Of each flight; states of a mission that repeats itself are known by then."""
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Occupancy:
    """States of a mission, name -> (n,), evenly spaced in time. ``flights`` were flown, ``failed`` more did not end well."""

    states: Mapping[str, FloatArray]
    flights: int
    failed: int
    seconds: float
    source: str

    def of(self, names: Sequence[str]) -> dict[str, FloatArray]:
        """The named states. Raises BadInputError for one that is not known."""
        missing = [n for n in names if n not in self.states]
        if missing:
            raise BadInputError(
                f"the bounds depend on {', '.join(missing)}, which {self.source} does not tell; known are {', '.join(self.states)}"
            )
        return {n: self.states[n] for n in names}


@dataclass(frozen=True)
class CampaignMission:
    """A finished campaign opened to fly some of it again. ``cases`` are those that ended well, ``failed`` how many did not.

    ``same_aircraft`` False: made by uqharness 0.1, which left no identity that tells whether the aircraft is as it was.
    """

    folder: Path
    spec: CampaignSpec
    mission: Mission
    cases: tuple[Case, ...]
    failed: int
    same_aircraft: bool = True


def open_campaign(folder: Path) -> CampaignMission:
    """Raises BadInputError where the campaign's aircraft, script or versions are not what they were."""
    manifest = read_complete(folder)
    spec = spec_of(manifest)
    mission = find_mission(spec, folder)
    # What this version calls the same aircraft is not what 0.1 did: its hash may differ with not a byte changed.
    but_for = () if has_digests(manifest) else ("uqharness", "aircraft")
    refuse_if_different(folder, manifest, describe(spec, mission, manifest["cases"], ""), but_for)
    if needs_copy(spec):
        make_copy(spec, mission, folder)
    table = read_cases(folder, manifest)
    ok = set(table.loc[table["status"] == "ok", "case_id"])
    every = build_cases(spec, replace(mission, aircraft_hash=manifest["hashes"]["aircraft"]))
    flown = tuple(c for c in every if c.case_id in ok)
    return CampaignMission(
        folder, spec, mission, flown, len(table) - len(ok), has_digests(manifest)
    )


def some_cases(cases: Sequence[Case], count: int) -> list[Case]:
    """``count`` cases that are spread over air, conditions and epistemic samples alike."""
    air = list(dict.fromkeys(c.aleatory_id for c in cases))
    conditions = list(dict.fromkeys((c.wind_mps, c.turbulence) for c in cases))
    chosen: list[Case] = []
    for k in range(min(count, len(cases))):
        wanted = conditions[k % len(conditions)], air[(k // len(conditions)) % len(air)]
        there = [
            c
            for c in cases
            if ((c.wind_mps, c.turbulence), c.aleatory_id) == wanted and c not in chosen
        ]
        # Steps of the golden section never fall into step with the order of the corners.
        chosen += [there[int(len(there) * math.fmod(0.5 + k * _GOLDEN, 1.0))]] if there else []
    return chosen


def fly_mission(campaign: CampaignMission, count: int) -> Occupancy:
    """States of ``count`` of the campaign's flights, after their burn-in. Raises BadInputError if none ended well."""
    parts: list[dict[str, FloatArray]] = []
    failed, seconds = 0, 0.0
    for case in some_cases(campaign.cases, count):
        states, ok = _fly(case.flight)
        if ok:
            parts.append(states)
            seconds += len(next(iter(states.values()))) / RATE_HZ
        else:
            failed += 1
    if not parts:
        raise BadInputError(
            f"{campaign.folder}: all its flights failed, so the mission's flight states are not known; give records of complete "
            "flights with --occupancy FILE..."
        )
    names = [n for n in parts[0] if all(n in p for p in parts)]
    merged = {n: np.concatenate([p[n] for p in parts]) for n in names}
    return Occupancy(merged, len(parts), failed, seconds, f"campaign {campaign.folder}")


def _fly(spec: FlightSpec) -> tuple[dict[str, FloatArray], bool]:
    """States (n,) after the burn-in, true values as the bounds see them in a campaign, and whether the flight ended well."""
    mission = staged_mission(spec)
    table = {n: s for n, s in properties.sources(mission.aircraft).items() if n in STATES}
    needed = {n: s for n, s in table.items() if n in properties.STANDARD}
    optional = {
        **properties.standard_positions(),
        **{n: s for n, s in table.items() if n not in properties.STANDARD},
    }
    rate = min(RATE_HZ, 1.0 / mission.aircraft.dt_s)
    flight = replace(spec, duration_s=min(spec.duration_s, LONGEST_S), record_rate_hz=rate)
    recorded = record_mission(mission, flight, needed, optional)
    states = {n: np.asarray(v, dtype=float) for n, v in recorded.signals.items() if n != "time_s"}
    return states, recorded.status == "ok" and bool(len(next(iter(states.values()))))


def recorded_mission(paths: Sequence[Path], aircraft: Aircraft, cutoff_hz: float) -> Occupancy:
    """The same from flight records or logs of the mission, smoothed as the bounds' data were. Raises BadInputError."""
    parts: list[dict[str, FloatArray]] = []
    seconds = 0.0
    for path in paths:
        record = read_flight(path, aircraft)
        known = tuple(n for n in STATES if n in record and np.isfinite(record[n]).mean() > 0.5)
        stride = max(1, round(1.0 / (RATE_HZ * record.dt_s)))
        pieces = [
            {
                n: smooth(np.asarray(record[n][rows], dtype=float), record.dt_s, cutoff_hz)[
                    ::stride
                ]
                for n in known
            }
            for rows in record.segments(known, 1.0)
        ]
        if not pieces:
            raise BadInputError(
                f"--occupancy {path}: no second of it has all of {', '.join(known) or 'the states'}"
            )
        parts += pieces
        seconds += sum(len(p["V_mps"]) for p in pieces if "V_mps" in p) * stride * record.dt_s
    names = [n for n in parts[0] if all(n in p for p in parts)]
    merged = {n: np.concatenate([p[n] for p in parts]) for n in names}
    return Occupancy(merged, len(paths), 0, seconds, ", ".join(p.name for p in paths))
