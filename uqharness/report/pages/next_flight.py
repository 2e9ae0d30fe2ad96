"""The page of a planned test flight: what it brings, where the mission lacks data, what to fly."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.model_form import CoefficientBounds, MissingTerm, Outside, parameter_variance
from sysid.units import percent
from uqharness.campaign import Winner
from uqharness.files import finite
from uqharness.next_flight import (
    MAX_SENSOR_SCATTER_RATIO,
    MIN_NARROWING,
    NextFlight,
    Occupancy,
    Prospect,
)
from uqharness.replay import axis_label, shown_channel
from uqharness.report.parts import (
    Figure,
    Figures,
    Page,
    Say,
    Section,
    Table,
    Words,
    provenance,
    remarks,
    shown,
)
from uqharness.report.svg import Chart, Scale

_BINS, _CELLS, _MOST_DOTS = 16, 24, 1500


def next_flight_page(
    found: NextFlight, document: Mapping[str, Any], figures: Sequence[Figure], command: str
) -> Page:
    """The page of a plan. document: next-flight.json; figures: of :func:`uncertainty_figures`, none to leave them out."""
    name = document["aircraft"]["name"]
    where = (
        "Quartiles (25, 50, 75 %): of the data behind the bounds, of the mission, and of the mission weighted by the prediction "
        "variance."
    )
    legend = (
        ("fillrange", "mission"),
        ("second", "polynomial unknown, now"),
        ("first", "after the flight"),
        ("limit", "scatter, which stays"),
        ("joint", "range of the data"),
        ("dot", "states of the flight"),
    )
    drawn = (Figures(tuple(figures), legend, True, "next-flight"),) if figures else ()
    fly = (
        f"uqharness fly {name} --script next-flight.xml --out FILE flies it in simulation; test-points.csv is the same for an "
        f"operator. Gain: share of the mean width that a point takes, given those chosen before it. {len(found.refused)} of "
        f"{found.n_points} test points were refused."
    )
    sections = (
        Section(
            "Where the mission lacks data", (Words(where, note=True), *drawn, _where_table(found))
        ),
        Section("What to fly", (Words(fly, note=True), _point_table(found))),
        *remarks(document, key=()),
        provenance(
            ("Command", command),
            ("Files", "next-flight.json, next-flight.xml, test-points.csv, beside this page"),
        ),
    )
    asked = f"What test flight narrows the interval of {found.coefficient} most in the mission's flight states?"
    verdict = tuple(Say(text) for text in document["words"])
    return Page(f"Next test flight for {found.coefficient} of {name}", asked, verdict, sections)


def _where_table(found: NextFlight) -> Table:
    rows = []
    for w in found.where:
        quantity, unit, factor = shown_channel(w.state)
        spread = (
            " / ".join(shown(factor * float(v)) for v in values)
            for values in (w.data, w.mission, w.variance)
        )
        rows.append((f"{quantity} [{unit}]", *spread))
    return Table(
        "Quartiles of each state.",
        ("State", "Data", "Mission", "Uncertainty"),
        tuple(rows),
        key=True,
    )


def _point_table(found: NextFlight) -> Table:
    rows = []
    for k, p in enumerate(found.plan, start=1):
        unit = ", ".join(f"{s.unit_s:g} s" for s in p.point.steps) or "-"
        rows.append((str(k), f"{p.start_s:.0f} s", p.point.name, unit, percent(p.gain)))
    return Table(
        "Test points in the order of the flight.",
        ("Number", "From", "Point", "Unit", "Gain"),
        tuple(rows),
        key=True,
    )


def uncertainty_figures(
    now: CoefficientBounds,
    then: CoefficientBounds,
    mission: Mapping[str, FloatArray],
    flown: Mapping[str, FloatArray],
    outside: Outside,
    coefficient: str,
) -> list[Figure]:
    """Half-width from the uncertainty of the polynomial along each state, and occupancy times variance over two states.

    mission: states (n,) of the mission; flown: of the planned flight.
    """
    before, after = (b.t * np.sqrt(parameter_variance(b, mission, outside)) for b in (now, then))
    figures = [
        _profile(now, state, mission[state], before, after, coefficient) for state in now.states
    ]
    if len(now.states) < 2:
        return figures
    spread = {}
    for state in now.states:
        bins = np.digitize(
            mission[state], np.quantile(mission[state], np.linspace(0.0, 1.0, 7)[1:-1])
        )
        mean = np.bincount(bins, before**2, 6) / np.maximum(np.bincount(bins, minlength=6), 1)
        spread[state] = float(np.ptp(mean))
    # The two states along which the uncertainty differs most over the mission.
    first, second = sorted(now.states, key=lambda s: -spread[s])[:2]
    return [*figures, *_maps(now, (first, second), mission, flown, (before, after))]


def _profile(
    b: CoefficientBounds,
    state: str,
    values: FloatArray,
    before: FloatArray,
    after: FloatArray,
    coefficient: str,
) -> Figure:
    quantity, unit, factor = shown_channel(state)
    low, high = (float(v) for v in np.quantile(values, [0.002, 0.998]))
    edges = np.linspace(low, high, _BINS + 1)
    bins = np.clip(np.digitize(values, edges) - 1, 0, _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    scatter = b.t * float(np.sqrt(b.s2))
    many = count >= 3
    means = [np.bincount(bins, curve, _BINS)[many] / count[many] for curve in (before, after)]
    y = Scale(
        f"half-width of {coefficient} [-]",
        0.0,
        1.1 * max(scatter, *(float(m.max(initial=0.0)) for m in means)),
    )
    x = Scale(axis_label(state), factor * low, factor * high)
    chart = Chart(
        f"half-width-{state}",
        f"Half-width of {coefficient} [-] along {quantity} [{unit}], now and after.",
        x,
        y,
        190,
    )
    chart.band(
        factor * edges,
        np.zeros(_BINS + 1),
        np.append(0.6 * y.high * count / count.max(), 0.0),
        "fillrange",
        steps=True,
    )
    middle = factor * 0.5 * (edges[1:] + edges[:-1])[many]
    for mean, kind in zip(means, ("second", "first"), strict=True):
        chart.line(middle, mean, kind)
    chart.level(scatter, "limit")
    k = b.states.index(state)
    for edge in (b.hull.low[k], b.hull.high[k]):
        if low < edge < high:
            chart.upright(factor * float(edge), "joint")
    return Figure(
        chart.name,
        chart.svg(),
        f"Half-width of {coefficient} along {quantity}; shaded: how often the mission is there.",
    )


def _maps(
    b: CoefficientBounds,
    pair: tuple[str, str],
    mission: Mapping[str, FloatArray],
    flown: Mapping[str, FloatArray],
    curves: tuple[FloatArray, FloatArray],
) -> list[Figure]:
    factors = [shown_channel(s)[2] for s in pair]
    x, y = (f * mission[s] for f, s in zip(factors, pair, strict=True))
    dots = [
        f * flown[s][:: max(1, len(flown[s]) // _MOST_DOTS)]
        for f, s in zip(factors, pair, strict=True)
    ]
    box = [np.quantile(v, [0.002, 0.998]) for v in (x, y)]
    found = [np.histogram2d(x, y, _CELLS, box, weights=c**2) for c in curves]
    most = max(float(found[0][0].max()), 1e-300)
    scales = [
        Scale(axis_label(s), *_reach(ends, d)) for s, ends, d in zip(pair, box, dots, strict=True)
    ]
    i, j = (b.states.index(s) for s in pair)
    across = factors[0] * np.array(
        [b.hull.low[i], b.hull.high[i], b.hull.high[i], b.hull.low[i], b.hull.low[i]]
    )
    up = factors[1] * np.array(
        [b.hull.low[j], b.hull.low[j], b.hull.high[j], b.hull.high[j], b.hull.low[j]]
    )
    figures = []
    for (weights, x_edges, y_edges), when in zip(found, ("now", "after"), strict=True):
        label = f"Occupancy times variance, {when}, over {axis_label(pair[0])} and {axis_label(pair[1])}."
        chart = Chart(f"variance-{when}", label, scales[0], scales[1], 300)
        chart.cells(x_edges, y_edges, np.minimum(weights / most, 1.0), "")
        chart.path(across, up, "joint")
        if when == "after":
            chart.dots(dots[0], dots[1], "dot")
        figures.append(
            Figure(
                chart.name,
                chart.svg(),
                f"Occupancy times variance {when}: the darker, the larger its share.",
            )
        )
    return figures


def _reach(box: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Axis limits: the mission, and the flight as far as it lies within as much again on either side."""
    span = float(box[1] - box[0])
    low, high = np.quantile(values, [0.01, 0.99])
    return max(min(float(box[0]), float(low)), float(box[0]) - span), min(
        max(float(box[1]), float(high)), float(box[1]) + span
    )


# What `next-flight` leaves: next-flight.json and the table of test points.

# The answer of next-flight in sentences: what it is about, what a flight brings, or why none
# does.

MOST = 0.9
"""Share of a flight's gain that its few most telling points have together."""


def words(
    found: NextFlight, winner: Winner, missing: Sequence[MissingTerm] | None = None
) -> list[str]:
    """The answer in sentences."""
    c, p = found.coefficient, found.prospect
    low, high = (100.0 * s for s in winner.share)
    sure = "certain" if winner.certain else "not certain"
    out = [
        f"{c} has {low:.0f} to {high:.0f} % of the p-box of {winner.metric} ({winner.condition}; its lead is {sure})."
    ]
    out.append(
        f"In the mission's flight states its interval is {p.current.total:.3g} wide on average. "
        f"{_percent(found.extrapolated)} of the mission lies outside the data. The "
        f"polynomial's uncertainty alone gives {p.current.parameter:.3g}, the scatter about it the rest."
    )
    flight = f"The flight of {found.end_s / 60.0:.1f} min narrows the interval by {_percent(p.narrowing)} (its parameter part by "
    flight += (
        f"{_percent(p.parameter_narrowing)}); as long a repetition of what was flown before, by "
        f"{_percent(1.0 - p.repeated.total / p.current.total)} ("
        f"{_percent(1.0 - p.repeated.parameter / p.current.parameter)}); unlimited data "
        f"of the same kind, by {_percent(p.at_most)}."
    )
    shown = 1.0 - p.refitted.total / p.current.total
    if abs(shown - p.narrowing) > 0.01:
        flight += (
            f" Bounds made again will come out {_percent(abs(shown))} {'narrower' if shown >= 0.0 else 'wider'}, because residuals "
            "scatter differently at the speeds of these points; that difference is no information."
        )
    out.append(flight)
    out += _first_points(found)
    if not found.worth_flying:
        out.append(_why_not(found, p))
    out += _of_form(found, missing)
    others = [
        f"{name} {_percent(o.narrowing)}"
        for name, o in found.prospects.items()
        if name != c and o.narrowing >= MIN_NARROWING
    ]
    if others:
        out.append(f"The same flight narrows {', '.join(others)}.")
    return out


def _first_points(found: NextFlight) -> list[str]:
    """How few of the points bring most of it; nothing where it takes more than half of them."""
    order = sorted(range(len(found.plan)), key=lambda k: -found.plan[k].gain)
    total, gained, few = sum(p.gain for p in found.plan), 0.0, list[int]()
    for k in order:
        few.append(k)
        gained += found.plan[k].gain
        if gained >= MOST * total:
            break
    if 2 * len(few) > len(found.plan):
        return []
    numbers = ", ".join(str(k + 1) for k in sorted(few))
    what = f"point {numbers} brings" if len(few) == 1 else f"points {numbers} bring"
    return [
        f"Of what the flight takes off the mean width {what} {_percent(gained / total)}; a short flight would be those."
    ]


def _why_not(found: NextFlight, p: Prospect) -> str:
    if p.at_most >= MIN_NARROWING:
        return (
            f"Not worth flying for {found.coefficient} alone ({_percent(MIN_NARROWING)} is asked for): more minutes would bring up to "
            f"{_percent(p.at_most)}."
        )
    text = (
        f"More data cannot narrow this interval: {_percent(1.0 - p.at_most)} of its width is scatter about the polynomial, which "
        "stays. "
    )
    ratio = found.scatter / found.simulated_scatter
    if not math.isfinite(ratio):
        return text + "A longer flight (--minutes) would show whether that is noise or model form."
    if ratio > MAX_SENSOR_SCATTER_RATIO:
        return (
            text
            + f"It is {ratio:.1f} times what the model's own sensors and air give ({found.simulated_scatter:.2g}): a term is "
            "missing, or the air was rougher than simulated (--turbulence)."
        )
    return (
        text
        + f"It is {ratio:.1f} times what the model's own sensors and air give ({found.simulated_scatter:.2g}): calmer air, "
        "better sensors or a lower --cutoff-hz of the bounds narrow it, no manoeuvre does."
    )


def _of_form(found: NextFlight, missing: Sequence[MissingTerm] | None) -> list[str]:
    """What the scatter is made of, where the flights behind the bounds were given."""
    c = found.coefficient
    if missing is None:
        if found.worth_flying and not found.form_is_short:
            return []
        return [
            "Give the flights behind the bounds (--flight FILE...) to learn whether a term is missing."
        ]
    if not missing:
        return [
            f"In the flights given no term of second order is missing from the bounds of {c}: what scatters is noise and air."
        ]
    listed = ", ".join(f"{m.name} ({_percent(m.share)})" for m in missing)
    states = ",".join(dict.fromkeys(s for m in missing for s in m.states))
    text = f"Of what scatters in the flights given, this is explained by terms that the bounds of {c} lack: {listed}. More flying "
    text += f"leaves it: put them into the model (uqharness refine) or their states ({states}) into the bounds (uqharness bounds "
    return [text + f"--states {c}=...). In turbulence gusts can pass for such terms."]


def _percent(value: float) -> str:
    return percent(value)


FORMAT = "next-flight 1"
COLUMNS = (
    "number",
    "start_s",
    "end_s",
    "speed_mps",
    "bank_deg",
    "kind",
    "control",
    "size",
    "unit",
    "unit_s",
    "pattern",
    "begins_s",
    "gain",
)


def document(
    found: NextFlight,
    winner: Winner,
    mission: Occupancy,
    missing: Sequence[MissingTerm] | None,
    air: Mapping[str, Any],
    units: Mapping[str, str],
    warnings: Sequence[str],
) -> dict[str, Any]:
    """next-flight.json. air: aircraft, bounds and conditions of the simulated flight, as they are to be written."""
    return {
        "format": FORMAT,
        **air,
        "metric": winner.metric,
        "coefficient": found.coefficient,
        "share": list(winner.share),
        "certain": winner.certain,
        "verdict": "fly" if found.worth_flying else "no",
        "words": words(found, winner, missing),
        "mission": {
            "source": mission.source,
            "flights": mission.flights,
            "failed": mission.failed,
            "seconds": round(mission.seconds, 3),
            "outside_data": found.extrapolated,
        },
        "where": {
            w.state: {
                "data": w.data.tolist(),
                "mission": w.mission.tolist(),
                "variance": finite(w.variance.tolist()),
            }
            for w in found.where
        },
        "prospects": {c: prospect_row(p) for c, p in found.prospects.items()},
        "scatter": {"bounds": found.scatter, "simulated": finite(found.simulated_scatter)},
        "missing": None
        if missing is None
        else [{"term": m.name, "share": m.share} for m in missing],
        "flight_s": found.end_s,
        "points": [point_row(found, k, units) for k in range(len(found.plan))],
        "tried": found.n_points,
        "refused": [{"point": r.point.name, "reason": r.reason} for r in found.refused],
        "warnings": list(warnings),
    }


def prospect_row(p: Prospect) -> dict[str, Any]:
    """Widths and narrowings of one coefficient."""
    return {
        "width": p.current.total,
        "width_after": p.planned.total,
        "narrowing": p.narrowing,
        "narrowing_at_most": p.at_most,
        "narrowing_same_manoeuvres": 1.0 - p.repeated.total / p.current.total,
        "width_redone": p.refitted.total,
        "narrowing_redone": 1.0 - p.refitted.total / p.current.total,
        "parameter_width": p.current.parameter,
        "parameter_width_after": p.planned.parameter,
        "parameter_narrowing": p.parameter_narrowing,
        "parameter_narrowing_same_manoeuvres": 1.0 - p.repeated.parameter / p.current.parameter,
    }


def point_row(found: NextFlight, k: int, units: Mapping[str, str]) -> dict[str, Any]:
    """One test point; its steps by control."""
    item = found.plan[k]
    return {
        "number": k + 1,
        "name": item.point.name,
        "start_s": item.start_s,
        "end_s": item.end_s,
        "speed_mps": item.point.condition.speed_mps,
        "bank_deg": item.point.condition.bank_deg,
        "steps": [
            {
                "control": s.control,
                "size": s.size,
                "unit": units[s.control],
                "unit_s": s.unit_s,
                "pattern": [[n, sign] for n, sign in s.pattern],
                "begins_s": s.start_s,
            }
            for s in item.point.steps
        ],
        "gain": item.gain,
    }


def points_csv(found: NextFlight, units: Mapping[str, str]) -> bytes:
    """test-points.csv: one row a control that a point moves, one row for steady flight."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for k, item in enumerate(found.plan):
        condition = item.point.condition
        speed = "" if condition.speed_mps is None else f"{condition.speed_mps:g}"
        head = [
            k + 1,
            f"{item.start_s:g}",
            f"{item.end_s:g}",
            speed,
            f"{condition.bank_deg:g}",
            item.point.kind,
        ]
        if not item.point.steps:
            writer.writerow([*head, "", "", "", "", "", "", f"{item.gain:.4g}"])
        for s in item.point.steps:
            pattern = " ".join(f"{'+' if sign > 0 else '-'}{n}" for n, sign in s.pattern)
            writer.writerow(
                [
                    *head,
                    s.control,
                    f"{s.size:g}",
                    units[s.control],
                    f"{s.unit_s:g}",
                    pattern,
                    f"{s.start_s:g}",
                    f"{item.gain:.4g}",
                ]
            )
    return buffer.getvalue().encode()
