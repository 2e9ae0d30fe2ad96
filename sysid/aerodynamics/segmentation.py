"""Cuts a record into pieces that a simulation can fly through: labelled manoeuvres, else excited stretches, else free flight."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.record import FlightRecord
from sysid.vocabulary import SURFACES

MIN_S = 2.0
MAX_S = 20.0
_EXCITED_DEG = (
    1.5  # a surface this far from its median of the seconds around is being moved on purpose
)
_MEDIAN_S = 6.0
_BEFORE_S, _AFTER_S = 1.0, 3.0


@dataclass(frozen=True)
class Piece:
    """Consecutive rows of a record without a gap. ``label`` is the manoeuvre's name, or how the piece was found."""

    label: str
    rows: slice
    start_s: float
    end_s: float


def cut(
    record: FlightRecord, needed: Sequence[str], min_s: float = MIN_S, max_s: float = MAX_S
) -> tuple[list[Piece], str]:
    """Pieces in order of time, and one sentence saying how they were found.

    needed  channels that must be finite throughout a piece; pieces shorter than ``min_s`` seconds are left out, longer ones
            than ``max_s`` cut into equal parts.
    """
    if "manoeuvre" in record and any(record["manoeuvre"]):
        labels = np.asarray(record["manoeuvre"], dtype=object)
        how = "manoeuvres as labelled in the record"
    else:
        excited = _excited(record)
        if excited.any():
            labels = np.where(excited, "excited", "").astype(object)
            how = "no manoeuvre is labelled: stretches in which a surface was moved on purpose"
        else:
            labels = np.full(len(record), "flight", dtype=object)
            how = "no manoeuvre is labelled and no surface was moved on purpose: the whole flight in pieces"
    time = record["time_s"]
    pieces = []
    for whole in record.segments(tuple(needed), min_s):
        inside = labels[whole]
        edges = [0, *(np.flatnonzero(inside[1:] != inside[:-1]) + 1).tolist(), len(inside)]
        for a, b in itertools.pairwise(edges):
            if not inside[a] or time[whole.start + b - 1] - time[whole.start + a] < min_s:
                continue
            parts = max(1, int(np.ceil((b - a) * record.dt_s / max_s - 1e-6)))
            marks = np.linspace(whole.start + a, whole.start + b, parts + 1).astype(int)
            for first, last in itertools.pairwise(marks.tolist()):
                pieces.append(
                    Piece(
                        str(inside[a]),
                        slice(first, last),
                        float(time[first]),
                        float(time[last - 1]),
                    )
                )
    return pieces, how


def _excited(record: FlightRecord) -> NDArray[np.bool_]:
    from scipy.ndimage import median_filter

    found = np.zeros(len(record), dtype=bool)
    width = max(3, round(_MEDIAN_S / record.dt_s)) | 1
    for name in SURFACES:
        if name not in record:
            continue
        values = np.nan_to_num(record[name])
        found |= (
            np.abs(values - median_filter(values, size=min(width, len(values) | 1), mode="nearest"))
            > _EXCITED_DEG
        )
    before, after = round(_BEFORE_S / record.dt_s), round(_AFTER_S / record.dt_s)
    at = np.flatnonzero(found)
    out = np.zeros(len(record), dtype=bool)
    if at.size:
        # Close the pauses within a manoeuvre, then add what comes before and after it.
        breaks = np.flatnonzero(np.diff(at) > before + after)
        for group in np.split(at, breaks + 1):
            out[max(0, group[0] - before) : group[-1] + after + 1] = True
    return out


def as_logged(record: FlightRecord, name: str, rows: slice) -> FloatArray:
    """The channel at ``rows``, NaN where its value was only filled in between two logged ones.

    A channel slower than the grid counts once for every time it was logged; counted at every row its noise would look smooth
    and its weight in a fit would be several times too large.
    """
    values = np.array(record[name][rows], dtype=np.float64)
    rate = record.metadata.native_hz.get(name, 0.0)
    stride = max(1, round(1.0 / (record.dt_s * rate))) if rate > 0 else 1
    if stride > 1:
        kept = (np.arange(rows.start, rows.stop) % stride) == 0
        values[~kept] = np.nan
    return values
