"""Coverage: do the intervals hold on a flight that was not used to make them?

`coverage` reports the share of a hold-out flight inside the bounds, by coefficient and manoeuvre;
`leave_one_out` repeats the fit without each manoeuvre; `verdict` says whether bounds hold. Standard
errors allow for autocorrelation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import fft

from sysid.aerodynamics import (
    COEFFICIENTS,
    ResidualPiece,
    Residuals,
    noise_cosines,
    noise_variance,
)
from sysid.arrays import FloatArray
from sysid.estimation import effective_samples, integral_time
from sysid.model_form.components import motion_waves, split_long_pieces
from sysid.model_form.fit import (
    Design,
    FitOptions,
    FittedBounds,
    fit_bounds,
    remove_state_noise,
    with_components,
)
from sysid.model_form.model_form import CoefficientBounds, ModelForm, Outside

# Coverage of a hold-out flight: by speed and incidence, by manoeuvre, and the verdict.

Verdict = Literal["holds", "fails", "inconclusive"]
MIN_SHARE_INSIDE = 0.85
"""Share of a hold-out flight that 95 % bounds must contain, whatever its standard error.

Single flights scatter by 0.02 to 0.04.
"""
MAX_SHARE_ERROR = 0.025
"""Standard error of the share above which the verdict is inconclusive."""
_ONE_SIDED = 1.6448536269514722
"""Standard normal quantile of 95 %."""
_BINS = 3


@dataclass(frozen=True)
class Bin:
    """Share inside of the n samples whose state lies from ``low`` to ``high``, in its unit."""

    low: float
    high: float
    share: float
    n: int


@dataclass(frozen=True)
class Conformal:
    """Bounds ``factor`` times as wide hold 95 % of a further manoeuvre's samples.

    They do so with a probability of at least ``level``. The statement is distribution-free if
    manoeuvres are exchangeable: the factor is an order statistic of the factors that the manoeuvres
    need (Vovk et al., "Algorithmic Learning in a Random World" (2005)); with fewer than 19
    manoeuvres it is the largest, at the level m/(m + 1).
    """

    factor: float
    level: float
    manoeuvres: int


def verdict(share: float, error: float, level: float) -> Verdict:
    """Decide whether bounds hold, from the share of a hold-out flight inside.

    Parameters
    ----------
    share : float
        Share of samples inside.
    error : float
        Its standard error; NaN if unknown.
    level : float
        Confidence of the bounds.

    Returns
    -------
    {"holds", "fails", "inconclusive"}
        "fails" where the share's upper 95 % limit lies below the level, or the share below
        MIN_SHARE_INSIDE; "inconclusive" where the standard error exceeds MAX_SHARE_ERROR or is
        unknown.

    Examples
    --------
    >>> verdict(0.96, 0.01, 0.95), verdict(0.80, 0.01, 0.95), verdict(0.96, 0.05, 0.95)
    ('holds', 'fails', 'inconclusive')
    """
    if not share >= MIN_SHARE_INSIDE or share + _ONE_SIDED * error < level:
        return "fails"
    return "holds" if error <= MAX_SHARE_ERROR else "inconclusive"


def bins(residuals: Residuals, state: str, inside: Sequence[FloatArray]) -> tuple[Bin, ...]:
    """Compute the share inside for thirds of the samples by a state.

    ``inside`` is 0 or 1 for each sample, piece by piece.
    """
    values, is_inside = residuals.states.get(state), np.concatenate(list(inside))
    if values is None:
        return ()
    edges = np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1))
    out = []
    for k in range(_BINS):
        in_bin = (values >= edges[k]) & ((values < edges[k + 1]) | (k == _BINS - 1))
        share = float(is_inside[in_bin].mean()) if in_bin.any() else float("nan")
        out.append(Bin(float(edges[k]), float(edges[k + 1]), share, int(in_bin.sum())))
    return tuple(out)


def conformal(
    pieces: Sequence[ResidualPiece], stretch: Sequence[FloatArray], level: float = 0.95
) -> Conformal:
    """Compute the conformal factor over manoeuvres.

    ``stretch`` holds the factor (n,) that each sample of a piece needs.
    """
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
    # Order statistic for the level, or the largest factor of few manoeuvres.
    rank = int(np.ceil((m + 1) * level))
    if rank > m:
        return Conformal(float(needed[-1]), m / (m + 1.0), m)
    return Conformal(float(needed[rank - 1]), rank / (m + 1.0), m)


LEVELS = (0.95, 0.68)
BLOCKS = 10


@dataclass(frozen=True)
class Coverage:
    """Coverage of one coefficient on one flight.

    Attributes
    ----------
    share, error : mapping of float to float
        Level to the share of samples within the bounds of that confidence, and to its standard
        error.
    n, n_effective : int, float
        Samples, and effective sample size of the residual about the interval's middle.
    mean_width : float
        Of the 95 % bounds, without the sensors' noise [-].
    outside : float
        Share of samples outside the data.
    manoeuvres : mapping
        Label to level to share.
    speeds, incidences : tuple of Bin
        Shares at the 95 % level in thirds of airspeed and angle of attack.
    conformal : Conformal or None
        Factor by which manoeuvres show that the 95 % bounds must be widened.
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
    """Compute the coverage of a form on a flight's residuals.

    Where the form separates noise, samples are those of `in_motion_band`, and the noise that the
    flight's own sensors have there is added to the interval.

    Parameters
    ----------
    form : ModelForm
        Bounds.
    residuals : Residuals
        Filtered as the form's own were.
    levels : sequence of float
        Confidences.

    Returns
    -------
    dict of str to Coverage
        One per coefficient.

    Raises
    ------
    KeyError
        For a missing state.
    """
    if any(b.parts is not None for b in form.coefficients.values()):
        residuals = in_motion_band(remove_state_noise(residuals))
    return {
        c: _coverage(c, b, form.outside, residuals, levels) for c, b in form.coefficients.items()
    }


def in_motion_band(residuals: Residuals) -> Residuals:
    """Return the part of the residuals that is as slow as an aircraft's motion, with its noise.

    Components are estimated from these frequencies alone, so that they predict no others: what is
    faster, such as the vibration of an engine and the air's own rotation, is no model error.
    Residuals without noise are returned as they are.
    """
    if any(p.noise is None for p in residuals.pieces):
        return residuals
    pieces = []
    for piece in residuals.pieces:
        assert piece.noise is not None
        count = motion_waves(len(piece), residuals)
        waves = fft.dct(piece.delta, axis=0, norm="ortho")
        waves[count:] = 0.0
        size = noise_cosines(piece.noise)[0]
        share = size[:count].sum(axis=0) / np.maximum(size.sum(axis=0), np.finfo(float).tiny)
        passages = tuple(replace(p, gain=p.gain * np.sqrt(share)) for p in piece.noise.passages)
        pieces.append(
            replace(
                piece,
                delta=fft.idct(waves, axis=0, norm="ortho"),
                noise=replace(piece.noise, passages=passages),
            )
        )
    return replace(residuals, pieces=tuple(pieces))


def _coverage(
    coefficient: str,
    bounds: CoefficientBounds,
    outside: Outside,
    residuals: Residuals,
    levels: Sequence[float],
) -> Coverage:
    """Compute the coverage of one coefficient."""
    y = residuals.columns(coefficient)
    inside: dict[float, list[FloatArray]] = {}
    for level in levels:
        ends = [measured_bounds(bounds, coefficient, p, level, outside) for p in residuals.pieces]
        inside[level] = [
            ((v >= low) & (v <= high)).astype(float) for v, (low, high) in zip(y, ends, strict=True)
        ]
    share = {level: float(np.concatenate(rows).mean()) for level, rows in inside.items()}
    # Effective sample size from the residual about the interval's middle.
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
    """Compute the factor (n,) by which the 95 % bounds must be widened to hold each sample and
    zero.

    Bounds are those of measured samples, widened about their middle.
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
    """Compute the interval (n,) of a piece's measured samples, its sensors' noise included.

    Parameters
    ----------
    bounds : CoefficientBounds
        Interval of the coefficient.
    coefficient : str
        Among COEFFICIENTS.
    piece : ResidualPiece
        Samples.
    confidence : float, optional
        By default that of the bounds.
    outside : {"grow", "clamp"}
        Behaviour outside the data.

    Returns
    -------
    tuple of two arrays (n,)
        Lower and upper end [-].
    """
    return bounds.sample_interval(piece.states, _noise(coefficient, piece), confidence, outside)


def _noise(coefficient: str, piece: ResidualPiece) -> FloatArray:
    """Return the variance (n,) of the sensors' noise in a piece's samples; 0 where unknown."""
    if piece.noise is None:
        return np.zeros(len(piece))
    return noise_variance(piece.noise)[:, COEFFICIENTS.index(coefficient)]


def share_error(inside: Sequence[FloatArray]) -> float:
    """Compute the standard error of a share, from 0 or 1 for each sample, piece by piece.

    Consecutive samples fall outside together, so autocorrelation counts.
    """
    values = np.concatenate(list(inside))
    # Binomial variance times the integral time.
    p = float(values.mean())
    return float(np.sqrt(p * (1.0 - p) * integral_time([v - p for v in inside]) / len(values)))


def with_distinct_labels(residuals: Residuals) -> Residuals:
    """Rename pieces that all have one label by the part of the flight in which they lie."""
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
    """Compute the coverage of each manoeuvre by bounds from the other manoeuvres.

    A share far below the confidence shows that a manoeuvre contains something that the others do
    not.

    Parameters
    ----------
    residuals : Residuals
        Of all manoeuvres. Where all pieces have one label, BLOCKS parts of the flight replace
        manoeuvres.
    designs : mapping of str to Design
        As given to `fit_bounds`.
    options : FitOptions
        As given to `fit_bounds`.
    outside : {"grow", "clamp"}
        Behaviour outside the data.
    fitted : mapping of str to FittedBounds, optional
        Result of `fit_bounds` for the same residuals.

    Returns
    -------
    dict
        Manoeuvre to coefficient to share. NaN where the other manoeuvres are too short for a fit;
        empty for a single piece.
    """
    out: dict[str, dict[str, float]] = {}
    residuals = with_distinct_labels(residuals)
    if len(residuals.labels) < 2:
        return out
    fits = dict(fitted) if fitted is not None else fit_bounds(residuals, designs, options)
    blocks = [p.label for p in split_long_pieces(residuals).pieces]
    separated = any(f.bounds.parts is not None for f in fits.values())
    slow = in_motion_band(residuals) if separated else residuals
    for label in residuals.labels:
        left_out = slow.only([label])
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
    """Return the interval of the other blocks; None if that needs another fit."""
    if fitted.separation is None or fitted.bounds.parts is None:
        return None
    presumed = fitted.bounds.parts.noise / fitted.bounds.parts.noise_scale
    return with_components(fitted.bounds, fitted.separation.excluding(blocks), presumed)
