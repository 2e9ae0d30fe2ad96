"""Draw ground tracks: one lap of a study's flights with the commanded path, or a complete flight.

A commanded circle is recovered from positions and signed distances by least squares. Axes east and
north have equal scales.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sysid.arrays import FloatArray
from uqharness.report.parts import Figure
from uqharness.report.svg import Chart, Scale, scale

if TYPE_CHECKING:
    import pandas as pd

_HEIGHT, _LAP_HEIGHT = 330, 290
_LONGEST_S = 120.0
"""Time [s] displayed of a track that does not complete a turn."""
_NEAR_M = 0.05
_APART_M = 0.1
"""Distance [m] below which two flights count as the same line."""
_MAX_POINTS = 4000
_MIN_M = 1.0
"""Shortest track [m] that is drawn; a shorter one is a receiver at rest."""
_WIDEST = 3.0
"""Largest radius of a circle that is drawn, in lengths of the track."""
_KINDS: Mapping[tuple[str, str], str] = {
    ("before", "nominal"): "second thin",
    ("before", "worst corner"): "second",
    ("after", "nominal"): "first thin",
    ("after", "worst corner"): "first",
}


@dataclass(frozen=True)
class Circle:
    """The centre and radius [m] of a commanded circle."""

    north_m: float
    east_m: float
    radius_m: float


def circle_of(north_m: FloatArray, east_m: FloatArray, distance_m: FloatArray) -> Circle | None:
    """Return the circle from which signed distances are measured, by least squares.

    With r the distance from the centre c and d = r - R, n^2 + e^2 - d^2 = 2 c.(n, e) + 2 R d + R^2
    - c^2, which is linear in c, R and the remaining constant.

    Parameters
    ----------
    north_m, east_m, distance_m : array
        Positions and distances (n,) [m], positive outside the circle.

    Returns
    -------
    Circle or None
        None if the distances are not measured from a circle.
    """
    is_known = np.isfinite(north_m) & np.isfinite(east_m) & np.isfinite(distance_m)
    # Four unknowns need more points than a few.
    n, e, d = north_m[is_known], east_m[is_known], distance_m[is_known]
    if n.size < 8:
        return None
    # Linear least squares in c_n, c_e, R and the constant.
    rows = np.column_stack([2.0 * n, 2.0 * e, 2.0 * d, np.ones(n.size)])
    (cn, ce, radius, _), _, rank, _ = np.linalg.lstsq(rows, n**2 + e**2 - d**2, rcond=1e-10)
    if (
        rank < 4
        or not radius > 0.0
        or np.abs(np.hypot(n - cn, e - ce) - radius - d).max() > _NEAR_M
    ):
        return None
    return Circle(float(cn), float(ce), float(radius))


def equal_scales(east: FloatArray, north: FloatArray, height: int) -> tuple[Scale, Scale]:
    """Return axes with equal scales around the points.

    Parameters
    ----------
    east, north : array
        Points (n,) [m].
    height : int
        Height of the chart in drawing units.

    Returns
    -------
    tuple of Scale
        East and north [m]; one metre has the same length on both.
    """
    # Centre of the points; an empty chart gives the size of the plot area.
    middle = [0.5 * float(np.nanmin(v) + np.nanmax(v)) for v in (east, north)]
    blank = Chart(
        "blank", "", Scale("", 0.0, 1.0), Scale("", middle[1] - 1e3, middle[1] + 1e3), height
    )
    _, _, across, down = blank.plot
    # Metres per drawing unit: the larger of both directions, with a margin.
    metres = 1.1 * max(float(np.ptp(east)) / across, float(np.ptp(north)) / down, 1e-3)
    ends = [
        (m - 0.5 * metres * size, m + 0.5 * metres * size)
        for m, size in zip(middle, (across, down), strict=True)
    ]
    return Scale("east [m]", *ends[0]), Scale("north [m]", *ends[1])


@dataclass(frozen=True)
class Lap:
    """One lap of the flights of a study, all in the same gusts.

    Attributes
    ----------
    tracks : mapping of (str, str) to DataFrame
        Rows of tracks.parquet within the lap, by (when, model).
    begin_s, end_s : float
        Time interval [s].
    at_s : float
        Instant around which the lap lies.
    apart_m : float
        Largest distance between two flights at that instant [m]; 0 for one flight.
    worst_flight : tuple of str
        Key of the worst corner that was flown last.
    largest_m : float
        Its largest distance from the path in the complete flight [m].
    circle : Circle or None
        Commanded path, if it is a circle.
    """

    tracks: Mapping[tuple[str, str], pd.DataFrame]
    begin_s: float
    end_s: float
    at_s: float
    apart_m: float
    worst_flight: tuple[str, str]
    largest_m: float
    circle: Circle | None

    def called(self, key: tuple[str, str]) -> str:
        """Return the label of a flight: its model, and when it was flown if there are two
        versions.
        """
        when, model = key
        return model if len({w for w, _ in self.tracks}) == 1 else f"{model}, {when}"


def lap_of(track_rows: pd.DataFrame) -> Lap | None:
    """Select the lap in which the flights differ most.

    If they do not differ, it is the lap in which the worst corner is farthest from its path.

    Parameters
    ----------
    track_rows : DataFrame
        tracks.parquet of a study.

    Returns
    -------
    Lap or None
        None without a worst corner with known distances from its path.
    """
    # Rows of tracks.parquet by version and model.
    tracks = {
        (str(when), str(model)): rows
        for (when, model), rows in track_rows.groupby(["when", "model"], sort=False)
    }
    # The last worst corner that has known distances.
    worst_flight = next(
        (
            key
            for key in reversed(list(tracks))
            if key[1] != "nominal" and tracks[key]["distance_m"].notna().any()
        ),
        None,
    )
    if worst_flight is None:
        return None
    time_s, north, east, distance = (
        tracks[worst_flight][c].to_numpy(dtype=float)
        for c in ("time_s", "north_m", "east_m", "distance_m")
    )
    # The lap lies around the largest separation, or around the largest distance from the path.
    separation_m = _largest_separation(time_s, list(tracks.values()))
    at = (
        int(np.argmax(separation_m))
        if separation_m.max() > _APART_M
        else int(np.nanargmax(np.abs(distance)))
    )
    begin, end = _turn(time_s, north, east, at)
    lap_tracks = {
        key: rows[(rows["time_s"] >= begin) & (rows["time_s"] <= end)]
        for key, rows in tracks.items()
    }
    largest, circle = float(np.nanmax(np.abs(distance))), circle_of(north, east, distance)
    return Lap(
        lap_tracks,
        begin,
        end,
        float(time_s[at]),
        float(separation_m[at]),
        worst_flight,
        largest,
        circle,
    )


def ground_track(name: str, lap: Lap, radius_m: float, condition: str) -> Figure:
    """Draw the tracks of a lap.

    Parameters
    ----------
    name : str
        Name of the figure.
    lap : Lap
        Tracks, and the commanded circle if there is one.
    radius_m : float
        Radius in question [m], drawn on both sides of the circle.
    condition : str
        Condition in words.
    """
    # Commanded circle and the circles at the radius in question.
    rings = list(_rings(lap.circle, radius_m)) if lap.circle else []
    # Axes contain all tracks and circles.
    east = np.concatenate(
        [*(rows["east_m"] for rows in lap.tracks.values()), *(ring[0] for ring in rings)]
    )
    north = np.concatenate(
        [*(rows["north_m"] for rows in lap.tracks.values()), *(ring[1] for ring in rings)]
    )
    x, y = equal_scales(east, north, _LAP_HEIGHT)
    label = f"Ground track of one lap, north [m] over east [m], {condition}; {_largest(lap)}."
    chart = Chart(name, label, x, y, _LAP_HEIGHT)
    for (ring_east, ring_north, kind), words in zip(
        rings, ("commanded path", f"{radius_m:g} m from it", ""), strict=False
    ):
        chart.path(ring_east, ring_north, kind, words)
    # Dashed and thin lines last, so that coinciding lines stay visible.
    for key, rows in _in_order(lap):
        chart.path(
            rows["east_m"].to_numpy(dtype=float),
            rows["north_m"].to_numpy(dtype=float),
            _KINDS[key],
            lap.called(key),
        )
    reason = (
        f"the lines are {lap.apart_m:.2g} m apart"
        if lap.apart_m > _APART_M
        else "the worst corner is farthest from its path"
    )
    caption = (
        f"Ground track of the lap ({lap.end_s - lap.begin_s:.0f} s) in which {reason}."
        f" {_sentence(condition)}, one air for all lines."
    )
    return Figure(name, chart.svg(), caption)


def track_distance(name: str, lap: Lap, radius_m: float) -> Figure:
    """Draw the distances from the path [m] over the time of the lap [s].

    Parameters
    ----------
    name : str
        Name of the figure.
    lap : Lap
        Tracks with distances.
    radius_m : float
        Radius in question [m].
    """
    sides = {key: rows["distance_m"].to_numpy(dtype=float) for key, rows in lap.tracks.items()}
    # Distances of all flights set the axis.
    distances = np.concatenate(list(sides.values()))
    # A limit far from all lines would only compress them.
    limits = [radius_m] + ([-radius_m] if np.nanmin(distances) < -0.5 * radius_m else [])
    quantity = "distance from the path [m]" + (", outside positive" if lap.circle else "")
    y = scale(quantity, [distances, np.array([0.0, *limits])])
    x = Scale("time in the lap [s]", 0.0, lap.end_s - lap.begin_s)
    chart = Chart(
        name,
        f"{quantity[0].upper()}{quantity[1:]}, over time in the lap [s]; {_largest(lap)}.",
        x,
        y,
        _LAP_HEIGHT,
    )
    chart.level(0.0, "third", "commanded path")
    for limit in limits:
        chart.level(limit, "limit", f"{radius_m:g} m from it")
    for key, rows in _in_order(lap):
        chart.line(
            rows["time_s"].to_numpy(dtype=float) - lap.begin_s,
            sides[key],
            _KINDS[key],
            lap.called(key),
        )
    caption = (
        f"The same lap. {_sentence(_largest(lap))}; in the complete flight {lap.largest_m:.3g} m"
        f" ({lap.called(lap.worst_flight)})."
    )
    return Figure(name, chart.svg(), caption)


def _in_order(lap: Lap) -> list[tuple[tuple[str, str], pd.DataFrame]]:
    """Return the flights in drawing order: nominal models and dashed "before" lines on top."""
    return sorted(
        lap.tracks.items(), key=lambda item: (item[0][1] == "nominal", item[0][0] == "before")
    )


def _largest(lap: Lap) -> str:
    """Return a sentence with the largest distance of each flight from the path."""
    texts = [
        f"{np.nanmax(np.abs(rows['distance_m'])):.3g} m ({lap.called(key)})"
        for key, rows in lap.tracks.items()
        if rows["distance_m"].notna().any()
    ]
    return f"largest distance from the path: {', '.join(texts)}"


def _sentence(words: str) -> str:
    """Return text with a capital first letter."""
    return f"{words[:1].upper()}{words[1:]}"


def _largest_separation(time_s: FloatArray, tracks: Sequence[pd.DataFrame]) -> FloatArray:
    """Return the largest distance between two flights across the path [m] (n,); 0 where unknown."""
    distances = []
    for rows in tracks:
        known_rows = rows[rows["distance_m"].notna()]
        if len(known_rows):
            at, distance = (
                known_rows[column].to_numpy(dtype=float) for column in ("time_s", "distance_m")
            )
            # Interpolate to common instants; unknown outside the record.
            distances.append(np.interp(time_s, at, distance, left=np.nan, right=np.nan))
    separation = np.max(distances, axis=0) - np.min(distances, axis=0)
    return np.nan_to_num(separation)


def flight_track(
    name: str, columns: Mapping[str, FloatArray], words: str = "", circles: Sequence[Circle] = ()
) -> Figure | None:
    """Draw the track of a flight with start, end and commanded circles.

    Parameters
    ----------
    name : str
        Name of the figure.
    columns : mapping of str to array
        ``north_m`` and ``east_m`` [m], or ``vn_mps`` and ``ve_mps`` with ``time_s``; optionally
        ``cross_track_m``.
    words : str
        Addition to the caption.
    circles : sequence of Circle
        Commanded circles; default: the one that the cross-track error implies.

    Returns
    -------
    Figure or None
        None if the position is not known.
    """
    place = _places(columns)
    if place is None:
        return None
    north, east = place
    is_known = np.isfinite(north) & np.isfinite(east)
    # Circles given by the caller, else the one that the cross-track error implies.
    commanded = list(circles) or _commanded(north, east, columns)
    rings = [next(_rings(circle, 0.0)) for circle in commanded]
    ends = [
        np.concatenate([v[is_known], *(ring[k] for ring in rings)])
        for k, v in enumerate((east, north))
    ]
    x, y = equal_scales(ends[0], ends[1], _HEIGHT)
    circle_text = f", commanded circle of {commanded[0].radius_m:.4g} m" if commanded else ""
    chart = Chart(name, f"Ground track, north [m] over east [m]{circle_text}.", x, y, _HEIGHT)
    for k, (ring_east, ring_north, kind) in enumerate(rings):
        chart.path(
            ring_east,
            ring_north,
            kind,
            "" if k else f"commanded circle, radius {commanded[0].radius_m:.4g} m",
        )
    # Thin long tracks.
    few = max(1, math.ceil(len(east) / _MAX_POINTS))
    chart.path(east[::few], north[::few], "first thin", "flown")
    at = np.flatnonzero(is_known)
    for k, shape, label in ((at[0], "disc", "start"), (at[-1], "square", "end")):
        chart.marker(float(east[k]), float(north[k]), "second", shape, label)
    return Figure(
        name,
        chart.svg(),
        " ".join(
            ["Ground track; one metre is as long to the east as to the north.", words]
        ).strip(),
    )


def _places(columns: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray] | None:
    """Return north and east [m], from positions or integrated velocities; None if the aircraft is
    at rest.
    """
    if {"north_m", "east_m"} <= set(columns):
        north, east = (np.asarray(columns[n], dtype=float) for n in ("north_m", "east_m"))
    elif {"vn_mps", "ve_mps", "time_s"} <= set(columns):
        time_s = np.asarray(columns["time_s"], dtype=float)
        # Integrate the velocities; NaN counts as no motion.
        step = np.diff(time_s, append=time_s[-1])
        north, east = (
            np.nancumsum(np.asarray(columns[n], dtype=float) * step) for n in ("vn_mps", "ve_mps")
        )
    else:
        return None
    is_known = np.isfinite(north) & np.isfinite(east)
    # A receiver at rest has no track.
    moved = is_known.any() and max(float(np.ptp(v[is_known])) for v in (north, east)) >= _MIN_M
    return (north, east) if moved else None


def _commanded(
    north: FloatArray, east: FloatArray, columns: Mapping[str, FloatArray]
) -> list[Circle]:
    """Return the circle implied by the cross-track error, for either sign convention."""
    if "cross_track_m" not in columns:
        return []
    distance = np.asarray(columns["cross_track_m"], dtype=float)
    # The sign convention of the error is not known.
    circle = circle_of(north, east, distance) or circle_of(north, east, -distance)
    # A circle much larger than the track would appear as a line and hide the track.
    reach = max(float(np.nanmax(v) - np.nanmin(v)) for v in (north, east))
    return [circle] if circle is not None and circle.radius_m <= _WIDEST * reach else []


def _turn(time_s: FloatArray, north: FloatArray, east: FloatArray, at: int) -> tuple[float, float]:
    """Return start and end [s] of one turn of the course around the instant ``at``."""
    # Course angle, continuous over turns.
    course = np.unwrap(np.arctan2(np.gradient(east), np.gradient(north)))
    low, high = float(course.min()) + math.pi, float(course.max()) - math.pi
    is_in_turn = (
        np.abs(course - (min(max(course[at], low), high) if low < high else course[at])) <= math.pi
    )
    first = (
        at - int(np.argmin(is_in_turn[: at + 1][::-1])) + 1 if not is_in_turn[: at + 1].all() else 0
    )
    last = (
        at + int(np.argmin(is_in_turn[at:])) - 1
        if not is_in_turn[at:].all()
        else len(is_in_turn) - 1
    )
    # Limit the interval for a flight that does not turn.
    begin, end = (
        max(time_s[first], time_s[at] - 0.5 * _LONGEST_S),
        min(time_s[last], time_s[at] + 0.5 * _LONGEST_S),
    )
    return float(begin), float(end)


def _rings(circle: Circle, radius_m: float) -> Iterator[tuple[FloatArray, FloatArray, str]]:
    """Yield east and north [m] of the path and of circles ``radius_m`` outside and inside it."""
    # Two degrees per point.
    angle = np.linspace(0.0, 2.0 * math.pi, 181)
    for size, kind in (
        (circle.radius_m, "third"),
        (circle.radius_m + radius_m, "limit"),
        (circle.radius_m - radius_m, "limit"),
    ):
        if size > 0.0:
            yield circle.east_m + size * np.sin(angle), circle.north_m + size * np.cos(angle), kind
