"""The page of model-form bounds and of their validation, from model-form.json, bounds.json, coverage.json, residuals.parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.model_form.model_form import CoefficientBounds, ModelForm
from uqharness.errors import BadInputError
from uqharness.identification.validation import HOLDS_FROM, load_form
from uqharness.replay.channel_units import axis_label, shown_channel
from uqharness.replay.histories import History, have, read_histories
from uqharness.report.history import end_to_end
from uqharness.report.parts import Bullets, Cell, Facts, Figure, Figures, Page, Say, Section, Table, Words, shown
from uqharness.report.svg import Chart, scale
from uqharness.result_documents import Bounds, Coverage, read_document

Array = NDArray[np.float64]
FORM, DETAILS, COVERAGE, RESIDUALS = "model-form.json", "bounds.json", "coverage.json", "residuals.parquet"
NEAR = 1.0
"""A residual is near a slice when each of the other states is within so many standard deviations of the slice's."""
_BEYOND = 0.3  # of the data's width that a slice goes on beyond them
_MOST_DOTS = 220


def bounds_page(folder: Path, prefix: str = "") -> Page:
    """The page of the folder that ``uqharness bounds`` wrote. Raises BadInputError."""
    form = load_form(folder / FORM)
    details = read_document(folder / DETAILS, Bounds) if (folder / DETAILS).is_file() else {}
    pieces = read_histories(folder / RESIDUALS)
    if pieces and not have(pieces, needed := [*form.states, *form.coefficients]):
        raise BadInputError(f"{folder / RESIDUALS}: must have the columns {', '.join(needed)}; run its command again")
    sections = [_width_section(form, details.get("coefficients", {})), slice_section(form, pieces, prefix)]
    within = within_section(pieces, list(form.coefficients), "The flights within their own bounds", prefix)
    sections += [] if within is None else [within]
    sections.append(_left_out_section(details))
    said = (*details.get("warnings", ()), *details.get("notes", ()))
    if said:
        sections.append(Section("Warnings and notes", (Bullets(tuple(said)),)))
    sections.append(_provenance(form, details))
    flights = ", ".join(f.name for f in form.flights)
    asked = (
        f"By how much may the coefficients of {form.aircraft.name} be wrong, as functions of the flight state, judged by "
        f"{flights}? {100 * form.confidence:g} % prediction intervals of flight minus model, dimensionless, body axes."
    )
    return Page(f"Model-form bounds of {form.aircraft.name}", asked, _verdict(details, form), tuple(sections))


def _verdict(details: Mapping[str, Any], form: ModelForm) -> tuple[Say, ...]:
    rows = details.get("coefficients", {})
    said = []
    ratios = {c: r["mean_width"] / r["noise_width"] for c, r in rows.items() if r.get("mean_width") and r.get("noise_width")}
    if ratios:
        model = [f"{c} {v:.1f}" for c, v in ratios.items() if v >= 1.5]
        noise = [f"{c} {v:.1f}" for c, v in ratios.items() if v < 1.5]
        if model:
            said.append(Say(f"Wider than the sensors' noise forces, so the model's own: {', '.join(model)} times."))
        if noise:
            said.append(Say(f"Hardly wider than the sensors' noise forces, so the sensors': {', '.join(noise)} times.", "warn"))
    kept = {c: r["left_out_share"] for c, r in rows.items() if r.get("left_out_share") is not None}
    if kept:
        worst = min(kept, key=lambda c: kept[c])
        level: Any = "good" if kept[worst] >= HOLDS_FROM else "warn"
        said.append(
            Say(
                f"Bounds made without a manoeuvre hold {100 * kept[worst]:.0f} % of its samples or more ({worst} least).",
                level,
            )
        )
    most, name = max((len(b.states), c) for c, b in form.coefficients.items())
    far = "grow" if form.outside == "grow" else "stand at the edge of the data"
    said.append(Say(f"{len(form.coefficients)} coefficients, of at most {most} states ({name}); beyond the data the bounds {far}."))
    return tuple(said)


def _width_section(form: ModelForm, rows: Mapping[str, Mapping[str, Any]]) -> Section:
    table = []
    for c, b in form.coefficients.items():
        r = rows.get(c, {})
        width, forced = r.get("mean_width"), r.get("noise_width")
        ratio = width / forced if width is not None and forced else None
        walk = None if not np.isfinite(b.walk_rate) else 100.0 * b.walk_rate
        table.append(
            (
                f"{c} [1]", str(len(b.terms)), str(b.n), shown(b.n_effective, ".0f"), shown(float(np.sqrt(b.s2))), shown(width),
                shown(forced), shown(ratio, ".2f"), shown(walk, ".2g"),
            )
        )  # fmt: skip
    head = (
        "Coefficient", "Terms", "Samples", "Independent", "Residual's standard deviation", "Mean width", "Width noise forces",
        "Ratio", "Walk [%/√s]",
    )  # fmt: skip
    text = (
        "Independent: what the autocorrelated samples are worth. Width noise forces: what adding the sensors' noise once more "
        "gives; a ratio near 1 says that the interval is the sensors', not the model's."
    )
    return Section("How wide the bounds are", (Words(text, note=True), Table("Bounds by coefficient.", head, tuple(table))))


def slice_section(form: ModelForm, pieces: Sequence[History], prefix: str = "") -> Section:
    """Each coefficient's bounds along each of its states, the others at the data's medians."""
    text = (
        "Along each state the others stand at the medians of the data. Solid: "
        f"{100 * form.confidence:g} % bounds, dotted: 68 %; shaded: where the data are."
        + (" Dots: flight minus model where the other states are within a standard deviation of the slice." if pieces else "")
    )
    legend = [
        ("first", f"{100 * form.confidence:g} % bounds"),
        ("limit2", "68 % bounds"),
        ("fillrange", "range of the data"),
    ]
    if pieces:
        legend.append(("dot", "flight minus model near the slice"))
    states = {} if not pieces else {s: np.concatenate([h.columns[s] for h in pieces]) for s in form.states}
    parts = []
    for c, b in form.coefficients.items():
        values = np.concatenate([h.columns[c] for h in pieces]) if pieces else np.empty(0)
        figures = tuple(_slice(form, c, b, k, states, values, prefix) for k in range(len(b.states)))
        parts.append(Section(f"Slices of {c}", (Figures(figures, tuple(legend), narrow=True),)))
    return Section("Slices of the bounds", (Words(text, note=True),), tuple(parts))


def _slice(
    form: ModelForm, coefficient: str, b: CoefficientBounds, k: int, states: Mapping[str, Array], values: Array, prefix: str
) -> Figure:  # fmt: skip
    state = b.states[k]
    quantity, unit, factor = shown_channel(state)
    low, high = float(b.hull.low[k]), float(b.hull.high[k])
    reach = _BEYOND * max(high - low, 1e-9)
    at = np.linspace(low - reach, high + reach, 81)
    middle = dict(zip(b.states, b.hull.middle[:, 1], strict=True))
    along = {s: at if s == state else np.full(len(at), middle[s]) for s in b.states}
    lower, upper = b.bounds(along, form.confidence, form.outside)
    narrow = b.bounds(along, 0.68, form.outside)
    near = np.zeros(0, dtype=int)
    if values.size:
        close = np.ones(values.size, dtype=bool)
        for j, other in enumerate(b.states):
            if other != state:
                close &= np.abs(states[other] - b.hull.middle[j, 1]) <= NEAR * b.scale[j]
        near = np.flatnonzero(close)[:: max(1, int(close.sum()) // _MOST_DOTS)]
    label = (
        f"Bounds of {coefficient} [1] along {quantity} [{unit}] from {factor * at[0]:.3g} to {factor * at[-1]:.3g}: "
        f"{lower[40]:.2g} to {upper[40]:.2g} at the middle."
    )
    y = scale(f"flight minus model, {coefficient} [1]", [lower, upper, values[near]])
    x = scale(axis_label(state), [factor * at], margin=0.0)
    chart = Chart(f"{prefix}slice-{coefficient}-{state}", label, x, y, height=190)
    ends = factor * np.array([low, high])
    chart.band(ends, np.array([y.low] * 2), np.array([y.high] * 2), "fillrange")
    if values.size:
        chart.dots(factor * states[state][near], values[near], "dot")
    chart.level(0.0, "zero")
    for end in (lower, upper):
        chart.line(factor * at, end, "first")
    for end in narrow:
        chart.line(factor * at, end, "limit2")
    return Figure(chart.name, chart.svg(), f"{coefficient} along {quantity} [{unit}]")


def within_section(pieces: Sequence[History], names: Sequence[str], title: str, prefix: str = "") -> Section | None:
    """Flight minus model within the bounds, pieces end to end; None where it was not kept."""
    if not pieces:
        return None
    figures = []
    for c in names:
        if not have(pieces, (c, f"{c}_lower", f"{c}_upper")):
            continue
        band = ([h.columns[f"{c}_lower"] for h in pieces], [h.columns[f"{c}_upper"] for h in pieces], "")
        inside = np.concatenate(
            [(h.columns[c] >= low) & (h.columns[c] <= high) for h, low, high in zip(pieces, *band[:2], strict=True)]
        )
        share = 100.0 * float(np.mean(inside))
        label = f"Flight minus model, {c} [1], along the pieces within its bounds: {share:.1f} % of the samples lie inside."
        figures.append(
            end_to_end(
                pieces, f"{prefix}within-{c}", [(c, "plain thin", "")], band, label, f"flight minus model, {c} [1]",
                f"{c} [1]: {share:.1f} % of the samples inside", outside=True,
            )
        )  # fmt: skip
    legend = (("plain thin", "flight minus model"), ("fill1", "bounds"), ("dotout", "outside the bounds"))
    return Section(title, (Figures(tuple(figures), legend),))


def _left_out_section(details: Mapping[str, Any]) -> Section:
    rows = details.get("left_out", {})
    if not rows:
        return Section("Leaving one manoeuvre out", (Words("Not checked, or not kept in this folder."),))
    names = list(next(iter(rows.values())))
    cells = tuple((m, *(_share(row.get(c)) for c in names)) for m, row in rows.items())
    caption = "Share of a manoeuvre's samples [1] inside the bounds that the other manoeuvres give."
    return Section("Leaving one manoeuvre out", (Table(caption, ("Manoeuvre left out", *names), cells),))


def _share(value: float | None) -> Cell:
    return Cell(shown(value, ".2f"), "" if value is None else "good" if value >= HOLDS_FROM else "warn")


def _provenance(form: ModelForm, details: Mapping[str, Any]) -> Section:
    cut = form.filtering
    airspeed = "none" if np.isinf(cut.airspeed_cutoff_hz) else f"{cut.airspeed_cutoff_hz:g} Hz"
    filters = f"{cut.cutoff_hz:g} Hz, airspeed {airspeed}, walk {cut.walk_cutoff_hz:g} Hz, {cut.rate_hz:.0f} samples a second"
    items = [
        ("Command", details.get("command") or "not recorded"), ("Version", f"uqharness {details.get('version', 'not recorded')}"),
        (f"Aircraft {form.aircraft.name} (SHA-256)", form.aircraft.sha256),
        *((f"Flight {f.name} (SHA-256)", f"{f.sha256} {f.seconds:.0f} s, {f.samples} samples") for f in form.flights),
        ("Filter", filters),
        ("Files", "model-form.json, model-form.xml (the same as a JSBSim system), residuals.parquet, report.md, beside this page"),
    ]  # fmt: skip
    return Section("Where it came from", (Facts(tuple(items)),))


def coverage_page(folder: Path, prefix: str = "") -> Page:
    """The page of the folder that ``uqharness validate-bounds --out`` wrote. Raises BadInputError."""
    found = read_document(folder / COVERAGE, Coverage)
    pieces = read_histories(folder / RESIDUALS)
    rows = []
    for c, row in found["coverage"].items():
        level = "good" if row["0.95"] >= HOLDS_FROM else "bad"
        errors = found.get("errors", {}).get(c, {})
        first, second = (f"{100 * row[k]:.1f} ± {shown(_percent(errors.get(k)), '.1f')}" for k in ("0.95", "0.68"))
        rows.append((c, Cell(first, level), second, shown(row.get("n_effective"), ".0f"), shown(row.get("mean_width"))))  # type: ignore[arg-type]
    head = (
        "Coefficient",
        "Inside the 95 % bounds [%]",
        "Inside the 68 % bounds [%]",
        "Independent samples",
        "Mean width [1]",
    )
    table = Table("Share of a new flight's samples inside the bounds, ± standard error.", head, tuple(rows))
    sections = [Section("Coverage by coefficient", (table,))]
    within = within_section(pieces, list(found["coverage"]), "The new flight within the bounds", prefix)
    sections += [] if within is None else [within]
    said = (*found.get("warnings", ()), *found.get("notes", ()))
    if said:
        sections.append(Section("Warnings and notes", (Bullets(tuple(said)),)))
    sections.append(Section("Where it came from", (Facts((("Command", found.get("command") or "not recorded"),)),)))
    bad = found.get("failed", [c for c, row in found["coverage"].items() if not row["0.95"] >= HOLDS_FROM])
    if bad:
        shares = ", ".join(f"{c} {100 * found['coverage'][c]['0.95']:.1f} %" for c in bad)
        verdict = Say(
            f"The bounds do not hold: inside the 95 % bounds are only {shares}; at least {100 * HOLDS_FROM:g} % is asked for.",
            "bad",
        )
    else:
        text = f"The bounds hold: every coefficient has at least {100 * HOLDS_FROM:g} % of this flight inside its 95 % bounds."
        verdict = Say(text, "good")
    asked = "Do the bounds hold on a flight that they were not made from?"
    return Page("Validation of model-form bounds", asked, (verdict,), tuple(sections))


def _percent(value: float | None) -> float | None:
    return None if value is None else 100.0 * value
