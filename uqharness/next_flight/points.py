"""Define test points, write the script that flies them, and collect the states of a mission.

A test point is a control input about a steady condition (speed and bank): doublets, 3-2-1-1 inputs,
throttle steps, or none. `library` lists the points that an aircraft can try, `script_text` adds
them to a mission's run script, and `fly_mission` and `recorded_mission` return the flight states
(`Occupancy`) over which intervals are averaged.
`try_points` flies each point once and keeps those within the limits of states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np
from lxml import etree

from sysid.aerodynamics import Cutoffs, Residuals, smooth
from sysid.aerodynamics.coefficients import STATES
from sysid.arrays import FloatArray
from sysid.errors import LogError
from sysid.units import G0_MPS2
from uqharness.campaign import (
    CampaignSpec,
    Case,
    Mission,
    build_cases,
    describe,
    find_mission,
    has_digests,
    make_copy,
    needs_copy,
    read_cases,
    read_complete,
    refuse_if_different,
    spec_of,
)
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder
from uqharness.flight import (
    DEFAULT_TURBULENCE_SOURCE,
    FlightSpec,
    record_mission,
    recorded_flight,
    staged_mission,
    turbulence_and_noise_seeds,
    write_record,
)
from uqharness.replay import flight_residuals, prediction_of, read_bounds_flights, read_flight
from uqharness.simulator import (
    MANOEUVRE_PROPERTY,
    SECOND_ORDER,
    Aircraft,
    InputCard,
    SteadyCondition,
    find_trim,
    linearise,
    modes,
    open_aircraft,
    parse_xml,
    read_script,
)
from uqharness.simulator import aircraft as properties

DOUBLET = ((1, 1.0), (1, -1.0))
THREE_TWO_ONE_ONE = ((3, 1.0), (2, -1.0), (1, 1.0), (1, -1.0))
QUIET_S = 1.0
"""Open loop before the first step, from which the segment's start state is estimated."""
REST_S = 3.0
STEADY_S = 6.0
AMPLITUDES = (0.1, 0.2, 0.35)
"""Shares of half the control's travel."""
_SURFACES = ("elevator", "aileron", "rudder")


@dataclass(frozen=True)
class Steps:
    """A sequence of steps of one control about its position.

    Attributes
    ----------
    control : str
        Name of the input.
    size : float
        Amplitude of a step [unit of the control].
    unit_s : float
        Duration of one unit.
    pattern : tuple of (int, float)
        Units and sign of each step.
    start_s : float
        Start after the point's quiet time.
    """

    control: str
    size: float
    unit_s: float
    pattern: tuple[tuple[int, float], ...] = DOUBLET
    start_s: float = 0.0

    @property
    def end_s(self) -> float:
        """End of the last step [s]."""
        return self.start_s + self.unit_s * sum(units for units, _ in self.pattern)


@dataclass(frozen=True)
class Condition:
    """Steady condition from which a test point starts.

    ``speed_mps`` is true airspeed; ``bank_deg`` is that of a steady turn, positive to the right.
    Speed None: whatever the mission flies.
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
    """A control input at a condition.

    Attributes
    ----------
    kind : str
        The input in words.
    steps : tuple of Steps
        Empty for steady flight with fixed controls.
    condition : Condition
        Speed and bank.
    rest_s : float
        Seconds without inputs after the last step.
    """

    kind: str
    steps: tuple[Steps, ...]
    condition: Condition
    rest_s: float = REST_S

    # pytest would collect a class of this name as tests.
    __test__ = False

    @property
    def name(self) -> str:
        """Kind and condition in words."""
        return f"{self.kind}, {self.condition.text}"

    @property
    def seconds(self) -> float:
        """Time from taking over the controls to handing them back [s]."""
        return QUIET_S + max((s.end_s for s in self.steps), default=0.0) + self.rest_s


def half_travel(card: InputCard) -> float:
    """Return half the distance between the stops of a control [its unit]."""
    return 0.5 * (card.limits[1] - card.limits[0])


def library(
    aircraft: Aircraft, conditions: Sequence[Condition], unit_s: Mapping[str, float]
) -> list[TestPoint]:
    """List the test points of an aircraft at every condition.

    Steady flight; doublets of each surface in both directions; 3-2-1-1 of the elevator; throttle
    doublets; doublets of all surfaces one after the other. Amplitudes are shares of the card's half
    travel; `trials.try_points` finds those that the aircraft can fly.

    Parameters
    ----------
    aircraft : Aircraft
        Its card names inputs and stops.
    conditions : sequence of Condition
        Speeds and banks.
    unit_s : mapping
        Control -> seconds of one unit of its pattern.

    Returns
    -------
    list of TestPoint
        Grouped by condition.
    """
    kinds = [*_kinds(aircraft, unit_s)]
    return [replace(point, condition=c) for c in conditions for point in kinds]


def _kinds(aircraft: Aircraft, unit_s: Mapping[str, float]) -> Iterator[TestPoint]:
    """Yield the test points of one condition."""
    any_condition = Condition()
    inputs = aircraft.card.inputs
    yield TestPoint("steady", (), any_condition, STEADY_S)
    # Doublets of each surface, both directions first
    for control in (c for c in _SURFACES if c in inputs):
        unit, travel, unit_name = (
            unit_s[control],
            half_travel(inputs[control]),
            inputs[control].unit,
        )
        for share in AMPLITUDES:
            for sign in (1.0, -1.0):
                size = _round_size(sign * share * travel)
                yield TestPoint(
                    f"{control} doublet {size:+g} {unit_name}",
                    (Steps(control, size, unit),),
                    any_condition,
                )
    if "elevator" in inputs:
        travel, unit_name = half_travel(inputs["elevator"]), inputs["elevator"].unit
        for share in (-0.1, 0.1):
            size = _round_size(share * travel)
            steps = Steps("elevator", size, 0.7 * unit_s["elevator"], THREE_TWO_ONE_ONE)
            yield TestPoint(f"elevator 3-2-1-1 {size:+g} {unit_name}", (steps,), any_condition)
    # The engine answers more slowly than surfaces do.
    if "throttle" in inputs:
        travel, unit_name = half_travel(inputs["throttle"]), inputs["throttle"].unit
        for share in (0.4, -0.4):
            size = _round_size(share * travel)
            steps = Steps("throttle", size, unit_s["throttle"])
            yield TestPoint(f"throttle doublet {size:+g} {unit_name}", (steps,), any_condition, 1.5)
    surfaces = [c for c in _SURFACES if c in inputs]
    # All surfaces one after the other, in one point
    if len(surfaces) > 1:
        for share in (0.1, 0.2):
            start, steps_of = 0.0, list[Steps]()
            for control in surfaces:
                size = _round_size(
                    (0.6 if control == "elevator" else 1.0) * share * half_travel(inputs[control])
                )
                steps_of.append(Steps(control, size, unit_s[control], start_s=start))
                # The next axis starts while this one still moves, which separates products of
                # states.
                start += 1.5 * unit_s[control]
            yield TestPoint(
                f"doublets of {', '.join(surfaces)} {share:.0%}", tuple(steps_of), any_condition
            )


def _round_size(size: float) -> float:
    """Round to two figures, as an operator would read them."""
    return float(f"{size:.2g}")


# The run script: the mission's script with events that fly the test points. With this project's
# autopilot (property ap/engaged) a point is flown open loop: the positions of surfaces and motor
# become the commands, the autopilot is disengaged, the steps are added, the autopilot recovers,
# and between conditions it changes speed and bank. Other aircraft keep flying their mission, and
# the steps are added to its commands.

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
"""Properties that identify this project's autopilot."""
RECOVERY_S = 8.0
"""Time on the autopilot after a point; without it fixed controls lead into a dive."""
TRANSITION_S = 14.0
"""Time on the autopilot to reach another speed or bank."""
MAX_BANK_RAD, MAX_PITCH_RAD, MAX_HEIGHT_LOSS_M = math.radians(60.0), math.radians(30.0), 35.0
"""Limits at which the safety pilot takes over: bank, pitch, height below the commanded one."""
_STRAIGHT_RADIUS_M = 3000.0  # radius of a circle that counts as straight: 1 deg of bank at 22 m/s
_STRAIGHT_PERIOD_S, _TURN_PERIOD_S = 30.0, 17.0  # navigation period on straights and in turns


@dataclass(frozen=True)
class ScheduledPoint:
    """A test point with its start and end [s of the flight]."""

    point: TestPoint
    start_s: float
    end_s: float


def schedule(points: Sequence[TestPoint], begin_s: float) -> tuple[list[ScheduledPoint], float]:
    """Compute when each point is flown.

    Parameters
    ----------
    points : sequence of TestPoint
        In the order of the flight; points of one condition should be adjacent.
    begin_s : float
        When the mission has settled and the first transition may start.

    Returns
    -------
    points : list of ScheduledPoint
    end_s : float
        End of the flight.

    Examples
    --------
    >>> timed, end_s = schedule([TestPoint("steady", (), Condition(), STEADY_S)], 4.0)
    >>> timed[0].start_s, timed[0].end_s, end_s
    (4.0, 11.0, 19.0)
    """
    time, last, out = begin_s, None, list[ScheduledPoint]()
    for point in points:
        # A new condition needs a transition.
        if point.condition != last:
            time += TRANSITION_S if point.condition.speed_mps is not None else 0.0
            last = point.condition
        out.append(ScheduledPoint(point, round(time, 3), round(time + point.seconds, 3)))
        time += point.seconds + RECOVERY_S
    return out, round(time, 3)


def script_text(
    mission: Path,
    aircraft: Aircraft,
    points: Sequence[TestPoint],
    begin_s: float,
    has_autopilot: bool,
    name: str,
    *,
    purpose: str,
) -> bytes:
    """Write the run script of a flight of test points.

    Parameters
    ----------
    mission : Path
        Script of the mission; it is read, not changed.
    aircraft : Aircraft
        Aircraft that flies.
    points : sequence of TestPoint
        In the order of the flight.
    begin_s : float
        When the first transition may start.
    has_autopilot : bool
        Whether points are flown open loop with this project's autopilot between them.
    name, purpose : str
        Name of the script, and first words of its description.

    Returns
    -------
    bytes
        The script as XML.

    Raises
    ------
    BadInputError
        If the mission's script cannot be parsed.
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
    # Properties that the script sets already are changed, others added.
    present = {(item.text or "").strip(): item for item in run.findall("property")}
    # The flight starts in still air without output files; the host sets wind and turbulence.
    calm: dict[str, float] = {
        name: 0.0 for name in ("air/wind-mps", "air/turbulence-w20-kt") if name in present
    }
    log = {"sensor/log": 1.0} if "sensor/log" in present else {}
    initial_values: dict[str, float] = {**SECOND_ORDER, MANOEUVRE_PROPERTY: 0.0, **calm, **log}
    for prop, value in initial_values.items():
        if prop in present:
            present[prop].set("value", f"{value:g}")
        else:
            item = etree.Element("property", value=f"{value:g}")
            item.text, item.tail = prop, "\n    "
            run.insert(0, item)
    # Events keep the script's indentation.
    events = [*_events(timed, aircraft, has_autopilot)]
    if len(run):
        run[-1].tail = "\n    "
    for item in events:
        etree.indent(item, "  ", level=2)
        item.tail = "\n    "
        run.append(item)
    events[-1].tail = "\n  "
    # Comments above the mission's root describe the mission and are left out.
    comment = (
        f"\n  {purpose}, made by uqharness next-flight from {mission.name}, in still air unless the"
        f" host says otherwise.\n  {MANOEUVRE_PROPERTY} counts the test points, 0 in between; the"
        " event that sets a number bears the point's name.\n"
    )
    body = etree.tostring(root, encoding="unicode", with_tail=False)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<!--{comment}-->\n{body}\n'.encode()


def _events(
    timed: Sequence[ScheduledPoint], aircraft: Aircraft, has_autopilot: bool
) -> Iterator[etree._Element]:
    """Yield the events of all test points, with a safety pilot if there is an autopilot."""
    half_frame_s = (
        0.5 * aircraft.dt_s
    )  # so that rounding of the clock cannot shift an event by a frame
    last: Condition | None = None
    if has_autopilot:
        yield _safety_pilot()
    for number, item in enumerate(timed, start=1):
        condition = item.point.condition
        # Change speed and bank before the first point of a condition.
        if has_autopilot and condition.speed_mps is not None and condition != last:
            at = item.start_s - TRANSITION_S
            yield _event(
                f"{at:.2f} s, to {condition.text}", at - half_frame_s, [*_set_turn(condition)]
            )
        last = condition
        take_over = [*_take_over(aircraft)] if has_autopilot else []
        yield _event(
            item.point.name,
            item.start_s - half_frame_s,
            [*take_over, _set(MANOEUVRE_PROPERTY, number)],
        )
        # Each step becomes a change relative to the step before; changes at one time share an
        # event.
        changes: dict[float, list[tuple[str, float]]] = {}
        for steps in item.point.steps:
            time, previous = item.start_s + QUIET_S + steps.start_s, 0.0
            for units, sign in (*steps.pattern, (0, 0.0)):
                changes.setdefault(round(time, 4), []).append(
                    (steps.control, steps.size * (sign - previous))
                )
                previous, time = sign, time + units * steps.unit_s
        for at, moves in sorted(changes.items()):
            move_words = ", ".join(f"{control} {delta:+g}" for control, delta in moves)
            sets = [
                _delta(aircraft.card.inputs[control].property, delta) for control, delta in moves
            ]
            yield _event(f"{at:.2f} s, {move_words}", at - half_frame_s, sets)
        # The autopilot takes over again after the point.
        hand_back = [_set("ap/engaged", 1), *_set_turn(condition)] if has_autopilot else []
        yield _event(
            f"{item.end_s:.2f} s, end of {number}",
            item.end_s - half_frame_s,
            [*hand_back, _set(MANOEUVRE_PROPERTY, 0)],
        )


def _safety_pilot() -> etree._Element:
    """Return the event that ends a point if attitude or height leave the limits: the autopilot
    takes over, and the point's record ends.
    """
    event = etree.Element("event", name="safety pilot", persistent="true")
    condition = etree.SubElement(event, "condition", logic="OR")
    condition.text = (
        "".join(
            f"\n        {name} {sign} {value:g}"
            for name, sign, value in (
                ("attitude/phi-rad", "gt", MAX_BANK_RAD),
                ("attitude/phi-rad", "lt", -MAX_BANK_RAD),
                ("attitude/theta-rad", "gt", MAX_PITCH_RAD),
                ("attitude/theta-rad", "lt", -MAX_PITCH_RAD),
                ("nav/altitude-error-m", "lt", -MAX_HEIGHT_LOSS_M),
            )
        )
        + "\n      "
    )
    event.extend([_set("ap/engaged", 1), _set(MANOEUVRE_PROPERTY, 0)])
    return event


def _event(name: str, time_s: float, sets: Sequence[etree._Element]) -> etree._Element:
    """Return an event at a time of the simulation."""
    event = etree.Element("event", name=name)
    condition = etree.SubElement(event, "condition")
    condition.text = f"simulation/sim-time-sec ge {time_s:.4f}"
    event.extend(sets)
    return event


def _set(name: str, value: float) -> etree._Element:
    """Return an action that sets a property to a number."""
    return etree.Element("set", name=name, value=f"{value:.6g}")


def _delta(name: str, value: float) -> etree._Element:
    """Return an action that adds a number to a property."""
    return etree.Element("set", name=name, type="FG_DELTA", value=f"{value:.6g}")


def _computed(name: str, function: str) -> etree._Element:
    """Return an action that sets a property to the value of a function."""
    item = etree.Element("set", name=name)
    item.append(etree.fromstring(f"<function>{function}</function>"))
    return item


def _take_over(aircraft: Aircraft) -> Iterator[etree._Element]:
    """Set commands to the positions of the controls, then disengage the autopilot."""
    for card in aircraft.card.inputs.values():
        source = _position_property(card)
        if source is not None:
            yield _computed(
                card.property, f"<sum><property>{source}</property><value>0</value></sum>"
            )
    yield _set("ap/engaged", 0)


def _position_property(card: InputCard) -> str | None:
    """Return the property with the position of a control in the unit of its command."""
    return (
        card.position
        if card.position is not None and card.unit in ("deg", "pct", "rad")
        else card.selected
    )


def _set_turn(condition: Condition) -> Iterator[etree._Element]:
    """Command the speed and a circle of the condition's bank.

    The circle's centre is abeam of the present position, so that the turn starts at once. R = V^2 /
    (g tan(bank)); a radius of 3 km counts as straight.
    """
    if condition.speed_mps is None:
        return
    bank = math.radians(abs(condition.bank_deg))
    radius = (
        condition.speed_mps**2 / (G0_MPS2 * math.tan(bank)) if bank > 1e-3 else _STRAIGHT_RADIUS_M
    )
    radius = min(radius, _STRAIGHT_RADIUS_M)
    side = -1.0 if condition.bank_deg < 0.0 else 1.0
    yield _set("ap/airspeed-cmd-mps", condition.speed_mps)
    yield _set("ap/WP_LOITER_RAD", round(radius, 1))
    yield _set("ap/loiter-direction", side)
    yield _set(
        "ap/NAVL1_PERIOD", _TURN_PERIOD_S if radius < _STRAIGHT_RADIUS_M else _STRAIGHT_PERIOD_S
    )
    for axis, trig, sign in (("north", "sin", -side), ("east", "cos", side)):
        yield _computed(
            f"ap/loiter-center-{axis}-m",
            f"<sum><property>nav/{axis}-m</property><product><value>{sign * radius:.1f}</value>"
            f"<{trig}><property>attitude/psi-rad</property></{trig}></product></sum>",
        )


# States of a mission: from flights of a campaign, or from flight records.

RATE_HZ = 10.0
MAX_FLIGHT_S = 300.0
"""Length that is simulated of each flight; enough for a mission that repeats itself."""
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Occupancy:
    """Flight states of a mission.

    Attributes
    ----------
    states : mapping
        State -> values (n,), evenly spaced in time.
    flights, failed : int
        Flights behind them, and flights that did not reach their end.
    seconds : float
        Total time.
    source : str
        Where they come from, for messages.
    """

    states: Mapping[str, FloatArray]
    flights: int
    failed: int
    seconds: float
    source: str

    def of(self, names: Sequence[str]) -> dict[str, FloatArray]:
        """Return the named states; BadInputError if one is not available."""
        missing = [n for n in names if n not in self.states]
        if missing:
            raise BadInputError(
                f"the bounds depend on {', '.join(missing)}, which {self.source} lacks; it has"
                f" {', '.join(self.states)}"
            )
        return {n: self.states[n] for n in names}


@dataclass(frozen=True)
class CampaignMission:
    """A finished campaign that is opened to repeat some of its flights.

    Attributes
    ----------
    folder : Path
        Its folder.
    spec : CampaignSpec
        Its settings.
    mission : Mission
        Aircraft and script.
    cases : tuple of Case
        Flights that reached their end.
    failed : int
        Number of the others.
    same_aircraft : bool
        False for campaigns of uqharness 0.1, which did not store whether the aircraft is unchanged.
    """

    folder: Path
    spec: CampaignSpec
    mission: Mission
    cases: tuple[Case, ...]
    failed: int
    same_aircraft: bool = True


def open_campaign(folder: Path) -> CampaignMission:
    """Open a finished campaign.

    Raises BadInputError if its aircraft, script or versions have changed.
    """
    manifest = read_complete(folder)
    spec = spec_of(manifest)
    mission = find_mission(spec, folder)
    # uqharness 0.1 hashed aircraft differently, so its hash says nothing about changes.
    ignored_keys = () if has_digests(manifest) else ("uqharness", "aircraft")
    refuse_if_different(
        folder, manifest, describe(spec, mission, manifest["cases"], ""), ignored_keys
    )
    if needs_copy(spec):
        make_copy(spec, mission, folder)
    table = read_cases(folder, manifest)
    ok = set(table.loc[table["status"] == "ok", "case_id"])
    all_cases = build_cases(spec, replace(mission, aircraft_hash=manifest["hashes"]["aircraft"]))
    # Only flights that reached their end are repeated.
    good_cases = tuple(c for c in all_cases if c.case_id in ok)
    return CampaignMission(
        folder, spec, mission, good_cases, len(table) - len(ok), has_digests(manifest)
    )


def some_cases(cases: Sequence[Case], count: int) -> list[Case]:
    """Choose cases spread evenly over air, conditions and epistemic samples.

    Parameters
    ----------
    cases : sequence of Case
        All cases.
    count : int
        Number to choose; fewer are returned if there are fewer.
    """
    air = list(dict.fromkeys(c.aleatory_id for c in cases))
    conditions = list(dict.fromkeys((c.wind_mps, c.turbulence) for c in cases))
    chosen: list[Case] = []
    for k in range(min(count, len(cases))):
        target = conditions[k % len(conditions)], air[(k // len(conditions)) % len(air)]
        candidates = [
            c
            for c in cases
            if ((c.wind_mps, c.turbulence), c.aleatory_id) == target and c not in chosen
        ]
        # Steps of the golden section do not align with the order of the corners.
        chosen += (
            [candidates[int(len(candidates) * math.fmod(0.5 + k * _GOLDEN, 1.0))]]
            if candidates
            else []
        )
    return chosen


def fly_mission(campaign: CampaignMission, count: int) -> Occupancy:
    """Fly some cases of a campaign again and return the states after their burn-in.

    Parameters
    ----------
    campaign : CampaignMission
        The campaign.
    count : int
        Flights.

    Raises
    ------
    BadInputError
        If none reached its end.
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
    """Return the true states (n,) after the burn-in, and whether the flight reached its end."""
    mission = staged_mission(spec)
    table = {n: s for n, s in properties.sources(mission.aircraft).items() if n in STATES}
    needed = {n: s for n, s in table.items() if n in properties.STANDARD}
    optional = {
        **properties.standard_positions(),
        **{n: s for n, s in table.items() if n not in properties.STANDARD},
    }
    rate = min(RATE_HZ, 1.0 / mission.aircraft.dt_s)
    flight = replace(spec, duration_s=min(spec.duration_s, MAX_FLIGHT_S), record_rate_hz=rate)
    recorded = record_mission(mission, flight, needed, optional)
    states = {n: np.asarray(v, dtype=float) for n, v in recorded.signals.items() if n != "time_s"}
    return states, recorded.status == "ok" and bool(len(next(iter(states.values()))))


def recorded_mission(paths: Sequence[Path], aircraft: Aircraft, cutoff_hz: float) -> Occupancy:
    """Return the states of a mission from flight records or logs.

    Parameters
    ----------
    paths : sequence of Path
        Records.
    aircraft : Aircraft
        Aircraft that flew them.
    cutoff_hz : float
        Cutoff of the smoothing; the same as for the data behind the bounds.

    Raises
    ------
    BadInputError
        If a record cannot be read, or has no second with all states.
    """
    parts: list[dict[str, FloatArray]] = []
    seconds = 0.0
    for path in paths:
        record = read_flight(path, aircraft)
        # States that the record has for at least half of its time.
        available = tuple(n for n in STATES if n in record and np.isfinite(record[n]).mean() > 0.5)
        # Thinned after smoothing.
        stride = max(1, round(1.0 / (RATE_HZ * record.dt_s)))
        pieces = [
            {
                n: smooth(np.asarray(record[n][rows], dtype=float), record.dt_s, cutoff_hz)[
                    ::stride
                ]
                for n in available
            }
            for rows in record.segments(available, 1.0)
        ]
        if not pieces:
            raise BadInputError(
                f"--occupancy {path}: no second of it has all of"
                f" {', '.join(available) or 'the states'}"
            )
        parts += pieces
        seconds += sum(len(p["V_mps"]) for p in pieces if "V_mps" in p) * stride * record.dt_s
    names = [n for n in parts[0] if all(n in p for p in parts)]
    merged = {n: np.concatenate([p[n] for p in parts]) for n in names}
    return Occupancy(merged, len(paths), 0, seconds, ", ".join(p.name for p in paths))


# Try test points on the model.
#
# Each point is simulated with sensor noise and turbulence. A point is refused if the flight
# ends or a state leaves its allowed range; otherwise its filtered states say what information
# it would add, and its residuals what scatter noise and air alone produce.

RANGE_EXTENSION = 0.5
"""Share of its range by which a state may exceed what has been flown: flight tests proceed in
small steps.
"""
_FALLBACK_UNIT_S = 0.5
_DOUBLET_PEAK = 2.331122


@dataclass(frozen=True)
class TestFlight:
    """How test flights are simulated.

    Attributes
    ----------
    aircraft : Aircraft
        Model that flies.
    mission : Path
        Run script that the points are added to.
    has_autopilot : bool
        Whether the aircraft has this project's autopilot.
    begin_s : float
        When the first transition may start.
    turbulence, turbulence_source : str
        Intensity and model of turbulence.
    noise : bool
        Whether sensors have noise.
    rate_hz : float
        Rate of the record.
    """

    aircraft: Aircraft
    mission: Path
    has_autopilot: bool
    begin_s: float
    turbulence: str = "none"
    noise: bool = True
    rate_hz: float = 50.0
    turbulence_source: str = DEFAULT_TURBULENCE_SOURCE

    __test__ = False


@dataclass(frozen=True)
class Trial:
    """A test point as the model flew it.

    Attributes
    ----------
    point : TestPoint
        The point.
    states : mapping
        State -> values (n,), filtered as the data behind the bounds.
    delta : array (n, 6)
        Residual coefficients, which contain noise and gusts only.
    """

    point: TestPoint
    states: Mapping[str, FloatArray]
    delta: FloatArray


@dataclass(frozen=True)
class RefusedPoint:
    """A test point that must not be flown, and the reason."""

    point: TestPoint
    reason: str


def has_autopilot(aircraft: Aircraft) -> bool:
    """Return whether the aircraft has this project's autopilot."""
    # The instance must outlive its manager, or absolute names are not found.
    fdm = open_aircraft(aircraft)
    manager = fdm.get_property_manager()
    return all(manager.hasNode(name) for name in AUTOPILOT)


def has_noise(aircraft: Aircraft) -> bool:
    """Return whether the aircraft has a sensors system."""
    return bool(open_aircraft(aircraft).get_property_manager().hasNode("sensor/V-mps"))


def unit_times(aircraft: Aircraft, speed_mps: float, altitude_m: float) -> dict[str, float]:
    """Choose the duration of one unit of a control's pattern from the modes of the model.

    The spectrum of a doublet of half width T, (4/w) sin^2(wT/2), is largest where tan(wT/2) = wT,
    at wT = 2.33. The elevator excites the short period, aileron and rudder the dutch roll.

    Parameters
    ----------
    aircraft : Aircraft
        Model.
    speed_mps, altitude_m : float
        Condition of the trim.

    Returns
    -------
    dict
        Control -> seconds, between 0.2 and 3; 0.5 s if the model cannot be trimmed.
    """
    frequencies: dict[str, float] = {}
    try:
        # Modes at the trim; a model that cannot be trimmed gets the default.
        trim = find_trim(aircraft, SteadyCondition(speed_mps, altitude_m))
        if trim.converged:
            frequencies = {
                m.name: abs(complex(m.real, m.imag)) for m in modes(linearise(aircraft, trim))
            }
    except (BadInputError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        pass
    pitch, yaw = (
        (
            float(f"{min(max(_DOUBLET_PEAK / frequencies[m], 0.2), 3.0):.1g}")
            if frequencies.get(m, 0.0) > 0.0
            else _FALLBACK_UNIT_S
        )
        for m in ("short_period", "dutch_roll")
    )
    return {"elevator": pitch, "aileron": yaw, "rudder": yaw, "throttle": round(3.0 * pitch, 1)}


def fly_points(
    flight: TestFlight, points: Sequence[TestPoint], seed: int, path: Path
) -> tuple[bool, float, str]:
    """Simulate points and write the record.

    Returns
    -------
    ok : bool
        Whether the flight reached its end.
    flown_s : float
        How long it flew.
    reason : str
        Why it ended.
    """
    script = path.with_suffix(".xml")
    text = script_text(
        flight.mission,
        flight.aircraft,
        points,
        flight.begin_s,
        flight.has_autopilot,
        path.stem,
        purpose="Test points",
    )
    script.write_bytes(text)
    return fly_script(flight, script, seed, path)


def fly_script(
    flight: TestFlight, script: Path, seed: int, path: Path, duration_s: float | None = None
) -> tuple[bool, float, str]:
    """Simulate a script, or its first ``duration_s`` seconds; see `fly_points`."""
    read = read_script(script)
    turbulence, noise = turbulence_and_noise_seeds(seed)
    spec = FlightSpec(
        aircraft=flight.aircraft.folder,
        script=script,
        duration_s=duration_s or read.end_s,
        turbulence=flight.turbulence,
        turbulence_source=flight.turbulence_source,
        sensor_noise=flight.noise,
        seed_turbulence=turbulence,
        seed_noise=noise,
        properties=dict(properties.SECOND_ORDER),
        record_rate_hz=flight.rate_hz,
    )
    record, recorded = recorded_flight(flight.aircraft, read, spec)
    write_record(record, path)
    return recorded.status == "ok", recorded.flown_s, recorded.reason


def residuals_of(aircraft: Aircraft, paths: Sequence[Path], cutoffs: Cutoffs) -> list[Residuals]:
    """Compute residual coefficients of records, one `Residuals` per record.

    Raises BadInputError if a record cannot be read.
    """
    arm = aircraft.accelerometer_m
    flights, measured = read_bounds_flights(paths, aircraft)
    with prediction_of(aircraft, measured) as pair:
        return [flight_residuals(pair, f, arm, cutoffs) for f in flights]


def try_points(
    flight: TestFlight,
    points: Sequence[TestPoint],
    allowed: Mapping[str, tuple[float, float]],
    cutoffs: Cutoffs,
    seed: int,
) -> tuple[list[Trial], list[RefusedPoint]]:
    """Simulate every point, those of one condition in one flight.

    A point at which a flight ends is refused, and the points after it are flown again.

    Parameters
    ----------
    flight : TestFlight
        How flights are simulated.
    points : sequence of TestPoint
        Grouped by condition.
    allowed : mapping
        State -> smallest and largest value that a point, with its recovery, may reach.
    cutoffs : Cutoffs
        Filters of the residuals.
    seed : int
        Seed of the first flight; later flights use the next ones.

    Returns
    -------
    trials : list of Trial
    refused : list of RefusedPoint
    """
    trials: list[Trial] = []
    refused: list[RefusedPoint] = []
    with scratch_folder() as scratch:
        for number, (_, group) in enumerate(groupby(points, key=lambda p: p.condition)):
            remaining, attempt = list(group), 0
            while remaining:
                path = scratch.path / f"trial-{number}-{attempt}.parquet"
                attempt += 1
                ok, flown_s, reason = fly_points(flight, remaining, seed + number, path)
                timed, _ = schedule(remaining, flight.begin_s)
                # Points whose recovery was complete before the flight ended count as flown.
                done = [t for t in timed if ok or t.end_s + RECOVERY_S <= flown_s]
                # The first point that is not complete ended the flight.
                ended = [] if ok else remaining[len(done) : len(done) + 1]
                accepted, rejected = _check_points(
                    path, [(t.point, t.start_s, t.end_s) for t in done], allowed
                )
                refused += rejected + [RefusedPoint(p, f"the flight ends: {reason}") for p in ended]
                if accepted:
                    trials += _trials_of(flight.aircraft, path, accepted, cutoffs)
                remaining = remaining[len(done) + len(ended) :]
    return trials, refused


def _check_points(
    path: Path,
    points: Sequence[tuple[TestPoint, float, float]],
    allowed: Mapping[str, tuple[float, float]],
) -> tuple[list[TestPoint], list[RefusedPoint]]:
    """Split points by whether they stay within the allowed ranges and do not lose too much
    height.
    """
    import pandas as pd

    frame = pd.read_parquet(path)
    accepted: list[TestPoint] = []
    rejected: list[RefusedPoint] = []
    for point, start_s, end_s in points:
        # The point and the recovery after it.
        rows = frame[(frame["time_s"] >= start_s) & (frame["time_s"] <= end_s + RECOVERY_S)]
        reason = ""
        if "h_m" in rows and float(rows["h_m"].iloc[0] - rows["h_m"].min()) > MAX_HEIGHT_LOSS_M:
            reason = (
                f"it loses {float(rows['h_m'].iloc[0] - rows['h_m'].min()):.0f} m, allowed are"
                f" {MAX_HEIGHT_LOSS_M:g}"
            )
        # States within the ranges.
        for state, (low, high) in allowed.items():
            values = rows[state].to_numpy()
            if reason:
                break
            # Percentiles instead of extremes: single samples are sensor noise.
            lowest, highest = np.percentile(values, [1.0, 99.0])
            if lowest < low or highest > high:
                reason = (
                    f"{state} reaches {lowest if lowest < low else highest:.3g}, allowed are"
                    f" {low:.3g} to {high:.3g}"
                )
                break
        if reason:
            rejected.append(RefusedPoint(point, reason))
        else:
            accepted.append(point)
    return accepted, rejected


def _trials_of(
    aircraft: Aircraft, path: Path, points: Sequence[TestPoint], cutoffs: Cutoffs
) -> list[Trial]:
    """Compute states and residuals of each point of a record."""
    try:
        (residuals,) = residuals_of(aircraft, [path], cutoffs)
    except LogError as error:
        raise BadInputError(str(error)) from None
    out = []
    for point in points:
        # Segments are labelled with the point's name.
        pieces = [p for p in residuals.pieces if p.label == point.name]
        if pieces:
            names = [n for n in pieces[0].states if all(n in p.states for p in pieces)]
            states = {n: np.concatenate([p.states[n] for p in pieces]) for n in names}
            out.append(Trial(point, states, np.concatenate([p.delta for p in pieces])))
    return out


def sorted_points(points: Sequence[TestPoint]) -> list[TestPoint]:
    """Sort points by condition, conditions in the order of first appearance."""
    conditions = list(dict.fromkeys(p.condition for p in points))
    return sorted(points, key=lambda p: conditions.index(p.condition))
