"""Build the page of a planned test flight and write its files.

It shows what the flight brings, in which flight states the mission lacks data, and what to fly. The
files are next-flight.json and test-points.csv.
"""

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
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    provenance,
    remarks,
)
from uqharness.report.svg import Chart, Scale
from uqharness.results import next_flight as results
from uqharness.results.next_flight import NextFlightPlan

_BINS, _CELLS, _MAX_DOTS = 16, 24, 1500


def next_flight_page(
    plan: NextFlight, document: NextFlightPlan, figures: Sequence[Figure], command: str
) -> Page:
    """Return the page of a plan.

    Parameters
    ----------
    plan : NextFlight
        Planned flight.
    document : NextFlightPlan
        Content of next-flight.json.
    figures : sequence of Figure
        Figures of `uncertainty_figures`; empty to leave them out.
    command : str
        Command line.
    """
    name = document.aircraft.name
    quartile_text = (
        "Quartiles (25, 50, 75 %): of the data behind the bounds, of the mission, and of the"
        " mission weighted by the prediction variance."
    )
    # One legend for all charts of flight states.
    legend = (
        ("fillrange", "mission"),
        ("second", "polynomial unknown, now"),
        ("first", "after the flight"),
        ("limit", "scatter, which stays"),
        ("joint", "range of the data"),
        ("dot", "states of the flight"),
    )
    figure_block = (Figures(tuple(figures), legend, True, "next-flight"),) if figures else ()
    # What to do with the files, and how many test points were refused.
    fly = (
        f"uqharness fly {name} --script next-flight.xml --out FILE simulates it; test-points.csv is"
        " the flight card. Gain: share of the mean width that a point removes, after the points"
        f" before it. {len(plan.refused)} of {plan.n_points} test points were refused."
    )
    sections = (
        Section(
            "Where the mission lacks data",
            (Words(quartile_text, note=True), *figure_block, _where_table(plan)),
        ),
        Section("What to fly", (Words(fly, note=True), _point_table(plan))),
        *remarks(document, key=()),
        provenance(
            ("Command", command),
            ("Files", "next-flight.json, next-flight.xml, test-points.csv, next to this page"),
        ),
    )
    question = (
        f"What test flight narrows the interval of {plan.coefficient} most in the mission's flight"
        " states?"
    )
    verdict = tuple(Sentence(text) for text in document.words)
    return Page(f"Next test flight for {plan.coefficient} of {name}", question, verdict, sections)


def _where_table(plan: NextFlight) -> Table:
    """Return quartiles of each state: data, mission, mission weighted by variance."""
    rows = []
    for w in plan.where:
        quantity, unit, factor = shown_channel(w.state)
        quartiles = (
            " / ".join(format_value(factor * float(v)) for v in values)
            for values in (w.data, w.mission, w.variance)
        )
        rows.append((f"{quantity} [{unit}]", *quartiles))
    return Table(
        "Quartiles of each state.",
        ("State", "Data", "Mission", "Uncertainty"),
        tuple(rows),
        key=True,
    )


def _point_table(plan: NextFlight) -> Table:
    """Return the test points in the order of the flight."""
    rows = []
    for k, p in enumerate(plan.plan, start=1):
        unit = ", ".join(f"{s.unit_s:g} s" for s in p.point.steps) or "-"
        rows.append((str(k), f"{p.start_s:.0f} s", p.point.name, unit, percent(p.gain)))
    return Table(
        "Test points in the order of the flight.",
        ("Number", "From", "Point", "Unit", "Gain"),
        tuple(rows),
        key=True,
    )


def uncertainty_figures(
    current: CoefficientBounds,
    updated: CoefficientBounds,
    mission: Mapping[str, FloatArray],
    planned_flight: Mapping[str, FloatArray],
    outside: Outside,
    coefficient: str,
) -> list[Figure]:
    """Draw the half-width due to parameter uncertainty along each state, and maps over two states.

    Parameters
    ----------
    current, updated : CoefficientBounds
        Bounds before and after the flight.
    mission, planned_flight : mapping of str to array
        States (n,) of the mission and of the planned flight.
    outside : str
        Behaviour of the bounds outside the data.
    coefficient : str
        Name of the coefficient.
    """
    before, after = (
        b.t * np.sqrt(parameter_variance(b, mission, outside)) for b in (current, updated)
    )
    figures = [
        _profile(current, state, mission[state], before, after, coefficient)
        for state in current.states
    ]
    if len(current.states) < 2:
        return figures
    variance_ranges = {}
    for state in current.states:
        # Mean variance in six bins of equal occupancy.
        bins = np.digitize(
            mission[state], np.quantile(mission[state], np.linspace(0.0, 1.0, 7)[1:-1])
        )
        mean = np.bincount(bins, before**2, 6) / np.maximum(np.bincount(bins, minlength=6), 1)
        variance_ranges[state] = float(np.ptp(mean))
    # The two states along which the uncertainty differs most over the mission.
    first, second = sorted(current.states, key=lambda s: -variance_ranges[s])[:2]
    return [*figures, *_maps(current, (first, second), mission, planned_flight, (before, after))]


def _profile(
    b: CoefficientBounds,
    state: str,
    values: FloatArray,
    before: FloatArray,
    after: FloatArray,
    coefficient: str,
) -> Figure:
    """Draw the half-width along one state, before and after the flight."""
    quantity, unit, factor = shown_channel(state)
    # Ignore the most extreme 0.2 % on either side.
    low, high = (float(v) for v in np.quantile(values, [0.002, 0.998]))
    # Bins of equal width over the mission.
    edges = np.linspace(low, high, _BINS + 1)
    bins = np.clip(np.digitize(values, edges) - 1, 0, _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    # Residual scatter stays whatever is flown.
    scatter = b.t * float(np.sqrt(b.s2))
    many = count >= 3
    # Mean half-width where the mission has at least three samples.
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
    planned_flight: Mapping[str, FloatArray],
    curves: tuple[FloatArray, FloatArray],
) -> list[Figure]:
    """Draw occupancy times variance over two states, before and after the flight."""
    factors = [shown_channel(s)[2] for s in pair]
    x, y = (f * mission[s] for f, s in zip(factors, pair, strict=True))
    dots = [
        f * planned_flight[s][:: max(1, len(planned_flight[s]) // _MAX_DOTS)]
        for f, s in zip(factors, pair, strict=True)
    ]
    box = [np.quantile(v, [0.002, 0.998]) for v in (x, y)]
    # Occupancy weighted by the variance, before and after.
    histograms = [np.histogram2d(x, y, _CELLS, box, weights=c**2) for c in curves]
    largest = max(float(histograms[0][0].max()), 1e-300)
    scales = [
        Scale(axis_label(s), *_reach(ends, d)) for s, ends, d in zip(pair, box, dots, strict=True)
    ]
    i, j = (b.states.index(s) for s in pair)
    # Outline of the data.
    across = factors[0] * np.array(
        [b.hull.low[i], b.hull.high[i], b.hull.high[i], b.hull.low[i], b.hull.low[i]]
    )
    up = factors[1] * np.array(
        [b.hull.low[j], b.hull.low[j], b.hull.high[j], b.hull.high[j], b.hull.low[j]]
    )
    figures = []
    for (weights, x_edges, y_edges), when in zip(histograms, ("now", "after"), strict=True):
        label = (
            f"Occupancy times variance, {when}, over {axis_label(pair[0])} and"
            f" {axis_label(pair[1])}."
        )
        chart = Chart(f"variance-{when}", label, scales[0], scales[1], 300)
        chart.cells(x_edges, y_edges, np.minimum(weights / largest, 1.0), "")
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
    """Return axis limits: the mission, and the flight within one width on either side."""
    span = float(box[1] - box[0])
    low, high = np.quantile(values, [0.01, 0.99])
    return max(min(float(box[0]), float(low)), float(box[0]) - span), min(
        max(float(box[1]), float(high)), float(box[1]) + span
    )


# What `next-flight` leaves: next-flight.json and the table of test points.

# The answer as sentences.

MAIN_SHARE = 0.9
"""Share of a flight's gain that its most informative points have together."""


def words(
    plan: NextFlight, winner: Winner, missing: Sequence[MissingTerm] | None = None
) -> list[str]:
    """Return the answer as sentences.

    Parameters
    ----------
    plan : NextFlight
        Planned flight.
    winner : Winner
        Coefficient and its share of the p-box.
    missing : sequence of MissingTerm, optional
        Terms that explain residual scatter; None if the flights were not given.
    """
    c, p = plan.coefficient, plan.prospect
    # What the coefficient contributes, and how certain that is.
    low, high = (100.0 * s for s in winner.share)
    sure = "certain" if winner.certain else "not certain"
    out = [
        (
            f"{c} has {low:.0f} to {high:.0f} % of the p-box of {winner.metric}"
            f" ({winner.condition}; its lead is {sure})."
        )
    ]
    out.append(
        f"In the mission's flight states its interval is {p.current.total:.3g} wide on average."
        f" {_percent(plan.extrapolated)} of the mission is outside the data. The polynomial's"
        f" uncertainty alone gives {p.current.parameter:.3g}; the remainder is scatter."
    )
    # What the planned flight brings, against repetition and unlimited data.
    flight = (
        f"The flight of {plan.end_s / 60.0:.1f} min narrows the interval by"
        f" {_percent(p.narrowing)} (its parameter part by "
    )
    flight += (
        f"{_percent(p.parameter_narrowing)}); the same time with the former manoeuvres, by"
        f" {_percent(1.0 - p.repeated.total / p.current.total)}"
        " ("
        f"{_percent(1.0 - p.repeated.parameter / p.current.parameter)}); unlimited data of the same"
        f" kind, by {_percent(p.at_most)}."
    )
    redone_narrowing = 1.0 - p.refitted.total / p.current.total
    # New bounds also reflect a different scatter; say so if it matters.
    if abs(redone_narrowing - p.narrowing) > 0.01:
        flight += (
            f" New bounds will be {_percent(abs(redone_narrowing))}"
            f" {'narrower' if redone_narrowing >= 0.0 else 'wider'}, because residuals scatter"
            " differently at the speeds of these points; this difference adds no information."
        )
    out.append(flight)
    out += _first_points(plan)
    if not plan.worth_flying:
        out.append(_reason_not_to_fly(plan, p))
    out += _form_sentences(plan, missing)
    further_prospects = [
        f"{name} {_percent(o.narrowing)}"
        for name, o in plan.prospects.items()
        if name != c and o.narrowing >= MIN_NARROWING
    ]
    if further_prospects:
        out.append(f"The same flight narrows {', '.join(further_prospects)}.")
    return out


def _first_points(plan: NextFlight) -> list[str]:
    """Return a sentence on how few points bring most of the gain; empty if more than half are
    needed.
    """
    # Most informative points first, until their sum is large enough.
    order = sorted(range(len(plan.plan)), key=lambda k: -plan.plan[k].gain)
    total, gained, few = sum(p.gain for p in plan.plan), 0.0, list[int]()
    for k in order:
        few.append(k)
        gained += plan.plan[k].gain
        if gained >= MAIN_SHARE * total:
            break
    if 2 * len(few) > len(plan.plan):
        return []
    # Points are numbered from 1.
    numbers = ", ".join(str(k + 1) for k in sorted(few))
    subject = f"point {numbers} brings" if len(few) == 1 else f"points {numbers} bring"
    return [
        (
            f"Of the reduction of the mean width {subject} {_percent(gained / total)}: enough for a"
            " short flight."
        )
    ]


def _reason_not_to_fly(plan: NextFlight, p: Prospect) -> str:
    """Return why the flight is not worth flying."""
    if p.at_most >= MIN_NARROWING:
        return (
            f"Not worth flying for {plan.coefficient} alone: {_percent(MIN_NARROWING)} is required;"
            f" more minutes would bring up to {_percent(p.at_most)}."
        )
    text = (
        f"More data cannot narrow this interval: {_percent(1.0 - p.at_most)} of its width is"
        " scatter about the polynomial. "
    )
    # Scatter relative to what sensors and air alone give.
    ratio = plan.scatter / plan.simulated_scatter
    if not math.isfinite(ratio):
        return text + "A longer flight (--minutes) would show whether that is noise or model form."
    if ratio > MAX_SENSOR_SCATTER_RATIO:
        return (
            text + f"It is {ratio:.1f} times the scatter from simulated sensors and air"
            f" ({plan.simulated_scatter:.2g}): a term is missing, or the air was rougher than"
            " simulated (--turbulence)."
        )
    return (
        text + f"It is {ratio:.1f} times the scatter from simulated sensors and air"
        f" ({plan.simulated_scatter:.2g}): only calmer air, better sensors or a lower --cutoff-hz"
        " of the bounds narrow it."
    )


def _form_sentences(plan: NextFlight, missing: Sequence[MissingTerm] | None) -> list[str]:
    """Return what the scatter consists of, if the flights behind the bounds were given."""
    c = plan.coefficient
    if missing is None:
        if plan.worth_flying and not plan.form_is_short:
            return []
        return [
            ("Give the flights of the bounds (--flight FILE...) to test whether a term is missing.")
        ]
    if not missing:
        return [
            (
                f"In these flights no term of second order is missing from the bounds of {c}: the"
                " scatter is noise and air."
            )
        ]
    listed = ", ".join(f"{m.name} ({_percent(m.share)})" for m in missing)
    states = ",".join(dict.fromkeys(s for m in missing for s in m.states))
    text = (
        f"Shares of the scatter in these flights that terms explain which the bounds of {c} lack:"
        f" {listed}. More flights do not reduce it: put the terms into the model (uqharness refine)"
        f" or their states ({states}) into the bounds (uqharness bounds "
    )
    return [text + f"--states {c}=...). In turbulence gusts can resemble such terms."]


def _percent(value: float) -> str:
    """Format a share."""
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
    plan: NextFlight,
    winner: Winner,
    mission: Occupancy,
    missing: Sequence[MissingTerm] | None,
    origin: Mapping[str, Any],
    units: Mapping[str, str],
    *,
    warnings: Sequence[str],
) -> NextFlightPlan:
    """Return the content of next-flight.json.

    Parameters
    ----------
    plan : NextFlight
        Planned flight.
    winner : Winner
        Coefficient and its share of the p-box.
    mission : Occupancy
        Flight states of the mission.
    missing : sequence of MissingTerm, optional
        Terms that explain residual scatter.
    origin : mapping
        Fields aircraft, campaign, bounds and simulated.
    units : mapping of str to str
        Unit of each control.
    warnings : sequence of str
        Warnings.
    """
    # Verdict first, then the states of the mission and the points of the flight.
    return NextFlightPlan(
        format=FORMAT,
        **origin,
        metric=winner.metric,
        coefficient=plan.coefficient,
        share=list(winner.share),
        certain=winner.certain,
        verdict="fly" if plan.worth_flying else "no",
        words=words(plan, winner, missing),
        mission=results.MissionStates(
            source=mission.source,
            flights=mission.flights,
            failed=mission.failed,
            seconds=round(mission.seconds, 3),
            outside_data=plan.extrapolated,
        ),
        where={
            w.state: results.StateQuartiles(
                data=w.data.tolist(), mission=w.mission.tolist(), variance=w.variance.tolist()
            )
            for w in plan.where
        },
        prospects={c: prospect_row(p) for c, p in plan.prospects.items()},
        scatter=results.Scatter(bounds=plan.scatter, simulated=plan.simulated_scatter),
        missing=(
            None
            if missing is None
            else [results.MissingTerm(term=m.name, share=m.share) for m in missing]
        ),
        flight_s=plan.end_s,
        points=[point_row(plan, k, units) for k in range(len(plan.plan))],
        tried=plan.n_points,
        refused=[
            results.RefusedTestPoint(point=r.point.name, reason=r.reason) for r in plan.refused
        ],
        warnings=list(warnings),
    )


def prospect_row(p: Prospect) -> results.ProspectRow:
    """Return widths and narrowings of one coefficient."""
    return results.ProspectRow(
        width=p.current.total,
        width_after=p.planned.total,
        narrowing=p.narrowing,
        narrowing_at_most=p.at_most,
        narrowing_same_manoeuvres=1.0 - p.repeated.total / p.current.total,
        width_redone=p.refitted.total,
        narrowing_redone=1.0 - p.refitted.total / p.current.total,
        parameter_width=p.current.parameter,
        parameter_width_after=p.planned.parameter,
        parameter_narrowing=p.parameter_narrowing,
        parameter_narrowing_same_manoeuvres=1.0 - p.repeated.parameter / p.current.parameter,
    )


def point_row(plan: NextFlight, k: int, units: Mapping[str, str]) -> results.PlannedPoint:
    """Return one test point with its steps."""
    item = plan.plan[k]
    return results.PlannedPoint(
        number=k + 1,
        name=item.point.name,
        start_s=item.start_s,
        end_s=item.end_s,
        speed_mps=item.point.condition.speed_mps,
        bank_deg=item.point.condition.bank_deg,
        steps=[
            results.ControlStep(
                control=s.control,
                size=s.size,
                unit=units[s.control],
                unit_s=s.unit_s,
                pattern=[list(pair) for pair in s.pattern],
                begins_s=s.start_s,
            )
            for s in item.point.steps
        ],
        gain=item.gain,
    )


def points_csv(plan: NextFlight, units: Mapping[str, str]) -> bytes:
    """Return test-points.csv: a row per control that a point moves, one for steady flight."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for k, item in enumerate(plan.plan):
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
            # Signs and lengths of the steps.
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
