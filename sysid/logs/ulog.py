"""Read PX4 ULog files (.ulg) with pyulog.

pyulog keeps the selected topics in memory and reports dropouts. One file may hold several logs,
which are read one by one and concatenated; `time_base.split` separates them again.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from sysid.errors import Finding, LogError
from sysid.foreign.raw import FieldSelection, MessageTable, ProgressCallback, RawLog
from sysid.foreign.regular_files import open_regular
from sysid.logs.time_base import RESTART_S

# PX4's MAV_TYPE parameter and vehicle_status.vehicle_type.
_MAV_TYPES = {
    1: "fixed wing",
    2: "quadrotor",
    10: "rover",
    13: "hexarotor",
    14: "octorotor",
    19: "VTOL",
    20: "VTOL",
    21: "VTOL",
    22: "VTOL",
}
_VEHICLE_TYPES = {1: "rotary wing", 2: "fixed wing", 3: "rover", 4: "airship"}


_MAGIC = b"ULog\x01\x12\x35"
_HEADER_BYTES = 16
_BLOCK_BYTES = 4 << 20
_PART = 1 << 40  # offset of places between logs of one file; no log has as many records


def read(
    path: Path, selection: FieldSelection | None = None, callback: ProgressCallback | None = None
) -> RawLog:
    """Read a ULog file.

    Parameters
    ----------
    path : Path
        File.
    selection : mapping or None
        Topic name to fields; None reads all topics.
    callback : callable, optional
        Called once with 1.0 at the end.

    Raises
    ------
    LogError
        If pyulog cannot read the file, or it has no topic with data.
    """
    with open_regular(path) as handle:
        starts = _headers(handle)
        if len(starts) > 1:
            handle.seek(0)
            content = handle.read()
    if len(starts) == 1:
        raw = _read(partial(open_regular, path), path, selection, 0)
    else:
        # Concatenated logs are cut at their headers.
        ends = [*starts[1:], len(content)]
        parts = [content[start:end] for start, end in zip(starts, ends, strict=True)]
        raw = _concatenate_logs(
            [_read(partial(io.BytesIO, p), path, selection, n) for n, p in enumerate(parts)]
        )
    if callback is not None:
        callback(1.0)
    if not raw.messages:
        raise LogError(
            "no topic with flight data could be read: the importer supports none of the log's",
            path,
        )
    return raw


def _headers(handle: BinaryIO) -> list[int]:
    """Return the offsets at which logs begin in the file."""
    starts, base, tail = [0], 0, b""
    while block := handle.read(_BLOCK_BYTES):
        data = tail + block
        at = data.find(_MAGIC)
        while at >= 0:
            # Require the kind of a first message (flags or a definition), so that equal bytes
            # inside data are not taken for a header.
            kind = data[at + _HEADER_BYTES + 2 : at + _HEADER_BYTES + 3]
            if base + at > 0 and kind in (b"B", b"F", b"I", b"P") and base + at not in starts:
                starts.append(base + at)
            at = data.find(_MAGIC, at + 1)
        overlap = min(len(data), 2 * _HEADER_BYTES)
        base, tail = base + len(data) - overlap, data[len(data) - overlap :]
    return starts


def _read(
    open_log: Callable[[], BinaryIO], path: Path, selection: FieldSelection | None, number: int
) -> RawLog:
    """Read one log of a file, opened by ``open_log``; ``number`` counts the logs before it."""
    chatter = io.StringIO()
    names = None if selection is None else sorted(selection)
    try:
        # pyulog prints what it finds damaged, which belongs into the findings. It receives an
        # open file, because it would leave one open that it cannot read.
        with contextlib.redirect_stdout(chatter), np.errstate(all="ignore"):
            # The file as it is first read.
            with open_log() as handle:
                log = ULog(handle, names, disable_str_exceptions=True)
            stamps = [d.data["timestamp"] for d in log.data_list if "timestamp" in d.data]
            places = {}
            if any(_steps_back(stamp) for stamp in stamps):
                # Only then the order of records over all topics is needed, and the file is read
                # again.
                with open_log() as handle:
                    ordered = _OrderedULog(handle, names, disable_str_exceptions=True)
                places = {k: np.array(v, dtype=np.int64) for k, v in ordered.places.items()}
    except MemoryError:
        raise
    except Exception as e:  # pyulog meets damage with whatever its parsing runs into
        raise LogError(
            f"damaged or not a ULog file ({type(e).__name__}: {' '.join(str(e).split())[:120]});"
            " copy the log again",
            path,
        ) from None
    base = number * _PART
    messages = {}
    for data in log.data_list:
        fields = {
            f: v for f, v in data.data.items() if f != "timestamp" and not f.startswith("_padding")
        }
        if "timestamp" not in data.data or not len(data.data["timestamp"]):
            continue
        key = (str(data.name), int(data.multi_id))
        time_s = data.data["timestamp"].astype(np.float64) * 1e-6
        order = places.get(key)
        place = base + order if order is not None and len(order) == len(time_s) else None
        messages[key] = MessageTable(time_s, fields, place)
    if not places and messages:
        # Each topic is in order, and so are all together.
        ranks = np.argsort(np.argsort(np.concatenate([t.time_s for t in messages.values()])))
        ends = np.cumsum([len(t.time_s) for t in messages.values()])
        for (key, table), rank in zip(messages.items(), np.split(ranks, ends[:-1]), strict=True):
            messages[key] = replace(table, place=base + 1 + rank)
    parameters = _parameters(log)
    return RawLog(
        dialect="ulog",
        messages=messages,
        counts={f"{name}[{i}]" if i else name: len(t.time_s) for (name, i), t in messages.items()},
        parameters=parameters,
        texts=tuple((m.timestamp * 1e-6, str(m.message)) for m in log.logged_messages),
        vehicle=_vehicle(log, messages),
        facts={"px4": str(log.msg_info_dict.get("ver_sw_branch", ""))},
        findings=tuple(_findings(log, chatter.getvalue())),
        headers=(base,) if number else (),
        parameter_log=tuple((base, name, value) for name, value in parameters.items()),
        text_places=(base,) * len(log.logged_messages),
    )


def _concatenate_logs(parts: list[RawLog]) -> RawLog:
    """Concatenate several logs of one file; places in the file keep them apart."""
    messages: dict[tuple[str, int], MessageTable] = {}
    for key in dict.fromkeys(key for part in parts for key in part.messages):
        tables = [part.messages[key] for part in parts if key in part.messages]
        names = set.intersection(*(set(t.fields) for t in tables))
        messages[key] = MessageTable(
            np.concatenate([t.time_s for t in tables]),
            {n: np.concatenate([t.fields[n] for t in tables]) for n in names},
            (
                None
                if any(t.place is None for t in tables)
                else np.concatenate([t.place for t in tables if t.place is not None])
            ),
        )
    return replace(
        parts[0],
        messages=messages,
        counts={key: sum(p.counts.get(key, 0) for p in parts) for p in parts for key in p.counts},
        parameters={name: value for p in parts for name, value in p.parameters.items()},
        texts=tuple(text for p in parts for text in p.texts),
        vehicle=next((p.vehicle for p in parts if p.vehicle != "PX4"), "PX4"),
        findings=tuple({f.message: f for p in parts for f in p.findings}.values()),
        headers=tuple(h for p in parts for h in p.headers),
        parameter_log=tuple(row for p in parts for row in p.parameter_log),
        text_places=tuple(at for p in parts for at in p.text_places),
    )


def _steps_back(timestamp: NDArray[Any]) -> bool:
    """Return whether time steps back by more than RESTART_S (``timestamp`` in us)."""
    return len(timestamp) > 1 and bool(
        np.min(np.diff(timestamp.astype(np.float64))) < -1e6 * RESTART_S
    )


class _OrderedULog(ULog):
    """A ULog that records the order of the records of all topics in the file."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.places: dict[tuple[str, int], list[int]] = {}
        self.records = 0
        super().__init__(*args, **options)

    class _MessageData(ULog._MessageData):
        def initialize(
            self, data: bytes, header: Any, subscriptions: dict[int, Any], ulog_object: Any
        ) -> bool:
            """Parse a record and note its place."""
            damaged = bool(super().initialize(data, header, subscriptions, ulog_object))
            number = int.from_bytes(data[:2], "little")
            ulog_object.records += 1
            if not damaged and number in subscriptions:
                topic = subscriptions[number]
                key = (str(topic.message_name), int(topic.multi_id))
                ulog_object.places.setdefault(key, []).append(ulog_object.records)
            return damaged


def _parameters(log: ULog) -> dict[str, float]:
    """Return the numeric parameters."""
    out = {}
    for name, value in log.initial_parameters.items():
        with contextlib.suppress(TypeError, ValueError):
            out[str(name)] = float(value)
    return out


def _vehicle(log: ULog, messages: dict[tuple[str, int], MessageTable]) -> str:
    """Return the vehicle type by vehicle_status or MAV_TYPE."""
    status: Any = messages.get(("vehicle_status", 0))
    name = "PX4"
    if (
        status is not None
        and len(status.fields.get("is_vtol", ()))
        and int(np.max(status.fields["is_vtol"]))
    ):
        return f"{name} VTOL"
    kind = log.initial_parameters.get("MAV_TYPE")
    if isinstance(kind, int | float) and int(kind) in _MAV_TYPES:
        return f"{name} {_MAV_TYPES[int(kind)]}"
    if status is not None and len(status.fields.get("vehicle_type", ())):
        return (
            f"{name} {_VEHICLE_TYPES.get(int(status.fields['vehicle_type'][0]), 'unknown vehicle')}"
        )
    return name


def _findings(log: ULog, chatter: str) -> list[Finding]:
    """Return findings on dropouts and damage."""
    out = []
    if log.dropouts:
        lost_s = sum(d.duration for d in log.dropouts) * 1e-3
        text = f"the logger reports {len(log.dropouts)} dropouts, {lost_s:.2f} s together"
        out.append(
            Finding(
                "logger-dropouts",
                "",
                "warning",
                text,
                {"count": float(len(log.dropouts)), "seconds": lost_s},
            )
        )
    if log.file_corruption:
        lines = " ".join(chatter.split())[:160]
        out.append(
            Finding(
                "damaged-bytes", "", "warning", f"parts of the file could not be read ({lines})", {}
            )
        )
    return out
