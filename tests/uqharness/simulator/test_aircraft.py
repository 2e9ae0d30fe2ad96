"""The E-SPAARO's XML and card: thrust, commands, the plugin, density, and broken models."""

from __future__ import annotations

import dataclasses
import math
import re
import shutil
import tomllib

import numpy as np
import pytest
from pydantic import ValidationError

from sysid.record import FlightRecord
from tests.helpers import sixdof
from uqharness.errors import BadInputError
from uqharness.flight.spec import COEFFICIENTS
from uqharness.replay.model import _factor
from uqharness.simulator import engine
from uqharness.simulator.aircraft import (
    PROJECT_ROOT,
    Aircraft,
    InputCard,
    find_aircraft,
    open_aircraft,
    position_factor,
    read_card,
    sensors_from_cg,
    sources,
    with_start_altitude,
)
from uqharness.simulator.forced_state import BodyState, force_state

FT, LBF = 0.3048, 4.4482216152605
FORCES = ("forces/fbx-total-lbs", "forces/fby-total-lbs", "forces/fbz-total-lbs")
MOMENTS = ("moments/l-total-lbsft", "moments/m-total-lbsft", "moments/n-total-lbsft")
METRICS = ("aero/qbar-psf", "metrics/Sw-sqft", "metrics/bw-ft", "metrics/cbarw-ft")
STATE = BodyState(22.0, 1.0, 0.8, 0.2, 0.05, 0.3, 0.4, -0.2, 0.1)
CONTROLS = {"elevator": 1.5, "aileron": -2.0, "rudder": 3.0, "throttle": 70.0}


def outputs(properties=None, names=FORCES + MOMENTS + METRICS):
    _, out = force_state(find_aircraft("espaaro"), STATE, CONTROLS, 100.0, properties, tuple(names))
    return out


@pytest.mark.parametrize("throttle", [0.0, 13.0, 60.2, 100.0])
@pytest.mark.parametrize("V", [15.0, 30.0])
def test_thrust_map(throttle, V):
    controls = CONTROLS | {"throttle": throttle}
    state = BodyState(V, 0.0, 0.0, 0.0, 0.0, 0.0)
    _, out = force_state(
        find_aircraft("espaaro"),
        state,
        controls,
        0.0,
        None,
        ("propulsion/rpm", "propulsion/thrust-N", "atmosphere/rho-slugs_ft3"),
    )
    rho = out["atmosphere/rho-slugs_ft3"] * 515.378818
    assert out["propulsion/rpm"] == pytest.approx(sixdof.rpm(throttle), rel=1e-9)
    assert out["propulsion/thrust-N"] == pytest.approx(
        sixdof.thrust(throttle, V, rho), rel=1e-3, abs=1e-3
    )
    assert rho == pytest.approx(1.225, rel=1e-4)


def test_totals_are_the_independent_coefficients():
    names = [f"aero/{name}" for name in COEFFICIENTS]
    out = outputs(names=names)
    V = np.sqrt(22.0**2 + 1.0 + 0.8**2)
    expected = sixdof.coefficients(
        sixdof.TABLE_2_6,
        np.arctan2(0.8, 22.0),
        np.arcsin(1.0 / V),
        0.4 * 3.66 / (2 * V),
        -0.2 * 0.53 / (2 * V),
        0.1 * 3.66 / (2 * V),
        np.array([1.5, -2.0, 3.0]),
    )
    assert [out[name] for name in names] == pytest.approx(list(expected), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("level", [0.0, 0.3])
@pytest.mark.parametrize("index", range(6))
def test_a_delta_is_its_bound_times_qS_and_lengths_at_the_cg_and_moves_nothing_else(index, level):
    name = COEFFICIENTS[index]
    lower, upper = -0.004 - 0.001 * index, 0.007 + 0.001 * index
    remaining = {
        f"uq/{other}/{bound}": 0.0
        for other in COEFFICIENTS
        if other != name
        for bound in ("lower", "upper")
    }
    plain = outputs()
    moved = outputs(
        {
            "uq/active": 1.0,
            f"uq/{name}/lower": lower,
            f"uq/{name}/upper": upper,
            f"uq/{name}/level": level,
            **remaining,
        }
    )
    delta = lower + level * (upper - lower)
    # JSBSim's own feet: its metre has ten digits, and the claim is about the delta, not about the
    # metre.
    qS = plain["aero/qbar-psf"] * plain["metrics/Sw-sqft"]
    assert qS == pytest.approx(plain["aero/qbar-psf"] * 1.97 / FT**2, rel=1e-7)
    b, c = plain["metrics/bw-ft"], plain["metrics/cbarw-ft"]
    length = (1.0, 1.0, 1.0, b, c, b)[index]
    for position, key in enumerate(FORCES + MOMENTS):
        expected = qS * length * delta if position == index else 0.0
        assert moved[key] - plain[key] == pytest.approx(expected, rel=1e-9, abs=1e-11), key


@pytest.fixture
def copy(tmp_path):
    """A copy of the aircraft that a test may spoil."""
    folder = tmp_path / "aircraft" / "espaaro"
    shutil.copytree(PROJECT_ROOT / "aircraft" / "espaaro", folder)
    return folder


@pytest.mark.parametrize("name", ["espaaro", "espaaro_truth", "synthetic_stall"])
def test_rates_are_made_dimensionless_with_the_airspeed_of_this_frame(name):
    """A frame late they were 0.25 % off while the speed changed, which an estimator took for
    damping that goes with alpha.
    """
    fdm = open_aircraft(find_aircraft(name))
    (
        fdm["ic/h-sl-ft"],
        fdm["ic/vt-fps"],
        fdm["ic/p-rad_sec"],
        fdm["ic/q-rad_sec"],
        fdm["ic/r-rad_sec"],
    ) = (
        900.0,
        72.0,
        0.3,
        0.2,
        0.1,
    )
    engine.run_ic(fdm)
    fdm.run()
    for _ in range(5):
        before = fdm["velocities/vt-fps"]
        fdm.run()
        assert abs(fdm["velocities/vt-fps"] / before - 1.0) > 1e-5
        for axis, length in (("p", "bw"), ("q", "cbarw"), ("r", "bw")):
            expected = (
                fdm[f"velocities/{axis}-rad_sec"]
                * fdm[f"metrics/{length}-ft"]
                / (2.0 * fdm["velocities/vt-fps"])
            )
            assert fdm[f"aero/{axis}_hat"] == pytest.approx(expected, rel=1e-12)


def test_command_styles():
    def surfaces(**settings: float):
        fdm = open_aircraft(find_aircraft("espaaro"))
        for name, value in settings.items():
            fdm[name.replace("__", "/").replace("_", "-")] = value
        fdm["ic/u-fps"], fdm["ic/h-sl-ft"] = 72.0, 1000.0
        engine.run_ic(fdm)
        return [fdm[f"fcs/{s}-pos-deg"] for s in ("elevator", "aileron", "rudder")] + [
            fdm["fcs/throttle-pos-pct"]
        ]

    degrees = {
        "fcs__elevator_cmd_deg": 2.0,
        "fcs__aileron_cmd_deg": -3.0,
        "fcs__rudder_cmd_deg": 4.0,
        "fcs__throttle_cmd_pct": 55.0,
    }
    norms = {
        "fcs__elevator_cmd_norm": 0.5,
        "fcs__aileron_cmd_norm": -0.25,
        "fcs__rudder_cmd_norm": 0.1,
        "fcs__throttle_cmd_norm": 0.4,
    }
    assert surfaces(**degrees, **norms) == pytest.approx([2.0, -3.0, 4.0, 55.0])
    assert surfaces(**degrees, **norms, ap__input_norm=1.0) == pytest.approx(
        [10.0, -5.0, 2.0, 40.0]
    )
    assert surfaces(fcs__elevator_cmd_deg=40.0, fcs__throttle_cmd_pct=130.0)[::3] == pytest.approx(
        [25.0, 100.0]
    )


def test_misspelt_and_illegal_property_names_are_refused():
    fdm = open_aircraft(find_aircraft("espaaro"))
    with pytest.raises(BadInputError, match=r"did you mean aero/Cm_q"):
        engine.set_property(fdm, "aero/Cmq", -1.0)
    with pytest.raises(BadInputError, match="not a legal"):
        engine.set_property(fdm, "aero/Cm_p^2", -1.0)


# The air's density of a record that does not say how high it was flown.

TIME = {"time_s": np.arange(5) * 0.02, "V_mps": np.full(5, 20.0)}
INITIAL = '<initialize name="a">{}</initialize>'


def test_the_aircrafts_initial_conditions_say_where_it_flies(tmp_path):
    (tmp_path / "model.xml").write_text("<fdm_config/>")
    record, output = with_start_altitude(FlightRecord(TIME), tmp_path)
    assert "alt_m" not in record.metadata.start
    assert "air of sea level" in output
    for text, altitude in (
        ('<elevation unit="M">30</elevation><altitudeAGL unit="M">100</altitudeAGL>', 130.0),
        ("<altitude>1000</altitude>", 304.8),
        ('<altitudeMSL unit="FT">500</altitudeMSL>', 152.4),
    ):
        (tmp_path / "start.xml").write_text(INITIAL.format(text))
        record, output = with_start_altitude(FlightRecord(TIME), tmp_path)
        assert record.metadata.start["alt_m"] == pytest.approx(altitude)
        assert f"{altitude:g} m above sea level were taken from start.xml" in output
    (tmp_path / "other.xml").write_text(INITIAL.format("<altitude>9000</altitude>"))
    assert "air of sea level" in with_start_altitude(FlightRecord(TIME), tmp_path)[1]


# The card as the simulator reads it; normalised commands in a record's degrees.


def with_elevator(**keys) -> Aircraft:
    stock = find_aircraft("c172x")
    inputs = {
        **stock.card.inputs,
        "elevator": InputCard(property="fcs/elevator-cmd-norm", unit="norm", **keys),
    }
    return dataclasses.replace(stock, card=stock.card.model_copy(update={"inputs": inputs}))


def test_a_throw_makes_degrees_of_norms_both_ways():
    aircraft = with_elevator(throw_deg=-20.0, position="fcs/elevator-pos-rad")
    table = sources(aircraft)
    assert table["elevator_deg"].factor == -20.0
    assert table["elevator_pos_deg"].factor == pytest.approx(-57.29577951308232)
    assert _factor(aircraft.card, "elevator") == pytest.approx(-1.0 / 20.0)
    assert "elevator_norm" in sources(with_elevator())


SOUND = (
    '[aircraft]\nname = "a"\nxml = "a.xml"\n[inputs.elevator]\nproperty ='
    ' "fcs/elevator-cmd-deg"\nunit = "deg"\n'
)


def test_a_card_with_an_unknown_key_is_refused(tmp_path):
    card = tmp_path / "airframe.toml"
    card.write_text(SOUND.replace("[inputs", "dt_ms = 10\n[inputs"))
    with pytest.raises(BadInputError, match=r"airframe\.toml: aircraft\.dt_ms: no such key"):
        read_card(card)
    card.write_text(SOUND + "[else]\na = 1\n")
    with pytest.raises(BadInputError, match=r"airframe\.toml: else: no such key"):
        read_card(card)
    card.write_text("[aircraft\n")
    with pytest.raises(BadInputError, match="not valid TOML"):
        read_card(card)
    with pytest.raises(BadInputError, match="no such file"):
        read_card(tmp_path / "none.toml")


# Positions in a card changed in place; the author's remarks stay.


@pytest.mark.parametrize(
    ("card", "expected"),
    [
        (
            "# mine\n[sensors]\nnoise_std = { q_radps = 0.1 }  # that\n",
            {"accelerometer": [-0.02, 0.0, 0.0]},
        ),
        (
            "[sensors.position_m]\nvane = [1.0, 0.5, 0]\n",
            {"accelerometer": [-0.02, 0.0, 0.0], "vane": [0.98, 0.5, 0.0]},
        ),
        ("a = 1\n", {"accelerometer": [-0.02, 0.0, 0.0]}),
    ],
)
def test_sensors_stay_in_the_airframe_and_remarks_in_the_card(tmp_path, card, expected):
    path = tmp_path / "airframe.toml"
    path.write_text(card, encoding="utf-8")
    sensors_from_cg(path, 0.02, "moved")
    text = path.read_text(encoding="utf-8")
    assert tomllib.loads(text)["sensors"]["position_m"] == expected
    assert all(line in text for line in card.splitlines() if "#" in line)
    path.write_text("a = [", encoding="utf-8")
    with pytest.raises(BadInputError, match=r"airframe\.toml"):
        sensors_from_cg(path, 0.02, "moved")
    sensors_from_cg(tmp_path / "none.toml", 0.02, "moved")
    assert not (tmp_path / "none.toml").exists()


NESTED = r"<product> <property>aero/CZ_alpha</property>(.*?)</product>"

BREAKS = {
    # JSBSim flies on without the term, and says nothing.
    "unknown-operation-in-a-sum": (
        NESTED,
        r"<prodct> <property>aero/CZ_alpha</property>\1</prodct>",
        r"espaaro\.xml:\d+.*did you mean <product>",
    ),
    "no-mass": (r'<emptywt unit="KG">21\.34', '<emptywt unit="KG">0', "mass is 0"),
    "missing-property": (
        r"<property>aero/CX_0</property>",
        "<property>aero/CX_nope</property>",
        r"aero/CX_nope.*espaaro\.xml:\d+",
    ),
    "bad-number": (
        r'<wingarea unit="M2">1\.97</wingarea>',
        '<wingarea unit="M2">large</wingarea>',
        r"espaaro\.xml:\d+",
    ),
    "malformed": (r"</aerodynamics>", "</aerodynamic>", r"espaaro"),
    "unknown-operation": (
        r"<function name=\"aero/qbar_S\">.*?<product>(.*?)</product>",
        r'<function name="aero/qbar_S"><prodct>\1</prodct>',
        "prodct",
    ),
}


@pytest.mark.parametrize("kind", BREAKS)
def test_a_broken_model_is_one_clear_error(copy, kind):
    pattern, replacement, message = BREAKS[kind]
    xml = copy / "espaaro.xml"
    text, count = re.subn(pattern, replacement, xml.read_text(), count=1, flags=re.S)
    assert count == 1
    xml.write_text(text)
    with pytest.raises(BadInputError, match=message):
        force_state(find_aircraft(copy), STATE, CONTROLS, 100.0)


def test_a_position_unit_that_nothing_reads_or_the_name_contradicts_is_refused():
    position = {"property": "fcs/aileron-cmd-norm", "position": "fcs/mean-aileron-pos"}
    card = InputCard(**position, position_unit="rad", throw_deg=-20.0)
    assert position_factor(card) == pytest.approx(-180.0 / math.pi)
    for entry, reason in (
        ({**position, "position": "fcs/aileron-pos-rad"}, "in rad by its name"),
        ({"property": "fcs/aileron-cmd-norm"}, "needs position"),
        ({**position, "unit": "deg"}, 'unit = "norm"'),
    ):
        with pytest.raises(ValidationError, match=reason):
            InputCard(**entry, position_unit="deg")
