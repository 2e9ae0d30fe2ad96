"""Circles that an autopilot was told to fly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sysid.foreign.raw import MessageTable, RawLog
from sysid.logs.assemble import assemble
from sysid.logs.load import import_log
from sysid.logs.signal_map import shipped_map
from sysid.record import Loiter, Metadata

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
    (found,) = loiters(logged(radius, NTUN=targets((0.0, 900.0, 900.0), (50.05, *CENTRE))))
    assert (found.north_m, found.east_m) == pytest.approx(CENTRE, abs=0.3)
    assert (found.start_s, found.end_s) == (pytest.approx(50.1), pytest.approx(199.9))
    assert (found.radius_m, found.clockwise) == (abs(radius), radius > 0)


def test_a_target_that_is_moved_makes_two_loiters() -> None:
    found = loiters(logged(100.0, NTUN=targets((50.0, *CENTRE), (120.0, 500.0, 0.0))))
    assert [(round(x.north_m), round(x.end_s)) for x in found] == [(300, 120), (500, 200)]


@pytest.mark.parametrize("radius", [100.0, -60.0])
def test_without_a_target_positions_and_distances_give_the_centre(radius: float) -> None:
    (found,) = loiters(logged(radius))
    assert (found.north_m, found.east_m) == pytest.approx(CENTRE, abs=0.5)
    assert "cross-track" in found.source
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
    found = loiters(logged(100.0, mode=10.0, CMD=table))
    # The first stands in the log because it begins; the second is a waypoint.
    assert [(x.start_s, x.end_s, x.radius_m, x.clockwise) for x in found] == [
        (80.0, 150.0, 75.0, False),
        (150.0, pytest.approx(199.9), 100.0, True),
    ]
    assert [(x.north_m, x.east_m) for x in found] == [
        pytest.approx((300.0, -80.0), abs=0.3),
        pytest.approx((700.0, 50.0), abs=0.7),
    ]


def test_what_says_no_radius_or_circles_in_no_such_mode_has_none() -> None:
    raw = logged(100.0, NTUN=targets((50.0, *CENTRE)))
    assert loiters(RawLog(raw.dialect, raw.messages)) == ()
    assert loiters(logged(100.0, mode=5.0, NTUN=targets((50.0, *CENTRE)))) == ()


def test_loiters_stay_with_a_record() -> None:
    meta = Metadata(loiters=loiters(logged(-60.0)))
    assert Metadata.from_json(meta.to_json()).loiters == meta.loiters


@pytest.mark.parametrize("flight", ["flight4_loiter_medium", "flight5_loiter_severe"])
def test_genuine_targets_are_where_positions_and_distances_put_them(
    flight_data: Path, card_path: Path, flight: str
) -> None:
    record = import_log(flight_data / "espaaro-ardupilot" / f"{flight}.BIN", None, card_path)
    (found,) = record.metadata.loiters
    part = record.between(found.start_s + 60.0, found.end_s)
    n, e, d = (part[c] for c in ("north_m", "east_m", "cross_track_m"))
    miss = np.hypot(n - found.north_m, e - found.east_m) - found.radius_m - d
    assert found.clockwise
    assert abs(float(np.nanmedian(miss))) < 3.0
    assert float(np.nanstd(miss)) < 0.5
