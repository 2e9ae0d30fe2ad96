"""Manoeuvres from a table and from commands; loiters of an autopilot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.assemble import assemble
from sysid.logs.load import import_log
from sysid.logs.manoeuvres import (
    Manoeuvre,
    find_manoeuvres,
    label_from_commands,
    label_manoeuvres,
    with_manoeuvres,
)
from sysid.logs.signal_map import shipped_map
from sysid.record import FlightRecord, Loiter, Metadata
from tests.helpers.synthetic import flight


def test_manoeuvres_from_a_table(tmp_path: Path) -> None:
    record = flight(10.0)
    table = tmp_path / "m.csv"
    table.write_text("flight,manoeuvre,start_s,end_s\none,pull-up,2,4\ntwo,3211,5,6\n")
    labels = label_manoeuvres(record, table, "one")["manoeuvre"]
    assert set(labels) == {"", "pull-up"}
    assert (labels == "pull-up").sum() == 101
    with pytest.raises(LogError, match="no manoeuvre of flight 'three'"):
        label_manoeuvres(record, table, "three")
    table.write_text("a,b\n1,2\n")
    with pytest.raises(LogError, match="has no column"):
        label_manoeuvres(record, table, "one")


@pytest.mark.parametrize(
    ("text", "output"),
    [
        ("manoeuvre,start_s,end_s\na,soon,4\n", "start_s holds a time that is no number"),
        (
            "manoeuvre,start_s,end_s\na,90,95\n",
            "no manoeuvre of flight 'one' lies between 0.0 and 10.0 s",
        ),
        ("manoeuvre,start_s,end_s\n" + "a,1,2\n" * 10_001, "10001 manoeuvres; at most 10000"),
    ],
)
def test_tables_that_name_nothing_are_refused(tmp_path: Path, text: str, output: str) -> None:
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(LogError, match=output):
        label_manoeuvres(flight(10.0), tmp_path / "m.csv", "one")


# Manoeuvres that are found in a record's commands.

DT = 0.02


def record(seconds: float = 60.0, hz: float = 50.0, **commands: np.ndarray) -> FlightRecord:
    time = np.arange(round(seconds / DT)) * DT
    meta = Metadata(native_hz=dict.fromkeys(commands, hz))
    return FlightRecord({"time_s": time, **commands}, meta)


def pulses(
    start_s: float, size: float, *lengths_s: float, seconds: float = 60.0, trim: float = -1.3
) -> np.ndarray:
    """A command that leaves its trim for pulses of alternate sign."""
    time, out, begin, sign = (
        np.arange(round(seconds / DT)) * DT,
        np.full(round(seconds / DT), trim),
        start_s,
        1.0,
    )
    for length in lengths_s:
        out[(time >= begin - 1e-9) & (time < begin + length - 1e-9)] += sign * size
        begin, sign = begin + length, -sign
    return out


@pytest.mark.parametrize(
    ("lengths_s", "kind"),
    [
        ((0.5, 0.5), "doublet"),
        ((0.9, 0.6, 0.3, 0.3), "3-2-1-1"),
        ((1.0,), "pulse"),
        ((0.4, 1.2), "pulses"),
        ((0.4, 0.4, 0.4), "pulses"),
    ],
)
@pytest.mark.parametrize("size", [-4.0, 2.0])
def test_kind_axis_size_and_times(lengths_s: tuple[float, ...], kind: str, size: float) -> None:
    (result,) = find_manoeuvres(
        record(elevator_deg=pulses(20.0, size, *lengths_s), aileron_deg=pulses(70.0, 1.0))
    )
    assert result == Manoeuvre(
        kind,
        "pitch",
        pytest.approx(20.0),
        pytest.approx(20.0 + sum(lengths_s)),
        pytest.approx(size),
        "deg",
    )
    assert result.name == f"pitch {kind}"


def test_what_an_autopilot_does_is_no_manoeuvre() -> None:
    rng, time = np.random.default_rng(3), np.arange(6000) * DT
    gusts = np.convolve(rng.standard_normal(6200), np.exp(-np.arange(200) / 30.0), "valid")[:6000]
    turn = np.where(time > 60.0, 9.0 * np.exp(-(time - 60.0) / 0.8), 0.0)
    assert (
        find_manoeuvres(record(120.0, elevator_deg=0.5 * gusts, aileron_deg=turn + 0.02 * gusts))
        == ()
    )
    # Nor what is logged too slowly to show an edge.
    assert find_manoeuvres(record(elevator_deg=pulses(20.0, 4.0, 0.5, 0.5), hz=8.3)) == ()


def test_labels_reach_from_before_the_input_into_the_answer() -> None:
    pair = record(elevator_deg=pulses(20.0, 3.0, 0.5, 0.5), aileron_deg=pulses(23.0, 3.0, 0.5, 0.5))
    labels, time = label_from_commands(pair)["manoeuvre"], pair["time_s"]
    pitch, roll = (time[labels == name] for name in ("pitch doublet", "roll doublet"))
    assert (pitch[0], pitch[-1]) == (pytest.approx(19.0), pytest.approx(22.0, abs=DT))
    assert (roll[0], roll[-1]) == (pytest.approx(22.0), pytest.approx(27.0))
    with pytest.raises(LogError, match="no manoeuvre was found"):
        label_from_commands(record(elevator_deg=np.zeros(3000)))


def test_a_table_or_the_word_found_labels_a_record(tmp_path: Path) -> None:
    trajectory = record(elevator_deg=pulses(20.0, 3.0, 0.5, 0.5))
    table = tmp_path / "found.csv"
    table.write_text("manoeuvre,start_s,end_s\nmine,30,40\n", encoding="utf-8")
    assert set(with_manoeuvres(trajectory, Path("found"), "one")["manoeuvre"]) == {
        "",
        "pitch doublet",
    }
    assert set(with_manoeuvres(trajectory, table, "one")["manoeuvre"]) == {"", "mine"}


# Circles that an autopilot was told to fly.

LAT, LNG = 37.2, -76.45
NORTH_M, EAST_M = 110989.0, 88788.0
"""Metres a degree at this latitude, WGS 84: the series of the textbooks to the metre."""
CENTRE = (300.0, -80.0)
TIME = np.arange(0.0, 200.0, 0.1)


def degrees(north: np.ndarray | float, east: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(LAT + np.asarray(north) / NORTH_M), np.asarray(
        LNG + np.asarray(east) / EAST_M
    )


def logged(radius: float, mode: float = 12.0, **more: MessageTable) -> RawLog:
    """A flight that circles from 50 s on, mode MANUAL before; the first row lies at the start."""
    angle = np.sign(radius) * TIME * 0.22
    distance = 2.0 * np.sin(0.1 * TIME)
    north, east = (
        c + (abs(radius) + distance) * f(angle)
        for c, f in zip(CENTRE, (np.cos, np.sin), strict=True)
    )
    north[0] = east[0] = 0.0
    lat, lng = degrees(north, east)
    messages = {
        "IMU": MessageTable(TIME, {n: np.zeros(TIME.size) for n in ("GyrX", "GyrY", "GyrZ")}),
        "GPS": MessageTable(TIME, {"Lat": lat, "Lng": lng}),
        "MODE": MessageTable(np.array([0.0, 50.0]), {"ModeNum": np.array([0.0, mode])}),
        "NTUN": MessageTable(TIME, {"XT": distance}),
    }
    messages |= more
    return RawLog(
        "dataflash",
        {(n, 0): t for n, t in messages.items()},
        parameters={"WP_LOITER_RAD": radius},
        vehicle="ArduPlane",
    )


def loiters(raw: RawLog) -> tuple[Loiter, ...]:
    return assemble(raw, shipped_map("dataflash"), None).metadata.loiters


def targets(*places: tuple[float, float, float]) -> MessageTable:
    """NTUN with targets, each from a time on."""
    north, east = np.zeros(TIME.size), np.zeros(TIME.size)
    for start, n, e in places:
        north[start <= TIME], east[start <= TIME] = n, e
    lat, lng = degrees(north, east)
    return MessageTable(TIME, {"XT": np.full(TIME.size, np.nan), "TLat": lat, "TLng": lng})


@pytest.mark.parametrize("radius", [100.0, -60.0])
def test_the_navigations_target_is_the_centre(radius: float) -> None:
    (result,) = loiters(logged(radius, NTUN=targets((0.0, 900.0, 900.0), (50.05, *CENTRE))))
    assert (result.north_m, result.east_m) == pytest.approx(CENTRE, abs=0.3)
    assert (result.start_s, result.end_s) == (pytest.approx(50.1), pytest.approx(199.9))
    assert (result.radius_m, result.clockwise) == (abs(radius), radius > 0)


@pytest.mark.parametrize("radius", [100.0, -60.0])
def test_without_a_target_positions_and_distances_give_the_centre(radius: float) -> None:
    (result,) = loiters(logged(radius))
    assert (result.north_m, result.east_m) == pytest.approx(CENTRE, abs=0.5)
    assert "cross-track" in result.source
    # Distances from another circle tell of none.
    assert loiters(logged(radius, NTUN=MessageTable(TIME, {"XT": np.full(TIME.size, -20.0)}))) == ()


def test_loiter_commands_of_a_mission() -> None:
    lat, lng = degrees(np.array([0.0, 100.0, 300.0, 700.0]), np.array([0.0, 0.0, -80.0, 50.0]))
    table = MessageTable(
        np.array([1.0, 60.0, 80.0, 150.0]),
        {
            "CId": np.array([17, 16, 18, 17]),
            "Prm3": np.array([0.0, 0.0, -75.0, 0.0]),
            "Lat": lat,
            "Lng": lng,
        },
    )
    result = loiters(logged(100.0, mode=10.0, CMD=table))
    # The first stands in the log because it begins; the second is a waypoint.
    assert [(x.start_s, x.end_s, x.radius_m, x.clockwise) for x in result] == [
        (80.0, 150.0, 75.0, False),
        (150.0, pytest.approx(199.9), 100.0, True),
    ]
    assert [(x.north_m, x.east_m) for x in result] == [
        pytest.approx((300.0, -80.0), abs=0.3),
        pytest.approx((700.0, 50.0), abs=0.7),
    ]


@pytest.mark.parametrize("flight", ["flight4_loiter_medium", "flight5_loiter_severe"])
def test_genuine_targets_are_where_positions_and_distances_put_them(
    flight_data: Path, card_path: Path, flight: str
) -> None:
    record = import_log(flight_data / "espaaro-ardupilot" / f"{flight}.BIN", None, card_path)
    (result,) = record.metadata.loiters
    part = record.between(result.start_s + 60.0, result.end_s)
    n, e, d = (part[c] for c in ("north_m", "east_m", "cross_track_m"))
    miss = np.hypot(n - result.north_m, e - result.east_m) - result.radius_m - d
    assert result.clockwise
    assert abs(float(np.nanmedian(miss))) < 3.0
    assert float(np.nanstd(miss)) < 0.5
