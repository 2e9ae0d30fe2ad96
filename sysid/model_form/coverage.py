"""Do the intervals hold on a flight they have not seen? Coverage by coefficient and manoeuvre, and leaving manoeuvres out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import Residuals
from sysid.estimation import effective_samples, integral_time
from sysid.model_form.fit import Design, FitOptions, fit_bounds
from sysid.model_form.model_form import CoefficientBounds, ModelForm, Outside

FloatArray = NDArray[np.float64]
LEVELS = (0.95, 0.68)
BLOCKS = 10


@dataclass(frozen=True)
class Coverage:
    """Of one coefficient on one flight.

    share, error   level -> share of samples within the bounds of that confidence; its standard error, autocorrelation counted
    n, n_effective samples, and independent ones they are worth (of the residual about the interval's middle)
    mean_width     of the 95 % bounds        outside  share of samples outside the data's hull
    manoeuvres     label -> level -> share
    """

    share: Mapping[float, float]
    error: Mapping[float, float]
    n: int
    n_effective: float
    mean_width: float
    outside: float
    manoeuvres: Mapping[str, Mapping[float, float]]


def coverage(form: ModelForm, residuals: Residuals, levels: Sequence[float] = LEVELS) -> dict[str, Coverage]:
    """Coverage of a form on a flight's residuals, filtered as the form's own were. Raises KeyError for a missing state."""
    return {c: _of(c, b, form.outside, residuals, levels) for c, b in form.coefficients.items()}


def _of(coefficient: str, bounds: CoefficientBounds, outside: Outside, residuals: Residuals, levels: Sequence[float]) -> Coverage:
    y = residuals.columns(coefficient)
    inside: dict[float, list[FloatArray]] = {}
    for level in levels:
        ends = [bounds.bounds(p.states, level, outside) for p in residuals.pieces]
        inside[level] = [((v >= low) & (v <= high)).astype(float) for v, (low, high) in zip(y, ends, strict=True)]
    share = {level: float(np.concatenate(rows).mean()) for level, rows in inside.items()}
    middle = [0.5 * np.add(*bounds.interval(p.states, None, outside)) for p in residuals.pieces]
    ends = [bounds.bounds(p.states, 0.95, outside) for p in residuals.pieces]
    labels = [p.label for p in residuals.pieces]
    return Coverage(
        share=share,
        error={level: share_error(rows) for level, rows in inside.items()},
        n=sum(len(v) for v in y),
        n_effective=effective_samples([v - m for v, m in zip(y, middle, strict=True)]),
        mean_width=float(np.mean(np.concatenate([high - low for low, high in ends]))),
        outside=float(np.mean(np.concatenate([bounds.distance(p.states) > 0.0 for p in residuals.pieces]))),
        manoeuvres={
            label: {
                level: float(np.concatenate([r for r, name in zip(rows, labels, strict=True) if name == label]).mean())
                for level, rows in inside.items()
            }
            for label in residuals.labels
        },
    )


def share_error(inside: Sequence[FloatArray]) -> float:
    """Standard error of a share of samples, given 0 or 1 for each, piece by piece: samples in a row fall outside together."""
    values = np.concatenate(list(inside))
    p = float(values.mean())
    return float(np.sqrt(p * (1.0 - p) * integral_time([v - p for v in inside]) / len(values)))


def told_apart(residuals: Residuals) -> Residuals:
    """The same; pieces that all have one name are given names by the stretch of the flight they lie in."""
    n = len(residuals.pieces)
    if len(residuals.labels) != 1 or n < 2:
        return residuals
    blocks = [block for block in np.array_split(np.arange(n), min(BLOCKS, n)) if len(block)]
    named = []
    for block in blocks:
        first, last = residuals.pieces[block[0]], residuals.pieces[block[-1]]
        name = f"{first.label}, {first.time_s[0]:.0f} to {last.time_s[-1]:.0f} s"
        named += [replace(residuals.pieces[k], label=name) for k in block]
    return replace(residuals, pieces=tuple(named))


def leave_one_out(
    residuals: Residuals, designs: Mapping[str, Design], options: FitOptions, outside: Outside = "grow"
) -> dict[str, dict[str, float]]:
    """Manoeuvre -> coefficient -> share of its samples within the bounds that the other manoeuvres give.

    A share far below the confidence says that the manoeuvre holds something that the others do not. NaN where the rest is too
    short for a fit. Where all pieces have one name, BLOCKS stretches of the flight stand for manoeuvres; empty for a single piece.
    """
    out: dict[str, dict[str, float]] = {}
    residuals = told_apart(residuals)
    if len(residuals.labels) < 2:
        return out
    for label in residuals.labels:
        rest = residuals.only([other for other in residuals.labels if other != label])
        left_out = residuals.only([label])
        try:
            fitted = fit_bounds(rest, designs, options)
        except ValueError:
            out[label] = dict.fromkeys(designs, float("nan"))
            continue
        out[label] = {
            c: _of(c, f.bounds, outside, left_out, [options.confidence]).share[options.confidence] for c, f in fitted.items()
        }
    return out
