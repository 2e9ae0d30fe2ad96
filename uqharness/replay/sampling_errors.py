"""What sampling alone leaves between the coefficients that a flight demanded and those of a perfect model.

Demanded and predicted coefficients pass one filter, which equals the model's mean over the time between two rows by the mean of
its values at these rows (`sysid.aerodynamics.smooth`). That holds where coefficients go from row to row in straight lines. A
surface that jumps with its command jumps behind its row, and a fast mode answers within a row or two: half a row of the jump is
left, and what the mode bends. Both are the same in a flight of the model under the same commands, where nothing else is left.
So pieces around the jumps are flown by the model, and what the formulas leave of these flights is the error of sampling.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.aerodynamics import CUTOFF_HZ, demanded, half_width, smooth
from sysid.arrays import FloatArray
from uqharness.replay.force import ForcedModel, StatesOf, force_all
from uqharness.replay.in_lanes import ReplayJob, by_jsbsim, fly_all
from uqharness.replay.model import ReplayModel
from uqharness.replay.positions import WORTH_ONCE_S
from uqharness.replay.replay import CHANNELS, STATES
from uqharness.replay.segments import Segment

_PIECE_S = 2.0
"""Seconds flown from one measured state: gusts, or a model that is wrong or unstable, must not lead far away meanwhile."""


@dataclass(frozen=True)
class MeasuredSegment:
    """A segment with its measured channels by name, (n,) each without gaps, positions (n, c) of the controls in the record's
    units, altitude_m (n,) above sea level, and by how much the controls act late, ``late_s``."""

    segment: Segment
    channels: Mapping[str, FloatArray]
    positions: FloatArray
    altitude_m: FloatArray
    late_s: float = 0.0


@dataclass(frozen=True)
class _Flight:
    """Rows of segment ``number`` that are flown, of which ``rows`` are wanted."""

    number: int
    rows: slice
    flown: slice
    job: ReplayJob


def sampling_errors(
    model: ReplayModel,
    straight: ReplayModel,
    parts: Sequence[MeasuredSegment],
    properties: Mapping[str, float],
    cutoff_hz: float = CUTOFF_HZ,
) -> list[FloatArray]:
    """Errors that sampling makes in residual coefficients, around jumps of surfaces.

    Parameters
    ----------
    model, straight
        The aircraft with its actuators, and with its controls passed straight through.
    parts
        Segments that the coefficients are computed of.
    properties
        Values in force.
    cutoff_hz
        Of the filter.

    Returns
    -------
    list of ndarray
        (n, 6) CX CY CZ Cl Cm Cn of each segment, demanded minus predicted, of flights that the model itself makes; zero where no
        surface jumps nearby, and where the model leaves the flight.
    """
    out = [np.zeros((len(part.positions), 6)) for part in parts]
    flights = [
        flight
        for number, part in enumerate(parts)
        for flight in _flights(model, number, part, properties, cutoff_hz)
    ]
    if not flights:
        return out
    jobs = [flight.job for flight in flights]
    seconds = sum(float(np.ptp(job.segment.time_s)) for job in jobs)
    flown = list(fly_all(jobs) if seconds > WORTH_ONCE_S else map(by_jsbsim, jobs))
    sound = [
        (f, dict(zip(CHANNELS, y.T, strict=True)))
        for f, y in zip(flights, flown, strict=True)
        if np.isfinite(y).all()
    ]
    states = [
        StatesOf(
            f.job.segment,
            channels,
            parts[f.number].positions[f.flown],
            parts[f.number].altitude_m[f.flown],
        )
        for f, channels in sound
    ]
    answers = force_all(straight, states, properties) if states else []
    for (f, channels), forced in zip(sound, answers, strict=True):
        error = _error(channels, forced, f.job.segment, cutoff_hz)
        first = f.rows.start - f.flown.start
        out[f.number][f.rows] = error[first : first + f.rows.stop - f.rows.start]
    return out


def _flights(
    model: ReplayModel,
    number: int,
    part: MeasuredSegment,
    properties: Mapping[str, float],
    cutoff_hz: float,
) -> Iterator[_Flight]:
    """Flights of the model around the jumps of a segment, each wider than the rows wanted of it by the filter's half width."""
    segment = part.segment
    surfaces = [model.controls.index(c) for c in model.jumping if c != "throttle"]
    n, width = len(segment.time_s), half_width(segment.dt_s, cutoff_hz)
    commands = segment.controls[:, surfaces]
    before = commands[:1] if segment.before is None else segment.before[-1:, surfaces]
    jumps = np.abs(np.diff(commands, axis=0, prepend=before)).sum(axis=1) > 0.0
    length = max(round(_PIECE_S / segment.dt_s), 2 * width + 1)
    for start in range(0, n, length):
        rows = slice(start, min(start + length, n))
        flown = slice(max(rows.start - width, 0), min(rows.stop + width, n))
        if flown.stop - flown.start > 2 and jumps[flown].any():
            piece = segment.part(flown)
            if flown.start > 0:
                state = np.array([part.channels[c][flown.start] for c in STATES])
                altitude = float(part.altitude_m[flown.start])
                height = segment.h_m + altitude - segment.altitude_m
                piece = replace(piece, start=state, altitude_m=altitude, h_m=height)
            job = ReplayJob(model, piece, properties, piece.start, part.late_s)
            yield _Flight(number, rows, flown, job)


def _error(
    channels: Mapping[str, FloatArray], forced: ForcedModel, segment: Segment, cutoff_hz: float
) -> FloatArray:
    """(n, 6) demanded minus predicted coefficients of a flight that the model has made."""
    flown = demanded(
        np.column_stack([channels[f"a{a}_mps2"] for a in "xyz"]),
        np.column_stack([channels[f"{a}_radps"] for a in "pqr"]),
        forced.qbar,
        forced.mass,
        forced.other_force,
        forced.other_moment,
        segment.dt_s,
        np.array(segment.arm_m),
        cutoff_hz,
    )
    return np.asarray(flown - smooth(forced.coefficients, segment.dt_s, cutoff_hz))
