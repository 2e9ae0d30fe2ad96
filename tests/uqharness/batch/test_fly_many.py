"""Flights in both engines, and lanes that are independent of each other."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator

import numpy as np
import pytest

from tests.helpers import batch_engines as engines
from tests.helpers import batch_flights as flights
from tests.helpers import foreign_aircraft
from tests.helpers.batch_whole import (
    CORNER,
    EXPENSIVE,
    SECOND_ORDER,
    TRANSIENT,
    WALK,
    WHITE,
    beyond,
    same_end,
    spec,
    with_bounds,
    without_air,
)
from tests.helpers.few import few
from uqharness.batch import course
from uqharness.batch import course as lanes
from uqharness.batch.course import fly_many
from uqharness.batch.llvm import VECTORS, target_names
from uqharness.flight.fly import fly
from uqharness.flight.spec import FlightResult, FlightSpec
from uqharness.plugin.apply import instrument_aircraft
from uqharness.plugin.instrument import Bounds
from uqharness.simulator import MARK, find_aircraft, write_steady_start
from uqharness.simulator.own_mission import StartSection

ACTIVE = {"uq/active": 1.0}


MASS = {
    "inertia/mass-slugs": 1.5,
    "inertia/iyy-slugs_ft2": 3.9,
    "inertia/cg-x-in": 0.1,
    "inertia/ixz-slugs_ft2": 0.2,
}


FLIGHTS = {
    "jsbsim's turbulence": spec(wind_mps=3.0, turbulence="moderate", turbulence_source="jsbsim"),
    "white levels": spec(levels=WHITE, properties=ACTIVE, **EXPENSIVE),
    "walking levels": spec(levels=WALK, properties=ACTIVE, **EXPENSIVE),
    "other integrators": spec(properties=SECOND_ORDER, wind_mps=3.0),
    "mass and inertia": spec(properties=MASS, wind_mps=2.0, duration_s=30.0),
    "a parameter": spec(
        properties={"ap/altitude-cmd-m": 110.0, "ap/WP_LOITER_RAD": 90.0}, wind_mps=2.0
    ),
    "another start": spec(
        properties={"ic/psi-true-deg": 40.0, "ic/h-agl-ft": 500.0, "ic/lat-geod-deg": -33.0},
        duration_s=30.0,
    ),
    "another rate": spec(burn_in_s=20.0, record_rate_hz=20.0, duration_s=10.0, **EXPENSIVE),
    "stall": spec("synthetic_stall", **EXPENSIVE),
    "stall, corner": spec(
        "synthetic_stall", properties={"uq/active": 1.0, "uq/CZ/level": 0.0}, **EXPENSIVE
    ),
    "rudder doublet": spec("synthetic_stall", "doublet-rudder", 20.0),
    "flight for identification": spec("espaaro_truth", "flight-ident", 60.0, sensor_noise=True),
}


QUICK = ("walking levels", "mass and inertia", "stall")


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in FLIGHTS],
)
def test_fly_many_agrees_with_jsbsim(name):
    result = beyond(FLIGHTS[name])
    assert max(result.values()) < 1.0, result


def test_state_dependent_bounds_agree_with_jsbsim(tmp_path):
    plane = with_bounds(tmp_path, 0.001)
    levels = {**ACTIVE, "uq/CZ/level": 0.9, "uq/Cm/level": 0.3, "uq/Cl/level": 0.6}
    result = beyond(spec(plane, properties=levels, **EXPENSIVE))
    assert "extrapolated" in result
    assert max(result.values()) < 1.0, result


@pytest.mark.parametrize("outside", ["grow", pytest.param("clamp", marks=pytest.mark.slow)])
def test_a_transient_part_that_walks(tmp_path, outside):
    plane = with_bounds(tmp_path, 0.001, transient=0.0004, outside=outside)
    inputs = spec(
        plane,
        properties={**ACTIVE, "uq/CZ/level": 0.9},
        duration_s=30.0,
        transient=TRANSIENT,
        **EXPENSIVE,
    )
    result = beyond(inputs)
    assert max(result.values()) < 1.0, result
    if outside == "grow":
        other = dataclasses.replace(inputs, transient=dataclasses.replace(TRANSIENT, aleatory_id=5))
        assert max(beyond(inputs, changed=other).values()) > 1.0


@pytest.mark.parametrize(
    "change",
    few(
        [
            {"properties": {"uq/CZ/upper": 0.05000001, **CORNER}},
            {"properties": {**CORNER, "inertia/iyy-slugs_ft2": 4.0}},
            {"seed_noise": 7},
            {"seed_turbulence": 7},
            {"wind_from_deg": 270.00001},
        ],
        1,
    ),
)
def test_fly_many_differs_for_other_conditions(change):
    flight = spec(properties=CORNER, duration_s=20.0, **EXPENSIVE)
    assert max(beyond(flight, changed=dataclasses.replace(flight, **change)).values()) > 1.0


@pytest.mark.parametrize(
    "conditions",
    few(
        [
            {"wind_mps": 3.0, "turbulence": "moderate", "sensor_noise": True},
            {"wind_mps": 3.0, "turbulence": "severe", "levels": WALK, "properties": ACTIVE},
        ],
        1,
    ),
)
def test_an_aircraft_without_the_air_system(tmp_path, conditions):
    flight = spec(without_air(tmp_path), "doublet-elevator", 20.0, **conditions)
    assert max(beyond(flight).values()) < 1.0
    other = dataclasses.replace(flight, wind_from_deg=flight.wind_from_deg + 1.0)
    assert max(beyond(flight, changed=other).values()) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("aircraft", ["espaaro", "bounds"])
def test_fly_many_agrees_over_fifteen_minutes(tmp_path, aircraft):
    plane = with_bounds(tmp_path, 0.001) if aircraft == "bounds" else aircraft
    result = beyond(
        spec(plane, duration_s=900.0, properties={**ACTIVE, "uq/CZ/level": 0.9}, **EXPENSIVE)
    )
    assert max(result.values()) < 1.0, result


def test_a_flight_that_diverges_ends_at_the_same_time(tmp_path):
    """Wild bounds: control is lost, and the numbers with it. Before that the engines agree."""
    inputs = spec(
        with_bounds(tmp_path),
        properties={**ACTIVE, "uq/CZ/level": 0.9, "uq/Cm/level": 0.3},
        **EXPENSIVE,
    )
    assert fly(inputs).status == "diverged"
    result = beyond(inputs, until_s=15.0)
    assert max(result.values()) < 1.0, result


def test_a_flight_into_the_ground():
    inputs = spec(properties={"ap/altitude-cmd-m": -20.0, "ic/h-agl-ft": 60.0}, wind_mps=3.0)
    assert fly_many([inputs])[0].status == "ground-contact"
    assert max(beyond(inputs).values()) < 1.0


def _as_bytes(result):
    metrics = {name: np.float64(value).tobytes() for name, value in result.metrics.items()}
    return (
        result.status,
        result.reason,
        result.flown_s,
        metrics,
        {name: values.tobytes() for name, values in result.signals.items()},
    )


def _mixed():
    """Flights of several airs, samples and lengths."""
    out = []
    for seed in range(3):
        for level in (0.0, 0.5, 1.0):
            properties = {**ACTIVE, "uq/CZ/level": level, "uq/Cm/level": 1.0 - level}
            out.append(
                spec(
                    duration_s=8.0 + 2.0 * (seed % 2),
                    properties=properties,
                    seed_turbulence=seed + 1,
                    seed_noise=seed + 9,
                    **EXPENSIVE,
                )
            )
    return out


def test_lanes_are_independent():
    """Number, order and neighbours leave every byte alone; results come in the order given."""
    inputs = _mixed()
    single = [_as_bytes(fly_many([one])[0]) for one in inputs]
    assert len({str(each) for each in single}) == len(inputs)
    assert [_as_bytes(each) for each in fly_many(inputs)] == single
    order = np.random.default_rng(1).permutation(len(inputs))
    assert [_as_bytes(each) for each in fly_many([inputs[k] for k in order])] == [
        single[k] for k in order
    ]
    assert [_as_bytes(each) for each in fly_many(inputs * 3)] == single * 3


def test_a_lane_that_is_not_a_number_harms_no_other():
    inputs = _mixed()[:3]
    single = [_as_bytes(each) for each in fly_many(inputs)]
    invalid = dataclasses.replace(
        inputs[1], properties={**inputs[1].properties, "uq/Cm/level": 1e6}
    )
    joint = fly_many([inputs[0], invalid, inputs[2], invalid, invalid])
    assert [each.status for each in joint] == ["ok", "diverged", "ok", "diverged", "diverged"]
    assert [_as_bytes(joint[0]), _as_bytes(joint[2])] == [single[0], single[2]]
    assert same_end(fly(invalid), joint[1])


@pytest.mark.parametrize(
    ("air", "source"), few([(True, "spec"), (True, "jsbsim"), (False, "spec")], 1)
)
def test_one_program_flies_all_conditions(tmp_path, air, source):
    plane, script = ("espaaro", "loiter") if air else (without_air(tmp_path), "doublet-elevator")
    conditions = [
        {"wind_mps": 0.0, "wind_from_deg": 250.0, "turbulence": "light"},
        {"wind_mps": 6.0, "wind_from_deg": 250.0, "turbulence": "severe"},
    ]
    flights = [spec(plane, script, 8.0, turbulence_source=source, **air) for air in conditions]
    lanes.forget()
    joint = fly_many(flights)
    assert len(lanes._cache) == 1
    assert _as_bytes(joint[0]) != _as_bytes(joint[1])
    name = "cross_track" if air else "altitude"
    for ours, theirs in zip(joint, map(fly, flights), strict=True):
        np.testing.assert_allclose(ours.signals[name], theirs.signals[name], rtol=0.0, atol=1e-6)


def test_flights_in_pieces_and_groups_that_fit_into_memory(monkeypatch):
    flights = _mixed()
    complete = [_as_bytes(each) for each in fly_many(flights)]
    for name, size in (("_CHUNK", 70), ("_RECORD_BYTES", 1)):
        with monkeypatch.context() as patch:
            patch.setattr(course, name, size)
            assert [_as_bytes(each) for each in fly_many(flights)] == complete


@pytest.mark.slow
def test_the_narrowest_and_the_widest_vectors_give_the_same_bytes(monkeypatch):
    result = []
    for name in (target_names()[0], target_names()[-1]):
        monkeypatch.setenv(VECTORS, name)
        lanes._cache.clear()
        result.append([_as_bytes(each) for each in fly_many(_mixed())])
    lanes._cache.clear()
    assert target_names()[0] == "scalar" != target_names()[-1]
    assert result[0] == result[1]


def test_copies_of_an_aircraft_are_translated_once(tmp_path):
    first = spec("synthetic_stall", "doublet-rudder", 1.0)
    folder = shutil.copytree(first.aircraft, tmp_path / "synthetic_stall")
    copy = dataclasses.replace(first, aircraft=folder)
    mine, other = (course.compiled_mission(one) for one in (first, copy))
    assert other.lanes.flight.frame is mine.lanes.flight.frame
    assert other.staged is not mine.staged
    assert _as_bytes(fly_many([first])[0]) == _as_bytes(fly_many([copy])[0])
    # An edit is another aircraft.
    xml = folder / "synthetic_stall.xml"
    text = xml.read_text()
    edited = text.replace("<emptywt", "<!-- heavier --><emptywt")
    assert edited != text
    xml.write_text(edited)
    assert course.compiled_mission(copy).lanes.flight.frame is not mine.lanes.flight.frame


def test_the_nominal_model_flies_in_the_program_of_the_corners():
    course.forget()
    flights = [spec(duration_s=2.0, properties=levels) for levels in ({}, CORNER, {})]
    together = fly_many(flights)
    assert len(course._translations) == 1
    course.forget()
    alone = [fly_many([flight])[0] for flight in flights]
    assert [*map(_as_bytes, together)] == [*map(_as_bytes, alone)]
    assert _as_bytes(alone[0]) != _as_bytes(alone[1])


def test_metrics_are_those_of_jsbsim():
    flight = spec(duration_s=20.0, **EXPENSIVE)
    theirs, (ours,) = fly(flight), fly_many([flight])
    assert theirs.undefined == ours.undefined
    assert ours.metrics == pytest.approx(theirs.metrics, rel=1e-7, abs=1e-7, nan_ok=True)


START = """<?xml version="1.0"?><initialize name="start"><latitude unit="DEG" type="geodetic">50</latitude>
<longitude unit="DEG">0</longitude><altitudeMSL unit="M">1000</altitudeMSL><ubody unit="M/SEC">45</ubody>
<wbody unit="M/SEC">1</wbody><theta unit="DEG">1</theta></initialize>"""


EVENTS = (
    f'<property value="1">{MARK}</property>{engines.RUNNING}<property'
    ' value="0.8">fcs/throttle-cmd-norm</property><property'
    ' value="0.7">fcs/throttle-cmd-norm[1]</property>'
)


TWO = "".join(engines.mounted("eng_io320", "prop_75in2f", k, "<feed>0</feed>") for k in (0, 1))


@pytest.fixture(scope="module")
def twin() -> Iterator[flights.Craft]:
    """Two piston engines on an aircraft with a tank, whose mission begins in the steady state."""
    text = engines.aircraft(TWO + engines.tank(6.0), engines.HEAVY).replace(">10<", ">150<")
    with flights.craft(
        text, {}, EVENTS, {**engines.stock("eng_io320", "prop_75in2f"), "start.xml": START}
    ) as result:
        yield result


def engine_spec(twin: flights.Craft, properties: dict[str, float] | None = None) -> FlightSpec:
    return FlightSpec(
        twin.root / "aircraft" / "point", twin.script, 5.0, properties=properties or {}
    )


def apart(one: FlightResult, other: FlightResult) -> float:
    return max(
        float(
            np.abs(one.signals[name] - other.signals[name]).max()
            / max(0.01, np.abs(other.signals[name]).max())
        )
        for name in other.signals
    )


def test_engines_begin_in_the_steady_state(twin: flights.Craft) -> None:
    lane = fly_many([engine_spec(twin)])[0]
    assert lane.status == "ok"
    assert apart(lane, fly(engine_spec(twin))) < 1e-7


@pytest.mark.parametrize(
    ("name", "values"),
    few([("inertia/mass-slugs", (70.0, 60.0)), ("fcs/throttle-cmd-norm", (0.5, 0.9))], 1),
)
def test_lanes_differ_in_mass_and_throttle(
    twin: flights.Craft, name: str, values: tuple[float, float]
) -> None:
    specs = [engine_spec(twin, {name: value}) for value in values]
    lanes, verdict = fly_many(specs), [fly(one) for one in specs]
    assert apart(lanes[0], verdict[0]) < 1e-7
    assert apart(lanes[1], verdict[1]) < 1e-7
    assert apart(lanes[1], verdict[0]) > 1e-4


ALIKE = 1e-7


"""JSBSim settles engines to 1e-9."""


SIGNALS = ("V_mps", "height_m", "phi_rad", "alpha_rad", "load_factor")


@pytest.fixture(scope="module")
def fly_both(tmp_path_factory):
    parent = tmp_path_factory.mktemp("starts")
    copies = {}

    def differences(style, edits=(), duration_s=1.5):
        """Return the largest difference of each signal over its largest size."""
        if style not in copies:
            folder = foreign_aircraft.write(style, parent)
            copies[style] = parent / "aircraft" / style
            instrument_aircraft(find_aircraft(folder), Bounds(), copies[style], check=False)
            start = StartSection(V_mps=foreign_aircraft.SPEEDS_MPS[style], altitude_m=200.0)
            write_steady_start(
                find_aircraft(copies[style]), start, parent / f"{style}.xml", "campaign.toml"
            )
        folder = copies[style]
        for k, (name, old, new) in enumerate(edits):
            if k == 0:
                folder = parent / f"edited-{len(list(parent.iterdir()))}" / style
                shutil.copytree(copies[style], folder)
            text = (folder / name).read_text()
            assert old in text
            (folder / name).unlink()
            (folder / name).write_text(text.replace(old, new))
        # Without an air system the wind comes after the engines are started.
        spec = FlightSpec(folder, parent / f"{style}.xml", duration_s, wind_mps=3.0)
        theirs, (ours,) = fly(spec), course.fly_many([spec])
        assert theirs.status == "ok"
        if ours.status != "ok":
            return {"status": np.inf}, theirs
        return {
            name: float(np.abs(ours.signals[name] - theirs.signals[name]).max())
            / max(float(np.abs(theirs.signals[name]).max()), 1e-3)
            for name in SIGNALS
        }, theirs

    return differences


@pytest.mark.parametrize(
    "style", ["single", *(pytest.param(s, marks=pytest.mark.slow) for s in ("wing", "twin"))]
)
def test_a_propeller_out_of_balance_is_brought_there_by_frames(fly_both, style, monkeypatch):
    gaps, _ = fly_both(style)
    assert max(gaps.values()) < ALIKE, gaps
    if style == "single":
        monkeypatch.setattr(course, "power_is_balanced", lambda *_: np.array([True]))
        course.forget()  # starts that were computed before
        gaps, _ = fly_both(style)
        assert gaps["V_mps"] > 1e-5


SWITCHBOARD = "Systems/switchboard.xml"


LATE = "<test value='{}'> simulation/sim-time-sec gt 0.5 </test>"


def test_magnetos_are_what_a_system_commands(fly_both):
    on = '<test value="/controls/engines/engine[0]/magnetos"> electrics/live == 1 </test>'
    one = (SWITCHBOARD, on, LATE.format(1) + "<test value='3'> electrics/live == 1 </test>")
    spark = ("Engines/flat_four.xml", "<maxhp>", "<sparkfaildrop>0.2</sparkfaildrop><maxhp>")
    gaps, both_on = fly_both("single", [spark])
    assert max(gaps.values()) < ALIKE
    gaps, one_on = fly_both("single", [one, spark])
    assert max(gaps.values()) < ALIKE, gaps
    assert one_on.signals["V_mps"][-1] < both_on.signals["V_mps"][-1] - 1e-3


def test_a_starter_acts_on_an_engine_that_does_not_run(fly_both):
    starter = (SWITCHBOARD, "/controls/engines/engine[0]/starter == 1", "electrics/live == 1")
    gaps, _ = fly_both("single", [starter])
    assert max(gaps.values()) < ALIKE, gaps
    on = '<test value="/controls/engines/engine[0]/magnetos"> electrics/live == 1 </test>'
    stopped = (SWITCHBOARD, on, LATE.format(0) + "<test value='3'> electrics/live == 1 </test>")
    assert fly_both("single", [starter, stopped])[0]["status"] == np.inf


@pytest.mark.slow
def test_turbines_are_cut_off_as_a_system_commands(fly_both):
    gaps, running = fly_both("jet")
    assert max(gaps.values()) < ALIKE, gaps
    open_ = '<test value="1"> /controls/engines/engine[0]/cutoff eq 1 </test>'
    section = ("Systems/hydraulics.xml", open_, LATE.format(1))
    # The elevator keeps its hydraulics: the electric pump is on.
    gaps, off = fly_both("jet", [section])
    assert max(gaps.values()) < ALIKE, gaps
    assert off.signals["V_mps"][-1] < running.signals["V_mps"][-1] - 0.1
