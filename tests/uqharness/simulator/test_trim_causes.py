"""A trim that fails names its cause: step, thrust, a control at its limit, or no equilibrium."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from uqharness.simulator import forced_state, trim
from uqharness.simulator.aircraft import find_aircraft
from uqharness.simulator.trim import SteadyCondition, find_trim

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


def test_a_saturated_elevator_is_named_with_its_limit(tmp_path):
    result = find_trim(small_plane(tmp_path, 1e-3, elevator=-0.02), SteadyCondition(11.0, 100.0))
    assert not result.converged
    assert "elevator is saturated at its lower limit of -1 norm" in result.reason


def test_a_wing_that_does_not_carry_is_named():
    result = find_trim(find_aircraft("espaaro"), SteadyCondition(5.0))
    assert "alpha is at its upper limit of 28.6 deg" in result.reason
    assert "does not carry" in result.reason


def test_a_stalled_wing_is_named_before_alpha_is_at_its_limit():
    result = find_trim(find_aircraft("c310"), SteadyCondition(20.0))
    assert "downward acceleration" in result.reason
    assert "does not carry" in result.reason
    alpha = float(re.search(r"most lift, ([\d.]+) deg", result.reason).group(1))
    assert 5.0 < alpha < 28.0


@pytest.mark.parametrize(("name", "V_mps"), [("T38", 40.0)])
def test_a_failing_trim_takes_few_evaluations(name, V_mps, monkeypatch):
    """A count of models loaded, which is the time that a search takes, on any machine."""
    loaded = []
    original = forced_state.open_aircraft
    for module in (forced_state, trim):
        monkeypatch.setattr(
            module, "open_aircraft", lambda *a, **k: loaded.append(1) or original(*a, **k)
        )
    assert not find_trim(find_aircraft(name), SteadyCondition(V_mps)).converged
    assert len(loaded) < 300
