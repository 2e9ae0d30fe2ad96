"""Missions of ground stations, read and flown by the built-in autopilot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.flight import read_mission

HOME = (37.2, -80.5, 520.0)
# Frame, command, four parameters, latitude, longitude, altitude.
ROWS = [
    (3, 22, 15, 0, 0, 0, 0, 0, 50),
    (3, 16, 0, 0, 0, 0, 37.2045, -80.5, 100),
    (0, 16, 0, 0, 0, 0, 37.2045, -80.4955, 630),
    (3, 178, 0, 24, -1, 0, 0, 0, 0),
    (3, 206, 25, 0, 0, 0, 0, 0, 0),
    (3, 18, 0.5, 0, -100, 0, 37.2, -80.4955, 110),
    (3, 20, 0, 0, 0, 0, 0, 0, 0),
]


def waypoints(rows, home=HOME) -> str:
    table = [(0, 16, 0, 0, 0, 0, *home), *rows]
    lines = ["\t".join(map(str, (number, 0, *row, 1))) for number, row in enumerate(table, start=0)]
    return "\n".join(["QGC WPL 110", *lines]) + "\n"


def simple(row) -> dict:
    frame, command, *params = row
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": frame,
        "params": [x or None for x in params[:4]] + params[4:],
    }


def plan(items, **more) -> str:
    mission = {"plannedHomePosition": list(HOME), "items": items}
    return json.dumps({"fileType": "Plan", "mission": mission, **more})


def test_both_formats_are_the_same_mission(tmp_path: Path):
    (tmp_path / "a.waypoints").write_text(waypoints(ROWS))
    survey = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "TransectStyleComplexItem": {"Items": [simple(row) for row in ROWS[1:3]]},
    }
    items = [simple(ROWS[0]), survey, *(simple(row) for row in ROWS[3:])]
    (tmp_path / "a.plan").write_text(plan(items, geoFence={"circles": [{}]}))
    first, second = (read_mission(tmp_path / f"a.{end}") for end in ("waypoints", "plan"))
    assert first.items == second.items
    assert [item.kind for item in first.items] == ["leg", "leg", "turns", "home"]
    leg, turns = first.items[1:3]
    # 0.0045 degrees of latitude and longitude; 630 m above sea level are 110 above home.
    assert (leg.north_m, leg.height_m) == (pytest.approx(500.9, abs=0.1), 110.0)
    assert leg.east_m == pytest.approx(500.9 * np.cos(np.radians(37.2)), abs=0.1)
    assert (turns.amount, turns.radius_m, turns.speed_mps) == (0.5, -100.0, 24.0)
    assert "take-off" in first.notes[0]
    assert "geofence" in second.notes[0]


def test_jumps_are_carried_out(tmp_path: Path):
    leg = ROWS[1]
    (tmp_path / "a.waypoints").write_text(waypoints([leg, leg, (3, 177, 1, 2, 0, 0, 0, 0, 0)]))
    assert [item.number for item in read_mission(tmp_path / "a.waypoints").items] == [1, 2] * 3
    endless = (3, 177, 1, -1, *[0] * 5)
    (tmp_path / "a.waypoints").write_text(waypoints([leg, endless, leg]))
    mission = read_mission(tmp_path / "a.waypoints")
    assert (len(mission.items), len(mission.notes)) == (5000, 1)
    tag, jump = ((3, command, 7, 1, *[0] * 5) for command in (600, 601))
    (tmp_path / "a.waypoints").write_text(waypoints([leg, tag, leg, jump, leg]))
    assert [item.number for item in read_mission(tmp_path / "a.waypoints").items] == [1, 3, 3, 5]


def test_what_an_aeroplane_leaves_out_is_noted_with_its_line(tmp_path: Path):
    """A hold, heights above terrain and the landing, as missions of ground stations have them."""
    rows = [(10, 16, 5, *ROWS[1][3:]), (3, 189, *[0] * 7), (3, 85, 0, 0, 0, 0, 37.2, -80.5, 0)]
    (tmp_path / "a.waypoints").write_text(waypoints(rows))
    items = [simple(rows[0]), {"type": "ComplexItem", "complexItemType": "fwLandingPattern"}]
    (tmp_path / "a.plan").write_text(json.dumps(json.loads(plan(items)), indent=1))
    for name, landing, first in (("a.waypoints", "a.waypoints:5", 3), ("a.plan", "item 2", 12)):
        mission = read_mission(tmp_path / name)
        assert [(item.kind, item.height_m) for item in mission.items] == [("leg", 100)]
        notes = [note.removeprefix(f"{tmp_path}/") for note in mission.notes]
        assert landing in notes[0]
        assert "the landing is left out" in notes[0]
        assert notes[1].startswith(f"{name}:{first}: ")
        assert "heights above terrain" in notes[1]
        assert "holds are left out" in notes[2]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((3, 82, 0, 0, 0, 0, 37.2, -80.5, 0), "m.waypoints:3: NAV_SPLINE_WAYPOINT cannot"),
        ((3, 85, 0, 0, 0, 0, 37.2, -80.5, 0), "no item that moves"),
        ((3, 9999, 0, 0, 0, 0, 37.2, -80.5, 9), "command 9999 cannot"),
        ((4, 16, 0, 0, 0, 0, 37.2, -80.5, 50), "frame 4"),
        ((3, 16, 0, 0, 0, 0, 0, 0, 50), "without a position"),
        ((3, 16, 0, 0, 0, 0, 97.2, -80.5, 50), "97.2, -80.5 deg is none"),
        ((3, 16, 0, 0, 0, 0, 39.2, -80.5, 50), "km from home"),
        ((0, 16, 0, 0, 0, 0, 37.2, -80.5, 50), "-470 m above home"),
        ((3, 18, 0, 0, 60, 0, 37.2, -80.5, 50), "a loiter of 0"),
        ((3, 178, 1, 24, 0, 0, 0, 0, 0), "of type 1"),
        ((3, 177, 7, 1, 0, 0, 0, 0, 0), "DO_JUMP to item 7"),
        ((3, 601, 7, 1, 0, 0, 0, 0, 0), "DO_JUMP_TAG to tag 7"),
        ((3, 201, 0, 0, 0, 0, 0, 0, 0), "no item that moves"),
        ((3, 16, 0, 0), "received 7 fields"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_its_line(row, message: str, tmp_path: Path):
    path = tmp_path / "m.waypoints"
    path.write_text(waypoints([row]))
    with pytest.raises(BadInputError, match=message):
        read_mission(path)


def test_a_landing_on_the_way_is_refused_with_its_line(tmp_path: Path):
    rows = [ROWS[1], (3, 21, 0, 0, 0, 0, 37.2, -80.5, 0), ROWS[1]]
    path = tmp_path / "m.plan"
    path.write_text(json.dumps(json.loads(plan([simple(row) for row in rows])), indent=1))
    line = 1 + path.read_text()[: path.read_text().index(": 21,")].count("\n")
    with pytest.raises(BadInputError, match=f"m.plan:{line}: item 2: NAV_LAND cannot be flown"):
        read_mission(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "a plan of QGroundControl is JSON"),
        ("{}", "holds no mission with items"),
        ('{"mission": {"items": [], "plannedHomePosition": [1]}}', "plannedHomePosition"),
        (plan([{"type": "ComplexItem", "complexItemType": "StructureScan"}]), "without its own"),
        (plan([{"type": "SimpleItem", "params": [1]}]), "seven numbers"),
        ("GPX", "begins with QGC WPL 110"),
    ],
)
def test_files_of_another_kind(text: str, message: str, tmp_path: Path):
    path = tmp_path / "m.plan"
    path.write_text(text)
    with pytest.raises(BadInputError, match=message):
        read_mission(path)


def test_legs_and_a_loiter_are_flown(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "m.waypoints"
    path.write_text(waypoints(ROWS))
    words = ["fly", "espaaro", "--mission", str(path), "--duration-s", "110", "--wind-mps", "4"]
    assert main([*words, "--out", str(tmp_path / "flown.csv"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    items = document["mission_items"]
    assert [item["complete"] for item in items] == [True, True, True, False]
    # A leg from the start along it stays on it but for the wind; the turn by 90 degrees begins before the corner.
    assert items[0]["cross_track_max_m"] < 10.0
    assert items[1]["cross_track_median_m"] < 15.0
    rows = np.genfromtxt(tmp_path / "flown.csv", delimiter=",", names=True)
    at = np.searchsorted(rows["time_s"], items[1]["to_s"])
    # The flight begins 100 m above home, from where the record counts.
    assert rows["h_m"][at:].max() == pytest.approx(10.0, abs=6.0)
    # Half a turn to the left at 24 m/s around 100 m: the bank is negative, the speed is the new one.
    part = (rows["time_s"] > items[2]["to_s"] - 6.0) & (rows["time_s"] < items[2]["to_s"])
    assert np.median(rows["phi_rad"][part]) < -0.3
    assert np.median(rows["V_mps"][part]) == pytest.approx(24.0, abs=1.0)
