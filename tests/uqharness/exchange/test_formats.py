"""Exported models against the programs' equations, written here a second time: one state after the
other, in world axes for Gazebo, so that signs and axes are not assumed.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import uqharness as uq
from tests.helpers.places import ROOT
from uqharness.cli import main as cli
from uqharness.errors import BadInputError
from uqharness.exchange import (
    FlightStates,
    ardupilot_json,
    derivatives,
    gazebo,
    order_dependence,
    source_model,
    sweeps,
)
from uqharness.exchange.states import VARIABLES, Reference
from uqharness.simulator import find_aircraft

REFERENCE = Reference(
    0.8,
    2.1,
    0.36,
    6.5,
    np.array([[0.9, 0.0, -0.07], [0, 0.6, 0], [-0.07, 0, 1.4]]),
    {"elevator": 24.0, "aileron": 20.0, "rudder": 28.0},
)


def states(n: int, seed: int = 0) -> FlightStates:
    rng = np.random.default_rng(seed)
    width = {"alpha": 0.2, "beta": 0.2, "p": 0.06, "q": 0.006, "r": 0.04}
    values = {v: width.get(v, 15.0) * rng.uniform(-1.0, 1.0, n) for v in VARIABLES}
    return FlightStates(rng.uniform(12.0, 40.0, n), values, REFERENCE.b_m, REFERENCE.c_m)


def ardupilot_keys() -> dict[str, Any]:
    rng = np.random.default_rng(1)
    keys = {key: float(rng.normal()) for key in ardupilot_json.KEYS}
    return keys | {
        "s": 0.24,
        "b": 2.1,
        "c": 0.36,
        "oswald": 0.8,
        "mcoeff": 50.0,
        "alpha_stall": 0.3,
        "CGOffset": [0.02, -0.01, 0.03],
    }


def gazebo_model() -> gazebo.LiftDragModel:
    rng = np.random.default_rng(2)
    tags = {tag: float(rng.normal()) for tag in gazebo.TAGS}
    tags |= {
        "area": 0.8,
        "mac": 0.36,
        "AR": 2.1**2 / 0.8,
        "eff": 0.85,
        "alpha_stall": 0.3,
        "air_density": 1.2041,
    }
    surfaces = [
        gazebo.ControlSurface(
            name,
            {gazebo.variable_of(name): direction},
            direction,
            {
                f"{c}_ctrl": float(rng.normal()) / 30.0
                for c in ("CL", "CD", "CY", "Cell", "Cem", "Cen")
            },
        )
        for name, direction in (
            ("elevator_joint", -1.0),
            ("left_aileron_joint", -1.0),
            ("right_aileron_joint", 1.0),
            ("rudder_joint", -1.0),
        )
    ]
    return gazebo.LiftDragModel(tags, surfaces)


def by_ardupilot(k: dict[str, Any], V: float, x: dict[str, float]) -> list[float]:
    """SIM_Plane.cpp, one state: forces and torque over the pressure and the lengths."""
    u = V * math.cos(x["alpha"]) * math.cos(x["beta"])
    v, w = V * math.sin(x["beta"]), V * math.sin(x["alpha"]) * math.cos(x["beta"])
    alpha, beta = math.atan2(w, u), math.atan2(v, u)
    p, q, r = (
        x["p"] * 2 * V / REFERENCE.b_m,
        x["q"] * 2 * V / REFERENCE.c_m,
        x["r"] * 2 * V / REFERENCE.b_m,
    )
    elevator, aileron, rudder = -x["de"] / 24.0, x["da"] / 20.0, -x["dr"] / 28.0
    rho, s, b, c = 1.225, k["s"], k["b"], k["c"]
    m, a0 = k["mcoeff"], k["alpha_stall"]
    sigmoid = (1 + math.exp(-m * (alpha - a0)) + math.exp(m * (alpha + a0))) / (
        (1 + math.exp(-m * (alpha - a0))) * (1 + math.exp(m * (alpha + a0)))
    )
    line = k["c_lift_0"] + k["c_lift_a"] * alpha
    lift = (1 - sigmoid) * line + sigmoid * (
        2 * math.copysign(1, alpha) * math.sin(alpha) ** 2 * math.cos(alpha)
    )
    drag = k["c_drag_p"] + line**2 / (math.pi * k["oswald"] * b**2 / s)
    sine, cosine = math.sin(alpha), math.cos(alpha)
    pressure = 0.5 * rho * V**2 * s
    fx = pressure * (
        -drag * cosine
        + lift * sine
        + (-k["c_drag_q"] * cosine + k["c_lift_q"] * sine) * c * q / (2 * V)
        - k["c_drag_deltae"] * cosine * abs(elevator)
        + k["c_lift_deltae"] * sine * elevator
    )
    fz = pressure * (
        -drag * sine
        - lift * cosine
        + (-k["c_drag_q"] * sine - k["c_lift_q"] * cosine) * c * q / (2 * V)
        - k["c_drag_deltae"] * sine * abs(elevator)
        - k["c_lift_deltae"] * cosine * elevator
    )

    def lateral(z: str) -> float:
        rates = (k[f"c_{z}_p"] * p + k[f"c_{z}_r"] * r) * b / (2 * V)
        controls = k[f"c_{z}_deltaa"] * aileron + k[f"c_{z}_deltar"] * rudder
        return float(k[f"c_{z}_0"] + k[f"c_{z}_b"] * beta + rates + controls)

    fy = pressure * lateral("y")
    gx, gy, gz = k["CGOffset"]
    roll = pressure * b * lateral("l") + gy * fz - gz * fy
    pitch = (
        pressure
        * c
        * (
            k["c_m_0"]
            + k["c_m_a"] * alpha
            + k["c_m_q"] * c * q / (2 * V)
            + k["c_m_deltae"] * elevator
        )
        - gx * fz
        + gz * fx
    )
    yaw = pressure * b * lateral("n") - gy * fx + gx * fy
    return [
        fx / pressure,
        fy / pressure,
        fz / pressure,
        roll / (pressure * b),
        pitch / (pressure * c),
        yaw / (pressure * b),
    ]


def by_gazebo(model: gazebo.LiftDragModel, V: float, x: dict[str, float], turn: Rotation) -> Any:
    """AdvancedLiftDrag.cc, one state in a world that is turned by any rotation."""
    t = model.tags
    # Link axes forward, left, up.
    speed = V * np.array(
        [
            math.cos(x["alpha"]) * math.cos(x["beta"]),
            -math.sin(x["beta"]),
            -math.sin(x["alpha"]) * math.cos(x["beta"]),
        ]
    )
    spin = (
        2
        * V
        * np.array(
            [
                x["p"] / REFERENCE.b_m,
                -x["q"] / REFERENCE.c_m,
                -x["r"] / REFERENCE.b_m,
            ]
        )
    )
    rr, pr, yr = spin * np.array([1.0, -1.0, -1.0])
    flu = np.array([1.0, -1.0, -1.0])
    air = turn.apply(speed + np.cross(spin, flu * model.air_m))
    link = [turn.apply(flu * axis) for axis in np.eye(3)]
    ex, ez = turn.apply(flu * model.axes[0]), turn.apply(flu * model.axes[2])
    ey = np.cross(ez, ex)
    plane = air - (air @ ey) * ey
    size = float(np.linalg.norm(plane))
    sx = plane / size
    sz = np.cross(sx, ey)
    span = math.sqrt(t["area"] * t["AR"])
    alpha, beta = math.atan2(sx @ ez, sx @ ex), math.atan2(air @ ey, air @ ex)
    pressure, half = 0.5 * t["air_density"] * size**2, 0.5 * t["air_density"] * size
    m, a0 = 15.0, t["alpha_stall"]
    sigma = (1 + math.exp(-m * (alpha - a0)) + math.exp(m * (alpha + a0))) / (
        (1 + math.exp(-m * (alpha - a0))) * (1 + math.exp(m * (alpha + a0)))
    )
    control = dict.fromkeys(("CL", "CD", "CY", "Cell", "Cem", "Cen"), 0.0)
    for surface in model.surfaces:
        # The joint that the exporter writes turns by direction times deflection.
        ((variable, share),) = surface.shares.items()
        joint = share * x[variable]
        for key in control:
            control[key] += joint * surface.effects[f"{key}_ctrl"] * surface.direction

    def damped(name: str) -> float:
        return half * (
            t[f"{name}p"] * rr * span / 2
            + t[f"{name}q"] * pr * t["mac"] / 2
            + t[f"{name}r"] * yr * span / 2
        )

    lift = (1 - sigma) * (t["CL0"] + t["CLa"] * alpha)
    lift += sigma * 2 * (alpha / abs(alpha)) * math.sin(alpha) ** 2 * math.cos(alpha)
    lift += t["CLb"] * beta + control["CL"]
    flat = 2 / (1 + math.exp(-0.224 - 0.115 * max(t["AR"], 1 / t["AR"])))
    drag = (1 - sigma) * (t["CD0"] + lift**2 / (math.pi * t["AR"] * t["eff"]))
    drag += sigma * abs(flat * (0.5 - 0.5 * math.cos(2 * alpha))) + control["CD"]
    force = (lift * pressure + damped("CL")) * t["area"] * -sz
    force = force + (drag * pressure + damped("CD")) * t["area"] * -sx
    side = t["CYa"] * alpha + t["CYb"] * beta + control["CY"]
    force = force + (side * pressure + damped("CY")) * t["area"] * ey
    if alpha > a0:
        pitch = t["Cem0"] + t["Cema"] * a0 + t["Cema_stall"] * (alpha - a0)
    elif alpha < -a0:
        pitch = t["Cem0"] - t["Cema"] * a0 + t["Cema_stall"] * (alpha + a0)
    else:
        pitch = t["Cem0"] + t["Cema"] * alpha
    pitch += t["Cemb"] * beta + control["Cem"]
    roll = t["Cella"] * alpha + t["Cellb"] * beta + control["Cell"]
    yaw = t["Cena"] * alpha + t["Cenb"] * beta + control["Cen"]
    moment = (pitch * pressure + damped("Cem")) * t["area"] * t["mac"] * ey
    moment = moment + (roll * pressure + damped("Cell")) * t["area"] * span * ex
    moment = moment + (yaw * pressure + damped("Cen")) * t["area"] * span * ez
    moment = moment + np.cross(turn.apply(flu * model.arm_m), force)
    complete = 0.5 * t["air_density"] * V**2 * t["area"]
    lengths = (span, t["mac"], span)
    return np.array(
        [force @ axis / complete for axis in link]
        + [moment @ axis / complete / length for axis, length in zip(link, lengths, strict=True)]
    )


def rows(of: FlightStates) -> list[tuple[float, dict[str, float]]]:
    return [
        (float(of.V_mps[k]), {v: float(of.values[v][k]) for v in VARIABLES}) for k in range(len(of))
    ]


def test_ardupilots_equations():
    keys, of = ardupilot_keys(), states(1000)
    expected = [by_ardupilot(keys, V, x) for V, x in rows(of)]
    computed = ardupilot_json.coefficients(keys, of, REFERENCE.throw_deg)
    assert computed == pytest.approx(np.array(expected), rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("turned", [False, True])
def test_gazebos_equations(turned: bool):
    """Also with <cp> off the centre of gravity, and <forward> and <upward> turned in the link.

    Rates are those of the link; the air is felt at <cp>.
    """
    model, of = gazebo_model(), states(1000)
    if turned:
        axes = Rotation.from_euler("zyx", [0.2, -0.3, 0.1]).as_matrix()
        model = replace(model, arm_m=(-0.1, 0.03, 0.05), air_m=(-0.1, 0.02, 0.05), axes=axes)
    turns = Rotation.random(len(of), random_state=3)
    expected = [by_gazebo(model, V, x, turns[k]) for k, (V, x) in enumerate(rows(of))]
    computed = gazebo.coefficients(model, of)
    assert computed == pytest.approx(np.array(expected), rel=1e-10, abs=1e-10)


class _Formula:
    """A source that follows a formula, around a trim at 20 m/s."""

    def __init__(self, formula: Any) -> None:
        self.coefficients, self.reference = formula, REFERENCE
        self.middle = {"alpha": 0.05, "de": 0.0, "da": 0.0, "dr": 0.0}
        self.trim = SimpleNamespace(
            condition=SimpleNamespace(V_mps=20.0),
            alpha_rad=0.05,
            controls=dict.fromkeys(("elevator", "aileron", "rudder"), 0.0),
        )


def in_symmetry(of: FlightStates) -> FlightStates:
    """The same states without sideslip: there both programs are linear in what they hold."""
    return replace(of, values={**of.values, "beta": np.zeros(len(of))})


def test_a_source_of_gazebos_form_is_held_exactly():
    model = gazebo_model()
    tags = dict(model.tags) | {"alpha_stall": 5.0, "CLb": 0.0}
    complete = gazebo.LiftDragModel(tags, model.surfaces)
    # Without sideslip, where the program's own angle and pressure are no polynomials.
    source: Any = _Formula(lambda of: gazebo.coefficients(complete, in_symmetry(of)))
    fitted = gazebo.parameters(source, derivatives(source))
    constant = gazebo.LiftDragModel({**fitted.tags, "alpha_stall": 5.0}, fitted.surfaces)
    of = in_symmetry(states(500, 4))
    difference = gazebo.coefficients(constant, of) - gazebo.coefficients(complete, of)
    # Rolling, pitching and yawing moment and side force are linear; the polar is quadratic.
    assert np.abs(difference[:, [1, 3, 4, 5]]).max() < 1e-9
    assert constant.tags["CL0"] == pytest.approx(tags["CL0"], abs=1e-8)
    assert constant.tags["CLa"] == pytest.approx(tags["CLa"], abs=1e-8)


def test_the_model_of_an_aircraft_holds_its_pitching_moment(tmp_path: Path):
    loss = uq.export("espaaro", "ardupilot-json", out=tmp_path, speed_mps=22.2, states=200)
    # Cm of this aircraft is linear in alpha, q and elevator.
    assert loss.coefficients["Cm"].max < 1e-12
    assert loss.coefficients["CX"].rms > 0.001
    keys = ardupilot_json.read(tmp_path / "espaaro.json")
    # Full nose up raises the nose; right wing down, nose right, stable in pitch, yaw and roll.
    signs = {
        "c_m_deltae": 1,
        "c_l_deltaa": 1,
        "c_n_deltar": 1,
        "c_m_a": -1,
        "c_n_b": 1,
        "c_l_p": -1,
    }
    assert {key: int(math.copysign(1, keys[key])) for key in signs} == signs
    assert keys["s"] * 21.34 / 2.0 == pytest.approx(1.97, rel=1e-3)


def test_files_are_read_as_they_were_written(tmp_path: Path):
    uq.export("espaaro", "gazebo", out=tmp_path, speed_mps=22.2, states=50)
    models = [gazebo.read(tmp_path / name)[0] for name in ("model.sdf", "model-classic.sdf")]
    assert models[0] == models[1]
    assert [(*s.shares,) for s in models[0].surfaces] == [("de",), ("da",), ("da",), ("dr",)]
    text = (tmp_path / "model.sdf").read_text()
    # Forward, left, up: the product of inertia keeps JSBSim's sign.
    assert "<ixz>0.249" in text
    of = states(100, 5)
    complete = gazebo.coefficients(models[0], of)
    for old, new in (
        (f"<Cema>{models[0].tags['Cema']!r}", f"<Cema>{-models[0].tags['Cema']!r}"),
        (f"<Cenb>{models[0].tags['Cenb']!r}", f"<Cenb>{models[0].tags['Cenb'] / 57.3!r}"),
        (f"<mac>{models[0].tags['mac']!r}", "<mac>1.0"),
        ("<direction>1.0", "<direction>-1.0"),
    ):
        damaged = tmp_path / "spoilt.sdf"
        assert old in text
        damaged.write_text(text.replace(old, new, 1))
        assert gazebo.read(damaged)[0] != models[0]
        if "direction" not in old and "mac" not in old:
            assert np.abs(gazebo.coefficients(gazebo.read(damaged)[0], of) - complete).max() > 1e-4


FOREIGN = """<sdf version="1.5"><model name="plane">
<link name="base_link"><inertial><pose>0.02 0 0 0 0 0</pose><mass>1</mass></inertial></link>
{joints}
<plugin name="gz::sim::systems::AdvancedLiftDrag"><area>0.34</area><AR>6.5</AR><eff>0.97</eff>
<mac>0.22</mac><cp>-0.12 0.01 0</cp><link_name>base_link</link_name>
<num_ctrl_surfaces>2</num_ctrl_surfaces>{surfaces}</plugin>
</model></sdf>"""


@pytest.mark.parametrize(
    ("joint", "child", "axis", "effects", "shares"),
    [
        # Of an aeroplane with an elevator "elevons" are ailerons; the axis tells the sign.
        ("servo_0", "left_elevon", "0 1 0", {"Cell": -0.003}, {"da": -1.0}),
        ("servo_1", "right_elevon", "0 -1 0", {"Cell": -0.003}, {"da": -1.0}),
        ("servo_3", "rudder", "0 0 1", {"Cen": 0.0016}, {"dr": -1.0}),
        ("servo_4", "left_flap", "0 1 0", {"Cem": 0.01}, {}),
        # Names that tell nothing: the largest moment, in this project's signs.
        ("servo_5", "", "0 1 0", {"Cen": 0.002, "Cell": 0.001}, {"dr": -1.0}),
        ("servo_6", "panel", "0 1 0", {}, {}),
    ],
)
def test_joints_of_other_peoples_models(joint, child, axis, effects, shares, tmp_path: Path):
    elevator = '<joint name="servo_2"><child>elevator</child><axis><xyz>0 1 0</xyz></axis></joint>'
    joints = f'<joint name="{joint}"><child>{child}</child><axis><xyz>{axis}</xyz></axis></joint>'
    numbers = "".join(f"<{key}_ctrl>{value}</{key}_ctrl>" for key, value in effects.items())
    surfaces = "<control_surface><name>servo_2</name></control_surface>"
    surfaces += f"<control_surface><name>{joint}</name>{numbers}</control_surface>"
    path = tmp_path / "plane.sdf"
    path.write_text(FOREIGN.format(joints=elevator + joints, surfaces=surfaces))
    model, geometry = gazebo.read(path)
    assert model.surfaces[1].shares == shares
    # <cp> counts from the link, the arm from its centre of gravity, forward, right, down.
    assert model.arm_m == model.air_m == pytest.approx((-0.14, -0.01, 0.0))
    # Gazebo classic puts the forces <ref_pt> from the centre of gravity, and counts the surfaces.
    path.write_text(path.read_text().replace("cp>", "ref_pt>").replace(">2</num", ">1</num"))
    classic, _ = gazebo.read(path)
    assert classic.arm_m == pytest.approx((-0.12, -0.01, 0.0))
    assert (classic.air_m, len(classic.surfaces)) == (model.air_m, 1)
    assert (geometry.mass_kg, geometry.c_m) == (1.0, 0.22)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1]", "a JSON object"),
        ('{"s": 1}', "lacks b, c"),
        ("{", "a JSON object is needed"),
        (json.dumps(dict.fromkeys(ardupilot_json.KEYS, 1.0) | {"c_m_a": "x"}), "c_m_a = 'x'"),
        (
            json.dumps(dict.fromkeys(ardupilot_json.KEYS, 1.0) | {"CGOffset": [1, 2]}),
            "three finite",
        ),
    ],
)
def test_bad_json_is_one_sentence(content: str, message: str, tmp_path: Path):
    path = tmp_path / "model.json"
    path.write_text(content)
    with pytest.raises(BadInputError, match=message):
        ardupilot_json.read(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<sdf><model/></sdf>", "has no plugin"),
        ('<sdf><plugin name="LiftDragPlugin"/></sdf>', "1 plugins LiftDrag, of single wings"),
        (
            '<sdf><plugin name="AdvancedLiftDrag"><AR>6</AR><eff>1</eff><cp>0 0</cp></plugin></sdf>',
            "<cp> '0 0': 3 finite",
        ),
        ("<sdf>", "no XML"),
        ('<sdf><plugin name="AdvancedLiftDrag"><AR>x</AR></plugin></sdf>', "<AR> 'x': a finite"),
        ('<sdf><plugin name="AdvancedLiftDrag"><AR>0</AR></plugin></sdf>', "<AR> = 0: a number"),
    ],
)
def test_bad_sdf_is_one_sentence(content: str, message: str, tmp_path: Path):
    path = tmp_path / "model.sdf"
    path.write_text(content)
    with pytest.raises(BadInputError, match=message):
        gazebo.read(path)


def test_a_loss_beyond_the_bounds_is_refused_until_it_is_accepted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    form = ROOT / "tests/fuzz/corpus/results/bounds/model-form.json"
    words = ["export", "espaaro", "--to", "ardupilot-json", "--out", str(tmp_path / "out")]
    words += ["--speed-mps", "22.2", "--states", "100", "--bounds", str(form)]
    assert cli.main(words) == 1
    printed = capsys.readouterr()
    assert printed.out.startswith("Beyond the half-width of the bounds: CX")
    assert "made for another model" in printed.err
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["loss.csv", "loss.json"]
    assert cli.main([*words, "--accept-loss"]) == 1
    assert (tmp_path / "out" / "espaaro.json").is_file()


def test_nothing_that_is_not_its_own_is_overwritten(tmp_path: Path):
    plane, out = tmp_path / "aircraft" / "vtail-jet", tmp_path / "out"
    shutil.copytree(ROOT / "aircraft/espaaro", plane)
    (plane / "espaaro.xml").rename(plane / "vtail-jet.xml")
    card = (plane / "airframe.toml").read_text()
    (plane / "airframe.toml").write_text(card.replace("espaaro.xml", "vtail-jet.xml"))

    def export(to: str, place: Path) -> Any:
        return uq.export(plane, to, out=place, speed_mps=22.2, states=20)

    (tmp_path / "aircraft" / "v_tail_jet").mkdir()
    for to, place, message in (
        ("csv", plane / "table", "lies in the folder of the aircraft"),
        ("ardupilot-jsbsim", tmp_path, "has aircraft/v_tail_jet, which no export"),
    ):
        with pytest.raises(BadInputError, match=message):
            export(to, place)
    # ArduPilot would fly a jet of another frame.
    loss = export("ardupilot-json", out)
    assert loss.files[0] == "v_tail_jet.json"
    assert "is called v_tail_jet" in loss.notes[0]
    export("ardupilot-json", out)
    with pytest.raises(BadInputError, match="no export of vtail-jet to csv"):
        export("csv", out)
    assert not (plane / "table").exists()


def test_a_table_holds_one_variable_at_a_time_exactly():
    def formula(of: FlightStates) -> Any:
        x = of.values
        columns = [x["alpha"], x["beta"], x["q"], x["p"] + x["da"], x["alpha"] + x["de"], x["r"]]
        return np.column_stack(columns)

    source: Any = _Formula(formula)
    tables = sweeps.sweeps(source)
    of = states(50, 6)
    inside = {
        name: np.clip(of.values[name], tables[name][0].min(), tables[name][0].max())
        for name in VARIABLES
    }
    bounded = replace(of, values=inside)
    assert sweeps.coefficients(source, tables, bounded) == pytest.approx(
        formula(bounded), abs=1e-12
    )


def test_controls_with_a_memory_are_noticed():
    """A filter that runs on from state to state; a function of the state alone has none."""
    for formula, share in ((lambda x: np.cumsum(x), 1.0), (lambda x: x**2, 0.0)):
        source: Any = _Formula(lambda of, f=formula: np.tile(f(of.values["alpha"]), (6, 1)).T)
        assert (order_dependence(source, states(20)) > 0.5) == bool(share)


def test_the_cards_unit_of_the_commands_does_not_matter(tmp_path: Path):
    """Commands of 20 deg at 1 in place of degrees."""
    models = []
    for norm in (False, True):
        folder = tmp_path / str(norm) / "espaaro"
        shutil.copytree(ROOT / "aircraft/espaaro", folder)
        card = (folder / "airframe.toml").read_text().replace("[-25, 25]", "[-20, 20]")
        if norm:
            card = re.sub(r'"fcs/(\w+)-cmd-(deg|pct)"', r'"fcs/\1-cmd-norm"', card)
            card = re.sub(r"(?m)^(selected|servo_pwm) =.*\n", "", card)
            card = card.replace('unit = "pct"', 'unit = "norm"').replace("[0, 100]", "[0, 1]")
            card = card.replace('unit = "deg"\npos', 'throw_deg = 20\nunit = "norm"\npos')
            card = card.replace("[-20, 20]", "[-1, 1]").replace('norm" = 0', 'norm" = 1')
        (folder / "airframe.toml").write_text(card)
        source = source_model(find_aircraft(folder), 22.2)
        assert source.reference.throw_deg["elevator"] == pytest.approx(20.0)
        assert 20.0 < source.controls["throttle"] < 80.0
        models.append(ardupilot_json.parameters(source, derivatives(source)))
    for key in ardupilot_json.KEYS:
        assert models[1][key] == pytest.approx(models[0][key], rel=2e-3, abs=1e-4), key
