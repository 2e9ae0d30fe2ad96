"""Test points that a next flight could consist of: which control, how far, how long, at which speed
and bank.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from lxml import etree

from sysid.aerodynamics import smooth
from sysid.aerodynamics.coefficients import STATES
from sysid.arrays import FloatArray
from sysid.units import G0_MPS2
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
from uqharness.simulator import MANOEUVRE_PROPERTY, SECOND_ORDER, Aircraft, InputCard, parse_xml
from uqharness.simulator import aircraft as properties

DOUBLET = ((1, 1.0), (1, -1.0))
THREE_TWO_ONE_ONE = ((3, 1.0), (2, -1.0), (1, 1.0), (1, -1.0))
QUIET_S = 1.0
"""Open loop before the first step: the segment's start state is estimated from it."""
REST_S = 3.0
STEADY_S = 6.0
AMPLITUDES = (0.1, 0.2, 0.35)
"""Of half the control's travel."""
_SURFACES = ("elevator", "aileron", "rudder")


@dataclass(frozen=True)
class Steps:
    """Steps of a control about where it stands: ``pattern`` of (units, sign), ``size`` in the
    control's unit, from ``start_s``.
    """

    control: str
    size: float
    unit_s: float
    pattern: tuple[tuple[int, float], ...] = DOUBLET
    start_s: float = 0.0

    @property
    def end_s(self) -> float:
        """When the last step ends [s]."""
        return self.start_s + self.unit_s * sum(units for units, _ in self.pattern)


@dataclass(frozen=True)
class Condition:
    """What a test point begins from: true airspeed and bank of a steady turn (0: straight, +
    right). None: as the mission flies.
    """

    speed_mps: float | None = None
    bank_deg: float = 0.0

    @property
    def text(self) -> str:
        """Speed and bank in words."""
        if self.speed_mps is None:
            return "as the mission flies"
        turn = f", {self.bank_deg:+.0f} deg bank" if self.bank_deg else ""
        return f"{self.speed_mps:.3g} m/s{turn}"


@dataclass(frozen=True)
class TestPoint:
    """``kind`` in words, the steps (none: steady flight, controls as they stand), and ``rest_s``
    after the last of them.
    """

    kind: str
    steps: tuple[Steps, ...]
    condition: Condition
    rest_s: float = REST_S

    # pytest takes a class of this name for tests.
    __test__ = False

    @property
    def name(self) -> str:
        """The point in words: kind and condition."""
        return f"{self.kind}, {self.condition.text}"

    @property
    def seconds(self) -> float:
        """From taking the controls over to giving them back."""
        return QUIET_S + max((s.end_s for s in self.steps), default=0.0) + self.rest_s


def half_travel(card: InputCard) -> float:
    """Half the way from stop to stop, in the control's own unit."""
    return 0.5 * (card.limits[1] - card.limits[0])


def library(
    aircraft: Aircraft, conditions: Sequence[Condition], unit_s: Mapping[str, float]
) -> list[TestPoint]:
    """Steady flight, doublets both ways, 3-2-1-1, throttle doublets and all axes in turn, at every
    condition.

    unit_s: seconds of one unit by control. Amplitudes follow the card's stops; which of them an
    aircraft bears, a simulation tells."""
    kinds = [*_kinds(aircraft, unit_s)]
    return [replace(point, condition=c) for c in conditions for point in kinds]


def _kinds(aircraft: Aircraft, unit_s: Mapping[str, float]) -> Iterator[TestPoint]:
    nowhere = Condition()
    inputs = aircraft.card.inputs
    yield TestPoint("steady", (), nowhere, STEADY_S)
    for control in (c for c in _SURFACES if c in inputs):
        unit, travel, what = unit_s[control], half_travel(inputs[control]), inputs[control].unit
        for share in AMPLITUDES:
            for sign in (1.0, -1.0):
                size = _rounded(sign * share * travel)
                yield TestPoint(
                    f"{control} doublet {size:+g} {what}", (Steps(control, size, unit),), nowhere
                )
    if "elevator" in inputs:
        travel, what = half_travel(inputs["elevator"]), inputs["elevator"].unit
        for share in (-0.1, 0.1):
            size = _rounded(share * travel)
            steps = Steps("elevator", size, 0.7 * unit_s["elevator"], THREE_TWO_ONE_ONE)
            yield TestPoint(f"elevator 3-2-1-1 {size:+g} {what}", (steps,), nowhere)
    if "throttle" in inputs:
        travel, what = half_travel(inputs["throttle"]), inputs["throttle"].unit
        for share in (0.4, -0.4):
            size = _rounded(share * travel)
            steps = Steps("throttle", size, unit_s["throttle"])
            yield TestPoint(f"throttle doublet {size:+g} {what}", (steps,), nowhere, 1.5)
    surfaces = [c for c in _SURFACES if c in inputs]
    if len(surfaces) > 1:
        for share in (0.1, 0.2):
            start, steps_of = 0.0, list[Steps]()
            for control in surfaces:
                size = _rounded(
                    (0.6 if control == "elevator" else 1.0) * share * half_travel(inputs[control])
                )
                steps_of.append(Steps(control, size, unit_s[control], start_s=start))
                # The next axis begins while this one still moves: this separates products of
                # states.
                start += 1.5 * unit_s[control]
            yield TestPoint(
                f"doublets of {', '.join(surfaces)} {share:.0%}", tuple(steps_of), nowhere
            )


def _rounded(size: float) -> float:
    """Two figures: what a pilot or an operator can be told."""
    return float(f"{size:.2g}")


# The run script of a flight of test points: the mission's own script with manoeuvres added to
# it.
#
# With this project's autopilot (property ap/engaged) a test point is flown open loop: the
# surfaces' and the motor's positions become the commands, the autopilot lets go, the steps are
# added, the autopilot recovers, and between conditions it changes speed and bank. Any other
# aircraft goes on flying its mission, under whatever holds it there, and the steps are added to
# its commands.

AUTOPILOT = (
    "ap/engaged",
    "ap/airspeed-cmd-mps",
    "ap/WP_LOITER_RAD",
    "ap/loiter-center-north-m",
    "ap/loiter-center-east-m",
    "ap/loiter-direction",
    "nav/north-m",
    "nav/east-m",
    "nav/altitude-error-m",
)
"""Properties by which this project's autopilot is known."""
RECOVERY_S = 8.0
"""On the autopilot after a point: from an unsettled state, controls that stand still lead into a
dive.
"""
TRANSITION_S = 14.0
"""To another speed or bank, on the autopilot."""
MOST_BANK_RAD, MOST_PITCH_RAD, MOST_LOSS_M = math.radians(60.0), math.radians(30.0), 35.0
"""Where the safety pilot takes over: bank, pitch, height below the commanded one."""
_WIDE_M = 3000.0  # radius of a circle that counts as straight: 1 deg of bank at 22 m/s
_GENTLE_S, _FIRM_S = 30.0, 17.0  # navigation period on straights and in turns


@dataclass(frozen=True)
class Timed:
    """A test point and when it begins and ends, s of the flight."""

    point: TestPoint
    start_s: float
    end_s: float


def schedule(points: Sequence[TestPoint], begin_s: float) -> tuple[list[Timed], float]:
    """When each point is flown, and the end of the flight. Points of one condition should stand
    together.

    begin_s: when the mission has settled and the first transition may begin.
    """
    time, last, out = begin_s, None, list[Timed]()
    for point in points:
        if point.condition != last:
            time += TRANSITION_S if point.condition.speed_mps is not None else 0.0
            last = point.condition
        out.append(Timed(point, round(time, 3), round(time + point.seconds, 3)))
        time += point.seconds + RECOVERY_S
    return out, round(time, 3)


def script_text(
    mission: Path,
    aircraft: Aircraft,
    points: Sequence[TestPoint],
    begin_s: float,
    has_autopilot: bool,
    name: str,
    purpose: str,
) -> bytes:
    """The script as XML: the file ``mission`` with the points of `schedule` added.

    Raises BadInputError as parse_xml does.
    """
    tree = parse_xml(mission)
    root = tree.getroot()
    run = root.find("run")
    assert run is not None
    timed, end_s = schedule(points, begin_s)
    root.set("name", name)
    description = root.find("description")
    if description is None:
        description = etree.Element("description")
        description.tail = "\n  "
        root.insert(0, description)
    description.text = f"{purpose}: {len(points)} test points"
    use = root.find("use")
    assert use is not None
    use.set("aircraft", aircraft.name)
    for output in root.findall("output"):
        root.remove(output)
    run.set("end", f"{end_s:g}")
    run.set("dt", f"{aircraft.dt_s:g}")
    present = {(item.text or "").strip(): item for item in run.findall("property")}
    # The mission's own air is not that of a test flight: a host sets what it wants.
    calm: dict[str, float] = {
        name: 0.0 for name in ("air/wind-mps", "air/turbulence-w20-kt") if name in present
    }
    log = {"sensor/log": 1.0} if "sensor/log" in present else {}
    wanted: dict[str, float] = {**SECOND_ORDER, MANOEUVRE_PROPERTY: 0.0, **calm, **log}
    for prop, value in wanted.items():
        if prop in present:
            present[prop].set("value", f"{value:g}")
        else:
            item = etree.Element("property", value=f"{value:g}")
            item.text, item.tail = prop, "\n    "
            run.insert(0, item)
    events = [*_events(timed, aircraft, has_autopilot)]
    if len(run):
        run[-1].tail = "\n    "
    for item in events:
        etree.indent(item, "  ", level=2)
        item.tail = "\n    "
        run.append(item)
    events[-1].tail = "\n  "
    # Comments above the mission's root are left out: they tell of the mission.
    said = (
        f"\n  {purpose}, made by uqharness next-flight from {mission.name}, in still air unless the"
        f" host says otherwise.\n  {MANOEUVRE_PROPERTY} counts the test points, 0 in between; the"
        " event that sets a number bears the point's name.\n"
    )
    body = etree.tostring(root, encoding="unicode", with_tail=False)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<!--{said}-->\n{body}\n'.encode()


def _events(
    timed: Sequence[Timed], aircraft: Aircraft, has_autopilot: bool
) -> Iterator[etree._Element]:
    early = 0.5 * aircraft.dt_s  # so that rounding of the clock cannot shift an event by a frame
    last: Condition | None = None
    if has_autopilot:
        yield _safety_pilot()
    for number, item in enumerate(timed, start=1):
        condition = item.point.condition
        if has_autopilot and condition.speed_mps is not None and condition != last:
            at = item.start_s - TRANSITION_S
            yield _event(f"{at:.2f} s, to {condition.text}", at - early, [*_heading_for(condition)])
        last = condition
        taking = [*_take_over(aircraft)] if has_autopilot else []
        yield _event(
            item.point.name, item.start_s - early, [*taking, _set(MANOEUVRE_PROPERTY, number)]
        )
        changes: dict[float, list[tuple[str, float]]] = {}
        for steps in item.point.steps:
            time, before = item.start_s + QUIET_S + steps.start_s, 0.0
            for units, sign in (*steps.pattern, (0, 0.0)):
                changes.setdefault(round(time, 4), []).append(
                    (steps.control, steps.size * (sign - before))
                )
                before, time = sign, time + units * steps.unit_s
        for at, moves in sorted(changes.items()):
            said = ", ".join(f"{control} {delta:+g}" for control, delta in moves)
            sets = [
                _delta(aircraft.card.inputs[control].property, delta) for control, delta in moves
            ]
            yield _event(f"{at:.2f} s, {said}", at - early, sets)
        giving = [_set("ap/engaged", 1), *_heading_for(condition)] if has_autopilot else []
        yield _event(
            f"{item.end_s:.2f} s, end of {number}",
            item.end_s - early,
            [*giving, _set(MANOEUVRE_PROPERTY, 0)],
        )


def _safety_pilot() -> etree._Element:
    """Ends a point whose attitude or height gets out of hand: the autopilot takes over, and the
    point's record ends there.
    """
    event = etree.Element("event", name="safety pilot", persistent="true")
    condition = etree.SubElement(event, "condition", logic="OR")
    condition.text = (
        "".join(
            f"\n        {name} {sign} {value:g}"
            for name, sign, value in (
                ("attitude/phi-rad", "gt", MOST_BANK_RAD),
                ("attitude/phi-rad", "lt", -MOST_BANK_RAD),
                ("attitude/theta-rad", "gt", MOST_PITCH_RAD),
                ("attitude/theta-rad", "lt", -MOST_PITCH_RAD),
                ("nav/altitude-error-m", "lt", -MOST_LOSS_M),
            )
        )
        + "\n      "
    )
    event.extend([_set("ap/engaged", 1), _set(MANOEUVRE_PROPERTY, 0)])
    return event


def _event(name: str, time_s: float, sets: Sequence[etree._Element]) -> etree._Element:
    event = etree.Element("event", name=name)
    condition = etree.SubElement(event, "condition")
    condition.text = f"simulation/sim-time-sec ge {time_s:.4f}"
    event.extend(sets)
    return event


def _set(name: str, value: float) -> etree._Element:
    return etree.Element("set", name=name, value=f"{value:.6g}")


def _delta(name: str, value: float) -> etree._Element:
    return etree.Element("set", name=name, type="FG_DELTA", value=f"{value:.6g}")


def _computed(name: str, function: str) -> etree._Element:
    item = etree.Element("set", name=name)
    item.append(etree.fromstring(f"<function>{function}</function>"))
    return item


def _take_over(aircraft: Aircraft) -> Iterator[etree._Element]:
    """Commands to where the controls stand, then the autopilot lets go."""
    for card in aircraft.card.inputs.values():
        source = _stands_at(card)
        if source is not None:
            yield _computed(
                card.property, f"<sum><property>{source}</property><value>0</value></sum>"
            )
    yield _set("ap/engaged", 0)


def _stands_at(card: InputCard) -> str | None:
    """Property that says, in the command's own unit, where a control stands."""
    return (
        card.position
        if card.position is not None and card.unit in ("deg", "pct", "rad")
        else card.selected
    )


def _heading_for(condition: Condition) -> Iterator[etree._Element]:
    """Speed, and a circle that begins here and now: its centre abeam, so that no transition to it
    is flown.
    """
    if condition.speed_mps is None:
        return
    bank = math.radians(abs(condition.bank_deg))
    radius = condition.speed_mps**2 / (G0_MPS2 * math.tan(bank)) if bank > 1e-3 else _WIDE_M
    radius = min(radius, _WIDE_M)
    side = -1.0 if condition.bank_deg < 0.0 else 1.0
    yield _set("ap/airspeed-cmd-mps", condition.speed_mps)
    yield _set("ap/WP_LOITER_RAD", round(radius, 1))
    yield _set("ap/loiter-direction", side)
    yield _set("ap/NAVL1_PERIOD", _FIRM_S if radius < _WIDE_M else _GENTLE_S)
    for axis, trig, sign in (("north", "sin", -side), ("east", "cos", side)):
        yield _computed(
            f"ap/loiter-center-{axis}-m",
            f"<sum><property>nav/{axis}-m</property><product><value>{sign * radius:.1f}</value>"
            f"<{trig}><property>attitude/psi-rad</property></{trig}></product></sum>",
        )


# Where a mission flies: flight states of a few flights of a campaign, or of flight records.

RATE_HZ = 10.0
LONGEST_S = 300.0
"""Of each flight; states of a mission that repeats itself are known by then."""
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Occupancy:
    """States of a mission, name -> (n,), evenly spaced in time.

    ``flights`` were flown, ``failed`` more did not end well.
    """

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
                f"the bounds depend on {', '.join(missing)}, which {self.source} does not tell;"
                f" known are {', '.join(self.states)}"
            )
        return {n: self.states[n] for n in names}


@dataclass(frozen=True)
class CampaignMission:
    """A finished campaign opened to fly some of it again. ``cases`` are those that ended well,
    ``failed`` how many did not.

    ``same_aircraft`` False: made by uqharness 0.1, which left no identity that tells whether the
    aircraft is as it was."""

    folder: Path
    spec: CampaignSpec
    mission: Mission
    cases: tuple[Case, ...]
    failed: int
    same_aircraft: bool = True


def open_campaign(folder: Path) -> CampaignMission:
    """Raises BadInputError where the campaign's aircraft, script or versions are not what they
    were.
    """
    manifest = read_complete(folder)
    spec = spec_of(manifest)
    mission = find_mission(spec, folder)
    # What this version calls the same aircraft is not what 0.1 did: its hash may differ with not a
    # byte changed.
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
    """States of ``count`` of the campaign's flights, after their burn-in.

    Raises BadInputError if none ended well.
    """
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
            f"{campaign.folder}: all its flights failed, so the mission's flight states are not"
            " known; give records of complete flights with --occupancy FILE..."
        )
    names = [n for n in parts[0] if all(n in p for p in parts)]
    merged = {n: np.concatenate([p[n] for p in parts]) for n in names}
    return Occupancy(merged, len(parts), failed, seconds, f"campaign {campaign.folder}")


def _fly(spec: FlightSpec) -> tuple[dict[str, FloatArray], bool]:
    """States (n,) after the burn-in, true values as the bounds see them in a campaign, and whether
    the flight ended well.
    """
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
    """The same from flight records or logs of the mission, smoothed as the bounds' data were.

    Raises BadInputError.
    """
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
