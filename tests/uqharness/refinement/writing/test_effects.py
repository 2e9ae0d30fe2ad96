"""Effects in an aircraft's XML: where they stand, what they do, and that 0 leaves the model as it
was, bit for bit.
"""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest

from sysid.effects.catalogue import coefficient_effect, subsystem_effects
from uqharness.errors import BadInputError
from uqharness.identification.linearised import EffectProperty, servo_change
from uqharness.plugin.apply import Estimate
from uqharness.refinement.write_xml import EffectToWrite, carrier, switch_of, write_effects
from uqharness.replay.replay import runs_per_row
from uqharness.simulator import engine
from uqharness.simulator.actuators import Actuator
from uqharness.simulator.aircraft import find_aircraft, open_aircraft

STATES = (
    "velocities/p-rad_sec",
    "velocities/q-rad_sec",
    "velocities/r-rad_sec",
    "aero/alpha-rad",
    "aero/beta-rad",
    "velocities/vt-fps",
    "attitude/phi-rad",
    "attitude/theta-rad",
)


def write_files(effect, value, slopes=None):
    return EffectToWrite(effect, value, "a remark", slopes or {})


def trajectory(aircraft, properties=None, seconds=2.0):
    """(n, 8) states in a roll with all surfaces moved."""
    fdm = open_aircraft(aircraft)
    for name, value in (properties or {}).items():
        engine.set_property(fdm, name, value)
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/u-fps"], fdm["ic/w-fps"] = (
        45.0,
        400.0,
        70.0,
        2.0,
    )
    fdm["ic/p-rad_sec"] = 0.6
    fdm["fcs/elevator-cmd-deg"], fdm["fcs/aileron-cmd-deg"], fdm["fcs/rudder-cmd-deg"] = (
        1.0,
        -3.0,
        2.0,
    )
    engine.run_ic(fdm)
    rows = []
    for row in range(round(seconds / 0.01)):
        fdm["fcs/aileron-cmd-deg"] = -3.0 if row < 100 else 4.0
        fdm.run()
        rows.append([fdm[name] for name in STATES])
    return np.array(rows)


def test_a_term_joins_the_authors_sum_and_0_restores_the_model_bit_for_bit(tmp_path):
    aircraft = find_aircraft("espaaro")
    out = tmp_path / "aircraft" / "espaaro"
    out.parent.mkdir()
    assert (
        write_effects(aircraft, [write_files(coefficient_effect("Cm", "p_hat^2"), 3.0)], {}, out)
        == []
    )
    text = (out / "espaaro.xml").read_text(encoding="utf-8")
    assert (
        "<product> <property>aero/Cm_p2</property> <property>aero/p_hat</property>"
        " <property>aero/p_hat</property> </product>" in text
    )
    assert '<property value="3">aero/Cm_p2</property>  <!-- a remark; 0 switches it off -->' in text
    changed = find_aircraft(out)
    before = trajectory(aircraft)
    assert np.array_equal(trajectory(changed, {"aero/Cm_p2": 0.0}), before)
    assert np.abs(trajectory(changed)[:, 1] - before[:, 1]).max() > 0.005
    # The effect by itself: the reference truth's own term of the same value.
    truth = trajectory(
        find_aircraft("espaaro_truth"), {"aero/stall": 0.0, "aero/CX_q": 0.0, "aero/Cl_de": 0.0}
    )
    assert np.allclose(trajectory(changed), truth, atol=1e-12)


def test_a_term_carried_at_zero_gets_its_number(tmp_path):
    aircraft = find_aircraft("espaaro")
    out = tmp_path / "espaaro"
    effect = coefficient_effect("Cl", "de")
    assert (
        write_effects(
            aircraft, [write_files(effect, 3e-4)], {"aero/Cm_q": Estimate(-12.0, "new")}, out
        )
        == []
    )
    fdm = open_aircraft(find_aircraft(out))
    assert (fdm["aero/Cl_de"], fdm["aero/Cm_q"]) == (3e-4, -12.0)
    assert carrier(effect, aircraft) == EffectProperty("aero/Cl_de", 0.0)


@pytest.mark.parametrize(
    "term", ["abs(beta)*beta", "alphadot_hat", "de*CT", "alpha*V_rel", "1/h_over_b", "dt"]
)
def test_every_kind_of_variable_has_a_form_that_jsbsim_flies(tmp_path, term):
    aircraft = find_aircraft("espaaro")
    out = tmp_path / "espaaro"
    effect = coefficient_effect("CZ", term)
    write_effects(aircraft, [write_files(effect, 0.01)], {}, out)
    changed = find_aircraft(out)
    after = trajectory(changed, seconds=0.3)
    assert np.isfinite(after).all()
    assert not np.array_equal(after, trajectory(aircraft, seconds=0.3))
    assert np.array_equal(
        trajectory(changed, {effect.property_name: 0.0}, 0.3), trajectory(aircraft, seconds=0.3)
    )


@pytest.mark.parametrize("term", ["p_hat^2", "alphadot_hat"])
def test_rates_are_of_this_frames_airspeed_where_the_author_has_no_name_for_them(tmp_path, term):
    reference = find_aircraft("espaaro")
    nameless = tmp_path / "nameless"
    shutil.copytree(reference.folder, nameless)
    text = (nameless / "espaaro.xml").read_text(encoding="utf-8")
    for name in ("p_hat", "q_hat", "r_hat", "b_2V", "c_2V"):
        text = text.replace(f"aero/{name}<", f"aero/own_{name}<").replace(
            f'aero/{name}"', f'aero/own_{name}"'
        )
    (nameless / "espaaro.xml").write_text(text, encoding="utf-8")
    effect = write_files(coefficient_effect("Cm", term), 3.0)
    states = []
    for aircraft, folder in ((reference, "a"), (find_aircraft(nameless), "b")):
        out = tmp_path / folder / "espaaro"
        out.parent.mkdir()
        assert write_effects(aircraft, [effect], {}, out) == []
        states.append(trajectory(find_aircraft(out)))
    assert np.abs(states[0] - trajectory(reference)).max() > 1e-3
    assert np.allclose(states[0], states[1], rtol=0.0, atol=1e-10)


def test_beside_the_axes_it_does_the_same_as_in_the_sum(tmp_path):
    aircraft = find_aircraft("espaaro")
    effect = coefficient_effect("CZ", "q_hat*CT")
    write_effects(aircraft, [write_files(effect, -40.0)], {}, tmp_path / "in")
    shutil.copytree(aircraft.folder, tmp_path / "sumless")
    xml = tmp_path / "sumless" / "espaaro.xml"
    # The author's sum has another name, so that it is not known for that of CZ.
    xml.write_text(
        re.sub(r'aero/CZ(?=["<])', "aero/normal", xml.read_text(encoding="utf-8")), encoding="utf-8"
    )
    write_effects(
        find_aircraft(tmp_path / "sumless"), [write_files(effect, -40.0)], {}, tmp_path / "beside"
    )
    assert "aero/effect/" in (tmp_path / "beside" / "espaaro.xml").read_text(encoding="utf-8")
    inside, reference = (
        trajectory(find_aircraft(tmp_path / "in")),
        trajectory(find_aircraft(tmp_path / "beside")),
    )
    assert np.abs(inside - trajectory(aircraft)).max() > 1e-4
    assert np.allclose(inside, reference, atol=1e-10)


def test_subsystems_have_their_places(tmp_path):
    aircraft = find_aircraft("espaaro")
    by_key = {e.key: e for e in subsystem_effects(["aileron"], [], [])}
    chosen = [
        write_files(by_key["effect/propulsion/thrust_scale"], -0.1),
        write_files(by_key["effect/mass/Ixz"], 0.2),
        write_files(by_key["effect/actuator.aileron/lag"], 0.01),
        write_files(by_key["effect/propulsion/torque"], 0.02),
        write_files(by_key["effect/stall/dynamic"], 1.0, {"CZ_alpha": -3.3}),
        write_files(by_key["effect/propulsion/slipstream"], 0.5, {"Cm_de": -0.014}),
    ]
    out = tmp_path / "espaaro"
    write_effects(aircraft, chosen, {}, out)
    text = (out / "espaaro.xml").read_text(encoding="utf-8")
    assert '<property value="0.9">propulsion/thrust-scale</property>' in text
    assert '<ixz unit="KG*M2">0.45</ixz>' in text
    assert '<property value="20">effect/actuator/aileron-lag</property>' in text
    assert "<lag>effect/actuator/aileron-lag</lag>" in text
    changed = find_aircraft(out)
    assert np.isfinite(trajectory(changed)).all()
    assert carrier(by_key["effect/propulsion/thrust_scale"], aircraft) == EffectProperty(
        "propulsion/thrust-scale", 1.0
    )
    assert carrier(by_key["effect/mass/Ixz"], aircraft) is None


def pressed(aircraft, h_m: float, k: float | None = None) -> float:
    """Aerodynamic normal force [lbf] three frames after a level start at h_m."""
    fdm = open_aircraft(aircraft)
    if k is not None:
        engine.set_property(fdm, "effect/ground/lift", k)
    fdm["ic/lat-geod-deg"], fdm["ic/h-agl-ft"], fdm["ic/u-fps"], fdm["ic/w-fps"] = (
        45.0,
        h_m / 0.3048,
        70.0,
        3.0,
    )
    engine.run_ic(fdm)
    for _ in range(3):
        fdm.run()
    return float(fdm["forces/fbz-aero-lbs"])


def test_the_ground_lifts_by_its_share_and_only_near(tmp_path):
    aircraft = find_aircraft("espaaro")
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/ground/lift"]
    write_effects(aircraft, [write_files(effect, 0.1)], {}, tmp_path / "espaaro")
    changed = find_aircraft(tmp_path / "espaaro")
    assert pressed(changed, 3.66, 0.0) == pressed(aircraft, 3.66)
    ratio = pressed(changed, 3.66) / pressed(aircraft, 3.66)
    assert ratio == pytest.approx(
        1.0 + 0.1 * np.exp(-2.0), rel=3e-3
    )  # one span up; the aircraft moves a little, too
    assert pressed(changed, 100.0) == pytest.approx(pressed(aircraft, 100.0), rel=1e-12)


def test_a_rate_limit_counts_from_the_one_the_servo_has(tmp_path):
    aircraft = find_aircraft("espaaro")  # 240 deg/s
    effect = {e.key: e for e in subsystem_effects(["aileron"], [], [])}[
        "effect/actuator.aileron/rate_limit"
    ]
    write_effects(
        aircraft, [write_files(effect, 1.0 / 80.0 - 1.0 / 240.0)], {}, tmp_path / "espaaro"
    )
    text = "".join(p.read_text(encoding="utf-8") for p in (tmp_path / "espaaro").rglob("*.xml"))
    assert (
        '<property value="80">effect/actuator/aileron-rate_limit</property>  <!-- a remark; 240'
        " switches it off -->" in text
    )
    assert "<rate_limit>effect/actuator/aileron-rate_limit</rate_limit>" in text
    # SearchResult once more in the aircraft that has it: one property, the newer number.
    write_effects(
        find_aircraft(tmp_path / "espaaro"),
        [write_files(effect, 1.0 / 40.0 - 1.0 / 80.0)],
        {},
        tmp_path / "more" / "espaaro",
    )
    repeat = (tmp_path / "more" / "espaaro" / "espaaro.xml").read_text(encoding="utf-8")
    remarks = "  <!-- a remark; 240 switches it off -->  <!-- a remark; 80 switches it off -->"
    assert (
        f'<property value="40">effect/actuator/aileron-rate_limit</property>{remarks}\n' in repeat
    )
    assert repeat.count("effect/actuator/aileron-rate_limit</property>") == 1


@pytest.mark.parametrize(
    ("term", "value", "off"), [("lag", 0.06, 25.0), ("rate_limit", 0.1, 240.0)]
)
def test_a_servos_old_number_in_its_property_restores_the_model_bit_for_bit(
    tmp_path, term, value, off
):
    aircraft = find_aircraft("espaaro")
    effect = {e.key: e for e in subsystem_effects(["aileron"], [], [])}[
        f"effect/actuator.aileron/{term}"
    ]
    write_effects(aircraft, [write_files(effect, value)], {}, tmp_path / "espaaro")
    changed = find_aircraft(tmp_path / "espaaro")
    assert switch_of(effect, aircraft) == (f"effect/actuator/aileron-{term}", off)
    before = trajectory(aircraft)
    assert np.array_equal(trajectory(changed, {f"effect/actuator/aileron-{term}": off}), before)
    assert not np.array_equal(trajectory(changed), before)


def test_what_jsbsim_reads_as_a_number_alone_has_no_switch():
    aircraft = find_aircraft("espaaro")
    by_key = {e.key: e for e in subsystem_effects(["aileron"], ["ay_mps2"], [])}
    for key in ("mass/Ixz", "mass/cg_x", "actuator.aileron/deadband", "sensor.ay_mps2/scale"):
        assert switch_of(by_key[f"effect/{key}"], aircraft) is None


def test_a_commented_actuator_is_none(tmp_path):
    source = tmp_path / "given" / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, source)
    xml = source / "espaaro.xml"
    old = (
        '<!-- <channel name="old"><actuator'
        ' name="fcs/aileron-pos-deg"><lag>9</lag></actuator></channel> -->'
    )
    text = xml.read_text(encoding="utf-8")
    xml.write_text(text.replace("<flight_control", f"{old}\n<flight_control", 1), encoding="utf-8")
    effect = {e.key: e for e in subsystem_effects(["aileron"], [], [])}[
        "effect/actuator.aileron/lag"
    ]
    write_effects(find_aircraft(source), [write_files(effect, 0.01)], {}, tmp_path / "espaaro")
    assert old in (tmp_path / "espaaro" / "espaaro.xml").read_text(encoding="utf-8")
    assert np.isfinite(trajectory(find_aircraft(tmp_path / "espaaro"))).all()


def test_a_centre_of_gravity_that_moves_leaves_the_accelerometers_behind(tmp_path):
    aircraft = find_aircraft("espaaro")
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/mass/cg_x"]
    write_effects(aircraft, [write_files(effect, 0.05)], {}, tmp_path / "espaaro")
    changed = find_aircraft(tmp_path / "espaaro")
    assert changed.accelerometer_m == (-0.05, 0.0, 0.0)
    assert "<x>-0.05</x>  <!-- a remark -->" in changed.xml.read_text(encoding="utf-8")
    inputs, current = (
        (a.folder / "airframe.toml").read_text(encoding="utf-8").splitlines()
        for a in (aircraft, changed)
    )
    assert [n for g, n in zip(inputs, current, strict=True) if g != n] == [
        "position_m = { accelerometer = [-0.05, 0.0, 0.0] } # a remark"
    ]


def test_a_rate_limits_column_is_what_a_lower_limit_does():
    servo, h = Actuator(lag=25.0, rate=240.0), 0.02
    run_s = h / runs_per_row(h)
    command = np.repeat([0.0, 6.0, -6.0, 0.0], 40)
    column = servo_change("rate_limit", servo, command, h)
    before = servo.follow(command, h, run_s)
    fastest = np.abs(np.diff(before)).max() / h
    after = Actuator(lag=25.0, rate=0.75 * fastest).follow(command, h, run_s)
    assert column * (1.0 / (0.75 * fastest) - 1.0 / 240.0) == pytest.approx(
        after - before, abs=1e-9
    )
    # A servo at its limit already: the zero of the effect is that limit, not none.
    slow = Actuator(None, rate=100.0)
    at_limit = servo_change("rate_limit", slow, command, h)
    moved = Actuator(None, rate=75.0).follow(command, h, run_s) - slow.follow(command, h, run_s)
    assert at_limit * (1.0 / 75.0 - 1.0 / 100.0) == pytest.approx(moved, abs=1e-9)


@pytest.mark.parametrize(
    ("declared", "bytes_"),
    [
        ("UTF-8", "Vol d'été 1".encode()),
        ("ISO-8859-1", "Vol d'été 1".encode("latin-1")),
        ("US-ASCII", b"Vol d'&#233;t&#233; 1"),
    ],
)
def test_a_flights_name_with_accents_and_hyphens_is_written_as_the_file_is(
    tmp_path, declared, bytes_
):
    folder = tmp_path / "given" / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, folder)
    xml = folder / "espaaro.xml"
    xml.write_bytes(
        xml.read_bytes().replace(b'encoding="UTF-8"', f'encoding="{declared}"'.encode(), 1)
    )
    by_key = {e.key: e for e in subsystem_effects(["aileron"], [], [])}
    effects = [
        (by_key["effect/mass/Ixz"], 0.45),
        (by_key["effect/mass/cg_x"], 0.01),
        (by_key["effect/actuator.aileron/lag"], 0.01),
        (coefficient_effect("Cm", "p_hat^2"), 3.0),
    ]
    remark = "Vol d'été 1, a---b"
    write_effects(
        find_aircraft(folder),
        [EffectToWrite(e, v, remark, {}) for e, v in effects],
        {},
        tmp_path / "espaaro",
    )
    written_xml = (tmp_path / "espaaro" / "espaaro.xml").read_bytes()
    assert written_xml.count(b"<!-- " + bytes_ + b", a- - -b") == len(effects)
    open_aircraft(find_aircraft(tmp_path / "espaaro"))


@pytest.mark.parametrize(
    ("unit", "moved"),
    [(' unit="IN"', -1.0), ("", -1.0), (' unit="M"', -0.0254), (' unit="FT"', -0.0254 / 0.3048)],
)
def test_a_centre_of_gravity_moves_in_the_authors_unit(tmp_path, unit, moved):
    folder = tmp_path / "given" / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, folder)
    xml = folder / "espaaro.xml"
    x = "<!-- <x> 7 </x> --> <x><!-- aft -->2<!-- of the nose --></x>"
    place = f'<location name="CG"{unit}> {x} <y> 0 </y> <z> 0 </z> </location>'
    text = re.sub(
        r'<location name="CG".*?</location>',
        place,
        xml.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    xml.write_text(text, encoding="utf-8")
    aircraft = find_aircraft(folder)
    local = cg_in(aircraft)
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/mass/cg_x"]
    write_effects(aircraft, [write_files(effect, 0.0254)], {}, tmp_path / "espaaro")
    changed = find_aircraft(tmp_path / "espaaro")
    assert cg_in(changed) == pytest.approx(local - 1.0, abs=1e-5)
    assert (
        f"<x><!-- aft -->{2.0 + moved:.8g}<!-- of the nose --></x>  <!-- a remark -->"
        in changed.xml.read_text(encoding="utf-8")
    )


def cg_in(aircraft):
    fdm = open_aircraft(aircraft)
    fdm["ic/lat-geod-deg"], fdm["ic/h-sl-ft"], fdm["ic/u-fps"] = 45.0, 400.0, 70.0
    engine.run_ic(fdm)
    return fdm["inertia/cg-x-in"]


def test_a_centre_of_gravity_in_a_unit_that_JSBSim_does_not_know(tmp_path):
    folder = tmp_path / "given" / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, folder)
    aircraft = find_aircraft(folder)
    text = re.sub(
        r'<location name="CG"[^>]*>',
        '<location name="CG" unit="CM">',
        aircraft.xml.read_text(encoding="utf-8"),
    )
    aircraft.xml.write_text(text, encoding="utf-8")
    effect = {e.key: e for e in subsystem_effects([], [], [])}["effect/mass/cg_x"]
    with pytest.raises(
        BadInputError,
        match=r"espaaro\.xml:\d+: unit \"CM\" of the centre of gravity; use M, FT or IN",
    ):
        write_effects(aircraft, [write_files(effect, 0.0254)], {}, tmp_path / "espaaro")
