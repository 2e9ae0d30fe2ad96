"""What bounds and their validation leave on disk."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sysid.aerodynamics import Residuals, term_name
from sysid.distributions import normal_quantile
from sysid.model_form import ModelForm, Parts, measured_bounds
from uqharness.files import finite
from uqharness.identification import (
    CutoffRow,
    MadeBounds,
    Validation,
    failed,
    mean_left_out,
    verdicts,
)
from uqharness.replay import write_pieces
from uqharness.report.pages.model_form import RESIDUALS


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
