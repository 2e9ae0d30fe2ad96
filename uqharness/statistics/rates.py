"""Limits of a rate from counts per flight, with the flight as the unit: excursions of one flight need not be independent.

``X`` is the count of one flight, mu its mean. Flights are independent; within a flight anything may go on. Two facts carry all:

* lower side, no assumption but X >= 0: for 0 <= k < 1 the product over flights of 1 + k (X/m - 1) has mean <= 1 while mu <= m, so
  that it ever exceeds 1/a with probability a at most (Ville's inequality; Waudby-Smith and Ramdas, doi 10.1093/jrsssb/qkad009);
* upper side: with E[X^2] <= kappa mu, E[exp(-s X)] <= 1 - mu (1 - exp(-s kappa))/kappa. Proof: (1 - exp(-s x))/x is convex in x, so
  Jensen's inequality under the distribution weighted by x gives E[1 - exp(-s X)] >= mu (1 - exp(-s kappa))/kappa. A mean cannot be
  bounded from above by any number of flights without such an assumption (Bahadur and Savage 1956).

The assumption is stated as the largest ratio ``dispersion`` = Var X / E X (1: Poisson; 3: excursions come in clusters), for which
kappa = dispersion + mu. It need hold at the tested mean only: above it the ratio may grow in proportion with the mean, because what
counts is E[X^2]/mu^2. Pure: arrays in, arrays out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

Array = NDArray[np.float64]

# Bets of the lower side: small ones for rates near the tested one, large ones for rates far above it.
_BETS = np.array([0.01, 0.03, 0.06, 0.12, 0.2, 0.35, 0.5, 0.7])
# s kappa of the upper side's mixture; the first is for flights without any excursion, which decide most cells.
_TILTS = np.array([6.0, 2.0, 1.0, 0.5, 0.25, 0.1])
_TILT_WEIGHTS = np.array([0.75, 0.08, 0.07, 0.05, 0.03, 0.02])
_CHERNOFF_TILTS = np.geomspace(1e-3, 30.0, 80)
_BISECTIONS = 45


def observed_dispersion(counts: Array) -> Array:
    """Variance over mean of the counts (..., n), NaN marking none; 1 where it says nothing (fewer than 2 flights, or no count)."""
    known = np.isfinite(counts)
    flights = known.sum(axis=-1)
    values = np.where(known, counts, 0.0)
    mean = values.sum(axis=-1) / np.maximum(flights, 1)
    spread = np.where(known, (values - mean[..., None]) ** 2, 0.0).sum(axis=-1) / np.maximum(flights - 1, 1)
    found: Array = np.where((flights >= 2) & (mean > 0.0), spread / np.where(mean > 0.0, mean, 1.0), 1.0)
    return found


def bet_logs(counts: Array, mean: float | Array) -> Array:
    """Logarithm of what each bet earns on each count (...): (..., bets). ``mean`` is the tested one, above 0."""
    ratio = counts[..., None] / np.asarray(mean)[..., None]
    logs: Array = np.log1p(_BETS * (ratio - 1.0))
    return logs


def log_e_above(bets: Array) -> Array:
    """Logarithm of the evidence that the mean is above the tested one, from sums over flights of ``bet_logs`` (..., bets)."""
    found: Array = logsumexp(bets, axis=-1) - np.log(_BETS.size)
    return found


def log_e_below(flights: Array, total: Array, mean: float | Array, dispersion: Array, assumed: float) -> Array:
    """Logarithm of the evidence that the mean is below ``mean``, after ``flights`` with ``total`` excursions (arrays alike).

    ``assumed`` dispersion chooses the tilts before anything is seen; ``dispersion`` >= assumed is the one allowed for, which may
    come from the data: a larger one gives less evidence, never more.
    """
    mean, flights, total = np.asarray(mean, float)[..., None], flights[..., None], total[..., None]
    s = _TILTS / (assumed + mean)
    kappa = np.maximum(dispersion, assumed)[..., None] + mean
    logs = -s * total - flights * np.log1p(mean * np.expm1(-s * kappa) / kappa)
    found: Array = logsumexp(logs, axis=-1, b=_TILT_WEIGHTS)
    return found


def upper_limits(flights: Array, total: Array, dispersion: Array, error: float, assumed: float | None = None) -> Array:
    """Upper limits (c,) of the mean count per flight, each missed with probability ``error`` at most; inf without flights.

    For a number of flights fixed beforehand, by Chernoff's bound. With the dispersion ``assumed`` before the first flight: valid at
    whatever moment the flying was stopped, by the mixture over tilts.
    """
    flights, total, dispersion = (np.asarray(item, float) for item in (flights, total, dispersion))

    def log_error(mean: Array) -> Array:
        if assumed is not None:
            return -log_e_below(flights, total, mean, dispersion, assumed)
        kappa = dispersion[..., None] + mean[..., None]
        s = _CHERNOFF_TILTS / kappa
        logs = s * total[..., None] + flights[..., None] * np.log1p(-mean[..., None] * -np.expm1(-s * kappa) / kappa)
        return np.asarray(logs.min(axis=-1))

    high = np.maximum(total / np.maximum(flights, 1.0), 1.0 / np.maximum(flights, 1.0))
    wanted = np.log(error)
    for _ in range(200):
        short = (log_error(high) > wanted) & (flights > 0)
        if not short.any():
            break
        high = np.where(short, 2.0 * high, high)
    low = np.zeros_like(high)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        rejected = log_error(middle) <= wanted
        low, high = np.where(rejected, low, middle), np.where(rejected, middle, high)
    return np.where(flights > 0, high, np.inf)


def lower_limits(counts: Array, error: float) -> Array:
    """Lower limits (c,) of the mean count per flight from counts (c, n), NaN marking none, each missed with probability ``error``
    at most, at whatever moment the flying was stopped. 0 where nothing was counted.
    """
    values, number = _tally(counts)
    some = (values > 0) & (number > 0)
    at = np.flatnonzero(some.any(axis=-1))
    found = np.zeros(counts.shape[0])
    if at.size == 0:
        return found
    values, number = values[at], number[at]
    wanted = -np.log(error)
    high = (values * number).sum(axis=-1) / number.sum(axis=-1)
    start = low = high * 1e-9
    for _ in range(_BISECTIONS):
        middle = np.sqrt(low * high)
        shown = log_e_above((number[..., None] * bet_logs(values, middle[:, None])).sum(axis=-2)) >= wanted
        low, high = np.where(shown, middle, low), np.where(shown, high, middle)
    # Where even the start was never shown to be too low, nothing is.
    found[at] = np.where(low > start, low, 0.0)
    return found


def _tally(counts: Array) -> tuple[Array, Array]:
    """Different counts (c, v) of each row and how many flights have them: the limits do not depend on the flights' order."""
    rows = [np.unique(row[np.isfinite(row)], return_counts=True) for row in counts]
    width = max((values.size for values, _ in rows), default=0)
    values, number = np.zeros((len(rows), max(width, 1))), np.zeros((len(rows), max(width, 1)))
    for row, (found, times) in enumerate(rows):
        values[row, : found.size], number[row, : found.size] = found, times
    return values, number
