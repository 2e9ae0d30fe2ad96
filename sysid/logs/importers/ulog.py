"""PX4 ULog (.ulg) by pyulog, which keeps the wanted topics in memory and reports dropouts itself."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from pyulog import ULog

from sysid.errors import Finding, LogError
from sysid.foreign.raw import MessageTable, Progress, RawLog, Wanted
from sysid.foreign.regular_files import open_regular

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


def read(path: Path, wanted: Wanted | None = None, progress: Progress | None = None) -> RawLog:
    """Read a ULog file. Raises LogError when pyulog cannot make sense of it or nothing useful is inside."""
    chatter = io.StringIO()
    try:
        # pyulog prints what it finds corrupt; it belongs into the findings, not onto the terminal.
        # Given an open file, since pyulog leaves a file open that it opened itself and could not read.
        with (
            open_regular(path) as handle,
            contextlib.redirect_stdout(chatter),
            np.errstate(all="ignore"),
        ):
            log = ULog(
                handle, None if wanted is None else sorted(wanted), disable_str_exceptions=True
            )
    except MemoryError:
        raise
    except Exception as e:  # pyulog meets damage with whatever its parsing runs into
        raise LogError(
            f"damaged or not a ULog file ({type(e).__name__}: {' '.join(str(e).split())[:120]}); copy the log again",
            path,
        ) from None
    if progress is not None:
        progress(1.0)
    messages = {}
    for data in log.data_list:
        fields = {
            f: v for f, v in data.data.items() if f != "timestamp" and not f.startswith("_padding")
        }
        if "timestamp" not in data.data or not len(data.data["timestamp"]):
            continue
        time_s = data.data["timestamp"].astype(np.float64) * 1e-6
        messages[(str(data.name), int(data.multi_id))] = MessageTable(time_s, fields)
    if not messages:
        raise LogError(
            "no topic with flight data could be read; the log holds nothing this importer knows",
            path,
        )
    return RawLog(
        dialect="ulog",
        messages=messages,
        counts={f"{name}[{i}]" if i else name: len(t.time_s) for (name, i), t in messages.items()},
        parameters=_parameters(log),
        texts=tuple((m.timestamp * 1e-6, str(m.message)) for m in log.logged_messages),
        vehicle=_vehicle(log, messages),
        facts={"px4": str(log.msg_info_dict.get("ver_sw_branch", ""))},
        findings=tuple(_findings(log, chatter.getvalue())),
    )


def _parameters(log: ULog) -> dict[str, float]:
    out = {}
    for name, value in log.initial_parameters.items():
        with contextlib.suppress(TypeError, ValueError):
            out[str(name)] = float(value)
    return out


def _vehicle(log: ULog, messages: dict[tuple[str, int], MessageTable]) -> str:
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
    out = []
    if log.dropouts:
        lost = sum(d.duration for d in log.dropouts) * 1e-3
        text = f"the logger reports {len(log.dropouts)} dropouts, {lost:.2f} s together"
        out.append(
            Finding(
                "logger-dropouts",
                "",
                "warning",
                text,
                {"count": float(len(log.dropouts)), "seconds": lost},
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
