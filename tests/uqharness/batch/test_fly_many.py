"""Flights in both engines, and lanes that are independent of each other."""

from __future__ import annotations

import dataclasses
import math
import shutil
import sys
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
    copied,
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
from uqharness.batch.program import available
from uqharness.errors import BadInputError
from uqharness.flight.fly import fly
from uqharness.flight.spec import COEFFICIENTS, FlightResult, FlightSpec
from uqharness.plugin.apply import instrument_aircraft
from uqharness.plugin.instrument import Bounds
from uqharness.plugin.model_form_xml import constant_xml
from uqharness.simulator import MARK, find_aircraft, write_steady_start
from uqharness.simulator.own_mission import StartSection


@pytest.fixture(autouse=True)
def _widest_vectors(monkeypatch):
    """Fly with the vectors that users fly with."""
    monkeypatch.delenv(VECTORS, raising=False)


ACTIVE = {"uq/active": 1.0}


MASS = {
    "inertia/mass-slugs": 1.5,
    "inertia/iyy-slugs_ft2": 3.9,
    "inertia/cg-x-in": 0.1,
    "inertia/ixz-slugs_ft2": 0.2,
}


FLIGHTS = {
    "calm": spec(),
    "wind": spec(wind_mps=5.0, wind_from_deg=200.0, duration_s=30.0),
    "jsbsim's turbulence": spec(wind_mps=3.0, turbulence="moderate", turbulence_source="jsbsim"),
    "jsbsim's turbulence, no wind": spec(
        turbulence="light", turbulence_source="jsbsim", duration_s=20.0
    ),
    "host's turbulence": spec(wind_mps=3.0, turbulence="severe"),
    "noise": spec(sensor_noise=True, duration_s=30.0),
    "all": spec(**EXPENSIVE),
    "corner": spec(properties=CORNER, **EXPENSIVE),
    "white levels": spec(levels=WHITE, properties=ACTIVE, **EXPENSIVE),
    "walking levels": spec(levels=WALK, properties=ACTIVE, **EXPENSIVE),
    "other integrators": spec(properties=SECOND_ORDER, wind_mps=3.0),
    "mass and inertia": spec(properties=MASS, wind_mps=2.0, duration_s=30.0),
    "span": spec(properties={"metrics/bw-ft": 11.0}, turbulence="light", duration_s=30.0),
    "a parameter": spec(
        properties={"ap/altitude-cmd-m": 110.0, "ap/WP_LOITER_RAD": 90.0}, wind_mps=2.0
    ),
    "another start": spec(
        properties={"ic/psi-true-deg": 40.0, "ic/h-agl-ft": 500.0, "ic/lat-geod-deg": -33.0},
        duration_s=30.0,
    ),
    "burn-in": spec(burn_in_s=20.0, duration_s=20.0, **EXPENSIVE),
    "another rate": spec(record_rate_hz=20.0, duration_s=10.0, **EXPENSIVE),
    "truth": spec("espaaro_truth", **EXPENSIVE),
    "stall": spec("synthetic_stall", **EXPENSIVE),
    "stall, corner": spec(
        "synthetic_stall", properties={"uq/active": 1.0, "uq/CZ/level": 0.0}, **EXPENSIVE
    ),
    "elevator doublet": spec(script="doublet-elevator", duration_s=20.0),
    "aileron doublet": spec("espaaro_truth", "doublet-aileron", 20.0),
    "rudder doublet": spec("synthetic_stall", "doublet-rudder", 20.0),
    "manoeuvres": spec(script="3-2-1-1", duration_s=20.0),
    "flight for identification": spec("espaaro_truth", "flight-ident", 60.0, sensor_noise=True),
}


QUICK = ("walking levels", "mass and inertia", "stall")


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in FLIGHTS],
)
def test_whole_flights(name):
    found = beyond(FLIGHTS[name])
    assert max(found.values()) < 1.0, found


def test_bounds_that_depend_on_the_state(tmp_path):
    plane = with_bounds(tmp_path, 0.001)
    levels = {**ACTIVE, "uq/CZ/level": 0.9, "uq/Cm/level": 0.3, "uq/Cl/level": 0.6}
    found = beyond(spec(plane, properties=levels, **EXPENSIVE))
    assert "extrapolated" in found
    assert max(found.values()) < 1.0, found


@pytest.mark.parametrize("outside", ["grow", pytest.param("clamp", marks=pytest.mark.slow)])
def test_a_transient_part_that_walks(tmp_path, outside):
    plane = with_bounds(tmp_path, 0.001, transient=0.0004, outside=outside)
    given = spec(
        plane,
        properties={**ACTIVE, "uq/CZ/level": 0.9},
        duration_s=30.0,
        transient=TRANSIENT,
        **EXPENSIVE,
    )
    found = beyond(given)
    assert max(found.values()) < 1.0, found
    if outside == "grow":
        other = dataclasses.replace(given, transient=dataclasses.replace(TRANSIENT, aleatory_id=5))
        assert max(beyond(given, changed=other).values()) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("air", [True, False])
def test_a_transient_part_beside_levels_that_walk(tmp_path, air):
    plane = with_bounds(tmp_path, 0.001, transient=0.0004) if air else without_air(tmp_path)
    if not air:
        text = constant_xml(dict.fromkeys(COEFFICIENTS, (-0.0004, 0.0004)), "made up")
        (plane / "Systems" / "model-form.xml").write_bytes(text)
    script = "loiter" if air else "doublet-elevator"
    active = {**ACTIVE, "uq/CZ/transient": 0.0004} if not air else ACTIVE
    found = beyond(
        spec(plane, script, 20.0, properties=active, levels=WALK, transient=TRANSIENT, **EXPENSIVE)
    )
    assert max(found.values()) < 1.0, found


NEAR = (
    {"seed_noise": 7},
    {"seed_turbulence": 7},
    {"wind_from_deg": 270.00001},
    {"wind_mps": 4.000001},
    {"properties": {**CORNER, **SECOND_ORDER}},
)


@pytest.mark.parametrize(
    "change",
    few(
        [
            {"properties": {"uq/CZ/upper": 0.05000001, **CORNER}},
            {"properties": {**CORNER, "uq/Cm/level": 1e-7}},
            {"properties": {**CORNER, "inertia/iyy-slugs_ft2": 4.0}},
            *(pytest.param(change, marks=pytest.mark.slow) for change in NEAR),
        ],
        1,
    ),
)
def test_another_flight_is_noticed(change):
    given = spec(properties=CORNER, duration_s=20.0, **EXPENSIVE)
    assert max(beyond(given, changed=dataclasses.replace(given, **change)).values()) > 1.0


@pytest.mark.parametrize(
    "conditions",
    [
        {"wind_mps": 3.0, "turbulence": "moderate", "sensor_noise": True},
        pytest.param({"wind_mps": 3.0, "wind_from_deg": 20.0}, marks=pytest.mark.slow),
        pytest.param(
            {"turbulence": "severe", "levels": WALK, "properties": ACTIVE}, marks=pytest.mark.slow
        ),
        pytest.param({}, marks=pytest.mark.slow),
    ],
)
def test_an_aircraft_without_the_air_system(tmp_path, conditions):
    plane = without_air(tmp_path)
    found = beyond(spec(plane, "doublet-elevator", 20.0, **conditions))
    assert max(found.values()) < 1.0, found
    other = spec(
        plane, "doublet-elevator", 20.0, **{"wind_mps": 3.0, **conditions, "wind_from_deg": 21.0}
    )
    assert (
        max(
            beyond(
                spec(plane, "doublet-elevator", 20.0, **{"wind_mps": 3.0, **conditions}),
                changed=other,
            ).values()
        )
        > 1.0
    )


@pytest.mark.slow
@pytest.mark.parametrize("aircraft", ["espaaro", "bounds"])
def test_bounds_with_levels_that_walk(tmp_path, aircraft):
    plane = with_bounds(tmp_path, 0.001) if aircraft == "bounds" else aircraft
    found = beyond(spec(plane, properties=ACTIVE, levels=WALK, **EXPENSIVE))
    assert max(found.values()) < 1.0, found


@pytest.mark.slow
@pytest.mark.parametrize("aircraft", ["espaaro", "bounds"])
def test_fifteen_minutes(tmp_path, aircraft):
    plane = with_bounds(tmp_path, 0.001) if aircraft == "bounds" else aircraft
    found = beyond(
        spec(plane, duration_s=900.0, properties={**ACTIVE, "uq/CZ/level": 0.9}, **EXPENSIVE)
    )
    assert max(found.values()) < 1.0, found


def test_a_flight_that_diverges_ends_at_the_same_time(tmp_path):
    """Wild bounds: control is lost, and the numbers with it. Before that the engines agree."""
    given = spec(
        with_bounds(tmp_path),
        properties={**ACTIVE, "uq/CZ/level": 0.9, "uq/Cm/level": 0.3},
        **EXPENSIVE,
    )
    assert fly(given).status == "diverged"
    found = beyond(given, until_s=15.0)
    assert max(found.values()) < 1.0, found


def test_a_flight_into_the_ground():
    given = spec(properties={"ap/altitude-cmd-m": -20.0, "ic/h-agl-ft": 60.0}, wind_mps=3.0)
    theirs, (ours,) = fly(given), fly_many([given])
    assert theirs.status == "ground-contact"
    assert same_end(theirs, ours)
    found = beyond(given)
    assert max(found.values()) < 1.0, found
    above = dataclasses.replace(given, properties={**given.properties, "ap/altitude-cmd-m": 20.0})
    assert fly_many([above])[0].status == "ok"


CONTACTS = """<ground_reactions>
  <contact type="STRUCTURE" name="TAIL"><location unit="IN"><x>60</x><y>0</y><z>-12</z></location>
   <static_friction>0.8</static_friction><dynamic_friction>0.5</dynamic_friction>
   <spring_coeff unit="LBS/FT">100</spring_coeff><damping_coeff unit="LBS/FT/SEC">10</damping_coeff></contact>
  <contact type="BOGEY" name="WHEEL"><location unit="IN"><x>-5</x><y>10</y><z>-30</z></location>
   <static_friction>0.8</static_friction><dynamic_friction>0.5</dynamic_friction><rolling_friction>0.02</rolling_friction>
   <spring_coeff unit="LBS/FT">100</spring_coeff><damping_coeff unit="LBS/FT/SEC">10</damping_coeff>
   <max_steer unit="DEG">0</max_steer><brake_group>NONE</brake_group><retractable>0</retractable></contact>
 </ground_reactions>"""


@pytest.mark.slow
def test_contact_points_touch_as_in_jsbsim(tmp_path):
    text = (copied(tmp_path / "plain") / "espaaro.xml").read_text()
    begin, end = (
        text.index("<ground_reactions"),
        text.index("</ground_reactions>") if "</ground_reactions>" in text else -1,
    )
    old = (
        text[begin : end + len("</ground_reactions>")]
        if end > 0
        else text[begin : text.index("/>", begin) + 2]
    )
    plane = copied(tmp_path, edits={"espaaro.xml": {old: CONTACTS}})
    for properties in (
        {"ap/altitude-cmd-m": -20.0, "ic/h-agl-ft": 40.0},
        {"ap/altitude-cmd-m": -20.0, "ic/h-agl-ft": 40.0, "ic/theta-deg": 20.0},
    ):
        given = spec(plane, properties=properties, wind_mps=2.0, duration_s=30.0)
        theirs, (ours,) = fly(given), fly_many([given])
        assert theirs.status == "ground-contact"
        assert "contact point" in theirs.reason
        assert same_end(theirs, ours), (theirs.reason, ours.reason)
    with pytest.raises(BadInputError, match="starts on the ground"):
        fly_many([spec(plane, properties={"ic/h-agl-ft": 1.0}, duration_s=5.0)])


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
    given = _mixed()
    alone = [_as_bytes(fly_many([one])[0]) for one in given]
    assert len({str(each) for each in alone}) == len(given)
    assert [_as_bytes(each) for each in fly_many(given)] == alone
    order = np.random.default_rng(1).permutation(len(given))
    assert [_as_bytes(each) for each in fly_many([given[k] for k in order])] == [
        alone[k] for k in order
    ]
    assert [_as_bytes(each) for each in fly_many(given * 3)] == alone * 3


def test_a_lane_that_is_not_a_number_harms_no_other():
    given = _mixed()[:3]
    alone = [_as_bytes(each) for each in fly_many(given)]
    bad = dataclasses.replace(given[1], properties={**given[1].properties, "uq/Cm/level": 1e6})
    together = fly_many([given[0], bad, given[2], bad, bad])
    assert [each.status for each in together] == ["ok", "diverged", "ok", "diverged", "diverged"]
    assert [_as_bytes(together[0]), _as_bytes(together[2])] == [alone[0], alone[2]]
    assert same_end(fly(bad), together[1])


@pytest.mark.parametrize(
    ("air", "source"),
    [
        (True, "spec"),
        pytest.param(True, "jsbsim", marks=pytest.mark.slow),
        pytest.param(False, "spec", marks=pytest.mark.slow),
    ],
)
def test_one_program_flies_all_conditions(tmp_path, air, source):
    plane, script = ("espaaro", "loiter") if air else (without_air(tmp_path), "doublet-elevator")
    cells = [(0.0, "light"), (6.0, "severe")]
    given = [
        spec(
            plane,
            script,
            8.0,
            wind_mps=wind,
            wind_from_deg=250.0,
            turbulence=turbulence,
            turbulence_source=source,
        )
        for wind, turbulence in cells
    ]
    lanes.forget()
    together = fly_many(given)
    assert len(lanes._cache) == 1
    alone = []
    for one in given:
        lanes.forget()
        alone += fly_many([one])
    assert [_as_bytes(each) for each in together] == [_as_bytes(each) for each in alone]
    assert len({str(_as_bytes(each)) for each in together}) == len(cells)
    for ours, theirs in zip(together, map(fly, given), strict=True):
        name = "cross_track" if air else "altitude"
        np.testing.assert_allclose(ours.signals[name], theirs.signals[name], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("chunk", few([70, 10, 333], 1))
def test_flights_in_pieces(monkeypatch, chunk):
    given = _mixed()
    whole = [_as_bytes(each) for each in fly_many(given)]
    monkeypatch.setattr(course, "_CHUNK", chunk)
    assert [_as_bytes(each) for each in fly_many(given)] == whole


def test_groups_that_fit_into_memory(monkeypatch):
    given = _mixed()
    whole = [_as_bytes(each) for each in fly_many(given)]
    monkeypatch.setattr(lanes, "_RECORD_BYTES", 1)
    assert [_as_bytes(each) for each in fly_many(given * 2)] == whole * 2


def _by_target(monkeypatch, names, source):
    """What each of the targets makes of some flights."""
    given = [dataclasses.replace(one, turbulence_source=source, duration_s=6.0) for one in _mixed()]
    found = []
    for name in names:
        monkeypatch.setenv(VECTORS, name)
        lanes._cache.clear()
        found.append([_as_bytes(each) for each in fly_many(given)])
    lanes._cache.clear()
    return found


@pytest.mark.slow
def test_the_narrowest_and_the_widest_vectors_give_the_same_bytes(monkeypatch):
    names = target_names()
    assert names[0] == "scalar" != names[-1]
    scalar, widest = _by_target(monkeypatch, (names[0], names[-1]), "spec")
    assert scalar == widest


@pytest.mark.slow
@pytest.mark.parametrize("source", ["jsbsim", "spec"])
def test_every_processor_gives_the_same_bytes(monkeypatch, source):
    """Scalar, SSE2, AVX2 and AVX-512 where the processor has them."""
    first, *others = _by_target(monkeypatch, target_names(), source)
    assert all(each == first for each in others)


def test_missing_llvmlite_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    said = available()
    assert said is not None
    assert "llvmlite is not installed" in said


def test_metrics_are_those_of_jsbsim():
    given = FLIGHTS["all"]
    theirs, (ours,) = fly(given), fly_many([given])
    assert theirs.undefined == ours.undefined
    assert theirs.metrics.keys() == ours.metrics.keys()
    for name, value in theirs.metrics.items():
        assert ours.metrics[name] == pytest.approx(
            value, rel=1e-7, abs=1e-7, nan_ok=math.isnan(value)
        )


@pytest.mark.slow
def test_a_coefficient_without_a_switch_is_taken_out_by_bounds_of_zero(tmp_path):
    text = (find_aircraft("espaaro").folder / "Systems" / "model-form.xml").read_text()
    # Plugins of other versions have no uq/<C>/active: a campaign that leaves a coefficient out
    # flies them all the same.
    edits = {line: "" for line in text.splitlines() if ">uq/CZ/active<" in line}
    made = copied(tmp_path, edits={"Systems/model-form.xml": edits})
    given = spec(made, duration_s=10.0, properties={**CORNER, "uq/CZ/active": 0.0})
    assert max(beyond(given).values()) <= 1.0
    left_in = spec(made, duration_s=10.0, properties=CORNER)
    assert max(beyond(given, changed=left_in).values()) > 1.0


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
    ) as found:
        yield found


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
    lanes, judged = fly_many(specs), [fly(one) for one in specs]
    assert apart(lanes[0], judged[0]) < 1e-7
    assert apart(lanes[1], judged[1]) < 1e-7
    assert apart(lanes[1], judged[0]) > 1e-4


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
        gaps, _ = fly_both(style)
        assert gaps["V_mps"] > 1e-5


SWITCHBOARD = "Systems/switchboard.xml"


LATE = "<test value='{}'> simulation/sim-time-sec gt 0.5 </test>"


def test_magnetos_are_what_a_system_commands(fly_both):
    on = '<test value="/controls/engines/engine[0]/magnetos"> electrics/live == 1 </test>'
    one = (SWITCHBOARD, on, LATE.format(1) + "<test value='3'> electrics/live == 1 </test>")
    spark = ("Engines/flat_four.xml", "<maxhp>", "<sparkfaildrop>0.2</sparkfaildrop><maxhp>")
    both_on, _ = fly_both("single", [spark])
    gaps, one_on = fly_both("single", [one, spark])
    assert max(gaps.values()) < ALIKE, gaps
    gaps, off = fly_both("single", [(SWITCHBOARD, on, on + LATE.format(0).replace("gt", "ge"))])
    # A switch takes the first test that holds, so that the second one does nothing.
    assert max(both_on.values()) < ALIKE
    assert max(gaps.values()) < ALIKE
    assert one_on.signals["V_mps"][-1] < off.signals["V_mps"][-1] - 1e-3


def test_a_starter_acts_on_an_engine_that_does_not_run(fly_both):
    starter = (SWITCHBOARD, "/controls/engines/engine[0]/starter == 1", "electrics/live == 1")
    gaps, _ = fly_both("single", [starter])
    assert max(gaps.values()) < ALIKE, gaps
    on = '<test value="/controls/engines/engine[0]/magnetos"> electrics/live == 1 </test>'
    stopped = (SWITCHBOARD, on, LATE.format(0) + "<test value='3'> electrics/live == 1 </test>")
    assert fly_both("single", [starter, stopped])[0]["status"] == np.inf
    assert max(fly_both("single", [stopped])[0].values()) < ALIKE


@pytest.mark.slow
def test_turbines_are_cut_off_as_a_system_commands(fly_both):
    gaps, running = fly_both("jet")
    assert max(gaps.values()) < ALIKE, gaps
    open_ = '<test value="1"> /controls/engines/engine[0]/cutoff eq 1 </test>'
    cut = ("Systems/hydraulics.xml", open_, LATE.format(1))
    # The elevator keeps its hydraulics: the electric pump is on.
    gaps, off = fly_both("jet", [cut])
    assert max(gaps.values()) < ALIKE, gaps
    assert off.signals["V_mps"][-1] < running.signals["V_mps"][-1] - 0.1
