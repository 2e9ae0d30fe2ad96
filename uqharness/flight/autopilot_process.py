"""A real autopilot in lock step: ArduPilot's JSON back-end over UDP, PX4's HIL messages over TCP.

The autopilot is a process that the user brings, such as ``arduplane --model JSON:127.0.0.1``. In
each frame it sends the pulses of its servos and waits for the state of the aircraft (protocol:
ArduPilot's libraries/SITL/examples/JSON/readme.md; PX4's src/modules/simulation/simulator_mavlink).
Simulated time stands still while it computes, so that equal seeds give equal flights if the
autopilot is deterministic.
"""

from __future__ import annotations

import contextlib
import json
import math
import shlex
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, NoReturn
from typing import Protocol as Interface

import numpy as np

from sysid.logs import Servo, read_card
from sysid.units import FT_M, G0_MPS2, PSF_PA, SEA_LEVEL_KGPM3
from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, InputCard, engine, set_command

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Protocol = Literal["ardupilot-json", "px4-hil"]
PORTS: Mapping[Protocol, int] = {"ardupilot-json": 9002, "px4-hil": 4560}
"""UDP port of ArduPilot's JSON back-end, TCP port of PX4's simulation link."""
_PACKETS = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}
"""Magic number to layout: magic, frame rate, frame count, pulses [us] of 16 or 32 outputs."""
_OUTPUTS = {"aileron": 1, "elevator": 2, "throttle": 3, "rudder": 4}
_CLOSED_US, _NEUTRAL_US, _OPEN_US = 1100.0, 1500.0, 1900.0
"""ArduPlane's default SERVOn_MIN, _TRIM and _MAX."""
_LONGEST_OUTPUT = 400
_MAX_DAMAGED = 100
"""Packets of another program in a row that end a flight."""
_STATE = {
    "gyro": ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec"),
    "accel": tuple(f"accelerations/a-pilot-{axis}-ft_sec2" for axis in "xyz"),
    "position": ("position/from-start-neu-n-ft", "position/from-start-neu-e-ft"),
    "height": ("position/h-agl-ft",),
    "velocity": ("velocities/v-north-fps", "velocities/v-east-fps", "velocities/v-down-fps"),
    "attitude": ("attitude/phi-rad", "attitude/theta-rad", "attitude/psi-rad"),
    "airspeed": ("velocities/vt-fps",),
}
_FEET = ("accel", "position", "height", "velocity", "airspeed", "altitude")
_HIL_STATE = {
    **{name: _STATE[name] for name in ("gyro", "accel", "velocity", "attitude", "airspeed")},
    "altitude": ("position/h-sl-ft",),
    "place": ("position/lat-geod-deg", "position/long-gc-deg"),
    "air": ("atmosphere/P-psf", "aero/qbar-psf", "atmosphere/T-R"),
}
_HIL_OUTPUTS = {"aileron": 1, "elevator": 2, "rudder": 3, "throttle": 4}
_HIL_SIGNS = {"aileron": 1.0, "elevator": -1.0, "rudder": -1.0}
"""PX4's positive control over a record's deflection: right wing down, nose up, nose right."""
_PX4, _LOCK_STEP_FLAG, _EVERY_FIELD, _FIX_3D = 12, 1, 0x1FFF, 3
_BOOT_WAIT_S, _SEND_WAIT_S, _NO_MAVLINK_BYTES = 1.0, 10.0, 4096
_GPS_INTERVAL_S = 0.1


@dataclass(frozen=True)
class AutopilotSettings:
    """How a real autopilot is started and connected.

    Attributes
    ----------
    command : str
        Its command line.
    warmup_s : float
        Time during which it receives the state and the aircraft keeps its own commands [s]; its
        filters need some.
    timeout_s : float
        Longest real time without a packet of it [s].
    port : int, optional
        Port of the simulator, by default that of the protocol; 0 lets the system choose.
        ``{port}`` in the command is its number.
    protocol : str
        "ardupilot-json" (UDP) or "px4-hil" (MAVLink over TCP).
    """

    command: str
    warmup_s: float = 0.0
    timeout_s: float = 60.0
    port: int | None = None
    protocol: Protocol = "ardupilot-json"


class AutopilotStoppedError(RuntimeError):
    """The autopilot's process ended or fell silent during the flight."""


class _Link(Interface):
    """How a flight exchanges commands and state with the autopilot.

    ``check`` of `receive` raises AutopilotStoppedError for a process that has ended, or has been
    silent for the seconds that it is given.
    """

    port: int

    def connect(self, fdm: Any) -> None:
        """Bind the properties of the state."""

    def receive(self, check: Callable[[float], None]) -> dict[str, float]:
        """Wait for the commands of the next frame; return property to value."""

    def send(self, time_s: float) -> None:
        """Send the state after a frame."""

    def close(self) -> None:
        """Close the sockets."""


class AutopilotProcess:
    """A running autopilot, connected to a flight.

    Raises BadInputError if its command cannot be started or the port is taken.
    """

    def __init__(self, settings: AutopilotSettings, aircraft: Aircraft) -> None:
        self._settings = settings
        self._open_loop = aircraft.card.modes.get("open_loop", {})
        words = _words(settings.command)
        port = PORTS[settings.protocol] if settings.port is None else settings.port
        self._resources = contextlib.ExitStack()
        self._output = tempfile.TemporaryFile()  # noqa: SIM115
        self._resources.callback(self._output.close)
        link = _HilLink if settings.protocol == "px4-hil" else _JsonLink
        try:
            self._link: _Link = link(port, aircraft)
            self._resources.callback(self._link.close)
            self._process = subprocess.Popen(
                [word.replace("{port}", str(self._link.port)) for word in words],
                stdin=subprocess.DEVNULL,
                stdout=self._output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except BadInputError:
            self._resources.close()
            raise
        except OSError as error:
            self._resources.close()
            raise BadInputError(
                f"--autopilot-process: {words[0]}: {error.strerror}; give the command that starts"
                " the autopilot (docs/autopilot.md says how to build it)"
            ) from None

    def __enter__(self) -> AutopilotProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._resources.close()

    def around(self, fdm: Any, advance: Callable[[int], None]) -> Callable[[int], None]:
        """Return a loop that exchanges commands and state in each of n frames."""
        self._link.connect(fdm)

        def check(silent_s: float) -> None:
            self._check(fdm.get_sim_time(), silent_s)

        def stepped(count: int) -> None:
            for _ in range(count):
                try:
                    exchange()
                except _PeerError as error:
                    self._stop(str(error), fdm.get_sim_time())

        def exchange() -> None:
            commands = self._link.receive(check)
            if fdm.get_sim_time() >= self._settings.warmup_s:
                for name, value in self._open_loop.items():
                    engine.set_property(fdm, name, value)
                for name, value in commands.items():
                    set_command(fdm, name, value)
            advance(1)
            self._link.send(fdm.get_sim_time())

        return stepped

    def _check(self, time_s: float, silent_s: float) -> None:
        """Raise AutopilotStoppedError if the process has ended or is silent for too long."""
        code = self._process.poll()
        if code is not None:
            self._stop(f"ended with exit code {code}", time_s)
        if silent_s >= self._settings.timeout_s:
            self._stop(f"is silent for {silent_s:.0f} s", time_s)

    def _stop(self, event: str, time_s: float) -> NoReturn:
        """Raise AutopilotStoppedError with the last words of the process."""
        self._output.seek(0)
        text = self._output.read().decode(errors="replace").strip()[-_LONGEST_OUTPUT:]
        raise AutopilotStoppedError(
            f"the autopilot's process {event} at {time_s:.2f} s of flight; its output ends:"
            f" {text or '(nothing)'}"
        )


def _words(command: str) -> list[str]:
    """Split a command line. Raises BadInputError for an empty one, and an open quotation mark."""
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise BadInputError(f"--autopilot-process {command!r}: {error}; close it") from None
    if not words:
        raise BadInputError(
            "--autopilot-process: is empty; give the command that starts the autopilot"
        )
    return words


def _open_socket(kind: socket.SocketKind, port: int) -> socket.socket:
    """Return a socket bound to a port of this machine. Raises BadInputError if it is taken."""
    link = socket.socket(socket.AF_INET, kind)
    if kind == socket.SOCK_STREAM:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        link.bind(("127.0.0.1", port))
    except OSError as error:
        link.close()
        name = "TCP" if kind == socket.SOCK_STREAM else "UDP"
        raise BadInputError(
            f"--autopilot-process: {name} port {port} cannot be opened"
            f" ({error.strerror}); another simulator may be running"
        ) from None
    link.settimeout(0.2)
    return link


def _reader(fdm: Any, names: Mapping[str, Sequence[str]]) -> Callable[[], dict[str, list[float]]]:
    """Return a function that reads the state in SI units."""
    getters = {
        name: [engine.handle(fdm, prop).get_double_value for prop in properties]
        for name, properties in names.items()
    }

    def read() -> dict[str, list[float]]:
        return {
            name: [get() * (FT_M if name in _FEET else 1.0) for get in row]
            for name, row in getters.items()
        }

    return read


class _PeerError(Exception):
    """The other side of the link is not the autopilot that the protocol needs."""


class _JsonLink:
    """ArduPilot's JSON back-end: pulses come in, one line of JSON goes out."""

    def __init__(self, port: int, aircraft: Aircraft) -> None:
        self._scales = command_scales(aircraft)
        self._last_frame, self._reply, self._peer = -1, b"", ("", 0)
        self._socket = _open_socket(socket.SOCK_DGRAM, port)
        self.port: int = self._socket.getsockname()[1]

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def connect(self, fdm: Any) -> None:
        """Bind the properties of the state."""
        self._read = _reader(fdm, _STATE)

    def receive(self, check: Callable[[float], None]) -> dict[str, float]:
        """Return the commands of the next frame; a frame that is sent again is answered again."""
        silent_since, damaged = time.monotonic(), 0
        while True:
            try:
                packet, self._peer = self._socket.recvfrom(256)
            except TimeoutError:
                check(time.monotonic() - silent_since)
                continue
            layout = _PACKETS.get(int.from_bytes(packet[:2], "little"))
            if layout is None or len(packet) != layout.size:
                damaged += 1
                if damaged > _MAX_DAMAGED:
                    raise _PeerError(
                        f"sent {damaged} packets that are no servo pulses (ArduPilot sends them"
                        " with --model JSON:127.0.0.1)"
                    )
                check(time.monotonic() - silent_since)
                continue
            _, _, frame, *pulses = layout.unpack(packet)
            if frame == self._last_frame:
                self._socket.sendto(self._reply, self._peer)
                continue
            self._last_frame = frame
            return self._commands(tuple(pulses))

    def _commands(self, pulses: tuple[int, ...]) -> dict[str, float]:
        """Return the model's command properties from the pulses of all outputs [us]."""
        # A pulse of 0 is an output that is off.
        return {
            scale.property: scale.command(pulses[scale.output - 1] or math.nan)
            for scale in self._scales.values()
        }

    def send(self, time_s: float) -> None:
        """Send the state after a frame."""
        values = self._read()
        document = {
            "timestamp": time_s,
            "imu": {"gyro": values["gyro"], "accel_body": values["accel"]},
            "position": [*values["position"], -values["height"][0]],
            "velocity": values["velocity"],
            "attitude": values["attitude"],
            "airspeed": values["airspeed"][0],
        }
        # ArduPilot scans for "[%f, %f, %f]" right behind a key's colon.
        text = json.dumps(document, separators=(",", ":"))
        self._reply = f"\n{text}\n".encode()
        with contextlib.suppress(ConnectionError):
            self._socket.sendto(self._reply, self._peer)


class _HilLink:
    """PX4's simulation link: sensors go out as MAVLink, HIL_ACTUATOR_CONTROLS come in.

    PX4's clock is the time of the sensors, so that it cannot boot without them: until its first
    controls, the state of the start is sent again and again. From then on each frame waits for the
    controls of its time.
    """

    def __init__(self, port: int, aircraft: Aircraft) -> None:
        self._scales = control_scales(aircraft)
        self._dt_us = round(1e6 * aircraft.dt_s)
        self._server = _open_socket(socket.SOCK_STREAM, port)
        self._server.listen(1)
        self.port: int = self._server.getsockname()[1]
        self._connection: socket.socket | None = None
        self._mavlink = _dialect().MAVLink(None, srcSystem=1, srcComponent=200)
        self._mavlink.robust_parsing = True
        self._sent_us = self._start_us = self._damaged = 0
        self._is_locked, self._next_gps_us = False, 0

    def close(self) -> None:
        """Close both sockets."""
        if self._connection is not None:
            self._connection.close()
        self._server.close()

    def connect(self, fdm: Any) -> None:
        """Bind the properties of the state."""
        self._read = _reader(fdm, _HIL_STATE)

    def receive(self, check: Callable[[float], None]) -> dict[str, float]:
        """Return the commands of the time that was sent last."""
        silent_since = time.monotonic()
        while self._connection is None:
            try:
                self._connection, _ = self._server.accept()
                self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            except TimeoutError:
                check(time.monotonic() - silent_since)
        controls = None
        wait_s = _BOOT_WAIT_S
        while not self._is_locked:
            self._send_state(self._sent_us + self._dt_us)
            controls = self._controls(wait_s)
            check(time.monotonic() - silent_since)
            # The clock of a PX4 that boots runs in real time.
            wait_s = 1e-6 * self._dt_us
            self._is_locked = controls is not None
            self._start_us = self._sent_us
        silent_since = time.monotonic()
        while controls is None or controls.time_usec < self._sent_us:
            controls = self._controls(0.2)
            check(time.monotonic() - silent_since)
        if not controls.flags & _LOCK_STEP_FLAG:
            raise _PeerError(
                "does not run in lock step (HIL_ACTUATOR_CONTROLS without flag 1); build PX4 for"
                " SITL without 'nolockstep'"
            )
        return self._commands(controls.controls)

    def _controls(self, wait_s: float) -> Any:
        """Return the newest controls that arrive in the time, or None."""
        assert self._connection is not None
        self._connection.settimeout(wait_s)
        try:
            data = self._connection.recv(65536)
        except TimeoutError:
            return None
        except ConnectionError:
            data = b""
        if not data:
            raise _PeerError("closed the connection")
        newest = None
        for message in self._mavlink.parse_buffer(data) or ():
            kind = message.get_type()
            if kind == "BAD_DATA":
                self._damaged += len(message.data)
                if self._damaged > _NO_MAVLINK_BYTES:
                    raise _PeerError(
                        f"sent {self._damaged} bytes that are no MAVLink 2; is it PX4's simulation"
                        " link?"
                    )
            elif kind == "HEARTBEAT" and message.autopilot != _PX4:
                raise _PeerError(
                    f"is no PX4: its heartbeat has autopilot {message.autopilot}, PX4 has {_PX4};"
                    " ArduPilot flies with --autopilot-protocol ardupilot-json"
                )
            elif kind == "HIL_ACTUATOR_CONTROLS":
                newest = message
        return newest

    def _commands(self, controls: Sequence[float]) -> dict[str, float]:
        """Return the model's command properties from PX4's controls, -1 to 1 or 0 to 1.

        An output without a function is NaN.
        """
        return {
            scale.property: scale.command(controls[scale.output - 1])
            for scale in self._scales.values()
        }

    def send(self, time_s: float) -> None:
        """Send the sensors after a frame."""
        self._send_state(self._start_us + round(1e6 * time_s))

    def _send_state(self, time_us: int) -> None:
        """Send truth and GPS, then the sensors, whose time is PX4's clock."""
        assert self._connection is not None
        values = self._read()
        messages = [_truth(time_us, values)]
        if time_us >= self._next_gps_us:
            messages.append(_gps(time_us, values))
            self._next_gps_us = time_us + round(1e6 * _GPS_INTERVAL_S)
        messages.append(_sensors(time_us, values))
        self._sent_us = time_us
        # A peer that has gone is found by the next receive.
        with contextlib.suppress(ConnectionError):
            self._connection.settimeout(_SEND_WAIT_S)
            try:
                self._connection.sendall(b"".join(m.pack(self._mavlink) for m in messages))
            except TimeoutError:
                raise _PeerError("does not read its sensors") from None


def _integer(value: float, bits: int, signed: bool = True) -> int:
    """Return a number as an integer of a message, at its limits if it is larger."""
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    return min(max(round(value), low), high)


def _dialect() -> Any:
    """Return the messages of MAVLink, which few flights need."""
    from pymavlink.dialects.v20 import common

    return common


def _rotation(attitude: Sequence[float]) -> Rotation:
    """Return the rotation from body to north, east, down."""
    # Most flights have a built-in autopilot and need no more of scipy.
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", attitude[::-1])


def _place(values: Mapping[str, Sequence[float]]) -> tuple[int, int, int]:
    """Return latitude and longitude [1e-7 deg] and altitude [mm]."""
    latitude, longitude = (_integer(1e7 * x, 32) for x in values["place"])
    return latitude, longitude, _integer(1e3 * values["altitude"][0], 32)


def _truth(time_us: int, values: Mapping[str, Sequence[float]]) -> Any:
    """Return HIL_STATE_QUATERNION."""
    x, y, z, w = _rotation(values["attitude"]).as_quat().tolist()
    speed = _integer(100.0 * values["airspeed"][0], 16, signed=False)
    _, pressure, _ = values["air"]
    indicated = math.sqrt(2.0 * max(pressure, 0.0) * PSF_PA / SEA_LEVEL_KGPM3)
    return _dialect().MAVLink_hil_state_quaternion_message(
        time_us,
        [w, x, y, z],
        *values["gyro"],
        *_place(values),
        *(_integer(100.0 * v, 16) for v in values["velocity"]),
        _integer(100.0 * indicated, 16, signed=False),
        speed,
        *(_integer(1e3 * a / G0_MPS2, 16) for a in values["accel"]),
    )


def _gps(time_us: int, values: Mapping[str, Sequence[float]]) -> Any:
    """Return HIL_GPS, without errors."""
    north, east, down = values["velocity"]
    course = math.degrees(math.atan2(east, north)) % 360.0
    return _dialect().MAVLink_hil_gps_message(
        time_us,
        _FIX_3D,
        *_place(values),
        90,
        140,
        _integer(100.0 * math.hypot(north, east), 16, signed=False),
        *(_integer(100.0 * v, 16) for v in (north, east, down)),
        _integer(100.0 * course, 16, signed=False) % 36000,
        12,
    )


def _sensors(time_us: int, values: Mapping[str, Sequence[float]]) -> Any:
    """Return HIL_SENSOR, without errors."""
    static, dynamic, temperature = values["air"]
    from pymavlink.mavextra import get_mag_field_ef

    declination, inclination, strength = get_mag_field_ef(*values["place"])
    down, flat = math.radians(inclination), math.radians(declination)
    field = strength * np.array(
        [math.cos(down) * math.cos(flat), math.cos(down) * math.sin(flat), math.sin(down)]
    )
    return _dialect().MAVLink_hil_sensor_message(
        time_us,
        *values["accel"],
        *values["gyro"],
        *_rotation(values["attitude"]).inv().apply(field).tolist(),
        static * PSF_PA / 100.0,
        dynamic * PSF_PA / 100.0,
        values["altitude"][0],
        temperature / 1.8 - 273.15,
        _EVERY_FIELD,
    )


@dataclass(frozen=True)
class CommandScale:
    """From an output of the autopilot to a command of the model.

    Attributes
    ----------
    property : str
        Command property.
    output : int
        Place of the output in a packet, from 1.
    signals, values : tuple of float
        Table: pulse [us] or normalised control, and command in the property's unit.
    off : float
        Command where the output is off.
    """

    property: str
    output: int
    signals: tuple[float, ...]
    values: tuple[float, ...]
    off: float

    def command(self, signal: float) -> float:
        """Return the command of a signal; one that is not finite is off."""
        if not math.isfinite(signal):
            return self.off
        return float(np.interp(signal, self.signals, self.values))


def _inputs_and_servos(
    aircraft: Aircraft, outputs: Mapping[str, int]
) -> Iterator[tuple[str, InputCard, Servo | None, int]]:
    """Yield each control that the card names, with its input, its servo and its output.

    The output is the servo's ``channel``, else the autopilot's usual one.
    """
    servos = read_card(aircraft.folder / "airframe.toml").servos if aircraft.has_card else {}
    for control, usual in outputs.items():
        card, servo = aircraft.card.inputs.get(control), servos.get(control)
        if card is not None:
            yield control, card, servo, servo.channel or usual if servo is not None else usual


def control_scales(aircraft: Aircraft) -> dict[str, CommandScale]:
    """Return the scale of PX4's controls that the card names.

    Full control is the end of the travel: +1 is right wing down, nose up, nose right. Outputs are
    the card's ``channel``, else aileron 1, elevator 2, rudder 3, throttle 4.
    """
    scales = {}
    for control, card, _, output in _inputs_and_servos(aircraft, _HIL_OUTPUTS):
        low, high = card.limits
        signals: tuple[float, ...] = (0.0, 1.0)
        values: tuple[float, ...] = (low, high)
        off = low
        if control != "throttle":
            # A command may move the surface against the sign of flight records.
            if _HIL_SIGNS[control] * (card.throw_deg or 1.0) < 0.0:
                low, high = high, low
            signals, values, off = (-1.0, 0.0, 1.0), (low, 0.0, high), 0.0
        scales[control] = CommandScale(card.property, output, signals, values, off)
    return scales


def command_scales(aircraft: Aircraft) -> dict[str, CommandScale]:
    """Return the scale of each servo's pulses for the controls that the card names.

    The card's ``servo_pwm`` and ``channel`` count; without them ArduPlane's default pulses span the
    card's limits, and its default outputs are aileron 1, elevator 2, throttle 3 and rudder 4.
    """
    scales = {}
    for control, card, servo, output in _inputs_and_servos(aircraft, _OUTPUTS):
        low, high = card.limits
        table = [(_CLOSED_US, low), (_OPEN_US, high)]
        if control != "throttle":
            table = [(_CLOSED_US, low), (_NEUTRAL_US, 0.0), (_OPEN_US, high)]
        if servo is not None and card.unit in ("deg", "pct"):
            table = sorted(servo.table)
        pulses, values = zip(*table, strict=True)
        off = low if control == "throttle" else 0.0
        scales[control] = CommandScale(card.property, output, pulses, values, off)
    return scales
