"""The folder for ArduPilot's JSBSim backend, started and commanded as the backend does it: with a
run script like the one that it writes, in JSBSim's own working folder.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jsbsim
import numpy as np
import pytest

import uqharness as uq
from tests.helpers.places import ROOT
from uqharness.differences import MatchedRequest, fly_matched
from uqharness.errors import BadInputError
from uqharness.exchange import ardupilot_jsbsim, box, source_model
from uqharness.flight import read_gains
from uqharness.simulator import find_aircraft

MEMBER = {"uq/active": 1.0, "uq/CZ/level": 1.0, "uq/Cl/level": 0.0, "uq/Cn/active": 0.0}
START = """<?xml version="1.0"?>
<runscript name="start">
  <use aircraft="{name}" initialize="reset"/>
  <run start="0" end="10000000" dt="0.000833">
    <event name="start engine">
      <condition> simulation/sim-time-sec le 0.01 </condition>
      <set name="propulsion/engine[0]/set-running" value="1"/>
    </event>
    <event name="Trim">
      <condition>simulation/sim-time-sec ge 0.01</condition>
      <set name="simulation/do_simple_trim" value="2"/>
    </event>
  </run>
</runscript>
"""
RESET = """<?xml version="1.0"?>
<initialize name="Start up location">
  <latitude unit="DEG" type="geodetic"> -35.36 </latitude>
  <longitude unit="DEG"> 149.16 </longitude>
  <altitude unit="M"> 1.3 </altitude>
  <vt unit="FT/SEC"> 0.0 </vt>
  <gamma unit="DEG"> 0.0 </gamma>
  <phi unit="DEG"> 0.0 </phi>
  <theta unit="DEG"> 13.0 </theta>
  <psi unit="DEG"> 90.0 </psi>
</initialize>
"""


def start_flight(root: Path, name: str, duration_s: float = 3.0) -> Any:
    """Return JSBSim after the backend's start and some time with neutral commands."""
    (root / "start.xml").write_text(START.format(name=name))
    (root / "aircraft" / name / "reset.xml").write_text(RESET)
    fdm = jsbsim.FGFDMExec(str(root))
    fdm.set_debug_level(0)
    assert fdm.load_script(str(root / "start.xml"), 1 / 1200)
    fdm.run_ic()
    for _ in range(round(1200 * duration_s)):
        for control in ("aileron", "elevator", "rudder", "throttle"):
            fdm[f"fcs/{control}-cmd-norm"] = 0.0
        fdm.run()
    return fdm


@pytest.fixture(scope="module")
def espaaro(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return DIR of an export of one member, flown at 22.2 m/s."""
    out = tmp_path_factory.mktemp("sitl")
    uq.export("espaaro", "ardupilot-jsbsim", out=out, speed_mps=22.2, states=20, member="--1--0")
    return out


def test_it_stands_and_moves_by_normalised_commands(espaaro: Path) -> None:
    fdm = start_flight(espaaro, "espaaro_--1--0")
    assert 0.1 < fdm["position/h-agl-ft"] * 0.3048 < 0.5
    assert abs(fdm["attitude/theta-deg"]) < 5.0
    # At rest the accelerometers read one g upwards, whatever the eye point's name in the XML.
    assert fdm["accelerations/Nz"] == pytest.approx(1.0, abs=0.02)
    for control, sign in (("elevator", 1.0), ("aileron", -1.0), ("rudder", 0.4)):
        for _ in range(1200):
            fdm[f"fcs/{control}-cmd-norm"] = sign
            fdm.run()
        assert fdm[f"fcs/{control}-pos-deg"] == pytest.approx(25.0 * sign, abs=0.01)
    for _ in range(2400):
        fdm["fcs/throttle-cmd-norm"] = 1.0
        fdm.run()
    assert fdm["fcs/throttle-pos-pct"] == pytest.approx(100.0, abs=0.1)
    assert fdm["propulsion/thrust-N"] > 50.0


def test_without_contact_points_the_start_fails(espaaro: Path, tmp_path: Path) -> None:
    source = source_model(find_aircraft("espaaro"), 22.2)
    copy = ardupilot_jsbsim.write_folder(source, "plane", tmp_path)
    assert not ardupilot_jsbsim.ground_start(copy, tmp_path).failure
    text = copy.xml.read_text()
    copy.xml.write_text(re.sub(r"<contact .*?</contact>", "", text, flags=re.DOTALL))
    assert "rim" in ardupilot_jsbsim.ground_start(copy, tmp_path).failure


def test_diff_gives_the_copy_its_own_commands(tmp_path: Path) -> None:
    """Else the backend's commands of zero would drive it, and every channel would differ."""
    aircraft = find_aircraft("espaaro")
    copy = ardupilot_jsbsim.write_folder(source_model(aircraft, 22.2), "plane", tmp_path)
    request = MatchedRequest(speeds_mps=(22.2,), missions=("steady",))
    _, (flight,) = fly_matched(aircraft, copy, request)
    assert not flight.reason
    for channel, values in flight.a.items():
        np.testing.assert_allclose(flight.b[channel], values, rtol=1e-6, atol=1e-8)


def test_a_member_is_frozen_in_the_files(tmp_path: Path) -> None:
    aircraft = find_aircraft("espaaro")
    nominal = source_model(aircraft, 22.2)
    member = source_model(aircraft, 22.2, MEMBER)
    copy = ardupilot_jsbsim.write_folder(member, "frozen", tmp_path)
    states = box(member, 30)
    flight = source_model(copy, 22.2).coefficients(states)
    np.testing.assert_allclose(flight, member.coefficients(states), rtol=0, atol=1e-12)
    # The bounds of CZ reach .05, those of Cl .0015; Cn is switched off, CX is in its middle.
    difference = flight - nominal.coefficients(states)
    np.testing.assert_allclose(difference, [[0, 0, 0.05, -0.0015, 0, 0]] * 30, atol=1e-12)


def test_parameters_are_read_back_as_gains(espaaro: Path) -> None:
    text = (espaaro / "espaaro_--1--0.parm").read_text()
    values = {name: float(value) for name, value in map(str.split, text.splitlines())}
    # Nose down, right wing down and nose left are this model's positive commands.
    assert [values[f"SERVO{k}_REVERSED"] for k in (1, 2, 4)] == [0.0, 1.0, 1.0]
    assert values["RLL_RATE_FLTD"] == values["PTCH_RATE_FLTD"] == 12.0
    assert values["AIRSPEED_CRUISE"] == 22.2
    names = re.findall(
        r">\s*(ap/[A-Z0-9_]+)",
        (espaaro / "aircraft/espaaro_--1--0/Systems/autopilot.xml").read_text(),
    )
    gains = read_gains(espaaro / "espaaro_--1--0.parm", names).properties
    assert gains["ap/RLL_RATE_P"] == 0.22


def test_all_members_of_a_campaign(tmp_path: Path) -> None:
    campaign = tmp_path / "campaign.toml"
    text = (ROOT / "tests/doc_campaign.toml").read_text()
    text = text.replace('"CX", "CY"', '"CX"').replace(", CY = 0.010", "")
    campaign.write_text(text.replace("scripts/", f"{ROOT}/scripts/"))
    loss = uq.export(
        "espaaro",
        "ardupilot-jsbsim",
        out=tmp_path / "out",
        speed_mps=22.2,
        states=20,
        member="all",
        campaign=campaign,
    )
    names = sorted(path.name for path in (tmp_path / "out/aircraft").iterdir())
    assert names == ["espaaro_0-----", "espaaro_1-----"]
    assert max(row.max for row in loss.coefficients.values()) < 1e-12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"member": "01"}, "--member 01: no such member; allowed: six digits 0, 1 or -"),
        ({"campaign": Path("x.toml")}, "--campaign x.toml: needs --member"),
        ({"properties": {"fcs/unheard-of": 1.0}}, "fcs/unheard-of"),
    ],
)
def test_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=re.escape(message)):
        uq.export("espaaro", "ardupilot-jsbsim", out=tmp_path, speed_mps=22.2, states=20, **options)
