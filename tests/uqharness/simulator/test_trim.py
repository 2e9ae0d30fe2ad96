"""Trims and eigenvalues against published and independent figures; causes of failures."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import foreign_aircraft, sixdof
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.forced_state import force_state, open_forced
from uqharness.simulator.linear import linearise, modes
from uqharness.simulator.trim import (
    SteadyCondition,
    find_trim,
    pitch_for_climb,
)

# Independent linearisation about level trim at sea level, g = 9.81 (check figures of the method;
# angles deg, N, rpm, percent).
TRIM = {
    20.0: {"alpha": 1.850, "elevator": -0.380, "thrust": 20.05, "rpm": 5148.0, "throttle": 53.9},
    22.2: {"alpha": 0.833, "elevator": 0.237, "thrust": 23.13, "rpm": 5644.0, "throttle": 60.2},
}
MODES = {
    20.0: {
        "short_period": -4.728 + 3.786j,
        "phugoid": -0.1209 + 0.4261j,
        "dutch_roll": -0.685 + 2.700j,
        "roll": -7.94,
        "spiral": 0.0050,
    },
    22.2: {
        "short_period": -5.240 + 4.196j,
        "phugoid": -0.1344 + 0.3772j,
        "dutch_roll": -0.755 + 2.990j,
        "roll": -8.818,
        "spiral": -0.0029,
    },
}


@pytest.fixture(scope="module", params=[20.0, 22.2])
def trim_state(request):
    aircraft = find_aircraft("espaaro")
    trim = find_trim(aircraft, SteadyCondition(request.param))
    return aircraft, trim


def test_trim_figures(trim_state):
    _, trim = trim_state
    expected = TRIM[trim.condition.V_mps]
    assert trim.converged
    assert math.degrees(trim.alpha_rad) == pytest.approx(expected["alpha"], abs=0.01)
    assert trim.controls["elevator"] == pytest.approx(expected["elevator"], abs=0.01)
    assert trim.thrust_N == pytest.approx(expected["thrust"], rel=3e-3)
    assert trim.controls["throttle"] == pytest.approx(expected["throttle"], rel=3e-3)
    assert trim.rpm == pytest.approx(expected["rpm"], rel=1e-3)
    assert np.max(np.abs(trim.residual)) < 1e-8


def test_eigenvalues(trim_state):
    aircraft, trim = trim_state
    result = {mode.name: complex(mode.real, mode.imag) for mode in modes(linearise(aircraft, trim))}
    expected = MODES[trim.condition.V_mps]
    assert result.keys() == expected.keys()
    for name in ("short_period", "phugoid", "dutch_roll", "roll"):
        assert abs(result[name] - expected[name]) < 0.01 * abs(expected[name]), name
    assert abs(result["spiral"] - expected["spiral"]) < 1e-4


@pytest.mark.parametrize(("name", "mode"), [("Cn_beta", "dutch_roll"), ("Cm_q", "short_period")])
def test_a_coefficient_wrong_by_five_percent_fails_the_figures(name, mode):
    aircraft = find_aircraft("espaaro")
    invalid = SteadyCondition(22.2, properties={f"aero/{name}": 1.05 * sixdof.TABLE_2_6[name]})
    result = {
        m.name: complex(m.real, m.imag)
        for m in modes(linearise(aircraft, find_trim(aircraft, invalid)))
    }
    expected = MODES[22.2][mode]
    assert abs(result[mode] - expected) > 0.01 * abs(expected)


def eigenvalues(airframe: sixdof.Airframe, V: float):
    """Eigenvalues of the independent equations about their own level trim."""
    from scipy.optimize import fsolve

    def state(x):
        alpha, beta = x[0], x[1]
        velocity = V * np.array(
            [np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)]
        )
        theta = pitch_for_climb(alpha, beta, 0.0, 0.0)
        return np.concatenate([velocity, np.zeros(3), [0.0, theta, 0.0], np.zeros(3)]), x[2:]

    x = fsolve(
        lambda x: sixdof.derivative(airframe, *state(x))[:6], [0.02, 0.0, 0.0, 0.0, 0.0, 55.0]
    )
    centre, controls = state(x)
    jacobian = np.empty((12, 12))
    for column in range(12):
        step = np.zeros(12)
        step[column] = 1e-5
        jacobian[:, column] = (
            sixdof.derivative(airframe, centre + step, controls)
            - sixdof.derivative(airframe, centre - step, controls)
        ) / 2e-5
    retained = [0, 1, 2, 3, 4, 5, 6, 7]
    return np.linalg.eigvals(jacobian[np.ix_(retained, retained)])


def test_modes_of_a_changed_model_agree_with_the_independent_equations():
    rng = np.random.default_rng(3)
    changed = {key: value * rng.uniform(0.7, 1.3) for key, value in sixdof.TABLE_2_6.items()} | {
        "CZ_q": -3.0
    }
    aircraft = find_aircraft("espaaro")
    condition = SteadyCondition(
        21.0, properties={f"aero/{key}": value for key, value in changed.items()}
    )
    model = linearise(aircraft, find_trim(aircraft, condition))
    reference = eigenvalues(sixdof.Airframe(coefficients=changed), 21.0)
    for value in np.linalg.eigvals(model.A):
        assert np.min(np.abs(reference - value)) < max(2e-3 * abs(value), 2e-4), value


@pytest.mark.parametrize(
    ("bank_deg", "climb_deg", "height", "wind"),
    [
        (0, 0, 500.0, (0, 0, 0)),
        (30, 0, 100.0, (3, -2, 0)),
        (-45, 2, 100.0, (0, 7, 0)),
        (0, 5, 1500.0, (-5, 0, 0)),
    ],
)
def test_trim_for_any_bank_climb_height_and_wind(bank_deg, climb_deg, height, wind):
    aircraft = find_aircraft("espaaro")
    condition = SteadyCondition(
        22.2, height, math.radians(climb_deg), math.radians(bank_deg), 0.7, wind
    )
    trim = find_trim(aircraft, condition)
    assert trim.converged, trim.reason
    air = np.array(trim.velocity_ned_mps) - np.array(wind)
    assert np.linalg.norm(air) == pytest.approx(22.2, abs=1e-9)
    assert math.asin(-air[2] / 22.2) == pytest.approx(condition.climb_rad, abs=1e-6)
    if bank_deg:
        # A coordinated level turn: tan(bank) = V turn / g, to the few percent that thrust's lift
        # and pitch take.
        assert trim.turn_rate_radps == pytest.approx(
            9.806 * math.tan(condition.bank_rad) / 22.2, rel=0.03
        )


def test_an_aircraft_whose_rudder_follows_its_ailerons_flies_straight_with_a_little_bank():
    aircraft = find_aircraft("wrightFlyer1903")
    trim = find_trim(aircraft, SteadyCondition(12.0, 200.0))
    assert trim.converged, trim.reason
    assert 0.0 < abs(trim.condition.bank_rad) < math.radians(5.0)
    assert trim.turn_rate_radps == 0.0
    # JSBSim from there, nothing held: with that bank nothing turns it, with wings level something
    # does.
    level = replace(trim.state, phi=0.0)
    turning = [
        abs(force_state(aircraft, state, trim.controls, 200.0)[0]).max()
        for state in (trim.state, level)
    ]
    assert turning[0] < 1e-6
    assert turning[1] > 0.05


@pytest.mark.parametrize(("name", "V_mps"), [("x24b", 196.1), ("f16", 125.7)])
def test_a_trim_is_steady_with_its_filters_at_rest_and_not_in_their_first_frame(name, V_mps):
    aircraft = find_aircraft(name)
    trim = find_trim(aircraft, SteadyCondition(V_mps, 200.0))
    assert trim.converged, trim.reason
    assert trim.equilibrium is not None
    rested, first = (
        np.max(np.abs(force_state(aircraft, trim.state, trim.controls, 200.0, equilibrium=r)[0]))
        for r in (trim.equilibrium, None)
    )
    assert rested < 1e-6
    assert first > 1e-4
    # What flies on from there pitches with less than this in the first tenth of a second.
    fdm, _ = open_forced(aircraft, trim.state, trim.controls, 200.0, None, trim.equilibrium)
    while fdm.get_sim_time() < 0.1:
        fdm.run()
    assert abs(fdm["velocities/q-rad_sec"]) < 1e-4


# A trim that fails names its cause: step, thrust, a control at its limit, or no equilibrium.

Q_S = "<property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>"


def _axis(name, length, *terms):
    """A coefficient, sum of (factor, property) terms, on an axis with its reference length."""
    parts = "".join(
        f"<product><value>{factor}</value><property>{state}</property></product>"
        for factor, state in terms
    )
    arm = f"<property>metrics/{length}</property>" if length else ""
    return (
        f'<axis name="{name}"><function name="aero/{name}"><product>{Q_S}{arm}'
        f"<sum><value>{OFFSET.get(name, 0.0)}</value>{parts}</sum></product></function></axis>"
    )


OFFSET = {"LIFT": 0.25, "DRAG": 0.05}
SURFACES = "".join(
    f'<aerosurface_scale name="{name}"><input>fcs/{name}-cmd-norm</input><range><min>-0.4</min>'
    f"<max>0.4</max></range><output>fcs/{position}-pos-rad</output></aerosurface_scale>"
    for name, position in (
        ("elevator", "elevator"),
        ("aileron", "left-aileron"),
        ("rudder", "rudder"),
    )
)


def small_plane(folder, propeller_ixx, elevator=-0.9):
    """A model aeroplane of 1.5 kg with an electric motor and a propeller of that inertia
    [kg m2].
    """
    name = "gnat"
    (folder / name / "Engines").mkdir(parents=True)
    aerodynamics = (
        _axis("LIFT", "", (5.0, "aero/alpha-rad"))
        + _axis("DRAG", "", (0.3, "aero/alpha-rad"))
        + _axis("SIDE", "", (-0.4, "aero/beta-rad"))
        + _axis("ROLL", "bw-ft", (-0.05, "aero/beta-rad"), (0.2, "fcs/left-aileron-pos-rad"))
        + _axis("PITCH", "cbarw-ft", (-0.7, "aero/alpha-rad"), (elevator, "fcs/elevator-pos-rad"))
        + _axis("YAW", "bw-ft", (0.08, "aero/beta-rad"), (-0.07, "fcs/rudder-pos-rad"))
    )
    (folder / name / f"{name}.xml").write_text(
        f"""<?xml version="1.0"?>
<fdm_config name="{name}" version="2.0">
<metrics><wingarea unit="M2">0.35</wingarea><wingspan unit="M">1.6</wingspan>
<chord unit="M">0.22</chord></metrics>
<mass_balance><ixx unit="KG*M2">0.05</ixx><iyy unit="KG*M2">0.06</iyy><izz unit="KG*M2">0.1</izz>
<emptywt unit="KG">1.5</emptywt></mass_balance>
<ground_reactions/>
<propulsion><engine file="motor"><thruster file="screw">
<location unit="M"><x>-0.3</x><y>0</y><z>0</z></location></thruster></engine></propulsion>
<flight_control name="fcs"><channel name="surfaces">{SURFACES}</channel></flight_control>
<aerodynamics>{aerodynamics}</aerodynamics>
</fdm_config>""",
        encoding="utf-8",
    )
    (folder / name / "Engines" / "motor.xml").write_text(
        '<electric_engine name="motor"><power unit="WATTS">250</power></electric_engine>'
    )
    (folder / name / "Engines" / "screw.xml").write_text(
        f"""<propeller name="screw"><ixx unit="KG*M2">{propeller_ixx}</ixx>
<diameter unit="IN">9</diameter><numblades>2</numblades>
<table name="C_THRUST" type="internal"><tableData>0 0.1
0.5 0.06
1.1 -0.04</tableData></table>
<table name="C_POWER" type="internal"><tableData>0 0.05
0.5 0.04
1.1 -0.01</tableData></table></propeller>"""
    )
    return find_aircraft(folder / name)


def with_step(aircraft, dt_s):
    section = aircraft.card.aircraft.model_copy(update={"dt_s": dt_s})
    return replace(aircraft, card=aircraft.card.model_copy(update={"aircraft": section}))


def test_an_engine_unstable_at_the_step_is_named_with_both_speeds_and_cures(tmp_path):
    aircraft = small_plane(tmp_path, 1.2e-5)
    result = find_trim(aircraft, SteadyCondition(15.0, 100.0))
    assert not result.converged
    assert "engine 1 does not settle at a step of 0.01 s" in result.reason
    low, high = map(float, re.search(r"turns at (\d+) and (\d+) rpm", result.reason).groups())
    assert high > 10.0 * max(low, 100.0)
    step = float(re.search(r"dt_s = ([\d.]+)", result.reason).group(1))
    factor = float(re.search(r"<ixx> of (\d+) times", result.reason).group(1))
    # Both cures hold, and lead to the same steady flight.
    shorter = find_trim(with_step(aircraft, step), SteadyCondition(15.0, 100.0))
    heavier = find_trim(small_plane(tmp_path / "b", factor * 1.2e-5), SteadyCondition(15.0, 100.0))
    assert shorter.converged, shorter.reason
    assert heavier.converged, heavier.reason
    assert shorter.rpm == pytest.approx(heavier.rpm, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "V_mps"), [("espaaro", 40.0), pytest.param("c172x", 80.0, marks=pytest.mark.slow)]
)
def test_thrust_that_is_short_is_told_in_newtons(name, V_mps):
    aircraft = find_aircraft(name)
    result = find_trim(aircraft, SteadyCondition(V_mps))
    assert not result.converged
    full = float(re.search(r"at full throttle: (\d+) N", result.reason).group(1))
    missing = float(re.search(r"([\d.e+]+) N too little", result.reason).group(1))
    speed = float(re.search(r"try V <= ([\d.]+)", result.reason).group(1))
    slower = find_trim(aircraft, SteadyCondition(speed))
    assert slower.converged, slower.reason
    # Drag at these speeds grows nearly with the square of the airspeed.
    drag = slower.thrust_N * (V_mps / speed) ** 2
    assert full + missing == pytest.approx(drag, rel=0.1)


# The tanks of JSBSim's X15 are empty.
@pytest.mark.parametrize("name", ["SGS", "X15"])
def test_a_glider_finds_its_own_path(name):
    trim = find_trim(
        find_aircraft(name),
        SteadyCondition({"SGS": 25.0, "Shuttle": 200.0, "X15": 160.0}[name], 1000.0),
    )
    assert trim.converged
    assert trim.condition.climb_rad < 0.0
    # Steady: drag over lift is the tangent of the path, and the path is that of the velocity.
    north, east, down = trim.velocity_ned_mps
    assert math.atan2(-down, math.hypot(north, east)) == pytest.approx(
        trim.condition.climb_rad, abs=1e-9
    )


def test_a_saturated_elevator_is_named_with_its_limit(tmp_path):
    aircraft = small_plane(tmp_path, 1e-3, elevator=-0.02)
    slow, fast = (find_trim(aircraft, SteadyCondition(V, 100.0)) for V in (11.0, 25.0))
    assert not slow.converged
    assert not fast.converged
    assert "elevator is saturated at its lower limit of -1 norm" in slow.reason
    assert "rather a faster one" in slow.reason
    assert "rather a slower one" in fast.reason
    assert find_trim(aircraft, SteadyCondition(16.0, 100.0)).converged


def test_a_failure_need_not_be_explained():
    aircraft, condition = find_aircraft("espaaro"), SteadyCondition(40.0)
    brief, full = (find_trim(aircraft, condition, explains=explains) for explains in (False, True))
    assert not brief.converged
    assert "N too little" in full.reason
    assert full.reason.startswith(brief.reason)
    assert len(brief.reason) < len(full.reason) - 20
    np.testing.assert_array_equal(brief.residual, full.residual)


def test_a_wing_that_does_not_carry_is_named():
    result = find_trim(find_aircraft("espaaro"), SteadyCondition(5.0))
    assert "alpha is at its upper limit of 28.6 deg" in result.reason
    assert "does not carry" in result.reason


def test_filters_that_began_before_the_air_data_are_brought_to_rest(tmp_path):
    # A boosted elevator: dynamic pressure, unknown in the first frame, is its authority; positions
    # are written in degrees and read in radians.
    folder = foreign_aircraft.write("single", tmp_path)
    xml = folder / "single.xml"
    boosted = """
    <fcs_function name="boost/authority"><function><table>
      <independentVar>aero/qbar-psf</independentVar>
      <tableData>
        7 0
        20 1
      </tableData></table></function></fcs_function>
    <fcs_function name="boost/cmd-deg"><function><product>
      <value>20</value><property>pitch/sum</property><property>boost/authority</property>
    </product></function></fcs_function>
    <lag_filter name="boost/lag"><input>boost/cmd-deg</input><c1>5</c1>
      <output>fcs/elevator-pos-deg</output></lag_filter>
"""
    pattern = '<aerosurface_scale name="pitch/elevator">.*?</aerosurface_scale>'
    text, number = re.subn(pattern, boosted, xml.read_text(), count=1, flags=re.DOTALL)
    assert number
    plain = find_trim(find_aircraft(folder), SteadyCondition(50.0, 200.0))
    assert plain.converged
    xml.write_text(text)
    trim = find_trim(find_aircraft(folder), SteadyCondition(50.0, 200.0))
    assert trim.converged, trim.reason
    ratio = trim.controls["elevator"] / plain.controls["elevator"]
    assert ratio == pytest.approx(math.degrees(0.35) / 20.0, rel=1e-4)
