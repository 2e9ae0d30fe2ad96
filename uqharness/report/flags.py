"""Where in a record the findings of its log apply: channels, and stretches of time."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sysid.errors import Finding
from sysid.record import FlightRecord
from sysid.vocabulary import LABELS, SIGNALS
from uqharness.report.channels import Flag

MOST_SPANS = 60
"""Stretches of one finding that are drawn; nearer ones are joined until there are no more."""
_GROUPS: Mapping[str, tuple[str, ...]] = {
    "ground velocity": ("vn_mps", "ve_mps", "vd_mps"),
    "attitude": ("phi_rad", "theta_rad", "psi_rad"),
    "position": ("north_m", "east_m", "h_m"),
}
"""Names that a finding has for several channels."""
_WHOLE = ("flight-phase", "slower-than-grid", "time-repeats")
"""Findings that a chart's own shading shows, or that say nothing of a place."""


def channels_of(finding: Finding, record: FlightRecord) -> tuple[str, ...]:
    """Channels of the record that a finding concerns: its own, those of its group, or those made from its message."""
    name = finding.channel
    if name in record:
        return (name,)
    if name in _GROUPS:
        return tuple(n for n in _GROUPS[name] if n in record)
    sources = record.metadata.channels
    return tuple(
        n
        for n in record.columns
        if name and re.split(r"[\W]", sources.get(n, ""), maxsplit=1)[0] == name
    )


def spans_of(
    finding: Finding, channel: str, record: FlightRecord
) -> tuple[tuple[float, float], ...]:
    """Stretches [s] in which a finding holds for a channel; none where it holds throughout or the log does not say."""
    numbers = finding.numbers
    if "start_s" in numbers and "end_s" in numbers:
        return ((numbers["start_s"], numbers["end_s"]),)
    time_s = record["time_s"]
    if channel in LABELS:
        return ()
    values = record[channel]
    if finding.code in ("gap", "dropouts"):
        return _runs(time_s, ~np.isfinite(values))
    if finding.code == "out-of-range":
        return _runs(time_s, (values < SIGNALS[channel].low) | (values > SIGNALS[channel].high))
    if finding.code == "negative-airspeed":
        return _runs(time_s, values < 0.0)
    return ()


def flags_of(record: FlightRecord) -> dict[str, list[Flag]]:
    """Flags by channel, of every finding that concerns a channel."""
    out: dict[str, list[Flag]] = {}
    for finding in record.metadata.findings:
        if finding.code in _WHOLE:
            continue
        for channel in channels_of(finding, record):
            words = (
                finding.code if finding.severity == "info" else f"{finding.severity} {finding.code}"
            )
            found = out.setdefault(channel, [])
            if words not in [flag.words for flag in found]:
                found.append(Flag(words, spans_of(finding, channel, record)))
    return out


def _runs(time_s: NDArray[np.float64], mask: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Begin and end of each run of True, joined over ever longer distances until there are at most `MOST_SPANS`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    runs = [(float(time_s[a]), float(time_s[b - 1])) for a, b in edges.reshape(-1, 2)]
    apart = 0.0
    while len(runs) > MOST_SPANS:
        apart = 2.0 * apart or 1e-3 * float(time_s[-1] - time_s[0])
        joined = [runs[0]]
        for start, end in runs[1:]:
            if start - joined[-1][1] <= apart:
                joined[-1] = (joined[-1][0], end)
            else:
                joined.append((start, end))
        runs = joined
    return tuple(runs)
