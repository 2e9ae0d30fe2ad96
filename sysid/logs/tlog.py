"""Read MAVLink telemetry logs (.tlog) with pymavlink: 8 bytes of time, then a packet, repeated.

Only packets of selected kinds are decoded, which verifies their checksum. Packets of other systems
than the first autopilot are left out. Times are those of the vehicle's clock: a radio delivers
packets in bursts, so that receipt times jitter.
"""

from __future__ import annotations

import itertools
import os
from array import array
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sysid.arrays import FloatArray
from sysid.errors import Finding, LogError
from sysid.foreign.raw import FieldSelection, MessageTable, ProgressCallback, RawLog
from sysid.foreign.regular_files import open_regular
from sysid.logs.detect import frame_length, frame_time
from sysid.logs.time_base import boundaries

BLOCK_BYTES = 4 << 20
_SAME_CLOCK_S = 60.0  # a stamp that differs more from its receipt is of another clock
_AUTOPILOT_TYPES = {
    1: "fixed wing",
    2: "quadrotor",
    3: "coaxial helicopter",
    4: "helicopter",
    10: "rover",
    11: "boat",
    12: "submarine",
    13: "hexarotor",
    14: "octorotor",
    15: "tricopter",
    16: "flapping wing",
    19: "VTOL tail-sitter",
    20: "VTOL tail-sitter",
    21: "VTOL tiltrotor",
    22: "VTOL",
}
# MAV_TYPE of antenna tracker, ground station, onboard controller, gimbal, ADSB and camera.
_NOT_VEHICLES = {5, 6, 18, 26, 27, 30}
_BOOT_CLOCKS = ("ATTITUDE", "GLOBAL_POSITION_INT", "SYSTEM_TIME", "SCALED_IMU2")
_BOOT_FIELDS = (("time_boot_ms", 1e-3), ("time_usec", 1e-6), ("time_us", 1e-6))


class _Tlog:
    """Collected packets of a file and the state of the parser."""

    def __init__(self, selection: FieldSelection | None) -> None:
        # `mavlink.mavlink_map` is keyed by packet number; MAVLink classes know their fields.
        packet_numbers = {cls.msgname: number for number, cls in mavlink.mavlink_map.items()}
        names = set(packet_numbers if selection is None else selection) | {
            "HEARTBEAT",
            "STATUSTEXT",
            "PARAM_VALUE",
        }
        self.wanted = selection
        self.names = {packet_numbers[n]: n for n in names if n in packet_numbers}
        self.all_names = {number: n for n, number in packet_numbers.items()}
        self.parser = mavlink.MAVLink(None)
        self.receipt: dict[str, array[float]] = defaultdict(lambda: array("d"))
        self.place: dict[str, array[float]] = defaultdict(lambda: array("d"))
        self.stored_packets = 0
        self.boot: dict[str, array[float]] = defaultdict(lambda: array("d"))
        self.values: dict[str, dict[str, array[float]]] = defaultdict(
            lambda: defaultdict(lambda: array("d"))
        )
        self.counts: dict[str, int] = defaultdict(int)
        self.texts: list[tuple[int, float, str]] = []
        self.parameters: list[tuple[int, str, float]] = []
        self.system: int | None = None
        self.vehicle_type: int | None = None
        self.bad_packets = 0
        self.skipped_bytes = 0

    def block(self, data: bytes, last: bool) -> int:
        """Process the complete frames of ``data`` and return the number of bytes used."""
        pos, size = 0, len(data)
        while pos + 20 <= size:
            if data[pos + 8] in (0xFE, 0xFD):
                end = pos + 8 + frame_length(data, pos + 8)
                if end > size:
                    # Cut off at the end of the file, unless it was no frame at all.
                    if last:
                        break
                    return pos
                # Accept a frame if another one follows or the block ends with it.
                if end + 9 > size or data[end + 8] in (0xFE, 0xFD):
                    self._packet(data, pos, end)
                    pos = end
                    continue
            pos += 1
            self.skipped_bytes += 1
        if last:
            self.skipped_bytes += max(0, size - pos)
            return size
        return pos

    def _packet(self, data: bytes, pos: int, end: int) -> None:
        """Count a packet and decode it if it is of a selected kind."""
        is_version_2 = data[pos + 8] == 0xFD
        number = (
            int.from_bytes(data[pos + 15 : pos + 18], "little") if is_version_2 else data[pos + 13]
        )
        self.counts[self.all_names.get(number, "unknown")] += 1
        name = self.names.get(number)
        if name is None:
            return
        try:
            message = self.parser.decode(bytearray(data[pos + 8 : end]))
        except MemoryError:
            raise
        except (
            Exception
        ):  # pymavlink raises struct.error, KeyError, MAVError... for a damaged packet
            self.bad_packets += 1
            return
        self._keep(name, message, frame_time(data, pos))

    def _keep(self, name: str, message: Any, receipt_s: float) -> None:
        """Store the numeric fields, text or parameter of a packet of the vehicle."""
        system = message.get_srcSystem()
        if name == "HEARTBEAT" and message.type not in _NOT_VEHICLES and self.system is None:
            self.system, self.vehicle_type = system, int(message.type)
        # Ground stations and companions send on the same link.
        if self.system is not None and system != self.system:
            return
        if name == "STATUSTEXT":
            self.texts.append((self.stored_packets, receipt_s, str(message.text)))
            return
        if name == "PARAM_VALUE":
            self.parameters.append(
                (self.stored_packets, str(message.param_id), float(message.param_value))
            )
            return
        if name == "HEARTBEAT" and message.type in _NOT_VEHICLES:
            return
        self.receipt[name].append(receipt_s)
        self.stored_packets += 1
        self.place[name].append(self.stored_packets)
        boot = next(
            (getattr(message, f) * s for f, s in _BOOT_FIELDS if f in message.fieldnames),
            float("nan"),
        )
        self.boot[name].append(boot)
        store = self.values[name]
        for f in message.fieldnames:
            value = getattr(message, f)
            if isinstance(value, int | float) and (
                self.wanted is None or f in self.wanted.get(name, ())
            ):
                store[f].append(float(value))


def read(
    path: Path, selection: FieldSelection | None = None, callback: ProgressCallback | None = None
) -> RawLog:
    """Read a telemetry log.

    A message has the vehicle's time (since boot) if it carries one, else a time between those of
    the messages around it in the file.

    Parameters
    ----------
    path : Path
        File.
    selection : mapping or None
        Message name to fields; None reads all.
    callback : callable, optional
        Called with the share read, 0 to 1.

    Raises
    ------
    LogError
        If no packet with flight data can be read.
    """
    state = _Tlog(selection)
    # Packets may be split between blocks: the unread bytes join the next one.
    unread, done = b"", 0
    with open_regular(path) as handle:
        size = max(1, os.fstat(handle.fileno()).st_size)
        while True:
            fresh = handle.read(BLOCK_BYTES)
            data = unread + fresh
            used = state.block(data, last=not fresh)
            unread, done = data[used:], done + used
            if callback is not None:
                callback(done / size)
            if not fresh:
                break
    if not state.receipt:
        raise LogError(
            f"no MAVLink packet with flight data could be read in {size} bytes"
            f" ({state.bad_packets} packets failed their checksum); record the telemetry again",
            path,
        )
    # Position in the file, time of receipt and time since boot of each message.
    streams = {
        name: _Stream(
            np.frombuffer(state.place[name], dtype=np.float64).astype(np.int64),
            np.frombuffer(receipt, dtype=np.float64),
            np.frombuffer(state.boot[name], dtype=np.float64),
        )
        for name, receipt in state.receipt.items()
    }
    # Vehicle clock and radio clock differ by another offset after each boot.
    begins = _boots(streams)
    times, offsets = _times(streams, begins)
    # Tables of all fields that every message of a kind carries.
    messages = {}
    for name, stream in streams.items():
        fields = {f: np.frombuffer(v, dtype=np.float64) for f, v in state.values[name].items()}
        messages[(name, 0)] = MessageTable(
            times[name],
            {f: v for f, v in fields.items() if len(v) == len(times[name])},
            stream.place,
        )
    kind = state.vehicle_type
    return RawLog(
        dialect="tlog",
        messages=messages,
        counts=dict(state.counts),
        parameters={name: value for _, name, value in state.parameters},
        texts=tuple(
            (t - offsets[int(np.searchsorted(begins, at, side="right"))], text)
            for at, t, text in state.texts
        ),
        headers=tuple(begins),
        parameter_log=tuple(state.parameters),
        text_places=tuple(at for at, _, _ in state.texts),
        vehicle="" if kind is None else _AUTOPILOT_TYPES.get(kind, f"MAV_TYPE {kind}"),
        facts={} if kind is None else {"mav_type": float(kind)},
        findings=tuple(_findings(state, size)),
    )


@dataclass(frozen=True)
class _Stream:
    """Packets of one kind: place in the file, receipt time and vehicle time [s] (NaN if absent),
    each (n,).
    """

    place: NDArray[np.int64]
    receipt_s: FloatArray
    boot_s: FloatArray

    def rows(self, keep: NDArray[np.bool_]) -> _Stream:
        """Return the packets selected by a mask."""
        return _Stream(self.place[keep], self.receipt_s[keep], self.boot_s[keep])


def _boots(streams: dict[str, _Stream]) -> list[int]:
    """Return the places at which the vehicle's clock begins again.

    Only messages whose stamp is always the time since boot are used.
    """
    stamped = [streams[name] for name in _BOOT_CLOCKS if name in streams]
    if not stamped:
        return []
    return boundaries(
        np.concatenate([s.place for s in stamped]), np.concatenate([s.boot_s for s in stamped])
    )


def _times(
    streams: dict[str, _Stream], begins: list[int]
) -> tuple[dict[str, FloatArray], list[float]]:
    """Return times of all packets on the clock of their boot, and receipt time minus clock of
    each boot.
    """
    times = {name: np.full(len(s.place), np.nan) for name, s in streams.items()}
    edges = [-1, *begins, np.iinfo(np.int64).max]
    offsets = []
    for low, high in itertools.pairwise(edges):
        rows = {n: (s.place >= low) & (s.place < high) for n, s in streams.items()}
        part = {n: s.rows(rows[n]) for n, s in streams.items() if rows[n].any()}
        offset = _clock_offset(part) if part else 0.0
        offsets.append(offset)
        clock = _vehicle_clock(part, offset) if part else None
        for name, s in part.items():
            assert clock is not None
            arrived = s.receipt_s - offset
            # Some senders put the date into time_usec; such a stamp is no better than the
            # receipt time.
            on_clock = np.isfinite(s.boot_s) & (np.abs(s.boot_s - arrived) < 3600.0)
            times[name][rows[name]] = np.where(
                on_clock, s.boot_s, clock(s.place.astype(np.float64), arrived)
            )
    return times, offsets


def _vehicle_clock(
    streams: dict[str, _Stream], offset: float
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return a function from (places in the file, receipt times on the vehicle's clock) to times.

    It interpolates between the stamped messages.
    """
    place, stamp = [], []
    for s in streams.values():
        on_clock = np.isfinite(s.boot_s) & (
            np.abs(s.boot_s - (s.receipt_s - offset)) < _SAME_CLOCK_S
        )
        place.append(s.place[on_clock].astype(np.float64))
        stamp.append(s.boot_s[on_clock])
    at, stamp_s = np.concatenate(place), np.concatenate(stamp)
    order = np.argsort(at, kind="stable")
    at, stamp_s = at[order], np.maximum.accumulate(stamp_s[order]) if len(stamp_s) else stamp_s

    def clock(places: FloatArray, arrived: FloatArray) -> FloatArray:
        """Return times of unstamped messages, or their receipt times outside the stamped ones."""
        if len(at) < 2:
            return arrived
        between = (places >= at[0]) & (places <= at[-1])
        return np.where(between, np.interp(places, at, stamp_s), arrived)

    return clock


def _clock_offset(streams: dict[str, _Stream]) -> float:
    """Return receipt time minus boot time, s, of the least delayed packets.

    Messages of _BOOT_CLOCKS count; without any, time zero is the first packet.
    """
    best = []
    for name in _BOOT_CLOCKS:
        if name in streams:
            late = streams[name].receipt_s - streams[name].boot_s
            late = late[np.isfinite(late)]
            if len(late):
                # The 5 % quantile and not the minimum, because a packet with a damaged time
                # must not move the clock.
                best.append(float(np.quantile(late, 0.05)))
    return min(best) if best else min(float(s.receipt_s[0]) for s in streams.values())


def _findings(state: _Tlog, size: int) -> list[Finding]:
    """Return findings on damaged bytes and packets."""
    out = []
    if state.skipped_bytes:
        text = (
            f"{state.skipped_bytes} of {size} bytes belong to no packet: the log is damaged or cut"
            " short"
        )
        out.append(
            Finding("damaged-bytes", "", "warning", text, {"bytes": float(state.skipped_bytes)})
        )
    if state.bad_packets:
        text = f"{state.bad_packets} packets failed their checksum and were left out"
        out.append(
            Finding("damaged-packets", "", "warning", text, {"packets": float(state.bad_packets)})
        )
    return out
