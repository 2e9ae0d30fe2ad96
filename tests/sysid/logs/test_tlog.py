"""MAVLink telemetry: times, damage, other systems' packets."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sysid.errors import LogError
from sysid.logs import tlog
from sysid.logs.detect import frame_length, frame_time
from sysid.logs.info import log_info
from sysid.logs.load import import_log
from tests.helpers.log_writers import write_tlog
from tests.helpers.places import TESTS
from tests.helpers.synthetic import flight


def test_tlog_gives_its_channels_on_the_vehicles_clock(tmp_path: Path) -> None:
    record = flight(60.0, start_s=100.0)
    path = tmp_path / "a.tlog"
    write_tlog(path, record, every=5)
    back = import_log(path)
    assert back.metadata.dialect == "tlog"
    assert back.metadata.vehicle == "fixed wing"
    assert back.metadata.grid_hz == pytest.approx(10.0)
    theta = np.interp(back["time_s"], record["time_s"], record["theta_rad"])
    np.testing.assert_allclose(back["theta_rad"], theta, atol=2e-3)
    az = np.interp(back["time_s"], record["time_s"], record["az_mps2"])
    np.testing.assert_allclose(back["az_mps2"], az, atol=0.02)
    (purpose,) = [
        p
        for p in log_info(import_log(path, card_path=TESTS / "sysid" / "data")).purposes
        if p.name == "identification"
    ]
    assert "Hz; at least 20 Hz" in purpose.reason


def attitude(system: int, ms: int, roll: float) -> bytes:
    sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    stamp = struct.pack(">Q", 1_700_000_000_000_000 + 1000 * ms)
    beat = mavlink.MAVLink_heartbeat_message(1 if system == 7 else 2, 3, 81, 12, 4, 3)
    message = mavlink.MAVLink_attitude_message(ms, roll, 0.0, 0.0, 0.0, 0.0, 0.0)
    return stamp + beat.pack(sender) + stamp + message.pack(sender)


def test_packets_of_another_aircraft_are_left_out(tmp_path: Path) -> None:
    data = b"".join(attitude(7, 100 * k, 0.1) + attitude(9, 100 * k, 0.9) for k in range(1, 30))
    (tmp_path / "a.tlog").write_bytes(data)
    raw = tlog.read(tmp_path / "a.tlog")
    assert np.allclose(raw.messages[("ATTITUDE", 0)].fields["roll"], 0.1)
    assert raw.messages[("ATTITUDE", 0)].time_s == pytest.approx(0.1 * np.arange(1, 30))
    assert raw.vehicle == "fixed wing"
    # Counted they are all the same.
    assert raw.counts["ATTITUDE"] == 58


def test_damage_costs_the_packets_it_hits_and_is_told(tmp_path: Path) -> None:
    parts = [attitude(7, 100 * k, 0.1) for k in range(1, 30)]
    broken = bytearray(parts[10])
    broken[-5] ^= 0xFF
    (tmp_path / "a.tlog").write_bytes(
        b"".join([*parts[:5], b"\0" * 33, *parts[5:10], bytes(broken), *parts[11:]])
    )
    raw = tlog.read(tmp_path / "a.tlog")
    # The packet in front of the zeros is lost too: one counts when another follows.
    assert np.setdiff1d(
        np.arange(1, 30), np.rint(10.0 * raw.messages[("ATTITUDE", 0)].time_s)
    ).tolist() == [5, 11]
    result = {f.code: f.numbers for f in raw.findings}
    assert result["damaged-packets"] == {"packets": 1.0}
    assert result["damaged-bytes"]["bytes"] >= 33.0
    (tmp_path / "b.tlog").write_bytes(b"".join(parts))
    assert tlog.read(tmp_path / "b.tlog").findings == ()


def test_a_file_without_flight_data_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.tlog").write_bytes(b"\xfe" * 500)
    with pytest.raises(LogError, match="no MAVLink packet with flight data"):
        tlog.read(tmp_path / "a.tlog")


def test_what_comes_in_bursts_is_placed_by_the_stamps_around_it(tmp_path: Path) -> None:
    """A radio that hands over once a second: times of receipt are a second apart, and VFR_HUD has
    no other.
    """
    record = flight(40.0, start_s=100.0)
    write_tlog(tmp_path / "even.tlog", record, every=5)
    data, pos, out = (tmp_path / "even.tlog").read_bytes(), 0, b""
    while pos + 20 < len(data):
        end = pos + 8 + frame_length(data, pos + 8)
        late = np.ceil(frame_time(data, pos)) * 1e6
        out += struct.pack(">Q", int(late)) + data[pos + 8 : end]
        pos = end
    (tmp_path / "bursts.tlog").write_bytes(out)
    back = import_log(tmp_path / "bursts.tlog")
    assert np.isfinite(back["V_mps"]).mean() > 0.95
    np.testing.assert_allclose(
        back["V_mps"][5:-5],
        np.interp(back["time_s"], record["time_s"], record["V_mps"])[5:-5],
        atol=0.25,
    )
    # Placed by receipt, which is up to a second late, the speed would miss by more.
    late = np.interp(np.floor(back["time_s"]), record["time_s"], record["V_mps"])
    assert np.abs(late - np.interp(back["time_s"], record["time_s"], record["V_mps"])).max() > 1.0
    start, end = back.metadata.free_flight_s[0]
    assert end - start > 38.0
