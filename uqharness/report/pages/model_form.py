"""The page of model-form bounds and of their validation, from model-form.json, bounds.json, coverage.json, residuals.parquet."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Residuals, term_name
from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile
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
from uqharness.files import finite
from uqharness.identification import (
    CutoffRow,
    MadeBounds,
    Validation,
    failed,
    load_form,
    mean_left_out,
    verdicts,
)
from uqharness.replay import (
    CHANNELS,
    History,
    axis_label,
    have,
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
    Page,
    Say,
    Section,
    Table,
    Words,
    is_wanted,
    provenance,
    remarks,
    shown,
)
from uqharness.report.svg import Chart, scale
from uqharness.result_documents import Bounds, read_document

FORM, DETAILS, COVERAGE, RESIDUALS = (
    "model-form.json",
    "bounds.json",
    "coverage.json",
    "residuals.parquet",
)
NEAR = 1.0
"""A residual is near a slice when each of the other states is within so many standard deviations of the slice's."""
BEYOND = 0.3
"""Share of the data's width that a slice goes on beyond them."""
_MOST_DOTS = 220


def bounds_page(folder: Path, prefix: str = "", only: Collection[str] | None = None) -> Page:
    """The page of the folder that ``uqharness bounds`` wrote. ``only``: titles of the sections that are shown, if not all.

    Raises BadInputError.
    """
    form = load_form(folder / FORM)
    details = read_document(folder / DETAILS, Bounds) if (folder / DETAILS).is_file() else {}
    pieces = read_histories(folder / RESIDUALS)
    if pieces and not have(pieces, needed := [*form.states, *form.coefficients]):
        raise BadInputError(
            f"{folder / RESIDUALS}: must have the columns {', '.join(needed)}; run its command again"
        )
    sections = [
        _width_section(form, details.get("coefficients", {})),
        slice_section(form, pieces, prefix),
    ]
    if is_wanted(title := "The flights within their own bounds", only):
        sections += within_section(pieces, list(form.coefficients), title, "data", prefix)
    sections += [_left_out_section(details), _hull_section(form), *_filter_section(form, details)]
    said = {
        key: [with_shown_names(text, CHANNELS) for text in details.get(key, ())]
        for key in ("warnings", "notes")
    }
    sections += [*remarks(said, key=("notes",)), _provenance(form, details)]
    flights = ", ".join(f.name for f in form.flights)
    asked = (
        f"By how much may the coefficients of {form.aircraft.name} be wrong, as functions of the flight state, judged by "
        f"{flights}? {100 * form.confidence:g} % intervals of the model's error, dimensionless, body axes."
    )
    return Page(
        f"Model-form bounds of {form.aircraft.name}",
        asked,
        _verdict(details, form),
        tuple(sections),
    )


def _verdict(details: Mapping[str, Any], form: ModelForm) -> tuple[Say, ...]:
    rows = details.get("coefficients", {})
    said = []
    parts = {c: b.parts for c, b in form.coefficients.items() if b.parts is not None}
    if parts:
        errors = [f"{c} ±{_limit(p):.2g} ({_beside_noise(p)})" for c, p in parts.items() if p.found]
        none = [f"{c} ±{_limit(p):.2g}" for c, p in parts.items() if not p.found]
        if errors:
            sizes = ", ".join(errors)
            said.append(Say(f"Model error, at most (95 %): {sizes}."))
        if none:
            said.append(Say(f"No model error found above {', '.join(none)}.", "good"))
    else:
        said.append(
            Say("These intervals hold the sensors' noise besides the model's error.", "warn")
        )
    kept = {c: r["left_out_share"] for c, r in rows.items() if r.get("left_out_share") is not None}
    if kept:
        worst = min(kept, key=lambda c: kept[c])
        level: Any = "good" if kept[worst] >= MIN_SHARE_INSIDE else "warn"
        text = f"Bounds made without a manoeuvre hold {100 * kept[worst]:.0f} % of its samples or more ({worst} least)."
        said.append(Say(text, level))
    most, name = max((len(b.states), c) for c, b in form.coefficients.items())
    far = "grow" if form.outside == "grow" else "keep their values at the edge"
    text = f"Bounds of {len(form.coefficients)} coefficients as functions of up to {most} states ({name}); outside the data "
    text += f"they {far}."
    said.append(Say(text))
    return tuple(said)


def _limit(parts: Parts) -> float:
    """What 95 % of a normal model error of the largest likely size do not exceed [-]."""
    return 1.96 * parts.not_above


def _beside_noise(parts: Parts) -> str:
    """Write the size of the model error beside the sensors' noise in a sample."""
    if not parts.noise > 0.0:
        return "no sensor noise"
    return f"{significant(_limit(parts) / (1.96 * parts.noise))} times that of the sensor noise"


def _width_section(form: ModelForm, rows: Mapping[str, Mapping[str, Any]]) -> Section:
    table = []
    for c, b in form.coefficients.items():
        r = rows.get(c, {})
        p = b.parts
        sizes = ("-",) * 4
        if p is not None:
            time = shown(p.transient_time_s, ".2g")
            sizes = (
                shown(p.persistent),
                f"{shown(p.transient)} ({time} s)",
                shown(_limit(p)),
                "yes" if p.found else "no",
            )
        walk = None if not np.isfinite(b.walk_rate) else 100.0 * b.walk_rate
        table.append(
            (
                f"{c} [-]",
                str(len(b.terms)),
                shown(b.n_effective, ".0f"),
                shown(r.get("mean_width")),
                *sizes,
                shown(r.get("noise_std")),
                shown(walk, ".2g"),
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
        "Mean width: of the bounds that a campaign holds through a flight; they know the polynomial and what persists through a "
        "manoeuvre. Persistent, transient, sensor noise: standard deviations; the transient part changes within seconds, "
        "noise is in no bounds. Model error at most: 1.96 times the upper 95 % limit of its rms. Model error found: yes "
        "where a model error is more likely than noise alone by 20 to 1 or more. Rate of variation: of the error within a flight, "
        "in percent of its interval."
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
            Words("One flight: what changes from flight to flight is not estimable.", note=True)
        )
    return Section("How wide the bounds are", (*words, wide))


def slice_section(
    form: ModelForm,
    pieces: Sequence[History],
    prefix: str = "",
    baseline: Mapping[str, CoefficientBounds] | None = None,
) -> Section:
    """Each coefficient's bounds along each of its states, the others at the data's medians; ``baseline``: others beside them."""
    text = (
        "Along each state the others stand at the medians of the data. Solid: "
        f"{100 * form.confidence:g} % bounds, dotted: 68 %; shaded: where the data are."
        + (
            " Dots: flight minus model where the other states are within a standard deviation of the slice."
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
    states = (
        {}
        if not pieces
        else {s: np.concatenate([h.columns[s] for h in pieces]) for s in form.states}
    )
    parts = []
    for c, b in form.coefficients.items():
        values = np.concatenate([h.columns[c] for h in pieces]) if pieces else np.empty(0)
        other = (baseline or {}).get(c)
        figures = tuple(
            _slice(form, c, b, k, states, values, prefix, other) for k in range(len(b.states))
        )
        named = (*legend, *([("third", "bounds of the usual states")] if other else []))
        parts.append(Section(f"Slices of {c}", (Figures(figures, named, True, f"slices-{c}"),)))
    return Section("Slices of the bounds", (Words(text, note=True),), tuple(parts))


def _slice(
    form: ModelForm,
    coefficient: str,
    b: CoefficientBounds,
    k: int,
    states: Mapping[str, FloatArray],
    values: FloatArray,
    prefix: str,
    baseline: CoefficientBounds | None,
) -> Figure:
    state = b.states[k]
    quantity, unit, factor = shown_channel(state)
    low, high = float(b.hull.low[k]), float(b.hull.high[k])
    reach = BEYOND * max(high - low, 1e-9)
    at = np.linspace(low - reach, high + reach, 81)
    lower, upper = b.bounds(slice_states(b, state, at), form.confidence, form.outside)
    narrow = b.bounds(slice_states(b, state, at), 0.68, form.outside)
    others = (
        baseline.bounds(slice_states(baseline, state, at), outside=form.outside)
        if baseline and state in baseline.states
        else ()
    )
    near = np.zeros(0, dtype=int)
    if values.size:
        close = near_slice(b, state, states)
        near = np.flatnonzero(close)[:: max(1, int(close.sum()) // _MOST_DOTS)]
    label = (
        f"Bounds of {coefficient} [-] along {quantity} [{unit}] from {factor * at[0]:.3g} to {factor * at[-1]:.3g}: "
        f"{lower[40]:.2g} to {upper[40]:.2g} at the middle."
    )
    y = scale(f"flight minus model, {coefficient} [-]", [lower, upper, *others, values[near]])
    x = scale(axis_label(state), [factor * at], margin=0.0)
    chart = Chart(f"{prefix}slice-{coefficient}-{state}", label, x, y, height=190)
    ends = factor * np.array([low, high])
    chart.band(ends, np.array([y.low] * 2), np.array([y.high] * 2), "fillrange")
    if values.size:
        chart.dots(factor * states[state][near], values[near], "dot")
    chart.level(0.0, "zero")
    for sides, kind in (((lower, upper), "first"), (narrow, "limit2"), (others, "third")):
        for end in sides:
            chart.line(factor * at, end, kind)
    return Figure(chart.name, chart.svg(), f"{coefficient} along {quantity} [{unit}]")


def slice_states(b: CoefficientBounds, state: str, at: FloatArray) -> dict[str, FloatArray]:
    """States along a slice: ``state`` runs through ``at``, the others stand at the medians of the data."""
    middle = dict(zip(b.states, b.hull.middle[:, 1], strict=True))
    return {s: at if s == state else np.full(len(at), middle[s]) for s in b.states}


def near_slice(
    b: CoefficientBounds, state: str, states: Mapping[str, FloatArray]
) -> NDArray[np.bool_]:
    """(n,) which samples of the states lie near the slice along ``state``."""
    near = np.ones(len(states[state]), dtype=bool)
    for k, other in enumerate(b.states):
        if other != state:
            near &= np.abs(states[other] - b.hull.middle[k, 1]) <= NEAR * b.scale[k]
    return near


def variation_section(variations: Mapping[str, Variation]) -> Section:
    """Density of the level's changes over 0.02 s, the normal fitted to it, and the rates that other steps would give."""
    figures = []
    for c, found in variations.items():
        if len(found.increments) < 2 or not found.sigma > 0.0:
            continue
        density, edges = np.histogram(100.0 * found.increments, 60, density=True)
        mean, sigma = 100.0 * found.mean, 100.0 * found.sigma
        at = np.linspace(edges[0], edges[-1], 200)
        normal = np.exp(-0.5 * ((at - mean) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
        steps = np.append(density, 0.0)
        label = f"Changes of the level of {c} in {STEP_S:g} s: standard deviation {sigma:.2f} % of the interval's width."
        chart = Chart(
            f"variation-{c}",
            label,
            scale(f"change of the level of {c} in {STEP_S:g} s [% of width]", [edges]),
            scale("density [1/%]", [np.zeros(1), steps, normal], least=0.0),
            height=190,
        )
        chart.band(edges, np.zeros(len(edges)), steps, "fill1", steps=True)
        chart.line(at, normal, "second")
        rates = ", ".join(
            f"{100.0 * rate:.2g} over {lag:g} s" for lag, rate in found.lagged.items()
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
    """Flight minus model within the bounds, pieces end to end; none where it was not kept. file: of its figures."""
    if not pieces:
        return ()
    figures = []
    apart = False
    for c in names:
        if not have(pieces, (c, f"{c}_lower", f"{c}_upper")):
            continue
        band = (
            [h.columns[f"{c}_lower"] for h in pieces],
            [h.columns[f"{c}_upper"] for h in pieces],
            "",
        )
        inside = np.concatenate(
            [
                (h.columns[c] >= low) & (h.columns[c] <= high)
                for h, low, high in zip(pieces, *band[:2], strict=True)
            ]
        )
        share = 100.0 * float(np.mean(inside))
        ends = (f"{c}_model_lower", f"{c}_model_upper")
        model = [(end, "second", "") for end in ends] if have(pieces, ends) else []
        apart = apart or bool(model)
        label = f"Flight minus model, {c} [-], along the pieces within its bounds: {share:.1f} % of the samples lie inside."
        figures.append(
            end_to_end(
                pieces,
                f"{prefix}within-{c}",
                [(c, "plain thin", ""), *model],
                band,
                label,
                f"flight minus model, {c} [-]",
                f"{c} [-]: {share:.1f} % of the samples inside",
                outside=True,
            )
        )
    samples = "bounds of its samples, sensor noise and all" if apart else "bounds"
    legend = [
        ("plain thin", "flight minus model"),
        ("fill1", samples),
        ("dotout", "outside these bounds"),
    ]
    legend += [("second", "bounds of the model's persistent error")] if apart else []
    return (Section(title, (Figures(tuple(figures), tuple(legend), file=file),)),)


def _left_out_section(details: Mapping[str, Any]) -> Section:
    rows = details.get("left_out", {})
    if not rows:
        return Section(
            "Leaving one manoeuvre out", (Words("Not checked, or not kept in this folder."),)
        )
    names = list(next(iter(rows.values())))
    cells = tuple((m, *(_share(row.get(c)) for c in names)) for m, row in rows.items())
    caption = "Share of a manoeuvre's samples [-] inside the bounds that the other manoeuvres give."
    return Section(
        "Leaving one manoeuvre out", (Table(caption, ("Manoeuvre left out", *names), cells),)
    )


def _hull_section(form: ModelForm) -> Section:
    rows = {}
    for b in form.coefficients.values():
        for k, state in enumerate(b.states):
            quantity, unit, factor = shown_channel(state)
            values = (b.hull.low[k], *b.hull.middle[k], b.hull.high[k])
            rows[state] = (
                f"{quantity} [{unit}]",
                *(shown(factor * float(v), ".4g") for v in values),
            )
    text = (
        "A state is extrapolated (uq/extrapolated is 1) when one of its values lies beyond these, or its leverage is above the "
        "data's largest: in a corner of the box where no combination of states was flown."
    )
    head = ("State", "Smallest", "25 %", "50 %", "75 %", "Largest")
    table = Table(
        "Values of every state in the data.", head, tuple(rows[state] for state in form.states)
    )
    return Section("Where the data are", (Words(text, note=True), table))


def _filter_section(form: ModelForm, details: Mapping[str, Any]) -> tuple[Section, ...]:
    """Mean width by filter, the one in use first; none where other filters were not tried."""
    if not details.get("cutoffs"):
        return ()
    cut, used = form.filtering, details["coefficients"]
    widths = {c: row.get("mean_width") for c, row in used.items()}
    tried = [
        (r["cutoff_hz"], r.get("airspeed_cutoff_hz"), r["mean_width"]) for r in details["cutoffs"]
    ]
    rows = []
    for low_pass, airspeed, width in ((cut.cutoff_hz, cut.airspeed_cutoff_hz, widths), *tried):
        filters = (
            shown(low_pass, "g"),
            "none" if airspeed is None or np.isinf(airspeed) else f"{airspeed:g}",
        )
        rows.append((*filters, *(shown(width.get(c), ".2g") for c in used)))
    table = Table("Mean width [-].", ("Filter [Hz]", "Airspeed [Hz]", *used), tuple(rows))
    return (Section("Other filters", (table,)),)


def _share(value: float | None) -> Cell:
    return Cell(
        shown(value, ".2f"),
        "" if value is None else "good" if value >= MIN_SHARE_INSIDE else "warn",
    )


def _provenance(form: ModelForm, details: Mapping[str, Any]) -> Section:
    cut = form.filtering
    airspeed = "none" if np.isinf(cut.airspeed_cutoff_hz) else f"{cut.airspeed_cutoff_hz:g} Hz"
    filters = f"{cut.cutoff_hz:g} Hz, airspeed {airspeed}, walk {cut.walk_cutoff_hz:g} Hz, {cut.rate_hz:.0f} samples a second"
    items = [
        ("Command", details.get("command") or "not recorded"),
        ("Version", f"uqharness {details.get('version', 'not recorded')}"),
        (f"Aircraft {form.aircraft.name} (SHA-256)", form.aircraft.sha256),
        *(
            (f"Flight {f.name} (SHA-256)", f"{f.sha256} {f.seconds:.0f} s, {f.samples} samples")
            for f in form.flights
        ),
        ("Filter", filters),
        (
            "Files",
            "model-form.json, model-form.xml (the same as a JSBSim system), residuals.parquet, beside this page",
        ),
    ]
    return provenance(*items)


# What bounds and their validation leave on disk.


def forced_width(noise: float, confidence: float) -> float:
    """Width of the interval that noise of this standard deviation forces: twice the normal quantile times it."""
    return float(2.0 * normal_quantile(0.5 + 0.5 * confidence) * noise)


def bounds_document(found: MadeBounds) -> dict[str, Any]:
    """What ``bounds --json`` prints; figures that are not finite are null."""
    form = found.form
    kept = mean_left_out(found.residuals, found.left_out)
    rows = {}
    for c, b in form.coefficients.items():
        noise = found.noise.get(c, math.nan)
        rows[c] = finite(
            {
                "states": list(b.states),
                "terms": [term_name(t, b.states) for t in b.terms],
                "n": b.n,
                "n_effective": b.n_effective,
                "s": math.sqrt(b.s2),
                "mean_width": found.widths[c],
                "noise_width": forced_width(noise, b.confidence),
                "left_out_share": kept.get(c, math.nan),
                "walk_rate": b.walk_rate,
                "walk_sigma": found.variations[c].sigma,
                "noise_std": noise,
                **({} if b.parts is None else _parts(b.parts)),
            }
        )
    return {
        "aircraft": form.aircraft.name,
        "flights": [f.name for f in form.flights],
        "confidence": form.confidence,
        "outside": form.outside,
        "coefficients": rows,
        "left_out": {m: finite(row) for m, row in found.left_out.items()},
        "cutoffs": [_cutoff(row) for row in found.cutoffs],
        "warnings": list(found.warnings),
        "notes": list(found.notes),
    }


def _parts(parts: Parts) -> dict[str, float]:
    return {
        "persistent": parts.persistent,
        "transient": parts.transient,
        "transient_half_width": parts.transient_half_width,
        "transient_time_s": parts.transient_time_s,
        "flight": parts.flight,
        "noise_scale": parts.noise_scale,
        "not_above": parts.not_above,
        "found": parts.found,
    }


def _cutoff(row: CutoffRow) -> dict[str, Any]:
    cut = {"cutoff_hz": row.cutoffs.all_hz, "airspeed_cutoff_hz": row.cutoffs.airspeed_hz}
    return {**finite(cut), "mean_width": finite(row.width)}


def validation_document(found: Validation) -> dict[str, Any]:
    """What ``validate-bounds --json`` prints."""
    return {
        "coverage": {
            c: {
                "0.95": row.share[0.95],
                "0.68": row.share[0.68],
                "n_effective": row.n_effective,
                "mean_width": row.mean_width,
            }
            for c, row in found.coverage.items()
        },
        "errors": {
            c: {str(k): v for k, v in row.error.items()} for c, row in found.coverage.items()
        },
        "outside_data": {c: row.outside for c, row in found.coverage.items()},
        "manoeuvres": {
            m: {
                c: {str(k): v for k, v in row.manoeuvres[m].items()}
                for c, row in found.coverage.items()
            }
            for m in found.residuals.labels
        },
        "by_speed": _bins(found, "speeds", "V_mps"),
        "by_incidence": _bins(found, "incidences", "alpha_rad"),
        "conformal": {
            c: asdict(row.conformal)
            for c, row in found.coverage.items()
            if row.conformal is not None
        },
        "verdicts": dict(verdicts(found)),
        "flight_variance": {
            c: finite({"std": found.flight_std.get(c, math.nan)})["std"] for c in found.coverage
        },
        "failed": list(failed(found)),
        "warnings": list(found.warnings),
        "notes": list(found.notes),
    }


def _bins(found: Validation, kind: str, state: str) -> list[dict[str, Any]]:
    """Rows of a state's thirds, each with the share inside by coefficient."""
    out: list[dict[str, Any]] = []
    for c, row in found.coverage.items():
        for k, item in enumerate(getattr(row, kind)):
            if k == len(out):
                out.append(
                    {
                        "state": state,
                        "from": item.low,
                        "to": item.high,
                        "samples": item.n,
                        "share": {},
                    }
                )
            out[k]["share"] |= finite({c: item.share})
    return out


def write_residuals(form: ModelForm, residuals: Residuals, flights: str, out: Path) -> None:
    """residuals.parquet in ``out``: by piece the states, flight minus model per coefficient and the bounds of its samples there.

    Where the form keeps noise apart, the samples' bounds hold the sensors' noise; ``<C>_model_lower``, ``_upper`` do not.
    """
    columns = {state: [piece.states[state] for piece in residuals.pieces] for state in form.states}
    for name, bounds in form.coefficients.items():
        columns[name] = residuals.columns(name)
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
