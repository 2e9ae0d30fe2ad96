"""Build the page of a refinement, from refinement.json, model.diff and histories.parquet.

It shows residuals before and after, the effects with their evidence and alternatives, what remains
unexplained and where, intervals, a mission flown with both models, and the changes of the XML.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.distributions import Z95
from uqharness.errors import BadInputError
from uqharness.replay import HISTORIES, History, have_columns, read_histories, shown_channel
from uqharness.report.history import Model, end_to_end, history_section
from uqharness.report.pages.compare import in_shown_unit, ratio_figure
from uqharness.report.parts import (
    Block,
    Bullets,
    Cell,
    Code,
    Facts,
    Figure,
    Figures,
    Level,
    Page,
    Section,
    Sentence,
    Table,
    Words,
    format_value,
    is_wanted,
    percent,
    provenance,
    remarks,
)
from uqharness.report.svg import Chart, Scale, rows_chart, scale
from uqharness.results.base import read_result
from uqharness.results.refinement import (
    Alternative,
    BeforeAfter,
    Effect,
    HoldOutTest,
    Interval,
    Intervals,
    Mission,
    NearbyCandidate,
    Refinement,
    Remaining,
    RemainingPart,
    ResidualLocation,
    ResidualTables,
    SmoothTerm,
)

# Chart of the candidates.

MAX_UNLISTED = 8
"""Candidates in the chart that the page does not list elsewhere."""
LEGEND = (("wide", "candidate alone"), ("thick", "chosen effect alone"))
_MARKS = {
    "chosen": "\N{BLACK CIRCLE}",
    "withdrawn": "\N{MULTIPLICATION X}",
    "alternative": "\N{ALMOST EQUAL TO}",
    "left": "?",
}


@dataclass(frozen=True)
class ListedCandidate:
    """A candidate that the page lists.

    Attributes
    ----------
    part : str
        chosen, withdrawn, alternative or left.
    t : float or None
        Absolute t value in that role; None if unknown.
    """

    part: str
    t: float | None


def listed_candidates(done: Refinement) -> dict[str, ListedCandidate]:
    """Return the candidates that a refinement lists, by coefficient or subsystem and term.

    A candidate with several roles has the first of chosen, withdrawn, alternative, left. The |t|
    of an alternative is the square root of the gain in twice the log likelihood in place of the
    effect.
    """
    # Chosen and withdrawn effects, their alternatives, then candidates that remain.
    rows: list[tuple[str, _Candidate, float | None]] = []
    for part, effects in (("chosen", done.effects), ("withdrawn", done.withdrawn)):
        rows += [(part, e, e.evidence.t) for e in effects]
    for e in (*done.effects, *done.withdrawn):
        for a in e.alternatives:
            gain = a.evidence.twice_log_likelihood
            rows.append(("alternative", a, None if gain is None else math.sqrt(max(gain, 0.0))))
    remaining = done.remaining
    rows += [("left", w, w.t) for w in remaining.where if w.t is not None]
    rows += [("left", c, c.t) for c in (remaining.place.candidates if remaining.place else ())]
    out: dict[str, ListedCandidate] = {}
    for part, candidate, t in rows:
        if candidate.term:
            out.setdefault(_short(candidate), ListedCandidate(part, None if t is None else abs(t)))
    # The best candidate that was rejected.
    refused = done.best_refused
    if refused:
        out.setdefault(_as_scored(refused.effect), ListedCandidate("left", _abs(refused.t)))
    return out


_Candidate = Effect | Alternative | RemainingPart | NearbyCandidate


def _short(e: _Candidate) -> str:
    """Return the short name of a candidate."""
    return f"{e.coefficient or e.subsystem or ''} {e.term}".strip()


def _as_scored(key: str) -> str:
    """Return the key of a refused candidate in the form used by the scores."""
    return key.replace("/", " ", 1)


def candidate_figure(done: Refinement, prefix: str = "") -> Figure | None:
    """Draw |t| of the candidates.

    Parameters
    ----------
    done : Refinement
        Content of refinement.json.
    prefix : str
        Prefix of the figure name.

    Returns
    -------
    Figure or None
        None if the refinement scored no candidate.
    """
    board = done.candidates
    single_t = {r.effect: abs(r.t) for r in board.scores if r.t is not None}
    listed = listed_candidates(done)
    unlisted = [n for n in single_t if n not in listed][:MAX_UNLISTED]
    # Length of a row: the larger of both values.
    sizes = {
        n: max(single_t.get(n, 0.0), (listed[n].t or 0.0) if n in listed else 0.0)
        for n in (*listed, *unlisted)
    }
    if not sizes:
        return None
    order = sorted(sizes, key=lambda n: -sizes[n])
    limit = board.limit
    label = "Candidate effects by |t| [-]: " + ", ".join(f"{n} {sizes[n]:.1f}" for n in order) + "."
    x = Scale("|t| of the score test [-]", 0.0, 1.08 * max(*sizes.values(), limit or 0.0, 1e-9))
    titles = [f"{n} {_MARKS[listed[n].part]}" if n in listed else n for n in order]
    chart = rows_chart(f"{prefix}candidates", label, x, titles)
    # Bar: t alone; disc: t in the role of the candidate.
    for k, n in enumerate(order):
        if n in single_t:
            chart.across(
                0.0,
                single_t[n],
                k,
                "thick" if n in listed and listed[n].part == "chosen" else "wide",
            )
        if n in listed and listed[n].t is not None:
            chart.marker(listed[n].t or 0.0, float(k), "first", "disc")
    if limit is not None:
        chart.upright(limit, "limit", "critical value of the largest |t|")
    caption = (
        "Candidate effects on the training flights, |t| [-]: bars alone, discs with the other"
        " chosen effects (alternatives: in place of the effect). \N{BLACK CIRCLE} chosen,"
        " \N{ALMOST EQUAL TO} alternative, \N{MULTIPLICATION X} withdrawn, ? unexplained."
    )
    return Figure(chart.name, chart.svg(), caption)


# Sentences on tests, remaining residuals and their place.

_DIVERGED = 1e9
"""Change of twice the log likelihood from which replays of one of the models diverge."""


def place_words(place: ResidualLocation) -> list[str]:
    """Return where the strongest remaining residual is, in at most three lines.

    Empty without any.
    """
    if place.channel is None:
        return []
    name, _, _ = shown_channel(place.channel)
    side = "hold-out" if place.flights == "test" else "training"
    # Without an interval the record gives the reason.
    if place.from_s is None:
        first = (
            f"residual of {name}, {side} flights, {place.rms_over_noise:.2f} times its noise:"
            f" {place.reason}"
        )
    else:
        share = place.share_of_excess
        share_text = (
            "" if share is None else f", {100.0 * share:.0f} % of the channel's excess over noise"
        )
        when = f"{place.flight}, {place.from_s:.1f} to {place.to_s:.1f} s ({place.manoeuvre})"
        band = f"{place.from_Hz:.2g} to {place.to_Hz:.2g} Hz"
        first = (
            f"residual of {name}, {side} flight {when}, {band}: {place.rms_over_noise:.2f} times"
            f" its noise{share_text}"
        )
    dependence = place.state
    if dependence is not None:
        state, unit, factor = shown_channel(dependence.state)
        first += (
            f"; its {dependence.of} correlates with {state}, most at {factor * dependence.low:.3g}"
            f" to {factor * dependence.high:.3g} {unit} ({100.0 * dependence.share:.0f} % of"
            " its variance)"
        )
    candidates = ", ".join(
        f"{c.name} {c.leaves:.2f} (|t| {abs(c.t):.1f})" for c in place.candidates
    )
    current = f"rms over noise of {name} on the training flights {place.channel_on_train:.2f}"
    # What the nearest candidates would leave.
    second = f"{current}; with the nearest candidates: {candidates}"
    return [first, second, f"manoeuvres to fly next: {place.would_tell}"]


def smooth_words(smooth: SmoothTerm) -> str:
    """Return one line on the smooth term that is offered for interpretation."""
    channel, _, _ = shown_channel(smooth.channel)
    replaced = f", in place of {' and '.join(smooth.in_place_of)}," if smooth.in_place_of else ""
    return (
        f"smooth term without physics: a {smooth.name} ({smooth.property}){replaced} reduces the"
        f" residual of {channel} on the training flights from {smooth.channel_on_train:.2f} to"
        f" {smooth.leaves:.2f} times its noise; {hold_out_words(smooth.test)}"
    )


def no_region_words(done: Refinement) -> str:
    """Return the sentence for residuals without a distinct region."""
    # No region, but significant effects over all samples together.
    t_values = [e.evidence.t for e in (*done.effects, *done.withdrawn)]
    t_values += [w.t for w in done.remaining.where]
    sizes = [abs(t) for t in t_values if t is not None]
    if sizes:
        return (
            "no region has more samples outside the noise band than expected; over all samples the"
            f" disagreement is significant (|t| up to {max(sizes):.0f})"
        )
    if done.remaining.unexplained:
        return (
            "no region has more samples outside the noise band than expected, but the residuals"
            " exceed their noise: see the remaining residuals"
        )
    return "no residual beyond the noise"


def remaining_words(remaining: Remaining) -> list[str]:
    """Return what remains unexplained as sentences; empty if nothing does."""
    if not remaining.unexplained:
        return [w.words for w in remaining.where if w.words]
    out = []
    # Channels above their noise, coloured residuals, then single findings.
    above = remaining.channels_above_noise
    if above:
        out.append(
            "above their noise: " + ", ".join(f"{c} ({r:.2f} times)" for c, r in above.items())
        )
    if remaining.coloured_channels:
        out.append(f"residuals not white: {', '.join(remaining.coloured_channels)}")
    for w in remaining.where:
        if w.words:
            out.append(w.words)
        elif w.rms_over_noise is not None:
            depends = w.depends_on[0].state if w.depends_on else "none of the tested states"
            out.append(f"{w.coefficient}: {w.rms_over_noise:.2f} times noise, depends on {depends}")
    return out


def hold_out_words(test: HoldOutTest, withdrawn: bool = False) -> str:
    """Return what the hold-out flights show for one effect."""
    change, std = (
        math.nan if v is None else v for v in (test.change_of_twice_log_likelihood, test.std)
    )
    number = f"twice the log likelihood changes by {_with_error(change, std)}"
    # The number itself is meaningless if one model diverges.
    if abs(change) >= _DIVERGED:
        diverging = "without" if change > 0.0 else "with"
        number = f"the model diverges {diverging} it"
    share, share_std = test.share_of_estimate, test.share_std
    # With a standard error above 0.5 the share distinguishes neither none nor all of the estimate.
    if share is not None and share_std is not None and share_std < 0.5:
        number += f", best value {share:.2f} ± {share_std:.2f} times the estimate"
    if test.gap == "shrank":
        return f"confirmed, the hold-out residuals shrank: {number}"
    if test.gap == "grew":
        return f"contradicted, the hold-out residuals grew: {number}"
    if test.gap == "too far":
        return (
            "inconclusive, the hold-out residuals of both models are"
            f" {test.rms_over_that_of_train:.0f} times those of the training flights: check these"
            " logs"
        )
    withdrawal = "; withdrawn, because residuals are unexplained" if withdrawn else ""
    return f"inconclusive on the hold-out flights: {number}{withdrawal}"


def _with_error(value: float, std: float) -> str:
    """Format ``value ± std`` with three significant digits of the standard error."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f"{value:+.4g} ± {std:.3g}"
    # Decimals that show three significant digits of the standard error.
    places = 2 - math.floor(math.log10(std))
    return f"{round(value, places):+.{max(places, 0)}f} ± {round(std, places):.{max(places, 0)}f}"


def location_of_effect(effect: Effect) -> str:
    """Return where an effect is in the model: its property, a number of the XML, or a sensor."""
    sensor = (effect.subsystem or "").startswith("sensor.")
    return effect.property or ("a sensor's" if sensor else "a number in the XML")


# Section of effects.


def headline(e: Effect) -> str:
    """Return name, value and standard error of an effect."""
    return (
        f"{capital(e.name)}: {format_value(e.value, '.5g')} ±"
        f" {format_value(e.std, '.2g')}{_unit(e)}"
    )


def _unit(e: Effect) -> str:
    """Return the unit of an effect with a leading space; empty if it has none."""
    return "" if e.unit in (None, "", "1") else f" {e.unit}"


def capital(text: str) -> str:
    """Return text with a capital first letter."""
    return text[:1].upper() + text[1:]


def effect_section(done: Refinement, diff: str = "", prefix: str = "") -> Section:
    """Return the effects: value, change of the XML, alternatives, evidence, and rejected
    candidates.

    Parameters
    ----------
    done : Refinement
        Content of refinement.json.
    diff : str
        Text of model.diff.
    prefix : str
        Prefix of figure names.
    """
    # Value of each property that switches the effect off.
    off = {s.property: s.off for s in done.switch}
    parts = [
        Section(
            headline(e),
            (
                *_value(e, off, f"{prefix}effect{k}"),
                *_change(e, diff),
                *_alternatives(e),
                *_evidence(e),
            ),
        )
        for k, e in enumerate(done.effects)
    ]
    first: list[Block] = [] if parts else [Words("None.")]
    refused = done.best_refused
    if refused:
        t = format_value(_abs(refused.t), ".1f")
        first.append(Words(f"Best rejected candidate: {refused.effect} (|t| {t}): {refused.why}."))
    figure = candidate_figure(done, prefix)
    if figure:
        first.append(Figures((figure,), LEGEND, file="candidates"))
    return Section("Effects", tuple(first), tuple(parts))


def _value(e: Effect, off: Mapping[str, float], name: str) -> list[Block]:
    """Return the result on the hold-out flights and a chart of the 95 % interval."""
    out: list[Block] = [Words(f"{capital(hold_out_words(e.test, e.withdrawn))}.")] if e.test else []
    # 95 % interval with the value that switches the effect off.
    low, high = e.evidence.interval_95 or (None, None)
    if low is None or high is None or e.value is None:
        return out
    off_value = float(off.get(e.property or "", 0.0))
    ends = [float(v) for v in (low, high, off_value)]
    margin = 0.08 * (max(ends) - min(ends)) or 1.0
    label = (
        f"{capital(e.name)}: 95 % interval {format_value(low, '.5g')} to"
        f" {format_value(high, '.5g')}{_unit(e)}, without it {off_value:g}."
    )
    unit = e.unit or "-"
    axis = f"value [{'-' if unit == '1' else unit}]"
    chart = rows_chart(
        name, label, Scale(axis, min(ends) - margin, max(ends) + margin), [e.term], 24
    )
    chart.upright(off_value, "zero", "without the effect")
    chart.across(low, high, 0.0, "first")
    chart.marker(e.value, 0.0, "first", "disc")
    return [
        *out,
        Figures(
            (
                Figure(
                    chart.name,
                    chart.svg(),
                    "Value with its 95 % interval; the line is the model without the effect.",
                ),
            )
        ),
    ]


def _change(e: Effect, diff: str) -> list[Block]:
    """Return the lines of model.diff that name the effect, with their context."""
    text = lines_naming(diff, [w for w in (e.property, e.name) if w])
    return [Code(f"Change of the XML for {e.name}", text)] if text else []


def lines_naming(diff: str, words: Sequence[str], around: int = 2) -> str:
    """Return changed lines of a difference that contain one of the words.

    Parameters
    ----------
    diff : str
        Unified difference.
    words : sequence of str
        Words to look for.
    around : int
        Lines of context on either side.

    Examples
    --------
    >>> lines_naming("+a\\n b\\n+c", ["c"], around=0)
    '+c'
    """
    # Changed lines that contain a word, with their context.
    lines = [line for line in diff.splitlines() if not line.startswith(("--- ", "+++ ", "@@"))]
    matches = [
        k for k, line in enumerate(lines) if line[:1] in "+-" and any(w in line for w in words)
    ]
    with_context = sorted(
        {k for c in matches for k in range(max(c - around, 0), min(c + around + 1, len(lines)))}
    )
    out: list[str] = []
    # Dots mark omitted lines.
    for last, k in zip([-1, *with_context], with_context, strict=False):
        out += ["..."] * (last >= 0 and k > last + 1) + [lines[k]]
    return "\n".join(out)


def _alternatives(e: Effect) -> list[Block]:
    """Return which alternatives are confounded with the effect and which are excluded."""
    sentences = [
        (
            f"Distinguished from {a.name}."
            if a.separable
            else f"Confounded with {a.name}. To separate them: {a.would_separate}."
        )
        for a in e.alternatives
    ]
    return [Bullets(tuple(sentences))] if sentences else []


def _evidence(e: Effect) -> list[Block]:
    """Return the table of evidence for an effect."""
    evidence = e.evidence
    low, high = evidence.interval_95 or (None, None)
    rows = [
        ("Value", f"{format_value(e.value, '.5g')}{_unit(e)}"),
        ("Standard error", format_value(e.std, ".2g")),
        ("95 % interval", f"{format_value(low, '.5g')} to {format_value(high, '.5g')}"),
        ("|t|", format_value(_abs(evidence.t), ".1f")),
        (
            "Twice the log-likelihood gained",
            format_value(evidence.twice_log_likelihood, ".4g"),
        ),
        (
            "Gained on held-out manoeuvres",
            format_value(evidence.confirmed_on_held_out_manoeuvres, ".4g"),
        ),
        (
            "Held-out estimate differs by",
            (f"{format_value(evidence.held_out_estimate_differs_by_std, '.2f')} standard errors"),
        ),
        ("Property", location_of_effect(e)),
    ]
    reason = Words(f"{capital(e.why).rstrip('.')}.")
    return [reason, Table(f"Evidence for {e.name}.", ("Evidence", "Value"), tuple(rows))]


def _abs(value: float | None) -> float | None:
    """Return the absolute value; None for None."""
    return None if value is None else abs(value)


# Sections of intervals and mission.


def interval_section(gap: ResidualTables, prefix: str = "") -> Section:
    """Return width and coverage of the model-form intervals on the hold-out flights.

    Parameters
    ----------
    gap : ResidualTables
        Part of refinement.json with the intervals before and after.
    prefix : str
        Prefix of figure names.
    """
    title = "Model-form intervals on the hold-out flights"
    intervals = gap.intervals or Intervals(
        reason="this folder was written before they were computed"
    )
    if intervals.reason is not None:
        return Section(title, (Words(f"Not shown: {intervals.reason}."),))
    rows: list[tuple[str | Cell, ...]] = []
    for name, r in intervals.coefficients.items():
        # A wider interval after the refinement deserves attention.
        before, after = r.width_before, r.width_after
        level: Level = "warn" if before is not None and after is not None and after > before else ""
        rows.append(
            (
                name,
                format_value(before),
                Cell(format_value(after), level),
                *(_share(r, when) for when in ("before", "after")),
            )
        )
    head = (
        "Coefficient [-]",
        "Mean width before",
        "After",
        "Hold-out samples inside before [%]",
        "After [%]",
    )
    caption = (
        f"{100.0 * intervals.confidence:g} % intervals of each model, from the training flights."
    )
    text = (
        "Intervals as of uqharness bounds, one set for each model; ± is one standard error that"
        " allows for correlated samples."
    )
    figures = Figures(
        _interval_figures(intervals, prefix),
        (("second", "before"), ("first", "after")),
        file="intervals",
    )
    return Section(
        title, (Words(text, note=True), figures, Table(caption, head, tuple(rows), key=True))
    )


def _interval_figures(intervals: Intervals, prefix: str) -> tuple[Figure, ...]:
    """Draw the ratio of widths, and the coverage with 95 % limits."""
    rows = intervals.coefficients
    # Ratio of widths where both are known.
    widths = {
        c: r.width_after / r.width_before
        for c, r in rows.items()
        if r.width_after and r.width_before
    }
    out = []
    if widths:
        label = (
            "Mean width after over before [-]: "
            + ", ".join(f"{c} {v:.2f}" for c, v in widths.items())
            + "."
        )
        x = Scale("mean width after over before [-]", 0.0, 1.1 * max(1.0, *widths.values()))
        chart = rows_chart(f"{prefix}interval-widths", label, x, tuple(rows), 24)
        chart.upright(1.0, "zero")
        for k, c in enumerate(rows):
            if c in widths:
                chart.marker(widths[c], float(k), "first", "disc")
        out.append(
            Figure(chart.name, chart.svg(), "Mean width of the intervals after, over before [-].")
        )
    # Before and after slightly offset.
    sides = (("before", "second", "ring", -0.15), ("after", "first", "disc", 0.15))
    rows_with_coverage = [
        (
            k + offset,
            kind,
            shape,
            100.0 * getattr(r, f"coverage_{when}"),
            196.0 * (getattr(r, f"coverage_std_{when}") or 0.0),
        )
        for k, r in enumerate(rows.values())
        for when, kind, shape, offset in sides
        if getattr(r, f"coverage_{when}") is not None
    ]
    if rows_with_coverage:
        label = (
            "Hold-out samples inside the intervals [%],"
            f" at least {min(row[3] for row in rows_with_coverage):.1f}."
        )
        lowest = min(share - half for *_, share, half in rows_with_coverage)
        x = Scale("hold-out samples inside [%], with 95 % limits", max(0.0, lowest - 2.0), 101.0)
        chart = rows_chart(f"{prefix}interval-coverage", label, x, tuple(rows), 24)
        chart.upright(100.0 * intervals.confidence, "limit")
        for at, kind, shape, share, half in rows_with_coverage:
            chart.across(share - half, share + half, at, kind)
            chart.marker(share, at, kind, shape)
        out.append(
            Figure(
                chart.name,
                chart.svg(),
                "Share of the hold-out samples inside; the dashed line is the stated confidence.",
            )
        )
    return tuple(out)


def _share(row: Interval, when: str) -> str:
    """Format a coverage with its standard error."""
    share, std = getattr(row, f"coverage_{when}"), getattr(row, f"coverage_std_{when}")
    return "undefined" if share is None else f"{percent(share, '.1f')} ± {percent(std, '.1f')}"


def mission_section(folder: Path, gap: ResidualTables, prefix: str = "") -> Section:
    """Return p-boxes of a mission flown with both models within their own intervals.

    Parameters
    ----------
    folder : Path
        Folder of the refinement.
    gap : ResidualTables
        Part of refinement.json with the folders of the campaigns.
    prefix : str
        Prefix of figure names.
    """
    title = "The mission before and after"
    mission = gap.pbox or Mission(reason="this folder was written before its simulation")
    if mission.reason is not None:
        return Section(title, (Words(f"Not shown: {mission.reason}."),))
    # Imported here because it loads pandas, and not every refinement flies a mission.
    from uqharness.report.campaign import overlay_section, read_campaign_report

    folders = mission.folders
    flown_text = (
        f"{mission.mission}, {mission.corners} corners, {mission.flights_per_corner}"
        f" flights of {mission.duration_s:g} s each, the same air for both models. Failed"
        f" flights: {mission.before.failed} before, {mission.after.failed} after."
    )
    if len(folders) < 2:
        return Section(
            title,
            (Words(f"{flown_text} Without an effect there is only one model."),),
        )
    try:
        pair = [read_campaign_report(folder / name) for name in folders]
    except BadInputError as error:
        return Section(title, (Words(f"{flown_text} The campaigns cannot be read: {error}"),))
    # Same charts as for two campaigns, with a file name of their own.
    overlay = overlay_section(
        pair[0],
        pair[1],
        dict(zip(("before", "after"), folders, strict=True)),
        f"{prefix}mission-",
        title,
    )
    blocks: list[Block] = [Words(flown_text, note=True)]
    for block in overlay.blocks:
        if isinstance(block, Figures):
            blocks.append(replace(block, file="pbox"))
        else:
            blocks.append(replace(block, key=True) if isinstance(block, Table) else block)
    return Section(title, tuple(blocks))


# Section of a smooth term that is offered for interpretation.

RMS = ("rms_before", "rms_after", "noise_rms")
"""Keys of the residual rms before and after, and of the noise."""


def smooth_lines(done: Refinement) -> tuple[Sentence, ...]:
    """Return the sentence of the verdict on a smooth term; empty if none is offered."""
    smooth = done.remaining.smooth
    return (Sentence(f"{capital(smooth_words(smooth))}.", "warn"),) if smooth else ()


def smooth_sections(done: Refinement, prefix: str = "") -> list[Section]:
    """Return a smooth term with its curve, its effect on the residuals, and similar forms."""
    smooth = done.remaining.smooth
    if not smooth:
        return []
    text = (
        "No effect of the catalogue explains the remaining residual."
        f" {capital(smooth_words(smooth))}. The term has"
        f" {smooth.effective_degrees_of_freedom:.1f} effective degrees of freedom. It describes the"
        " residual and has no physical interpretation: look for physics of this shape, or fly the"
        " manoeuvres above. It is not valid outside the range of the chart, where its table is"
        f" constant. The model with it: {smooth.model}."
    )
    figures = Figures((_curve_figure(smooth, prefix),), file="unnamed")
    return [
        Section(
            "A smooth term, not an effect",
            (Words(text), figures, _gap_table(smooth), _shape_table(smooth)),
        )
    ]


def _curve_figure(smooth: SmoothTerm, prefix: str) -> Figure:
    """Draw the smooth term with its band and the density of the data."""
    # Curve of the term with its band and the number of samples.
    at, value, low, high, samples = (
        np.array(getattr(smooth.curve, k), dtype=float)
        for k in ("at", "value", "low", "high", "samples")
    )
    axis_label_text = f"{smooth.coefficient} [-]" + (
        f" over {smooth.times}" if smooth.times else ""
    )
    y = scale(axis_label_text, [value, low, high])
    # Density of the data at the foot of the chart.
    foot = y.low + 0.25 * (y.high - y.low) * samples / max(samples.max(), 1.0)
    label = (
        f"{capital(smooth.name)}: {value.min():.3g} to {value.max():.3g} over {smooth.state}"
        f" {at[0]:.3g} to {at[-1]:.3g}."
    )
    chart = Chart(f"{prefix}unnamed", label, scale(f"{smooth.state} [{smooth.unit}]", [at]), y)
    half = 0.5 * float(at[1] - at[0])
    chart.band(
        at - half,
        np.full_like(at, y.low),
        foot,
        "fillrange",
        "samples of the training flights",
        steps=True,
    )
    chart.level(0.0, "zero")
    chart.band(at, low, high, "fill1", "95 % band")
    chart.line(at, value, "first", "smooth term")
    caption = (
        "A smooth term, not an effect. The best straight line is subtracted if the model has this"
        " linear term. Grey: density of the data."
    )
    return Figure(chart.name, chart.svg(), caption)


def _gap_table(smooth: SmoothTerm) -> Table:
    """Return residuals with and without the term."""
    rows = []
    # Training flights, then hold-out flights.
    for side, flights in (("train", "Training"), ("test", "Hold-out")):
        gap = smooth.gap[side]
        channels = gap.predictions or gap.channels
        for name, gap_rows in (
            (smooth.channel, channels),
            (smooth.coefficient, gap.coefficients),
        ):
            label, values = in_shown_unit(name, gap_rows[name].as_json(), *RMS)
            rows.append((f"{flights}: {label}", *(format_value(v) for v in values)))
    head = ("Flights and quantity", "Without the term", "With it", "Noise")
    return Table(
        "Rms of log minus model without and with the term, in addition to the effects.",
        head,
        tuple(rows),
        True,
    )


def _shape_table(smooth: SmoothTerm) -> Table:
    """Return forms that resemble the term, with the residual that each leaves."""
    name, _, _ = shown_channel(smooth.channel)
    rows = tuple(
        (
            capital(s.form),
            format_value(s.correlation, ".3f"),
            format_value(s.leaves, ".3f"),
        )
        for s in smooth.shapes
    )
    caption = (
        f"Similar forms, and the residual of {name} on the training flights with each"
        f" ({smooth.leaves:.3f} with the term)."
    )
    return Table(
        caption, (f"Form in {smooth.state}", "Correlation [-]", "Rms over noise [-]"), rows
    )


REFINEMENT = "refinement.json"
_DIFF_LINES = 400


def refine_page(folder: Path, prefix: str = "", only: Collection[str] | None = None) -> Page:
    """Return the page of a folder that ``uqharness refine`` wrote.

    Parameters
    ----------
    folder : Path
        Folder of results.
    prefix : str
        Prefix of figure names.
    only : collection of str, optional
        Titles of the sections to build; default: all.

    Raises
    ------
    BadInputError
        If the folder cannot be read.
    """
    done = read_result(folder / REFINEMENT, Refinement)
    histories = read_histories(folder / HISTORIES)
    gap = done.gap.test
    diff = _diff(folder)
    # First what shrank, which effects did it, and where residuals remain.
    sections = [
        gap_section(gap, prefix),
        effect_section(done, diff, prefix),
        *_place_sections(done),
    ]
    sections += [*smooth_sections(done, prefix), _where_section(done)]
    # Coefficients with an effect; all if there is none.
    touched = list(
        dict.fromkeys(e.coefficient for e in done.effects if e.coefficient is not None)
    ) or list(COEFFICIENTS)
    figures = _coefficient_figures(histories, touched, gap, prefix)
    if figures:
        text = (
            "Coefficients measured on the hold-out flights minus the model's, before and after,"
            " segments end to end. The band contains 95 % of the samples if sensor noise is the"
            " only difference."
        )
        legend = (
            ("second thin", "before"),
            ("first thin", "after"),
            ("fill1", "95 % band of the noise"),
        )
        figure_block = Figures(figures, legend, file="coefficients")
        sections.append(
            Section("Coefficients before and after", (Words(text, note=True), figure_block))
        )
    # Hold-out flights beside the replays of both models.
    noise = {c: row.noise_rms for c, row in gap.channels.items()}
    models = [Model("_before", "second", "before"), Model("_after", "first", "after")]
    if is_wanted(title := "Hold-out flights against both models", only):
        sections += history_section(
            histories,
            noise,
            models,
            title,
            f"{prefix}refine-",
            2,
            file=lambda rank, _: "history" if rank == 0 and done.effects else None,
        )
    # Consequences for intervals and mission, then everything for reference.
    sections += [interval_section(gap, prefix), mission_section(folder, gap, prefix)]
    sections += [
        _remaining_section(done),
        _parameter_section(done),
        _model_section(done, diff),
        *remarks({"notes": done.notes}),
    ]
    # Provenance.
    train, test = (", ".join(names) or "flights not recorded" for names in (done.train, done.test))
    facts = (
        ("Command", done.command or "not recorded"),
        ("Chosen on", train),
        ("Shown on", test),
        ("Time", f"{format_value(done.seconds, '.0f')} s"),
        (
            "Files",
            (
                "refinement.json, model.diff, histories.parquet, aircraft/ (the refined model),"
                " next to this page"
            ),
        ),
    )
    sections.append(provenance(*facts))
    question = (
        f"What does the model lack? Effects were chosen on {train} and tested on the hold-out"
        f" flights {test}."
    )
    return Page("Refinement", question, _verdict(done), tuple(sections))


_VERDICTS: Mapping[str, tuple[str, Level]] = {
    "no-missing-effect": ("The residuals show no missing effect", "good"),
    "unexplained": ("A residual remains that no effect of the catalogue explains", "bad"),
}
_SHRANK: tuple[str, Level] = (
    "Effects were found and confirmed on the hold-out flights",
    "good",
)
_INCONCLUSIVE: tuple[str, Level] = (
    "Effects were found; the hold-out flights are inconclusive",
    "warn",
)
_MAX_SYMPTOMS = 2
_UNEXPLAINED_REMAINDER = (
    "Effects were found, but a residual remains that no effect of the catalogue explains"
)


def _verdict(done: Refinement) -> tuple[Sentence, ...]:
    """Return the verdict: effects with their tests, confounded alternatives, the largest
    improvement.
    """
    # An effect is confirmed if the residuals of the hold-out flights fell.
    is_confirmed = [e.test is not None and e.test.gap == "shrank" for e in done.effects]
    text, level = _VERDICTS.get(done.verdict, _SHRANK if any(is_confirmed) else _INCONCLUSIVE)
    if done.verdict == "unexplained" and done.effects:
        text = _UNEXPLAINED_REMAINDER
    sentences = [Sentence(f"{text} ({done.verdict}).", level)]
    for e, confirmed in zip(done.effects, is_confirmed, strict=True):
        t = "undefined" if e.evidence.t is None else format_value(abs(e.evidence.t), ".1f")
        tested = f"; {hold_out_words(e.test, e.withdrawn)}" if e.test else ""
        sentences.append(
            Sentence(
                f"{headline(e)} ({location_of_effect(e)}), |t| {t}{tested}.",
                "good" if confirmed else "warn",
            )
        )
    sentences.append(_remaining_line(done))
    for e in done.withdrawn:
        sentences.append(
            Sentence(f"Withdrawn: {headline(e)}; {hold_out_words(e.test, e.withdrawn)}.", "warn")
        )
    for e in done.effects:
        alike = [a.name.removesuffix(" off") for a in e.alternatives if not a.separable]
        if alike:
            sentences.append(
                Sentence(f"{capital(e.name)} is confounded with: {'; '.join(alike)}.", "warn")
            )
    sentences += smooth_lines(done)
    worst = _largest_fall(done.gap.test)
    if worst:
        sentences.append(Sentence(worst))
    return tuple(sentences)


def _remaining_line(done: Refinement) -> Sentence:
    """Return what remains in one line: the first two of its symptoms, or that the hold-out flights
    alone differ.
    """
    words, place = remaining_words(done.remaining), done.remaining.place
    if not words and place and place.channel and place.flights == "test" and not place.reason:
        ratio = format_value(place.rms_over_noise, ".1f")
        return Sentence(
            "Remaining: nothing on the training flights, but the hold-out flights differ:"
            f" {shown_channel(place.channel)[0]} is at {ratio} times its noise in"
            f" {place.flight} ({place.manoeuvre}); compare mass, centre of gravity, flaps, sensors"
            " and wind of both.",
            "warn",
        )
    if not words:
        return Sentence("Remaining: nothing beyond the sensors' noise.", "good")
    tail = f"; and {len(words) - _MAX_SYMPTOMS} more below" if len(words) > _MAX_SYMPTOMS else ""
    level: Level = "bad" if done.remaining.unexplained else "warn"
    return Sentence(f"Remaining: {'; '.join(words[:_MAX_SYMPTOMS])}{tail}.", level)


def _largest_fall(gap: ResidualTables) -> str:
    """Return a sentence on the channel whose residual fell most, relative to its noise."""
    # Channels with known residuals and noise.
    rows = {
        c: (r.rms_before, r.rms_after, r.noise_rms)
        for c, r in gap.channels.items()
        if r.rms_before and r.rms_after and r.noise_rms
    }
    if not rows:
        return ""
    name = max(rows, key=lambda c: (rows[c][0] - rows[c][1]) / rows[c][2])
    quantity, unit, factor = shown_channel(name)
    before, after, noise = (factor * v for v in rows[name])
    first, last = f"{before:.3g}", f"{after:.3g}"
    change = f"stays at {last}" if first == last else f"changes from {first} to {last}"
    return (
        f"On the hold-out flights the residual of {quantity} {change} {unit} (rms); "
        f"its noise is {noise:.3g} {unit}."
    )


def _diff(folder: Path) -> str:
    """Return the text of model.diff; empty if there is none."""
    path = folder / "model.diff"
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def _place_sections(done: Refinement) -> list[Section]:
    """Return where the strongest remaining residual is.

    Empty without any, or in an older folder.
    """
    place = done.remaining.place
    if not place or place.channel is None:
        return []
    lines = tuple(f"{capital(line)}." for line in place_words(place))
    name, _, _ = shown_channel(place.channel)
    rows = tuple(
        (capital(c.name), format_value(abs(c.t), ".1f"), format_value(c.leaves, ".3f"))
        for c in place.candidates
    )
    current = format_value(place.channel_on_train, ".3f")
    caption = (
        f"Nearest candidates, and the residual of {name} on the training flights with each"
        f" ({current} without)."
    )
    table = Table(caption, ("Candidate", "|t| [-]", "Rms over noise [-]"), rows)
    return [Section("Place of the remaining residual", (Bullets(lines, key=True), table))]


def _where_section(done: Refinement) -> Section:
    """Return the table of disagreements of the training flights."""
    rows = []
    for d in done.disagreement:
        region = "; ".join(_region(s, ends) for s, ends in d.region.items())
        size = (percent(d.share_outside_95, ".0f"), format_value(d.size, ".2g"))
        rows.append((d.coefficient, d.manoeuvre, region, *size))
    if not rows:
        text = no_region_words(done)
        return Section("Where model and flights disagreed", (Words(f"{capital(text)}."),))
    head = ("Coefficient", "Manoeuvre", "Region", "Outside the 95 % band [%]", "Size [-]")
    table = Table(
        "Disagreement of the training flights, the largest first.", head, tuple(rows), key=True
    )
    return Section("Where model and flights disagreed", (table,))


def _region(state: str, ends: Sequence[float | None]) -> str:
    """Return a range of a state as text."""
    quantity, unit, factor = shown_channel(state)
    low, high = (None if v is None else factor * v for v in ends)
    label = f"|{quantity.removeprefix('abs ')}|" if quantity.startswith("abs ") else quantity
    return f"{label} {format_value(low)} to {format_value(high)} {unit}".removesuffix(" -")


def gap_section(gap: ResidualTables, prefix: str = "") -> Section:
    """Return the residuals on the hold-out flights, by channel and coefficient.

    Parameters
    ----------
    gap : ResidualTables
        Residual rms before and after the refinement, and noise, as refinement.json holds them.
    prefix : str
        Prefix of figure names.
    """
    figures, rows = [], []
    for kind, quantities in (("channels", gap.channels), ("coefficients", gap.coefficients)):
        # Ratios to the noise for the figure, rms for the table.
        ratios = {}
        for name, r in quantities.items():
            label, (before, after, noise) = in_shown_unit(name, r.as_json(), *RMS)
            if before is not None and after is not None and noise:
                ratios[shown_channel(name)[0]] = {"before": before / noise, "after": after / noise}
                same = format_value(after) == format_value(before)
                answer = Cell(
                    format_value(after), "" if same else "good" if after < before else "bad"
                )
            else:
                answer = Cell(format_value(after))
            rows.append((label, format_value(before), answer, format_value(noise)))
        series = [("before", "second", "ring"), ("after", "first", "disc")]
        figure = ratio_figure(
            f"{prefix}shrinkage-{kind}", ratios, series, f"{kind} on the hold-out flights"
        )
        figures += [figure] if figure else []
    # Theil's coefficient summarises all channels.
    theil = gap.theil
    if theil:
        rows.append(
            (
                "Theil's U, mean [-]",
                format_value(theil.get("before"), ".4f"),
                Cell(format_value(theil.get("after"), ".4f")),
                "",
            )
        )
    text = (
        "Before: the model with parameters identified again, without the effects. After: with the"
        " effects. Start states and biases are estimated per flight. ✓: smaller than before, ✕:"
        " larger, to three digits."
    )
    table = Table(
        "Residuals on the hold-out flights: rms of log minus model.",
        ("Quantity", "Before", "After", "Noise"),
        tuple(rows),
        True,
    )
    figure_block = Figures(tuple(figures), file="gap")
    blocks: list[Block] = [Words(text, note=True), figure_block, table]
    if gap.predictions:
        blocks += [Words(_TURBULENT), _prediction_table(gap.predictions)]
    return Section("Residuals on the hold-out flights, before and after", tuple(blocks))


_TURBULENT = (
    "The flights were turbulent. The residuals above are those of open-loop replays, so they"
    " include the gust response; effects are tested by errors of predictions one sample ahead."
)


def _prediction_table(predictions: Mapping[str, BeforeAfter]) -> Table:
    """Return the errors of predictions one sample ahead."""
    rows = []
    for name, r in predictions.items():
        label, values = in_shown_unit(name, r.as_json(), *RMS)
        rows.append((label, *(format_value(v) for v in values)))
    head = ("Quantity", "Before", "After", "Expected")
    return Table(
        "Errors of predictions one sample ahead on the hold-out flights, rms.",
        head,
        tuple(rows),
        True,
    )


def _coefficient_figures(
    histories: Sequence[History], names: Sequence[str], gap: ResidualTables, prefix: str
) -> tuple[Figure, ...]:
    """Draw demanded minus modelled coefficients before and after."""
    out = []
    for c in names:
        if not have_columns(histories, (f"{c}_gap_before", f"{c}_gap_after")):
            continue
        noise = gap.coefficients[c].noise_rms if c in gap.coefficients else None
        # 95 % band of the noise, if it is known.
        band = None
        if noise is not None:
            half = [np.full(len(h.time_s), Z95 * noise) for h in histories]
            band = ([-h for h in half], half, "")
        label = (
            f"{c} [-] measured on the hold-out flights minus the model's, before and after,"
            " segments end to end."
        )
        series = [(f"{c}_gap_before", "second thin", ""), (f"{c}_gap_after", "first thin", "")]
        out.append(
            end_to_end(
                histories,
                f"{prefix}demand-{c}",
                series,
                band,
                label,
                f"flight minus model, {c} [-]",
                caption=f"{c} [-]",
            )
        )
    return tuple(out)


def _remaining_section(done: Refinement) -> Section:
    """Return what remains unexplained."""
    lines = tuple(remaining_words(done.remaining))
    if lines:
        return Section("What is left", (Bullets(lines, key=True),))
    unplaced = done.remaining.unexplained
    return Section(
        "Remaining residuals",
        (
            Words(
                "More than noise, at no identifiable place."
                if unplaced
                else "Nothing beyond noise."
            ),
        ),
    )


def _parameter_section(done: Refinement) -> Section:
    """Return the parameters of the refined model."""
    rows = tuple(
        (Cell(n, code=True), format_value(r.value, ".6g"), format_value(r.std, ".2g"))
        for n, r in done.parameters.items()
    )
    head = ("Property", "Value", "Standard error")
    return Section(
        "Parameters, identified with the effects",
        (Table("Parameters of the refined model.", head, rows),),
    )


def _model_section(done: Refinement, diff: str) -> Section:
    """Return the changes of the XML and how to switch off each effect."""
    blocks: list[Block] = [Facts((("Refined model", done.model or "not recorded"),))]
    switch = [f"{s.property} = {s.off:g} restores the model without it" for s in done.switch]
    if switch:
        blocks.append(Bullets(tuple(switch)))
    lines = diff.splitlines()
    if lines:
        more = (
            [f"... {len(lines) - _DIFF_LINES} more lines in model.diff"]
            if len(lines) > _DIFF_LINES
            else []
        )
        blocks.append(Code("Changes of the XML", "\n".join([*lines[:_DIFF_LINES], *more])))
    return Section("Changes of the XML", tuple(blocks))
