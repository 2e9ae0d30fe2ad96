"""What bounds and their validation leave on disk and on the screen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.aerodynamics.polynomial import term_name
from sysid.aerodynamics.residuals import Residuals
from sysid.aerodynamics.terms import COEFFICIENTS
from sysid.model_form.model_form import ModelForm
from sysid.model_form.variation import LAGS_S, STEP_S
from uqharness.identification.model_form import CutoffRow, MadeBounds, mean_left_out
from uqharness.identification.validation import HOLDS_FROM, Validation, failed
from uqharness.replay.histories import write_pieces
from uqharness.report.identify import markdown_table
from uqharness.report.pages.model_form import RESIDUALS

PUBLISHED = {
    "CX": (99.4, 64.0), "CY": (94.7, 63.7), "CZ": (93.9, 63.5), "Cl": (92.8, 72.7), "Cm": (98.4, 89.0), "Cn": (99.4, 94.6),
}  # fmt: skip
"""Table 2.3: coverage of the E-SPAARO's third flight at 95 and 68 %."""
Z95 = 1.959963984540054


_HULL = (
    "A state is extrapolated (`uq/extrapolated` is 1) when one of its values lies beyond these, or its leverage is above the "
    "data's largest: in a corner of the box where no combination of states was flown."
)


def forced_width(noise: float, confidence: float) -> float:
    """Width of the interval that noise of this standard deviation forces: twice the normal quantile times it."""
    from scipy import stats

    return float(2.0 * stats.norm.ppf(0.5 + 0.5 * confidence) * noise)


def bounds_document(found: MadeBounds) -> dict[str, Any]:
    """What ``bounds --json`` prints; figures that are not finite are null."""
    form = found.form
    kept = mean_left_out(found.residuals, found.left_out)
    rows = {}
    for c, b in form.coefficients.items():
        noise = found.noise.get(c, math.nan)
        rows[c] = _clean(
            {
                "states": list(b.states), "terms": [term_name(t, b.states) for t in b.terms],
                "n": b.n, "n_effective": b.n_effective,
                "s": math.sqrt(b.s2), "mean_width": found.widths[c], "noise_width": forced_width(noise, b.confidence),
                "left_out_share": kept.get(c, math.nan), "walk_rate": b.walk_rate, "walk_sigma": found.variations[c].sigma,
            }
        )  # fmt: skip
    return {
        "aircraft": form.aircraft.name,
        "flights": [f.name for f in form.flights],
        "confidence": form.confidence,
        "outside": form.outside,
        "coefficients": rows,
        "left_out": {m: _clean(row) for m, row in found.left_out.items()},
        "cutoffs": [_cutoff(row) for row in found.cutoffs],
        "warnings": list(found.warnings),
        "notes": list(found.notes),
    }


def _cutoff(row: CutoffRow) -> dict[str, Any]:
    cut = {"cutoff_hz": row.cutoffs.all_hz, "airspeed_cutoff_hz": row.cutoffs.airspeed_hz}
    return {**_clean(cut), "mean_width": _clean(row.width), "left_out_share": _clean(row.left_out)}


def _clean(row: Mapping[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}


def _figure(value: float | None, form: str) -> str:
    return "–" if value is None or not math.isfinite(value) else format(value, form)


def bounds_rows(document: Mapping[str, Any]) -> list[dict[str, str]]:
    """One row a coefficient."""
    out = []
    for c, row in document["coefficients"].items():
        width, forced = row["mean_width"], row["noise_width"]
        out.append(
            {
                "coefficient": c, "terms": str(len(row["terms"])), "n": str(row["n"]),
                "independent": _figure(row["n_effective"], ".0f"), "s": _figure(row["s"], ".3g"),
                "mean width": _figure(width, ".3g"), "noise forces": _figure(forced, ".3g"),
                "ratio": _figure(width / forced if forced else None, ".2f"),
                "left out": _figure(row["left_out_share"], ".3f"),
                "walk [%/√s]": _figure(None if row["walk_rate"] is None else 100.0 * row["walk_rate"], ".2g"),
            }
        )  # fmt: skip
    return out


def bounds_report(found: MadeBounds, document: Mapping[str, Any], figures: Sequence[str], command: str) -> str:
    """report.md of a form."""
    form = found.form
    cut = form.filtering
    airspeed = "no low-pass" if math.isinf(cut.airspeed_cutoff_hz) else f"{cut.airspeed_cutoff_hz:g} Hz"
    lines = [
        f"# Model-form bounds of {form.aircraft.name} from {', '.join(f.name for f in form.flights)}",
        "",
        f"    {command}",
        "",
        f"{100 * form.confidence:g} % prediction intervals of flight minus model. Filter {cut.cutoff_hz:g} Hz, airspeed "
        f"{airspeed}, walk {cut.walk_cutoff_hz:g} Hz, {cut.rate_hz:.0f} samples a second. Outside the data the bounds "
        + ("grow." if form.outside == "grow" else "stand at the data's edge."),
        "",
        markdown_table(bounds_rows(document)),
        (
            "*independent*: samples that n autocorrelated ones are worth. *noise forces*: width that sensor noise alone gives, by "
            "adding it once more; a ratio near 1 says that the interval is the sensors', not the model's. *left out*: share of "
            "each manoeuvre's samples inside the bounds that the other manoeuvres give, over all of them."
        ),
        "",
    ]
    if document["left_out"]:
        rows = [
            {"manoeuvre left out": m, **{c: _figure(v, ".2f") for c, v in row.items()}} for m, row in document["left_out"].items()
        ]
        lines += ["## Leaving one manoeuvre out", "", markdown_table(rows)]
    lines += ["## Where the data are", "", markdown_table(hull_rows(form)), _HULL, ""]
    if found.cutoffs:
        lines += [
            "## Other filters",
            "",
            markdown_table(cutoff_rows(found)),
            "Mean width (share inside when left out).",
            "",
        ]
    rows = [
        {
            "coefficient": c, f"sigma [%] over {STEP_S:g} s": _figure(100 * v.sigma, ".3f"),
            **{f"%/√s over {lag:g} s": _figure(100 * v.lagged[lag], ".2g") for lag in LAGS_S},
        }
        for c, v in found.variations.items()
    ]  # fmt: skip
    lines += [
        "## Rate of variation", "", markdown_table(rows),
        ("Change of level (share of the interval's width) of the low-passed residual. The first column is in use; the others "
        "show how a rate depends on the step it is taken over, because a low-passed signal is no random walk."), "",
    ]  # fmt: skip
    lines += [f"![{name}](figures/{name}.svg)\n" for name in figures]
    lines += [f"- warning: {w}" for w in found.warnings] + [f"- {n}" for n in found.notes]
    return "\n".join(lines) + "\n"


def hull_rows(form: ModelForm) -> list[dict[str, str]]:
    """Smallest, quartiles and largest value of every state in the data, angles in degrees."""
    out: dict[str, dict[str, str]] = {}
    for bounds in form.coefficients.values():
        for k, state in enumerate(bounds.states):
            degrees = 57.29577951308232 if state.endswith(("_rad", "_radps")) else 1.0
            values = [bounds.hull.low[k], *bounds.hull.middle[k], bounds.hull.high[k]]
            unit = state.rsplit("_", 1)[1].replace("radps", "deg/s").replace("rad", "deg").replace("mps", "m/s")
            row = {"state": state.rsplit("_", 1)[0], "unit": unit}
            row |= {n: f"{degrees * v:.4g}" for n, v in zip(("low", "25 %", "50 %", "75 %", "high"), values, strict=True)}
            out[state] = row
    return [out[s] for s in form.states]


def cutoff_rows(found: MadeBounds) -> list[dict[str, str]]:
    """Mean width and left-out share by filter, the one in use first."""
    cut = found.form.filtering
    here = {"cutoff_hz": cut.cutoff_hz, "airspeed_cutoff_hz": cut.airspeed_cutoff_hz}
    kept = mean_left_out(found.residuals, found.left_out)
    rows: list[tuple[dict[str, float], Mapping[str, float], Mapping[str, float]]] = [(here, found.widths, kept)]
    for row in found.cutoffs:
        at = {"cutoff_hz": row.cutoffs.all_hz, "airspeed_cutoff_hz": row.cutoffs.airspeed_hz}
        rows.append((at, row.width, row.left_out))
    return [
        {
            "filter [Hz]": f"{at['cutoff_hz']:g}",
            "airspeed [Hz]": "none" if math.isinf(at["airspeed_cutoff_hz"]) else f"{at['airspeed_cutoff_hz']:g}",
            **{c: f"{_figure(width[c], '.2g')} ({_figure(share.get(c), '.2f')})" for c in width},
        }
        for at, width, share in rows
    ]


def validation_document(found: Validation) -> dict[str, Any]:
    """What ``validate-bounds --json`` prints."""
    return {
        "coverage": {
            c: {
                "0.95": row.share[0.95], "0.68": row.share[0.68], "n_effective": row.n_effective, "mean_width": row.mean_width,
            }
            for c, row in found.coverage.items()
        },
        "errors": {c: {str(k): v for k, v in row.error.items()} for c, row in found.coverage.items()},
        "outside_data": {c: row.outside for c, row in found.coverage.items()},
        "manoeuvres": {
            m: {c: {str(k): v for k, v in row.manoeuvres[m].items()} for c, row in found.coverage.items()}
            for m in found.residuals.labels
        },
        "failed": list(failed(found)),
        "warnings": list(found.warnings),
        "notes": list(found.notes),
    }  # fmt: skip


def validation_rows(found: Validation) -> list[dict[str, str]]:
    """One row a coefficient, Table 2.3 beside it."""
    return [
        {
            "coefficient": c,
            "95 % bounds": f"{100 * row.share[0.95]:.1f} ± {100 * row.error[0.95]:.1f}",
            "68 % bounds": f"{100 * row.share[0.68]:.1f} ± {100 * row.error[0.68]:.1f}",
            "n": str(row.n),
            "independent": f"{row.n_effective:.0f}",
            "mean width": f"{row.mean_width:.3g}",
            "outside data [%]": f"{100 * row.outside:.1f}",
            "Table 2.3": f"{PUBLISHED[c][0]:g} / {PUBLISHED[c][1]:g}",
        }
        for c, row in ((c, found.coverage[c]) for c in COEFFICIENTS if c in found.coverage)
    ]


def validation_report(found: Validation, title: str, command: str, figures: Sequence[str]) -> str:
    """report.md of a validation."""
    rows = [
        {"manoeuvre": m, **{c: f"{r.manoeuvres[m][0.95]:.2f} / {r.manoeuvres[m][0.68]:.2f}" for c, r in found.coverage.items()}}
        for m in found.residuals.labels
    ]  # fmt: skip
    lines = [
        f"# {title}", "", f"    {command}", "", markdown_table(validation_rows(found)),
        ("Percent of samples inside, ± standard error (autocorrelation counted). Table 2.3 is another aeroplane's flight: for "
        "orientation, not for comparison."), "",
        "## By manoeuvre: share inside the 95 / 68 % bounds", "", markdown_table(rows), verdict(found), "",
    ]  # fmt: skip
    lines += [f"![{name}](figures/{name}.svg)\n" for name in figures]
    lines += [f"- warning: {w}" for w in found.warnings] + [f"- {n}" for n in found.notes]
    return "\n".join(lines) + "\n"


def verdict(found: Validation) -> str:
    """One sentence."""
    bad = failed(found)
    if not bad:
        return f"The bounds hold: every coefficient has at least {100 * HOLDS_FROM:g} % of this flight inside its 95 % bounds."
    shares = ", ".join(f"{c} {100 * found.coverage[c].share[0.95]:.1f} %" for c in bad)
    return f"The bounds do not hold: inside the 95 % bounds are only {shares}; at least {100 * HOLDS_FROM:g} % is asked for."


def write_residuals(form: ModelForm, residuals: Residuals, flights: str, out: Path) -> None:
    """residuals.parquet in ``out``: by piece the states, flight minus model per coefficient and its bounds there."""
    columns = {state: [piece.states[state] for piece in residuals.pieces] for state in form.states}
    for name in form.coefficients:
        bounds = [form.bounds(piece.states)[name] for piece in residuals.pieces]
        columns[name] = residuals.columns(name)
        columns[f"{name}_lower"], columns[f"{name}_upper"] = [low for low, _ in bounds], [high for _, high in bounds]
    write_pieces(out / RESIDUALS, [(flights, piece.label, piece.time_s) for piece in residuals.pieces], columns)
