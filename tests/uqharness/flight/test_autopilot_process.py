"""A peer in the place of a real autopilot: it speaks the protocol of ArduPilot's JSON back-end, with
its parser's demands (no blank behind a colon, one line), and holds bank and height by the pulses.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.places import ROOT
from uqharness.errors import BadInputError
from uqharness.flight import AutopilotSettings, FlightSpec, recorded_flight
from uqharness.flight.autopilot_process import AutopilotProcess, command_scales, control_scales
from uqharness.simulator import find_aircraft, read_script

PEER = """
import re, socket, struct, sys
port, mode, wide = int(sys.argv[1]), sys.argv[2], len(sys.argv) > 3
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.settimeout(20.0)
frame, start = 0, None
pulses = [1500, 1500, 1600, 1500] + [0] * (28 if wide else 12)
layout = "<HHI%dH" % len(pulses)
def vector(text, key):
    found = re.search('"%s":\\\\[([-0-9.e]+),([-0-9.e]+),([-0-9.e]+)\\\\]' % key, text)
    return [float(x) for x in found.groups()]
while True:
    packet = struct.pack(layout, 29569 if wide else 18458, 100, frame, *pulses)
    link.sendto(packet, ("127.0.0.1", port))
    if mode == "repeat" and frame % 7 == 0:
        link.sendto(packet, ("127.0.0.1", port))
        first = link.recvfrom(4096)[0]
        assert link.recvfrom(4096)[0] == first
        text = first.decode()
    else:
        text = link.recvfrom(4096)[0].decode()
    assert text.startswith("\\n{") and text.endswith("}\\n") and text.count("\\n") == 2
    roll, pitch, yaw = vector(text, "attitude")
    p, q, r = vector(text, "gyro")
    position, velocity = vector(text, "position"), vector(text, "velocity")
    start = position[2] if start is None else start
    climb = 0.02 * (position[2] - start) + 0.05 * velocity[2]
    # Nose down is more pulse in this aircraft's elevator table.
    pulses[0] = round(1500 - 400 * (0.8 * roll + 0.2 * p))
    pulses[1] = round(1500 + 400 * (0.8 * (pitch - 0.03 - climb) + 0.2 * q))
    frame += 1
    if mode == "dies" and frame == 100:
        sys.exit("gains lost")
    while mode == "garbage" and frame == 100:
        link.sendto(b"no pulses", ("127.0.0.1", port))
"""

HIL_PEER = """
import socket, sys, time
from pymavlink.dialects.v20 import common as mavlink
port, mode = int(sys.argv[1]), sys.argv[2]
link = socket.create_connection(("127.0.0.1", port), 20.0)
pack = mavlink.MAVLink(None, 1, 1)
def send(message):
    link.sendall(message.pack(pack))
if mode == "silent":
    time.sleep(60)
if mode == "garbage":
    link.sendall(b"x" * 9000)
    time.sleep(60)
send(mavlink.MAVLink_heartbeat_message(1, 3 if mode == "other" else 12, 0, 0, 0, 3))
count, truth, gps = 0, None, []
while True:
    for message in pack.parse_buffer(link.recv(65536)) or ():
        if message.get_type() == "HIL_STATE_QUATERNION":
            truth = message
        elif message.get_type() == "HIL_GPS":
            gps.append(message)
        elif message.get_type() == "HIL_SENSOR":
            assert truth.time_usec == message.time_usec and message.fields_updated == 0x1FFF
            assert len(gps) >= 1 and 900 < message.abs_pressure < 1014
            w, x, y, z = truth.attitude_quaternion
            roll, pitch = 2 * (w * x + y * z), 2 * (w * y - z * x)
            climb = -truth.vz / 100
            aileron = -(0.8 * roll + 0.2 * message.xgyro)
            elevator = -(0.8 * (pitch - 0.03 + 0.05 * climb) + 0.2 * message.ygyro)
            controls = [aileron, elevator, 0.0, 0.5] + [float("nan")] * 12
            flags = 0 if mode == "free" else 1
            send(mavlink.MAVLink_hil_actuator_controls_message(message.time_usec, controls, 129, flags))
            count += 1
            if mode == "closes" and count == 100:
                link.close()
                time.sleep(60)
"""


@pytest.fixture
def peer(tmp_path: Path) -> Path:
    path = tmp_path / "peer.py"
    path.write_text(PEER)
    return path


def fly(
    peer: Path,
    *words: str,
    duration_s: float = 12.0,
    warmup_s: float = 0.0,
    protocol: Any = "ardupilot-json",
    timeout_s: float = 20.0,
):
    command = " ".join([sys.executable, str(peer), "{port}", *words])
    script = read_script(ROOT / "scripts/loiter.xml")
    spec = FlightSpec(
        aircraft=find_aircraft("espaaro").folder,
        script=script.path,
        duration_s=duration_s,
        turbulence="light",
        seed_turbulence=3,
    )
    settings = AutopilotSettings(command, warmup_s, timeout_s, 0, protocol)
    return recorded_flight(find_aircraft("espaaro"), script, spec, settings)


def test_it_flies_in_lock_step_and_again_alike(peer: Path) -> None:
    table, recorded = fly(peer, "hold")
    assert recorded.status == "ok"
    # The peer flies wings level, where the script's own autopilot would turn.
    assert np.abs(table["phi_rad"]).max() < 0.25
    assert np.ptp(table["psi_rad"]) < 0.3
    assert np.ptp(table["h_m"]) < 15.0
    repeat, _ = fly(peer, "repeat", "wide")
    assert table.equals(repeat)


@pytest.mark.parametrize(
    ("mode", "reason"),
    [
        ("dies", r"ended with exit code 1 at 1\.0. s .*gains lost"),
        ("garbage", r"sent 101 packets that are no servo pulses .* at 1\.0. s"),
    ],
)
def test_a_peer_that_fails_keeps_the_flight_so_far(mode: str, reason: str, peer: Path) -> None:
    table, recorded = fly(peer, mode)
    assert recorded.status == "crashed"
    assert re.search(reason, recorded.reason), recorded.reason
    assert len(table) == 11


def test_a_command_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="no-such-autopilot: No such file"):
        AutopilotProcess(AutopilotSettings("no-such-autopilot", port=0), find_aircraft("espaaro"))


def test_pulses_follow_the_card() -> None:
    scales = command_scales(find_aircraft("espaaro"))
    assert {name: scale.output for name, scale in scales.items()} == {
        "aileron": 1,
        "elevator": 2,
        "throttle": 3,
        "rudder": 4,
    }
    assert scales["elevator"].values == (-20.0, 0.0, 20.0)
    assert scales["throttle"].signals == (1000.0, 2000.0)
    # Without a card: JSBSim's normalised commands over ArduPlane's default pulses.
    plain = command_scales(find_aircraft("c172p"))
    assert plain["elevator"].property == "fcs/elevator-cmd-norm"
    assert plain["elevator"].signals == (1100.0, 1500.0, 1900.0)


@pytest.fixture
def px4(tmp_path: Path) -> Path:
    path = tmp_path / "px4.py"
    path.write_text(HIL_PEER)
    return path


def test_px4s_messages_fly_in_lock_step_and_again_alike(px4: Path) -> None:
    table, recorded = fly(px4, "hold", protocol="px4-hil", duration_s=8.0)
    assert recorded.status == "ok", recorded.reason
    # The peer flies wings level, where the script's own autopilot would turn.
    assert np.abs(table["phi_rad"]).max() < 0.25
    assert np.ptp(table["psi_rad"]) < 0.3
    assert np.ptp(table["h_m"]) < 15.0
    repeat, _ = fly(px4, "hold", protocol="px4-hil", duration_s=8.0)
    assert table.equals(repeat)


@pytest.mark.parametrize(
    ("mode", "reason"),
    [
        ("closes", r"closed the connection at (0\.9|1\.0). s of flight"),
        ("silent", "is silent for 1 s at 0.00 s"),
        ("garbage", "bytes that are no MAVLink 2"),
        ("other", "is no PX4: its heartbeat has autopilot 3"),
        ("free", "does not run in lock step"),
    ],
)
def test_a_peer_that_is_no_px4_is_told_by_its_fault(mode: str, reason: str, px4: Path) -> None:
    timeout_s = 1.0 if mode == "silent" else 20.0
    _, recorded = fly(px4, mode, protocol="px4-hil", duration_s=2.0, timeout_s=timeout_s)
    assert recorded.status == "crashed"
    assert re.search(reason, recorded.reason), recorded.reason


def test_px4s_controls_follow_the_signs_of_flight_records(tmp_path: Path) -> None:
    scales = control_scales(find_aircraft("espaaro"))
    # Nose up and nose right are negative deflections; the card's channels count from 1.
    assert scales["elevator"].values == (25.0, 0.0, -25.0)
    assert scales["aileron"].values == (-25.0, 0.0, 25.0)
    assert scales["throttle"].values == (0.0, 100.0)
    assert [scales[name].output for name in ("aileron", "elevator", "rudder")] == [1, 2, 3]
