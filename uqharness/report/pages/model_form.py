"""Build the pages of model-form bounds and of their validation, and write their files.

The page of bounds comes from model-form.json, bounds.json and residuals.parquet. Coefficients are
dimensionless and refer to body axes; a residual is flight minus model.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Residuals
from sysid.arrays import FloatArray
from sysid.model_form import (
    MIN_SHARE_INSIDE,
    STEP_S,
    CoefficientBounds,
    ModelForm,
    Parts,
    Variation,
    measured_bounds,
)
from sysid.units import significant
from uqharness.errors import BadInputError
from uqharness.identification import load_form
from uqharness.replay import (
    CHANNELS,
    History,
    axis_label,
    have_columns,
    read_histories,
    shown_channel,
    with_shown_names,
    write_pieces,
)
from uqharness.report.history import end_to_end
from uqharness.report.parts import (
    Cell,
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
from uqharness.report.svg import Chart, scale
from uqharness.results.base import read_result
from uqharness.results.identification import Bounds, BoundsOfCoefficient, Coverage

FORM, DETAILS, COVERAGE, RESIDUALS = (
    "model-form.json",
    "bounds.json",
    "coverage.json",
    "residuals.parquet",
)
NEAR_SIGMA = 1.0
"""Distance from a slice, in standard deviations of each other state, within which a residual is
drawn.
"""
SLICE_MARGIN = 0.3
"""Share of the width of the data by which a slice extends beyond them."""
_MAX_DOTS = 220


def bounds_page(folder: Path, prefix: str = "", only: Collection[str] | None = None) -> Page:
    """Return the page of a folder that ``uqharness bounds`` wrote.

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
    # Form, details and residuals of the folder; details may be missing.
    form = load_form(folder / FORM)
    path = folder / DETAILS
    details = read_result(path, Bounds) if path.is_file() else Bounds(coefficients={})
    pieces = read_histories(folder / RESIDUALS)
    # Residuals of another command or version lack columns.
    if pieces and not have_columns(pieces, needed := [*form.states, *form.coefficients]):
        raise BadInputError(
            f"{folder / RESIDUALS}: must have the columns {', '.join(needed)}; run its command"
            " again"
        )
    sections = [
        _width_section(form, details.coefficients),
        slice_section(form, pieces, prefix),
    ]
    if is_wanted(title := "The flights within their own bounds", only):
        sections += within_section(pieces, list(form.coefficients), title, "data", prefix)
    sections += [_left_out_section(details), _hull_section(form), *_filter_section(form, details)]
    remark_texts = {
        key: [with_shown_names(text, CHANNELS) for text in texts]
        for key, texts in (("warnings", details.warnings), ("notes", details.notes))
    }
    sections += [*remarks(remark_texts, key=("notes",)), _provenance(form, details)]
    flights = ", ".join(f.name for f in form.flights)
    question = (
        f"How large may the errors of the coefficients of {form.aircraft.name} be, as functions of"
        f" the flight state, from {flights}? {100 * form.confidence:g} % intervals of the model"
        " error, dimensionless, body axes."
    )
    return Page(
        f"Model-form bounds of {form.aircraft.name}",
        question,
        _verdict(details, form),
        tuple(sections),
    )


def _verdict(details: Bounds, form: ModelForm) -> tuple[Sentence, ...]:
    """Return the size of the model error, the left-out coverage, and the states of the bounds."""
    sentences = []
    # Forms that separate noise state the size of the model error.
    parts = {c: b.parts for c, b in form.coefficients.items() if b.parts is not None}
    if parts:
        errors = [f"{c} ±{_limit(p):.2g} ({_beside_noise(p)})" for c, p in parts.items() if p.found]
        none = [f"{c} ±{_limit(p):.2g}" for c, p in parts.items() if not p.found]
        if errors:
            sizes = ", ".join(errors)
            sentences.append(Sentence(f"Model error, at most (95 %): {sizes}."))
        if none:
            sentences.append(Sentence(f"No model error found above {', '.join(none)}.", "good"))
    else:
        sentences.append(Sentence("These intervals include sensor noise.", "warn"))
    coverage = {
        c: r.left_out_share for c, r in details.coefficients.items() if r.left_out_share is not None
    }
    if coverage:
        # Lowest leave-one-manoeuvre-out coverage.
        worst = min(coverage, key=lambda c: coverage[c])
        level: Any = "good" if coverage[worst] >= MIN_SHARE_INSIDE else "warn"
        share = f"{100 * coverage[worst]:.0f} %"
        text = f"Leave-one-manoeuvre-out coverage: {share} ({worst}, the lowest)."
        sentences.append(Sentence(text, level))
    max_states, name = max((len(b.states), c) for c, b in form.coefficients.items())
    outside_text = "grow" if form.outside == "grow" else "keep their values at the edge"
    text = (
        f"Bounds of {len(form.coefficients)} coefficients as functions of up to {max_states} states"
        f" ({name}); outside the data "
    )
    text += f"they {outside_text}."
    sentences.append(Sentence(text))
    return tuple(sentences)


def _limit(parts: Parts) -> float:
    """Return the 95 % limit of a normal model error of the largest plausible size [-]."""
    return 1.96 * parts.not_above


def _beside_noise(parts: Parts) -> str:
    """Return the size of the model error relative to the sensor noise, as text."""
    if not parts.noise > 0.0:
        return "no sensor noise"
    return f"{significant(_limit(parts) / (1.96 * parts.noise))} times that of the sensor noise"


def _width_section(form: ModelForm, rows: Mapping[str, BoundsOfCoefficient]) -> Section:
    """Return the table of widths and parts by coefficient."""
    table = []
    for c, b in form.coefficients.items():
        r = rows.get(c, BoundsOfCoefficient())
        p = b.parts
        sizes = ("-",) * 4
        # Standard deviations of the parts, if the form separates them.
        if p is not None:
            time = format_value(p.transient_time_s, ".2g")
            sizes = (
                format_value(p.persistent),
                f"{format_value(p.transient)} ({time} s)",
                format_value(_limit(p)),
                "yes" if p.found else "no",
            )
        # Rate of variation in percent of the interval.
        walk = None if not np.isfinite(b.walk_rate) else 100.0 * b.walk_rate
        table.append(
            (
                f"{c} [-]",
                str(len(b.terms)),
                format_value(b.n_effective, ".0f"),
                format_value(r.mean_width),
                *sizes,
                format_value(r.noise_std),
                format_value(walk, ".2g"),
            )
        )
    head = (
        "Coefficient",
        "Terms",
        "Independent samples",
        "Mean width",
        "Persistent",
        "Transient (time)",
        "Model error at most ± (95 %)",
        "Model error found",
        "Sensor noise",
        "Rate of variation [%/√s]",
    )
    text = (
        "Mean width: of the bounds of polynomial and persistent error, constant through a flight in"
        " campaigns. Persistent, transient, sensor noise: standard deviations; the transient part"
        " changes within seconds, sensor noise is not in the bounds. Model error at most: 1.96"
        " times the upper 95 % limit of its rms. Model error found: yes if the odds against noise"
        " alone are at least 20 to 1. Rate of variation: of the error within a flight, in percent"
        " of its interval."
    )
    wide = Table("Bounds by coefficient.", head, tuple(table), key=True)
    flights = [
        c
        for c, b in form.coefficients.items()
        if b.parts is not None and not np.isfinite(b.parts.flight)
    ]
    words = [Words(text, note=True)]
    if flights:
        words.append(
            Words("One flight: variation from flight to flight is not estimable.", note=True)
        )
    return Section("Width of the bounds", (*words, wide))


def slice_section(
    form: ModelForm,
    pieces: Sequence[History],
    prefix: str = "",
    baseline: Mapping[str, CoefficientBounds] | None = None,
) -> Section:
    """Return the bounds of each coefficient along each of its states.

    Parameters
    ----------
    form : ModelForm
        Bounds.
    pieces : sequence of History
        Residuals; those near a slice are drawn.
    prefix : str
        Prefix of figure names.
    baseline : mapping of str to CoefficientBounds, optional
        Bounds to draw for comparison.
    """
    text = (
        "Along each state the others are at the medians of the data. Solid: "
        f"{100 * form.confidence:g} % bounds, dotted: 68 %; shaded: where the data are."
        + (
            " Dots: flight minus model where the other states are within a standard deviation of"
            " the slice."
            if pieces
            else ""
        )
    )
    legend = [
        ("first", f"{100 * form.confidence:g} % bounds"),
        ("limit2", "68 % bounds"),
        ("fillrange", "range of the data"),
    ]
    if pieces:
        legend.append(("dot", "flight minus model near the slice"))
    # Residuals are drawn near each slice.
    states = (
        {}
        if not pieces
        else {s: np.concatenate([h.columns[s] for h in pieces]) for s in form.states}
    )
    parts = []
    for c, b in form.coefficients.items():
        # All residuals of the coefficient.
        values = np.concatenate([h.columns[c] for h in pieces]) if pieces else np.empty(0)
        other = (baseline or {}).get(c)
        figures = tuple(
            _slice(form, c, b, k, states, values, prefix=prefix, baseline=other)
            for k in range(len(b.states))
        )
        entries = (*legend, *([("third", "bounds of the usual states")] if other else []))
        parts.append(Section(f"Slices of {c}", (Figures(figures, entries, True, f"slices-{c}"),)))
    return Section("Slices of the bounds", (Words(text, note=True),), tuple(parts))


def _slice(
    form: ModelForm,
    coefficient: str,
    b: CoefficientBounds,
    k: int,
    states: Mapping[str, FloatArray],
    values: FloatArray,
    *,
    prefix: str,
    baseline: CoefficientBounds | None,
) -> Figure:
    """Draw the bounds of a coefficient along one state."""
    state = b.states[k]
    quantity, unit, factor = shown_channel(state)
    low, high = float(b.hull.low[k]), float(b.hull.high[k])
    # Extend the slice beyond the data.
    reach = SLICE_MARGIN * max(high - low, 1e-9)
    at = np.linspace(low - reach, high + reach, 81)
    lower, upper = b.bounds(slice_states(b, state, at), form.confidence, form.outside)
    # 68 % bounds for comparison.
    narrow = b.bounds(slice_states(b, state, at), 0.68, form.outside)
    baseline_ends = (
        baseline.bounds(slice_states(baseline, state, at), outside=form.outside)
        if baseline and state in baseline.states
        else ()
    )
    dot_rows = np.zeros(0, dtype=int)
    if values.size:
        # Thin the dots evenly.
        is_near = near_slice(b, state, states)
        dot_rows = np.flatnonzero(is_near)[:: max(1, int(is_near.sum()) // _MAX_DOTS)]
    label = (
        f"Bounds of {coefficient} [-] along {quantity} [{unit}] from {factor * at[0]:.3g} to"
        f" {factor * at[-1]:.3g}: {lower[40]:.2g} to {upper[40]:.2g} at the middle."
    )
    y = scale(
        f"flight minus model, {coefficient} [-]", [lower, upper, *baseline_ends, values[dot_rows]]
    )
    x = scale(axis_label(state), [factor * at], margin=0.0)
    chart = Chart(f"{prefix}slice-{coefficient}-{state}", label, x, y, height=190)
    ends = factor * np.array([low, high])
    chart.band(ends, np.array([y.low] * 2), np.array([y.high] * 2), "fillrange")
    if values.size:
        chart.dots(factor * states[state][dot_rows], values[dot_rows], "dot")
    chart.level(0.0, "zero")
    # Bounds of both confidences, and the baseline.
    for sides, kind in (((lower, upper), "first"), (narrow, "limit2"), (baseline_ends, "third")):
        for end in sides:
            chart.line(factor * at, end, kind)
    return Figure(chart.name, chart.svg(), f"{coefficient} along {quantity} [{unit}]")


def slice_states(b: CoefficientBounds, state: str, at: FloatArray) -> dict[str, FloatArray]:
    """Return the states of a slice.

    Parameters
    ----------
    b : CoefficientBounds
        Bounds of one coefficient.
    state : str
        State along the slice.
    at : array
        Its values (n,).

    Returns
    -------
    dict of str to array
        States (n,); the others are at the medians of the data.
    """
    middle = dict(zip(b.states, b.hull.middle[:, 1], strict=True))
    return {s: at if s == state else np.full(len(at), middle[s]) for s in b.states}


def near_slice(
    b: CoefficientBounds, state: str, states: Mapping[str, FloatArray]
) -> NDArray[np.bool_]:
    """Return which samples lie near a slice.

    Parameters
    ----------
    b : CoefficientBounds
        Bounds of one coefficient.
    state : str
        State along the slice.
    states : mapping of str to array
        States (n,) of the samples.

    Returns
    -------
    array of bool
        True (n,) within `NEAR_SIGMA` standard deviations in all other states.
    """
    is_near = np.ones(len(states[state]), dtype=bool)
    for k, other in enumerate(b.states):
        if other != state:
            is_near &= np.abs(states[other] - b.hull.middle[k, 1]) <= NEAR_SIGMA * b.scale[k]
    return is_near


def variation_section(variations: Mapping[str, Variation]) -> Section:
    """Draw how the level of each coefficient varies within a flight.

    Parameters
    ----------
    variations : mapping of str to Variation
        Changes of the level within 0.02 s.

    Returns
    -------
    Section
        Density of the changes, the fitted normal, and rates of other lags [%/sqrt(s)].
    """
    figures = []
    for c, variation in variations.items():
        if len(variation.increments) < 2 or not variation.sigma > 0.0:
            continue
        # Density of the changes in percent of the interval.
        density, edges = np.histogram(100.0 * variation.increments, 60, density=True)
        mean, sigma = 100.0 * variation.mean, 100.0 * variation.sigma
        at = np.linspace(edges[0], edges[-1], 200)
        # Fitted normal.
        normal = np.exp(-0.5 * ((at - mean) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
        steps = np.append(density, 0.0)
        label = (
            f"Changes of the level of {c} in {STEP_S:g} s: standard deviation {sigma:.2f} % of the"
            " interval's width."
        )
        chart = Chart(
            f"variation-{c}",
            label,
            scale(f"change of the level of {c} in {STEP_S:g} s [% of width]", [edges]),
            scale("density [1/%]", [np.zeros(1), steps, normal], minimum=0.0),
            height=190,
        )
        chart.band(edges, np.zeros(len(edges)), steps, "fill1", steps=True)
        chart.line(at, normal, "second")
        rates = ", ".join(
            f"{100.0 * rate:.2g} over {lag:g} s" for lag, rate in variation.lagged.items()
        )
        figures.append(
            Figure(
                chart.name, chart.svg(), f"{c}: {sigma:.2f} % in {STEP_S:g} s. Rate [%/√s]: {rates}"
            )
        )
    legend = (("fill1", "flights"), ("second", "normal fitted to them"))
    return Section("Rate of variation", (Figures(tuple(figures), legend, True, "variation"),))


def within_section(
    pieces: Sequence[History], names: Sequence[str], title: str, file: str, prefix: str = ""
) -> tuple[Section, ...]:
    """Draw residuals within their bounds, pieces end to end.

    Parameters
    ----------
    pieces : sequence of History
        Residuals with their bounds; without any the result is empty.
    names : sequence of str
        Coefficients.
    title, file, prefix : str
        Heading, name of the file of figures, and prefix of figure names.
    """
    if not pieces:
        return ()
    figures = []
    has_noise_apart = False
    for c in names:
        if not have_columns(pieces, (c, f"{c}_lower", f"{c}_upper")):
            continue
        band = (
            [h.columns[f"{c}_lower"] for h in pieces],
            [h.columns[f"{c}_upper"] for h in pieces],
            "",
        )
        # Share of the samples within the bounds.
        inside = np.concatenate(
            [
                (h.columns[c] >= low) & (h.columns[c] <= high)
                for h, low, high in zip(pieces, *band[:2], strict=True)
            ]
        )
        share = 100.0 * float(np.mean(inside))
        # Bounds without sensor noise, if the form separates it.
        ends = (f"{c}_model_lower", f"{c}_model_upper")
        model = [(end, "second", "") for end in ends] if have_columns(pieces, ends) else []
        has_noise_apart = has_noise_apart or bool(model)
        label = (
            f"Flight minus model, {c} [-], along the pieces within its bounds: {share:.1f} % of the"
            " samples lie inside."
        )
        figures.append(
            end_to_end(
                pieces,
                f"{prefix}within-{c}",
                [(c, "plain thin", ""), *model],
                band,
                label,
                f"flight minus model, {c} [-]",
                caption=f"{c} [-]: {share:.1f} % of the samples inside",
                outside=True,
            )
        )
    samples = "bounds of its samples, sensor noise and all" if has_noise_apart else "bounds"
    legend = [
        ("plain thin", "flight minus model"),
        ("fill1", samples),
        ("dotout", "outside these bounds"),
    ]
    legend += [("second", "bounds of the model's persistent error")] if has_noise_apart else []
    return (Section(title, (Figures(tuple(figures), tuple(legend), file=file),)),)


def _left_out_section(details: Bounds) -> Section:
    """Return the leave-one-manoeuvre-out coverage."""
    rows = details.left_out
    if not rows:
        return Section(
            "Leaving one manoeuvre out", (Words("Not checked, or not kept in this folder."),)
        )
    names = list(next(iter(rows.values())))
    cells: list[tuple[str | Cell, ...]] = [
        (m, *(_share(row.get(c)) for c in names)) for m, row in rows.items()
    ]
    caption = "Share of a manoeuvre's samples [-] inside the bounds that the other manoeuvres give."
    return Section(
        "Leaving one manoeuvre out",
        (Table(caption, ("Manoeuvre left out", *names), tuple(cells)),),
    )


def _hull_section(form: ModelForm) -> Section:
    """Return the range and quartiles of each state."""
    rows = {}
    for b in form.coefficients.values():
        for k, state in enumerate(b.states):
            quantity, unit, factor = shown_channel(state)
            # Range and quartiles in displayed units.
            values = (b.hull.low[k], *b.hull.middle[k], b.hull.high[k])
            rows[state] = (
                f"{quantity} [{unit}]",
                *(format_value(factor * float(v), ".4g") for v in values),
            )
    text = (
        "A state is extrapolated (uq/extrapolated is 1) if one of its values is outside these"
        " ranges, or its leverage exceeds the largest in the data: a combination of states that the"
        " flights did not reach."
    )
    head = ("State", "Smallest", "25 %", "50 %", "75 %", "Largest")
    table = Table(
        "Values of every state in the data.", head, tuple(rows[state] for state in form.states)
    )
    return Section("Where the data are", (Words(text, note=True), table))


def _filter_section(form: ModelForm, details: Bounds) -> tuple[Section, ...]:
    """Return the mean width by filter, the one in use first; empty if no other was tried."""
    if not details.cutoffs:
        return ()
    filtering, used = form.filtering, details.coefficients
    widths = {c: row.mean_width for c, row in used.items()}
    alternatives = [(r.cutoff_hz, r.airspeed_cutoff_hz, r.mean_width) for r in details.cutoffs]
    rows = []
    for low_pass, airspeed, width in (
        (filtering.cutoff_hz, filtering.airspeed_cutoff_hz, widths),
        *alternatives,
    ):
        filters = (
            format_value(low_pass, "g"),
            "none" if airspeed is None or np.isinf(airspeed) else f"{airspeed:g}",
        )
        rows.append((*filters, *(format_value(width.get(c), ".2g") for c in used)))
    table = Table("Mean width [-].", ("Filter [Hz]", "Airspeed [Hz]", *used), tuple(rows))
    return (Section("Other filters", (table,)),)


def _share(value: float | None) -> Cell:
    """Return a share with its level."""
    return Cell(
        format_value(value, ".2f"),
        "" if value is None else "good" if value >= MIN_SHARE_INSIDE else "warn",
    )


def _provenance(form: ModelForm, details: Bounds) -> Section:
    """Return command, version, hashes and filters."""
    filtering = form.filtering
    airspeed = (
        "none" if np.isinf(filtering.airspeed_cutoff_hz) else f"{filtering.airspeed_cutoff_hz:g} Hz"
    )
    filters = (
        f"{filtering.cutoff_hz:g} Hz, airspeed {airspeed}, walk {filtering.walk_cutoff_hz:g} Hz,"
        f" {filtering.rate_hz:.0f} samples a second"
    )
    items = [
        ("Command", details.command or "not recorded"),
        ("Version", f"uqharness {details.version or 'not recorded'}"),
        (f"Aircraft {form.aircraft.name} (SHA-256)", form.aircraft.sha256),
        *(
            (f"Flight {f.name} (SHA-256)", f"{f.sha256} {f.seconds:.0f} s, {f.samples} samples")
            for f in form.flights
        ),
        ("Filter", filters),
        (
            "Files",
            (
                "model-form.json, model-form.xml (the same as a JSBSim system), residuals.parquet,"
                " next to this page"
            ),
        ),
    ]
    return provenance(*items)


# Files of bounds and of their validation.


def write_residuals(form: ModelForm, residuals: Residuals, flights: str, out: Path) -> None:
    """Write residuals.parquet: states, residuals and bounds of each piece.

    If the form separates noise, the bounds of samples contain the sensor noise; ``<C>_model_lower``
    and ``<C>_model_upper`` do not.

    Parameters
    ----------
    form : ModelForm
        Bounds.
    residuals : Residuals
        Flight minus model.
    flights : str
        Names of the flights.
    out : Path
        Folder.
    """
    columns = {state: [piece.states[state] for piece in residuals.pieces] for state in form.states}
    for name, bounds in form.coefficients.items():
        columns[name] = residuals.columns(name)
        # Bounds of measured samples contain the sensor noise.
        samples = [
            measured_bounds(bounds, name, piece, None, form.outside) for piece in residuals.pieces
        ]
        columns[f"{name}_lower"], columns[f"{name}_upper"] = (
            [low for low, _ in samples],
            [high for _, high in samples],
        )
        if bounds.parts is not None:
            model = [
                bounds.bounds(piece.states, outside=form.outside) for piece in residuals.pieces
            ]
            columns[f"{name}_model_lower"], columns[f"{name}_model_upper"] = (
                [low for low, _ in model],
                [high for _, high in model],
            )
    write_pieces(
        out / RESIDUALS,
        [(flights, piece.label, piece.time_s) for piece in residuals.pieces],
        columns,
    )


# The page of a validation, from coverage.json and residuals.parquet.


def coverage_page(folder: Path, prefix: str = "", only: Collection[str] | None = None) -> Page:
    """Return the page of a folder that ``uqharness validate-bounds --out`` wrote.

    ``only`` lists titles of the sections to build. Raises BadInputError.
    """
    return coverage_page_of(
        read_result(folder / COVERAGE, Coverage), read_histories(folder / RESIDUALS), prefix, only
    )


def coverage_page_of(
    document: Coverage,
    pieces: Sequence[History] = (),
    prefix: str = "",
    only: Collection[str] | None = None,
) -> Page:
    """Return the page of a validation from its document and residuals.

    Parameters
    ----------
    document : Coverage
        Content of coverage.json.
    pieces : sequence of History
        Residuals of the new flight.
    prefix : str
        Prefix of figure names.
    only : collection of str, optional
        Titles of the sections to build; default: all.

    Returns
    -------
    Page
        The verdict says whether the bounds hold, fail, or the flight is too short to tell.
    """
    sections = [_coverage_section(document)]
    if is_wanted(title := "The new flight within the bounds", only):
        sections += within_section(pieces, list(document.coverage), title, "coverage", prefix)
    sections += [
        *_manoeuvre_section(document),
        *_bin_section(document),
        *_conformal_section(document),
        *remarks(document, key=("notes",)),
    ]
    sections.append(provenance(("Command", document.command or "not recorded")))
    verdicts = _verdicts(document)
    # Failure outweighs an inconclusive result.
    failing, unsure = (
        [c for c, v in verdicts.items() if v == kind] for kind in ("fails", "inconclusive")
    )
    if failing:
        shares = ", ".join(f"{c} {100 * document.coverage[c].share_95:.1f} %" for c in failing)
        verdict = Sentence(
            f"The 95 % bounds do not hold: they contain only {shares} of the samples.", "bad"
        )
    elif unsure:
        verdict = Sentence(
            "Inconclusive: the flight is too short to tell whether the bounds of"
            f" {', '.join(unsure)} hold.",
            "warn",
        )
    else:
        verdict = Sentence(
            "The bounds hold: the coverage of every coefficient agrees with 95 %.",
            "good",
        )
    question = "Do the bounds hold on a new flight?"
    return Page("Validation of model-form bounds", question, (verdict,), tuple(sections))


_LEVELS: Mapping[str, Level] = {"holds": "good", "fails": "bad", "inconclusive": "warn"}


def _verdicts(document: Coverage) -> dict[str, str]:
    """Return the verdict of each coefficient; in older documents it follows from the coverage."""
    return {
        c: "holds" if row.share_95 >= MIN_SHARE_INSIDE else "fails"
        for c, row in document.coverage.items()
    } | document.verdicts


def _coverage_section(document: Coverage) -> Section:
    """Return the coverage by coefficient."""
    rows, verdicts = [], _verdicts(document)
    for c, row in document.coverage.items():
        level = _LEVELS[verdicts[c]]
        # Coverage with its standard error, at both confidences.
        errors = document.errors.get(c, {})
        first, second = (
            f"{100 * share:.1f} ± {percent(errors.get(k), '.1f')}"
            for k, share in (("0.95", row.share_95), ("0.68", row.share_68))
        )
        outside_share = percent(document.outside_data.get(c), ".1f")
        size = (
            format_value(row.n_effective, ".0f"),
            format_value(row.mean_width),
            outside_share,
        )
        rows.append((c, Cell(first, level), second, *size))
    head = (
        "Coefficient",
        "Inside the 95 % bounds [%]",
        "Inside the 68 % bounds [%]",
        "Independent samples",
        "Mean width [-]",
        "Outside the data [%]",
    )
    text = (
        "Samples are measured, so the sensor noise of this flight is added to the bounds, but not"
        " to the mean width. The standard error allows for autocorrelation."
    )
    table = Table(
        "Share of a new flight's samples inside the bounds, ± standard error.",
        head,
        tuple(rows),
        key=True,
    )
    return Section("Coverage by coefficient", (Words(text, note=True), table))


def _manoeuvre_section(document: Coverage) -> tuple[Section, ...]:
    """Return the coverage by manoeuvre; empty if it was not recorded."""
    names = tuple(document.coverage)
    rows = tuple(
        (
            m,
            *(
                " / ".join(percent(row.get(c, {}).get(p), ".0f") for p in ("0.95", "0.68"))
                for c in names
            ),
        )
        for m, row in document.manoeuvres.items()
    )
    table = Table(
        "Share of the samples inside the 95 / 68 % bounds [%].", ("Manoeuvre", *names), rows
    )
    return (Section("Coverage by manoeuvre", (table,)),) if rows else ()


def _bin_section(document: Coverage) -> tuple[Section, ...]:
    """Return the coverage by thirds of speed and incidence; empty if it was not recorded."""
    names = tuple(document.coverage)
    rows = []
    for row in (*document.by_speed, *document.by_incidence):
        quantity, unit, factor = shown_channel(row.state)
        # Range of the state in displayed units.
        low, high = (format_value(None if x is None else factor * x) for x in (row.low, row.high))
        ends = f"{quantity} {low} to {high} {unit}"
        rows.append((ends, str(row.samples), *(percent(row.share.get(c), ".0f") for c in names)))
    table = Table(
        "Share of the samples inside the 95 % bounds [%], by thirds of a state.",
        ("Range", "Samples", *names),
        tuple(rows),
    )
    return (Section("Coverage by speed and incidence", (table,)),) if rows else ()


def _conformal_section(document: Coverage) -> tuple[Section, ...]:
    """Return the conformal factors; empty if there are none."""
    rows = tuple(
        (
            c,
            format_value(r.factor, ".2f"),
            percent(r.level, ".0f"),
            format_value(r.manoeuvres, ".0f"),
        )
        for c, r in document.conformal.items()
    )
    if not rows:
        return ()
    text = (
        "Factor by which bounds must be widened to contain 95 % of the samples of a further"
        " manoeuvre, at the given level, for any distribution, if manoeuvres are exchangeable."
    )
    words = [Words(text, note=True)]
    # With one flight the variation between flights cannot be estimated.
    unknown = [c for c, std in document.flight_variance.items() if std is None]
    if unknown:
        words.append(
            Words(
                "Variation of the model error from flight to flight is not estimable for"
                f" {', '.join(unknown)}: one flight.",
                note=True,
            )
        )
    table = Table(
        "Conformal factor by coefficient.",
        ("Coefficient", "Factor [-]", "Level [%]", "Manoeuvres"),
        rows,
    )
    return (Section("Manoeuvre by manoeuvre", (*words, table)),)
