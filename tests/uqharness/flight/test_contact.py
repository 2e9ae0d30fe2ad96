"""Contact with the ground: the first step in which a contact point touches, in flights that have
been in the air.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from uqharness.flight.fly import GroundWatch, fly, fly_one_ulp_off
from uqharness.flight.spec import FlightSpec
from uqharness.simulator import engine, find_aircraft, stage

_DT_S, _BLOCK = 0.01, 10
START = """<initialize name="low">
  <latitude unit="DEG"> 45 </latitude> <longitude unit="DEG"> 0 </longitude>
  <altitude unit="FT"> {altitude_ft} </altitude> <vt unit="FT/SEC"> {speed_fps} </vt>
</initialize>
"""
SCRIPT = (
    '<runscript><use aircraft="c172p" initialize="low"/><run start="0" end="60"'
    ' dt="0.01"/></runscript>'
)


@pytest.fixture(scope="module")
def staging(tmp_path_factory):
    return stage(find_aircraft("c172p"), tmp_path_factory.mktemp("staged"))


def opened(staging, height_ft, speed_fps=0.0):
    fdm = engine.open_fdm(staging, _DT_S)
    fdm["ic/h-agl-ft"], fdm["ic/u-fps"] = height_ft, speed_fps
    engine.run_ic(fdm)
    return fdm


def watched(fdm, blocks):
    watch = GroundWatch(fdm, find_aircraft("c172p"), _BLOCK * _DT_S)
    for _ in range(blocks):
        touched = watch.advance(lambda steps: [fdm.run() for _ in range(steps)], _BLOCK)
        if touched:
            return touched, round(fdm.get_sim_time() / _DT_S)
    return "", round(fdm.get_sim_time() / _DT_S)


def first_contact(fdm):
    units = {f"gear/unit[{n}]": name for n, name in enumerate(("NOSE", "LEFT_MAIN", "RIGHT_MAIN"))}
    units |= {
        f"contact/unit[{n + 3}]": name
        for n, name in enumerate(("NOSE_SKID", "TAIL_SKID", "LEFT_TIP", "RIGHT_TIP"))
    }
    while not (
        touching := [name for unit, name in units.items() if fdm[f"{unit}/compression-ft"] > 0.0]
    ):
        fdm.run()
    return f"contact point {touching[0]}", round(fdm.get_sim_time() / _DT_S)


@pytest.mark.parametrize(("height_ft", "speed_fps"), [(6.0, 100.0), (100.0, 100.0), (300.0, 0.0)])
def test_the_first_step_of_contact_is_found_whatever_the_block(staging, height_ft, speed_fps):
    expected = first_contact(opened(staging, height_ft, speed_fps))
    assert watched(opened(staging, height_ft, speed_fps), 200) == expected
    assert expected[1] % _BLOCK, (
        "a contact at the end of a block would be found without looking at each step"
    )


def test_who_starts_on_the_wheels_may_stay_there_until_the_first_hop(staging):
    assert watched(opened(staging, 4.0), 300) == ("", 3000)
    # Fast enough to leave the ground: it touches again after eleven seconds.
    name, step = watched(opened(staging, 4.0, speed_fps=150.0), 300)
    assert (name, 300 < step < 3000) == ("contact point NOSE", True)


def low(tmp_path: Path, altitude_ft: float, speed_fps: float = 100.0) -> FlightSpec:
    folder = tmp_path / "c172p"
    shutil.copytree(find_aircraft("c172p").folder, folder)
    (folder / "low.xml").write_text(START.format(altitude_ft=altitude_ft, speed_fps=speed_fps))
    script = tmp_path / "low-script.xml"
    script.write_text(SCRIPT)
    return FlightSpec(folder, script, duration_s=20.0)


def test_a_flight_ends_with_the_name_of_what_touched_and_the_time(tmp_path):
    result = fly(low(tmp_path, 60.0))
    assert result.status == "ground-contact"
    assert result.reason == f"contact point NOSE touched the ground at {result.flown_s:.1f} s"
    assert 1.0 < result.flown_s < 5.0
    # Today's bounce would go on from here: without the watch the aircraft is in the air again.
    assert result.signals["height_m"].min() > 0.0


def test_a_unit_in_the_last_place_is_another_flight_by_rounding_alone(tmp_path):
    spec = low(tmp_path, 3000.0)
    one, moved, again = fly(spec), fly_one_ulp_off(spec), fly(spec)
    assert one.signals["V_mps"].tobytes() == again.signals["V_mps"].tobytes()
    assert one.signals["V_mps"].tobytes() != moved.signals["V_mps"].tobytes()
    assert moved.signals["V_mps"] == pytest.approx(one.signals["V_mps"], rel=1e-9)
