"""Gains from ArduPilot parameter files: names, units, formats and refusals."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.helpers.places import ROOT
from uqharness.errors import BadInputError
from uqharness.flight.autopilot_gains import NO_LIMIT, autopilot_gains, read_gains

XML = (ROOT / "aircraft" / "espaaro" / "Systems" / "autopilot.xml").read_text(encoding="utf-8")
DECLARED = {
    name: float(value)
    for value, name in re.findall(r'<property value="([^"]+)">(ap/[^<]+)</property>', XML)
}
# As the parameter file of an E-SPAARO-like airframe has them (docs/autopilot.md, column [E]).
FLOWN = {
    "RLL2SRV_TCONST": 0.45,
    "RLL2SRV_RMAX": 70,
    "RLL_RATE_P": 0.22,
    "RLL_RATE_I": 0.20,
    "RLL_RATE_FF": 0.40,
    "PTCH_RATE_P": 0.35,
    "PTCH2SRV_RMAX_UP": 60,
    "KFF_RDDRMIX": 0.15,
    "YAW2SRV_DAMP": 0.1,
    "TECS_CLMB_MAX": 6,
    "TECS_PITCH_MIN": -12,
    "THR_MAX": 100,
}


def test_a_parameter_sets_the_property_of_its_name_in_its_unit():
    result = autopilot_gains(FLOWN, DECLARED)
    assert result.properties == {f"ap/{name}": value for name, value in FLOWN.items()}
    # The aircraft's own file was written by hand from the same source: an independent copy of names
    # and units.
    assert {prop: DECLARED[prop] for prop in result.properties} == result.properties
    assert (result.ignored, result.n_others) == ({}, 0)


def test_older_names_have_other_units_and_give_way_to_newer_ones():
    old = {"LIM_ROLL_CD": 5000, "TRIM_PITCH_CD": 100, "ARSPD_FBW_MIN": 16, "ARSPD_FBW_MAX": 30}
    result = autopilot_gains(old, DECLARED).properties
    assert result == pytest.approx(
        {
            "ap/ROLL_LIMIT_DEG": 50,
            "ap/PTCH_TRIM_DEG": 1,
            "ap/AIRSPEED_MIN": 16,
            "ap/AIRSPEED_MAX": 30,
        }
    )
    pair = autopilot_gains({"LIM_ROLL_CD": 4500, "ROLL_LIMIT_DEG": 50}, DECLARED)
    assert pair.properties == {"ap/ROLL_LIMIT_DEG": 50}
    assert pair.ignored == {"LIM_ROLL_CD": "the file has the newer name too"}


def test_limits_that_zero_switches_off():
    result = autopilot_gains(
        {"RLL2SRV_RMAX": 0, "RLL_RATE_FLTT": 0, "TECS_PITCH_MAX": 0, "PTCH_LIM_MAX_DEG": 22},
        DECLARED,
    )
    assert result.properties == {
        "ap/RLL2SRV_RMAX": NO_LIMIT,
        "ap/RLL_RATE_FLTT": NO_LIMIT,
        "ap/TECS_PITCH_MAX": 22,
    }
    assert autopilot_gains({"TECS_PITCH_MIN": 0, "LIM_PITCH_MIN": -2500}, DECLARED).properties == {
        "ap/TECS_PITCH_MIN": -25
    }


def test_derivative_gains_switch_their_terms_on_and_share_a_filter():
    result = autopilot_gains(
        {"RLL_RATE_D": 0.02, "RLL_RATE_FLTD": 10, "PTCH_RATE_FLTD": 10}, DECLARED
    ).properties
    assert result == {"ap/RLL_RATE_D": 0.02, "ap/RATE_FLTD": 10, "ap/RATE_D_ON": 1.0}
    difference = autopilot_gains(
        {"RLL_RATE_D": 0, "RLL_RATE_FLTD": 10, "PTCH_RATE_FLTD": 12}, DECLARED
    )
    assert difference.properties == {"ap/RLL_RATE_D": 0}
    assert set(difference.ignored) == {"RLL_RATE_FLTD", "PTCH_RATE_FLTD"}


def test_what_is_ignored_is_named_with_the_reason():
    result = autopilot_gains(
        {
            "RLL_RATE_P": 0.2,
            "RLL_RATE_SMAX": 150,
            "YAW2SRV_INT": 0,
            "WP_LOITER_RAD": 80,
            "BATT_CAPACITY": 5000,
            "SERVO1_MIN": 1000,
        },
        DECLARED,
    )
    assert result.ignored["RLL_RATE_SMAX"] == "the autopilot has no such term"
    assert result.ignored["YAW2SRV_INT"] == "0: off, as in the autopilot"
    assert "mission" in result.ignored["WP_LOITER_RAD"]
    assert result.n_others == 2
    words = "\n".join(result.lines())
    assert "1 gains taken: RLL_RATE_P 0.2" in words
    assert "2 parameters of other functions" in words


@pytest.mark.parametrize(
    ("parameters", "properties", "words"),
    [
        ({"RLL2SRV_TCONST": 0}, DECLARED, "RLL2SRV_TCONST 0: allowed is a number above 0"),
        ({"RLL2SRV_RMAX": -1}, DECLARED, "RLL2SRV_RMAX -1: allowed is a number 0 (off) or above"),
        (
            {"AIRSPEED_MIN": 20, "ARSPD_FBW_MAX": 15},
            DECLARED,
            "AIRSPEED_MIN 20: allowed is a number below AIRSPEED_MAX 15",
        ),
        ({"FW_RR_P": 0.05, "FW_R_TC": 0.4}, DECLARED, "these are PX4's parameters"),
        ({"BATT_CAPACITY": 5000}, DECLARED, "none of the 1 parameters is a gain of this autopilot"),
        (
            FLOWN,
            {"fcs/elevator-cmd-norm"},
            "the aircraft has no autopilot of ArduPlane's structure",
        ),
    ],
)
def test_autopilot_gains_refusals(parameters, properties, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        autopilot_gains(parameters, properties)


# A parameter file read for gains: the formats of two ground stations, and errors with file and
# line.

PROPERTIES = {"ap/RLL_RATE_P", "ap/RLL2SRV_TCONST"}


@pytest.mark.parametrize(
    "text", ["RLL_RATE_P 0.3\n", "\ufeffRLL_RATE_P,0.3\r\n", "# plane\n1\t1\tRLL_RATE_P\t0.3\t9\n"]
)
def test_formats_of_ground_stations(tmp_path: Path, text: str):
    path = tmp_path / "plane.param"
    path.write_text(text, encoding="utf-8")
    assert read_gains(path, PROPERTIES).properties == {"ap/RLL_RATE_P": 0.3}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            b"RLL_RATE_P 0.3\nRLL2SRV_TCONST 0\n",
            "line 2: RLL2SRV_TCONST 0: allowed is a number above 0",
        ),
        (b"RLL2SRV_TCONST 1\nRLL_RATE_P 0.3\nRLL2SRV_TCONST,-1\n", "line 3: RLL2SRV_TCONST -1"),
        (b"RLL_RATE_P 0.3\nhello\n", "line 2: 'hello' is no parameter"),
        (b"\0\1\2", "is no parameter file"),
        (b"RLL_RATE_P nan\n", "line 1: 'RLL_RATE_P nan' is no parameter"),
        (b"RLL_RATE_P 1e999\n", "line 1: 'RLL_RATE_P 1e999' is no parameter"),
        (b"RLL_RATE_P 1_8\n", "line 1: 'RLL_RATE_P 1_8' is no parameter"),
        ("RLL_RATE_P \u0661\u0668\n".encode(), "line 1: 'RLL_RATE_P \u0661\u0668' is no"),
        (b"RLL_RATE_P\x1b[31m 1\n", "line 1: 'RLL_RATE_P\x1b[31m 1' is no parameter"),
        (b"RLL_RATE_P " + b"9" * 99_999 + b"\n", "line 1: 'RLL_RATE_P 9999"),
        (b"", "holds no parameter"),
        (b"FW_RR_P 0.05\n", "these are PX4's parameters"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, content: bytes, words: str):
    path = tmp_path / "plane.param"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=re.escape(f"{path}: {words}")):
        read_gains(path, PROPERTIES)
