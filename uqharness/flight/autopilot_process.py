"""A real autopilot in lock step: ArduPilot's JSON back-end over UDP.

The autopilot is a process that the user brings, such as ``arduplane --model JSON:127.0.0.1``. In
each frame it sends the pulses of its servos and waits for the state of the aircraft (protocol:
ArduPilot's libraries/SITL/examples/JSON/readme.md). Simulated time stands still while it computes,
so that equal seeds give equal flights if the autopilot is deterministic.
"""

from __future__ import annotations

import contextlib
import json
import shlex
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np

from sysid.logs import read_card
from sysid.units import FT_M
from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, engine

PORT = 9002
"""UDP port on which ArduPilot's JSON back-end expects the simulator."""
_PACKETS = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}
"""Magic number to layout: magic, frame rate, frame count, pulses [us] of 16 or 32 outputs."""
_OUTPUTS = {"aileron": 1, "elevator": 2, "throttle": 3, "rudder": 4}
_CLOSED_US, _NEUTRAL_US, _OPEN_US = 1100.0, 1500.0, 1900.0
"""ArduPlane's default SERVOn_MIN, _TRIM and _MAX."""
_LONGEST_OUTPUT = 400
_STATE = {
    "gyro": ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec"),
    "accel": tuple(f"accelerations/a-pilot-{axis}-ft_sec2" for axis in "xyz"),
    "position": ("position/from-start-neu-n-ft", "position/from-start-neu-e-ft"),
    "height": ("position/h-agl-ft",),
    "velocity": ("velocities/v-north-fps", "velocities/v-east-fps", "velocities/v-down-fps"),
    "attitude": ("attitude/phi-rad", "attitude/theta-rad", "attitude/psi-rad"),
    "airspeed": ("velocities/vt-fps",),
}
_FEET = ("accel", "position", "height", "velocity", "airspeed")


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
    port : int
        UDP port of the simulator; 0 lets the system choose. ``{port}`` in the command is its
        number.
    """

    command: str
    warmup_s: float = 0.0
    timeout_s: float = 60.0
    port: int = PORT


class AutopilotStoppedError(RuntimeError):
    """The autopilot's process ended or fell silent during the flight."""


class AutopilotProcess:
    """A running autopilot, connected to a flight.

    Raises BadInputError if its command cannot be started or the port is taken.
    """

    def __init__(self, settings: AutopilotSettings, aircraft: Aircraft) -> None:
        self._settings = settings
        self._scales = command_scales(aircraft)
        self._open_loop = aircraft.card.modes.get("open_loop", {})
        self._last_frame, self._reply, self._peer = -1, b"", ("", 0)
        self._resources = contextlib.ExitStack()
        self._output = tempfile.TemporaryFile()  # noqa: SIM115
        self._resources.callback(self._output.close)
        self._socket = self._resources.enter_context(
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        )
        try:
            self._socket.bind(("127.0.0.1", settings.port))
        except OSError as error:
            self._resources.close()
            raise BadInputError(
                f"--autopilot-process: UDP port {settings.port} cannot be opened"
                f" ({error.strerror}); another simulator may be running"
            ) from None
        self._socket.settimeout(0.2)
        words = shlex.split(settings.command)
        port = str(self._socket.getsockname()[1])
        try:
            self._process = subprocess.Popen(
                [word.replace("{port}", port) for word in words],
                stdin=subprocess.DEVNULL,
                stdout=self._output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            self._resources.close()
            raise BadInputError(
                f"--autopilot-process: {words[0]}: {error.strerror}; give the command that starts"
                " the autopilot (docs/autopilot.md says how to build ArduPlane)"
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
        """Return a loop that exchanges pulses and state in each of n frames."""
        state = {
            name: [engine.handle(fdm, prop).get_double_value for prop in properties]
            for name, properties in _STATE.items()
        }

        def stepped(count: int) -> None:
            for _ in range(count):
                pulses = self._receive(fdm.get_sim_time())
                if fdm.get_sim_time() >= self._settings.warmup_s:
                    for name, value in self._open_loop.items():
                        engine.set_property(fdm, name, value)
                    for name, value in self._commands(pulses).items():
                        engine.set_property(fdm, name, value)
                advance(1)
                self._send(fdm.get_sim_time(), state)

        return stepped

    def _commands(self, pulses: tuple[int, ...]) -> dict[str, float]:
        """Return the model's command properties from the pulses of all outputs [us]."""
        commands = {}
        for scale in self._scales.values():
            pulse = pulses[scale.output - 1]
            # A pulse of 0 is an output that is off.
            value = np.interp(pulse, scale.pulses_us, scale.values) if pulse else scale.off
            commands[scale.property] = float(value)
        return commands

    def _receive(self, time_s: float) -> tuple[int, ...]:
        """Return the pulses of the next frame; a frame that is sent again is answered again."""
        silent_since = time.monotonic()
        while True:
            try:
                packet, self._peer = self._socket.recvfrom(256)
            except TimeoutError:
                self._check(time_s, time.monotonic() - silent_since)
                continue
            layout = _PACKETS.get(int.from_bytes(packet[:2], "little"))
            if layout is None or len(packet) != layout.size:
                continue
            _, _, frame, *pulses = layout.unpack(packet)
            if frame == self._last_frame:
                self._socket.sendto(self._reply, self._peer)
                continue
            self._last_frame = frame
            return tuple(pulses)

    def _check(self, time_s: float, silent_s: float) -> None:
        """Raise AutopilotStoppedError if the process has ended or is silent for too long."""
        code = self._process.poll()
        if code is None and silent_s < self._settings.timeout_s:
            return
        self._output.seek(0)
        text = self._output.read().decode(errors="replace").strip()[-_LONGEST_OUTPUT:]
        end = (
            f"ended with exit code {code}"
            if code is not None
            else f"is silent for {silent_s:.0f} s"
        )
        raise AutopilotStoppedError(
            f"the autopilot's process {end} at {time_s:.2f} s of flight; its output ends:"
            f" {text or '(nothing)'}"
        )

    def _send(self, time_s: float, state: Mapping[str, list[Callable[[], float]]]) -> None:
        """Send the state after a frame."""
        values = {
            name: [get() * (FT_M if name in _FEET else 1.0) for get in getters]
            for name, getters in state.items()
        }
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


@dataclass(frozen=True)
class CommandScale:
    """From a servo's pulses to a command of the model.

    Attributes
    ----------
    property : str
        Command property.
    output : int
        Servo output, from 1.
    pulses_us, values : tuple of float
        Table: pulse [us] and command in the property's unit.
    off : float
        Command where the output is off.
    """

    property: str
    output: int
    pulses_us: tuple[float, ...]
    values: tuple[float, ...]
    off: float


def command_scales(aircraft: Aircraft) -> dict[str, CommandScale]:
    """Return the scale of each control that the card names.

    The card's ``servo_pwm`` and ``channel`` count; without them ArduPlane's default pulses span the
    card's limits, and its default outputs are aileron 1, elevator 2, throttle 3 and rudder 4.
    """
    servos = read_card(aircraft.folder / "airframe.toml").servos if aircraft.has_card else {}
    scales = {}
    for control, output in _OUTPUTS.items():
        card = aircraft.card.inputs.get(control)
        if card is None:
            continue
        low, high = card.limits
        table = [(_CLOSED_US, low), (_OPEN_US, high)]
        if control != "throttle":
            table = [(_CLOSED_US, low), (_NEUTRAL_US, 0.0), (_OPEN_US, high)]
        servo = servos.get(control)
        if servo is not None:
            output = servo.channel or output
            if card.unit in ("deg", "pct"):
                table = sorted(servo.table)
        pulses, values = zip(*table, strict=True)
        off = low if control == "throttle" else 0.0
        scales[control] = CommandScale(card.property, output, pulses, values, off)
    return scales
