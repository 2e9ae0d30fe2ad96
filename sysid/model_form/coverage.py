"""Do the intervals hold on a flight they have not seen?

Coverage by coefficient and manoeuvre, and leaving manoeuvres out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sysid.aerodynamics import COEFFICIENTS, ResidualPiece, Residuals, noise_variance
from sysid.arrays import FloatArray
from sysid.estimation import effective_samples, integral_time
from sysid.model_form.components import split_long_pieces
from sysid.model_form.fit import (
    Design,
    FitOptions,
    FittedBounds,
    fit_bounds,
    remove_state_noise,
    with_components,
)
from sysid.model_form.model_form import CoefficientBounds, ModelForm, Outside

# What the coverage of a new flight says of bounds: by speed and incidence, manoeuvre by
# manoeuvre, and whether they hold.

Verdict = Literal["holds", "fails", "inconclusive"]
MIN_SHARE_INSIDE = 0.85
"""Share of a new flight that 95 % bounds must contain, whatever its standard error: single flights
scatter by 0.02 to 0.04.
"""
MAX_SHARE_ERROR = 0.02
"""Standard error above which a share says neither that bounds hold nor that they do not."""
_ONE_SIDED = 1.6448536269514722  # standard normal quantile of 95 %
_BINS = 3


@dataclass(frozen=True)
class Bin:
    """Share of the samples inside whose state lies from ``low`` to ``high``, unit of the state; n
    of them.
    """

    low: float
    high: float
    share: float
    n: int


@dataclass(frozen=True)
class Conformal:
    """Bounds ``factor`` times as wide hold 95 % of the samples of a further manoeuvre with a
    probability of ``level`` or more.

    Distribution-free, if manoeuvres are alike: the factor is an order statistic of those that the
    manoeuvres need (Vovk et al., "Algorithmic Learning in a Random World" (2005)); with fewer than
    19 the largest, at the level m/(m + 1)."""

    factor: float
    level: float
    manoeuvres: int


def verdict(share: float, error: float, level: float) -> Verdict:
    """Whether bounds of confidence ``level`` hold, from the share of a new flight inside and its
    standard error.

    ``fails`` where the share's upper 95 % limit lies below the level, or the share below
    HOLDS_FROM; ``inconclusive`` where the standard error exceeds SURE_TO or is not known."""
    if not share >= MIN_SHARE_INSIDE or share + _ONE_SIDED * error < level:
        return "fails"
    return "holds" if error <= MAX_SHARE_ERROR else "inconclusive"


def bins(residuals: Residuals, state: str, inside: Sequence[FloatArray]) -> tuple[Bin, ...]:
    """Thirds of the samples by a state, and the share inside in each; ``inside`` 0 or 1 for each
    sample, piece by piece.
    """
    values, is_inside = residuals.states.get(state), np.concatenate(list(inside))
    if values is None:
        return ()
    edges = np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1))
    out = []
    for k in range(_BINS):
        of_bin = (values >= edges[k]) & ((values < edges[k + 1]) | (k == _BINS - 1))
        share = float(is_inside[of_bin].mean()) if of_bin.any() else float("nan")
        out.append(Bin(float(edges[k]), float(edges[k + 1]), share, int(of_bin.sum())))
    return tuple(out)


def conformal(
    pieces: Sequence[ResidualPiece], stretch: Sequence[FloatArray], level: float = 0.95
) -> Conformal:
    """Conformal factor over manoeuvres. stretch: factor (n,) that each sample of a piece needs."""
    labels = [(p.flight, p.label) for p in pieces]
    needed = np.sort(
        [
            np.quantile(
                np.concatenate(
                    [s for s, other in zip(stretch, labels, strict=True) if other == label]
                ),
                level,
            )
            for label in dict.fromkeys(labels)
        ]
    )
    m = len(needed)
    rank = int(np.ceil((m + 1) * level))
    if rank > m:
        return Conformal(float(needed[-1]), m / (m + 1.0), m)
    return Conformal(float(needed[rank - 1]), rank / (m + 1.0), m)


LEVELS = (0.95, 0.68)
BLOCKS = 10


@dataclass(frozen=True)
class Coverage:
    """Of one coefficient on one flight.

    share, error   level -> share of samples within the bounds of that confidence; its standard
    error, autocorrelation counted n, n_effective samples, and independent ones they are worth (of
    the residual about the interval's middle)
    mean_width     of the 95 % bounds, without the sensors' noise        outside  share of samples
    outside the data
    manoeuvres     label -> level -> share speeds, incidences  shares at the 95 % level in thirds of
    the flight's airspeed and angle of attack
    conformal      factor by which the 95 % bounds must be widened, by what manoeuvres show
    """

    share: Mapping[float, float]
    error: Mapping[float, float]
    n: int
    n_effective: float
    mean_width: float
    outside: float
    manoeuvres: Mapping[str, Mapping[float, float]]
    speeds: tuple[Bin, ...] = ()
    incidences: tuple[Bin, ...] = ()
    conformal: Conformal | None = None


def coverage(
    form: ModelForm, residuals: Residuals, levels: Sequence[float] = LEVELS
) -> dict[str, Coverage]:
    """Coverage of a form on a flight's residuals, filtered as the form's own were. Raises KeyError
    for a missing state.

    Samples are measured: where the form keeps noise apart, that of the flight's own sensors is
    added to the interval."""
    if any(b.parts is not None for b in form.coefficients.values()):
        residuals = remove_state_noise(residuals)
    return {
        c: _coverage(c, b, form.outside, residuals, levels) for c, b in form.coefficients.items()
    }


def _coverage(
    coefficient: str,
    bounds: CoefficientBounds,
    outside: Outside,
    residuals: Residuals,
    levels: Sequence[float],
) -> Coverage:
    y = residuals.columns(coefficient)
    inside: dict[float, list[FloatArray]] = {}
    for level in levels:
        ends = [measured_bounds(bounds, coefficient, p, level, outside) for p in residuals.pieces]
        inside[level] = [
            ((v >= low) & (v <= high)).astype(float) for v, (low, high) in zip(y, ends, strict=True)
        ]
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
        outside=float(
            np.mean(np.concatenate([bounds.distance(p.states) > 0.0 for p in residuals.pieces]))
        ),
        manoeuvres={
            label: {
                level: float(
                    np.concatenate(
                        [r for r, name in zip(rows, labels, strict=True) if name == label]
                    ).mean()
                )
                for level, rows in inside.items()
            }
            for label in residuals.labels
        },
        speeds=bins(residuals, "V_mps", inside[0.95]) if 0.95 in inside else (),
        incidences=bins(residuals, "alpha_rad", inside[0.95]) if 0.95 in inside else (),
        conformal=conformal(
            with_distinct_labels(residuals).pieces,
            [_stretch(bounds, coefficient, p, outside) for p in residuals.pieces],
        ),
    )


def _stretch(
    bounds: CoefficientBounds, coefficient: str, piece: ResidualPiece, outside: Outside
) -> FloatArray:
    """(n,) by what factor the 95 % bounds of measured samples must be widened about their middle to
    hold each sample and zero.
    """
    middle, half = bounds.sample_middle(piece.states, _noise(coefficient, piece), 0.95, outside)
    y = piece.delta[:, COEFFICIENTS.index(coefficient)]
    return np.maximum(np.where(y >= 0.0, y - middle, middle - y), 0.0) / np.maximum(
        half, np.finfo(float).tiny
    )


def measured_bounds(
    bounds: CoefficientBounds,
    coefficient: str,
    piece: ResidualPiece,
    confidence: float | None,
    outside: Outside,
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper end (n,) of the interval for a piece's measured samples, its sensors' noise
    and all.
    """
    return bounds.sample_interval(piece.states, _noise(coefficient, piece), confidence, outside)


def _noise(coefficient: str, piece: ResidualPiece) -> FloatArray:
    """(n,) variance of the sensors' noise in a piece's samples; 0 where it is not known."""
    if piece.noise is None:
        return np.zeros(len(piece))
    return noise_variance(piece.noise)[:, COEFFICIENTS.index(coefficient)]


def share_error(inside: Sequence[FloatArray]) -> float:
    """Standard error of a share of samples, given 0 or 1 for each, piece by piece: samples in a row
    fall outside together.
    """
    values = np.concatenate(list(inside))
    p = float(values.mean())
    return float(np.sqrt(p * (1.0 - p) * integral_time([v - p for v in inside]) / len(values)))


def with_distinct_labels(residuals: Residuals) -> Residuals:
    """The same; pieces that all have one name are given names by the stretch of the flight they lie
    in.
    """
    n = len(residuals.pieces)
    if len(residuals.labels) != 1 or n < 2:
        return residuals
    blocks = [block for block in np.array_split(np.arange(n), min(BLOCKS, n)) if len(block)]
    labelled = []
    for block in blocks:
        first, last = residuals.pieces[block[0]], residuals.pieces[block[-1]]
        name = f"{first.label}, {first.time_s[0]:.0f} to {last.time_s[-1]:.0f} s"
        labelled += [replace(residuals.pieces[k], label=name) for k in block]
    return replace(residuals, pieces=tuple(labelled))


def leave_one_out(
    residuals: Residuals,
    designs: Mapping[str, Design],
    options: FitOptions,
    outside: Outside = "grow",
    fitted: Mapping[str, FittedBounds] | None = None,
) -> dict[str, dict[str, float]]:
    """Manoeuvre -> coefficient -> share of its samples within the bounds that the other manoeuvres
    give.

    A share far below the confidence says that the manoeuvre holds something that the others do not.
    NaN where the rest is too short for a fit. Where all pieces have one name, BLOCKS stretches of
    the flight stand for manoeuvres; empty for a single piece. fitted: what `fit_bounds` made of the
    same residuals."""
    out: dict[str, dict[str, float]] = {}
    residuals = with_distinct_labels(residuals)
    if len(residuals.labels) < 2:
        return out
    fits = dict(fitted) if fitted is not None else fit_bounds(residuals, designs, options)
    blocks = [p.label for p in split_long_pieces(residuals).pieces]
    for label in residuals.labels:
        left_out = residuals.only([label])
        try:
            other_bounds = {
                c: _bounds_without(f, [k for k, name in enumerate(blocks) if name == label])
                for c, f in fits.items()
            }
            if not all(other_bounds.values()):
                remaining = residuals.only([other for other in residuals.labels if other != label])
                other_bounds = {
                    c: f.bounds for c, f in fit_bounds(remaining, designs, options).items()
                }
        except ValueError:
            out[label] = dict.fromkeys(designs, float("nan"))
            continue
        out[label] = {
            c: _coverage(c, b, outside, left_out, [options.confidence]).share[options.confidence]
            for c, b in other_bounds.items()
            if b
        }
    return out


def _bounds_without(fitted: FittedBounds, blocks: Sequence[int]) -> CoefficientBounds | None:
    """The interval of the other blocks; None where only another fit tells."""
    if fitted.separation is None or fitted.bounds.parts is None:
        return None
    presumed = fitted.bounds.parts.noise / fitted.bounds.parts.noise_scale
    return with_components(fitted.bounds, fitted.separation.excluding(blocks), presumed)
