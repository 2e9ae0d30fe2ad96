"""Split of one ordinary flight in time: some blocks to estimate from, the others to judge on.

`identify` takes every second block, `bounds` every second one of what `identify` left, and
`validate-bounds` and `compare` what remains. Each result lists the times that it was made from, so
that the next command leaves them out. Blocks of consecutive time keep slow gusts in one part; their
length is the one with which both parts fly most alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.foreign.regular_files import parse_json, read_regular
from sysid.model_form import ModelForm
from sysid.record import FlightRecord
from uqharness.simulator import Aircraft

MIN_SPLIT_S = 90.0
"""Shortest flight that is split for an identification, s: half of it determines few of the
parameters."""
MIN_LEFT_S = 20.0
"""Least that bounds, and a judgement, need of a flight, s."""
BLOCKS_S = (15.0, 20.0, 25.0, 30.0)
"""Lengths of blocks that are tried, s: longer than the longest prediction of `compare`."""
_MIN_BLOCKS = 4  # of which every second one is used
_STATES = ("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "h_m")
_CONTROLS = ("elevator_deg", "aileron_deg", "rudder_deg", "throttle_pct")

BoolArray = NDArray[np.bool_]
Intervals = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Split:
    """Parts of a flight, s of the record's time.

    Attributes
    ----------
    used_s, held_out_s : tuple of pairs
        First and last time of each stretch.
    block_s : float
        Length of the blocks; 0 where the flight is not split.
    difference : float
        Largest distance between the two parts' distributions (Kolmogorov-Smirnov) over states and
        controls, and ``differs`` where it occurs.
    """

    used_s: Intervals
    held_out_s: Intervals = ()
    block_s: float = 0.0
    difference: float = 0.0
    differs: str = ""

    def note(self, name: str, held_out_for: str, min_s: float = MIN_SPLIT_S) -> str:
        """Describe the split, or why there is none."""
        if not self.held_out_s:
            return (
                f"{name}: all {seconds(self.used_s):.0f} s are used, {min_s:.0f} s are needed to"
                f" hold rows out; {held_out_for} needs another flight"
            )
        return (
            f"{name}: {seconds(self.used_s):.0f} s in every second block of {self.block_s:.3g} s"
            f" are used,"
            f" {seconds(self.held_out_s):.0f} s are held out for {held_out_for} (the parts"
            f" differ most in {self.differs}, by {self.difference:.2f} of their distribution);"
            " --split none uses all"
        )


def seconds(intervals: Intervals) -> float:
    """Return the length of all stretches, s."""
    return sum(b - a for a, b in intervals)


def split_in_time(record: FlightRecord, enabled: bool = True, min_s: float = MIN_SPLIT_S) -> Split:
    """Return the parts of a flight: every second block is used.

    A flight shorter than ``min_s``, or one whose rows a map has selected block by block, is used
    completely.
    """
    chosen_by_map = any(
        f.code == "selected-rows" and "blocks of" in f.message for f in record.metadata.findings
    )
    complete = _intervals(record, np.ones(len(record), dtype=bool))
    length_s = len(record) * record.dt_s
    if not enabled or chosen_by_map or length_s < min_s - record.dt_s:
        return Split(complete)
    # Blocks count flown rows, so that gaps do not put all of one condition into one part.
    flown_s = np.arange(len(record)) * record.dt_s
    lengths_s = [s for s in BLOCKS_S if _MIN_BLOCKS * s <= length_s] or [length_s / _MIN_BLOCKS]
    parts = {s: np.floor(flown_s / s).astype(int) % 2 == 0 for s in lengths_s}
    differences = {s: _largest_difference(record, used) for s, used in parts.items()}
    block_s = min(lengths_s, key=lambda s: differences[s][0])
    used = parts[block_s]
    return Split(
        _intervals(record, used), _intervals(record, ~used), block_s, *differences[block_s]
    )


def _largest_difference(record: FlightRecord, used: BoolArray) -> tuple[float, str]:
    """Return the largest distance between two parts' distributions, and its channel."""
    # Imported here: it takes half a second to load, and few flights are split.
    from scipy.stats import ks_2samp

    step = max(1, round(0.2 / record.dt_s))
    out = []
    for channel in (*_STATES, *_CONTROLS):
        values = record.columns.get(channel)
        if values is None:
            continue
        a, b = (v[np.isfinite(v)] for v in (values[used][::step], values[~used][::step]))
        if len(a) and len(b):
            out.append((float(ks_2samp(a, b, method="asymp").statistic), channel))
    return max(out, default=(0.0, ""))


def _intervals(record: FlightRecord, mask: BoolArray) -> Intervals:
    """Return first and last time of each stretch of rows without a gap."""
    time_s = record["time_s"]
    rows = np.flatnonzero(mask)
    if not len(rows):
        return ()
    ends = np.flatnonzero((np.diff(rows) > 1) | (np.diff(time_s[rows]) > 1.5 * record.dt_s))
    first, last = np.append(0, ends + 1), np.append(ends, len(rows) - 1)
    return tuple(
        (float(time_s[rows[a]]), float(time_s[rows[b]])) for a, b in zip(first, last, strict=True)
    )


def inside(record: FlightRecord, intervals: Intervals) -> BoolArray:
    """Return whether each row lies in one of the intervals."""
    time_s, half = record["time_s"], 0.5 * record.dt_s
    out = np.zeros(len(record), dtype=bool)
    for a, b in intervals:
        out |= (time_s >= a - half) & (time_s <= b + half)
    return out


def rows_in(record: FlightRecord, intervals: Intervals) -> FlightRecord:
    """Return the rows of a record in the intervals."""
    return record.rows(inside(record, intervals))


def used_for_model(aircraft: Aircraft, sha256: str) -> Intervals:
    """Return the times of a flight that an identified aircraft was estimated from, by the fit.json
    beside it; empty where it lists none.
    """
    # The file is optional and may be of any origin: unreadable content is ignored.
    try:
        document = parse_json(read_regular(aircraft.folder.parent / "fit.json"))
        if sha256 not in document.get("flights_sha256", []):
            return ()
        return tuple((float(a), float(b)) for a, b in document["split"]["used_s"])
    except (OSError, ValueError, AttributeError, TypeError, KeyError):
        return ()


def used_for_bounds(form: ModelForm, sha256: str) -> Intervals:
    """Return the times of a flight that bounds were made from; empty where they list none."""
    return next((f.parts_s for f in form.flights if f.sha256 == sha256), ())


def without(record: FlightRecord, used: Intervals) -> FlightRecord | None:
    """Return the rows that no earlier result was made from; None where too little is left."""
    mask = ~inside(record, used)
    # The last block may lack rows at its ends.
    return record.rows(mask) if mask.sum() * record.dt_s >= MIN_LEFT_S - 1.0 else None
