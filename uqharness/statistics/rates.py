"""Limits of a rate from counts per flight, with the flight as the unit: excursions of one flight
need not be independent.

``X`` is the count of one flight, mu its mean. Flights are independent; within a flight anything may
go on. Two facts carry all:

* lower side, no assumption but X >= 0: for 0 <= k < 1 the product over flights of 1 + k (X/m - 1)
  has mean <= 1 while mu <= m, so that it ever exceeds 1/a with probability a at most (Ville's
  inequality; Waudby-Smith and Ramdas, doi 10.1093/jrsssb/qkad009);
* upper side: with E[X^2] <= kappa mu, E[exp(-s X)] <= 1 - mu (1 - exp(-s kappa))/kappa. Proof: (1 -
  exp(-s x))/x is convex in x, so Jensen's inequality under the distribution weighted by x gives E[1
  - exp(-s X)] >= mu (1 - exp(-s kappa))/kappa. A mean cannot be bounded from above by any number of
  flights without such an assumption (Bahadur and Savage 1956).

The assumption is stated as the largest ratio ``dispersion`` = Var X / E X (1: Poisson; 3:
excursions come in clusters), for which kappa = dispersion + mu. It need hold at the tested mean
only: above it the ratio may grow in proportion with the mean, because what counts is E[X^2]/mu^2.

A flight may end early, the share M of its time not flown. The rate per flight's length flown is r =
E X / (1 - E M), so that E[X + r M] = r: limits test Y = X + m M for each m. The upper side needs
E[exp(-s Y)] <= 1 - r (1 - exp(-s kappa))/kappa with kappa = dispersion + r. Flights that are whole
have it from the assumption above. In one that ended early with X <= dispersion, Y <= kappa, where
exp(-s Y) lies below its chord 1 - Y (1 - exp(-s kappa))/kappa. Both parts together have it,
whatever the share of flights that end early. So ``dispersion`` is also to be at least the count of
any flight that ended early. Pure: arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from scipy.special import betaincinv, logsumexp

from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile

# Bets of the lower side: small ones for rates near the tested one, large ones for rates far above
# it.
_BETS = np.array([0.01, 0.03, 0.06, 0.12, 0.2, 0.35, 0.5, 0.7])
# s kappa of the upper side's mixture; the first is for flights without any excursion, which decide
# most cells.
_TILTS = np.array([6.0, 2.0, 1.0, 0.5, 0.25, 0.1])
_TILT_WEIGHTS = np.array([0.75, 0.08, 0.07, 0.05, 0.03, 0.02])
_CHERNOFF_TILTS = np.geomspace(1e-3, 30.0, 80)
_BISECTIONS = 45
_DISPERSIONS = (1e-3, 1e6)


def observed_dispersion(counts: FloatArray) -> FloatArray:
    """Variance over mean of the counts (..., n), NaN marking none; 1 where it says nothing (fewer
    than 2 flights, or no count).
    """
    is_counted = np.isfinite(counts)
    flights = is_counted.sum(axis=-1)
    values = np.where(is_counted, counts, 0.0)
    mean = values.sum(axis=-1) / np.maximum(flights, 1)
    variance = np.where(is_counted, (values - mean[..., None]) ** 2, 0.0).sum(axis=-1) / np.maximum(
        flights - 1, 1
    )
    dispersion: FloatArray = np.where(
        (flights >= 2) & (mean > 0.0), variance / np.where(mean > 0.0, mean, 1.0), 1.0
    )
    return dispersion


def bet_logs(counts: FloatArray, mean: float | FloatArray) -> FloatArray:
    """Logarithm of what each bet earns on each count (...): (..., bets).

    ``mean`` is the tested one, above 0.
    """
    ratio = counts[..., None] / np.asarray(mean)[..., None]
    logs: FloatArray = np.log1p(_BETS * (ratio - 1.0))
    return logs


def log_e_above(bets: FloatArray) -> FloatArray:
    """Logarithm of the evidence that the mean is above the tested one, from sums over flights of
    ``bet_logs`` (..., bets).
    """
    log_e: FloatArray = logsumexp(bets, axis=-1) - np.log(_BETS.size)
    return log_e


def log_e_below(
    flights: FloatArray,
    total: FloatArray,
    mean: float | FloatArray,
    dispersion: FloatArray,
    assumed: float,
    missing: FloatArray | None = None,
) -> FloatArray:
    """Logarithm of the evidence that the mean is below ``mean``, after ``flights`` with ``total``
    excursions (arrays alike).

    ``assumed`` dispersion chooses the tilts before anything is seen; ``dispersion`` >= assumed is
    the one allowed for, which may come from the data: a larger one gives less evidence, never more.
    ``missing``: see `upper_limits`."""
    mean = np.asarray(mean, float)
    s = _TILTS / (assumed + mean[..., None])
    total = total if missing is None else total + mean * missing
    kappa = (np.maximum(dispersion, assumed) + mean)[..., None]
    logs = -s * total[..., None] - flights[..., None] * np.log1p(
        mean[..., None] * np.expm1(-s * kappa) / kappa
    )
    log_e: FloatArray = logsumexp(logs, axis=-1, b=_TILT_WEIGHTS)
    return log_e


def _log_error(
    flights: FloatArray,
    total: FloatArray,
    mean: FloatArray,
    dispersion: FloatArray,
    assumed: float | None,
    missing: FloatArray,
) -> FloatArray:
    """Logarithm of what bounds the chance of so few excursions (c,) where ``mean`` is true;
    arguments of `upper_limits`.
    """
    if assumed is not None:
        return -log_e_below(flights, total, mean, dispersion, assumed, missing)
    kappa = (dispersion + mean)[..., None]
    s = _CHERNOFF_TILTS / kappa
    charged = (total + mean * missing)[..., None]
    logs = s * charged + flights[..., None] * np.log1p(
        mean[..., None] * np.expm1(-s * kappa) / kappa
    )
    return np.asarray(logs.min(axis=-1))


def dispersion_that_allows(
    mean: float,
    flights: FloatArray,
    total: FloatArray,
    error: float,
    assumed: float | None = None,
    missing: FloatArray | None = None,
) -> FloatArray:
    """Largest dispersions (c,) with which the upper limit of the mean count per flight is at most
    ``mean``; arguments of `upper_limits`. 0 where no dispersion does."""
    flights, total = np.asarray(flights, float), np.asarray(total, float)
    absent = np.zeros_like(total) if missing is None else np.asarray(missing, float)
    means = np.full_like(total, mean)
    low, high = np.full_like(total, _DISPERSIONS[0]), np.full_like(total, _DISPERSIONS[1])
    none = _log_error(flights, total, means, low, assumed, absent) > np.log(error)
    for _ in range(_BISECTIONS):
        middle = np.sqrt(low * high)
        allowed = _log_error(flights, total, means, middle, assumed, absent) <= np.log(error)
        low, high = np.where(allowed, middle, low), np.where(allowed, high, middle)
    return np.where(none, 0.0, low)


def upper_limits(
    flights: FloatArray,
    total: FloatArray,
    dispersion: FloatArray,
    error: float,
    assumed: float | None = None,
    missing: FloatArray | None = None,
) -> FloatArray:
    """Upper limits (c,) of the mean count per flight, each missed with probability ``error`` at
    most; inf without flights.

    For a number of flights fixed beforehand, by Chernoff's bound. With the dispersion ``assumed``
    before the first flight: valid at whatever moment the flying was stopped, by the mixture over
    tilts.

    ``missing`` (c,): sums over flights of the share of its time that a flight did not fly. Limits
    are then of the count per flight's length *flown*, with ``dispersion`` at least the largest
    count of a flight that ended early (module's text). inf where too little was flown to say."""
    flights, total, dispersion = (np.asarray(item, float) for item in (flights, total, dispersion))
    absent = np.zeros_like(total) if missing is None else np.asarray(missing, float)

    def log_error(mean: FloatArray) -> FloatArray:
        return _log_error(flights, total, mean, dispersion, assumed, absent)

    high = np.maximum(total / np.maximum(flights, 1.0), 1.0 / np.maximum(flights, 1.0))
    log_target = np.log(error)
    for _ in range(40 if absent.any() else 200):
        short = (log_error(high) > log_target) & (flights > 0)
        if not short.any():
            break
        high = np.where(short, 2.0 * high, high)
    never = (log_error(high) > log_target) | (flights <= 0)
    low = np.zeros_like(high)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        rejected = log_error(middle) <= log_target
        low, high = np.where(rejected, low, middle), np.where(rejected, middle, high)
    return np.where(never, np.inf, high)


def share_upper(events: FloatArray, flights: FloatArray, error: float) -> FloatArray:
    """Upper limits (c,) of the share of flights with an event, each missed with probability
    ``error`` at most (Clopper and Pearson 1934): only that flights are independent is assumed. 1
    without flights."""
    events, flights = np.asarray(events, float), np.asarray(flights, float)
    some = events < flights
    limits: FloatArray = np.where(
        some,
        betaincinv(
            np.where(some, events + 1.0, 1.0), np.where(some, flights - events, 1.0), 1.0 - error
        ),
        1.0,
    )
    return limits


def lower_limits(counts: FloatArray, error: float) -> FloatArray:
    """Lower limits (c,) of the mean count per flight from counts (c, n), NaN marking none, each
    missed with probability ``error`` at most, at whatever moment the flying was stopped. 0 where
    nothing was counted."""
    values, number = _tally(counts)
    some = (values > 0) & (number > 0)
    at = np.flatnonzero(some.any(axis=-1))
    limits = np.zeros(counts.shape[0])
    if at.size == 0:
        return limits
    values, number = values[at], number[at]
    log_target = -np.log(error)
    high = (values * number).sum(axis=-1) / number.sum(axis=-1)
    start = low = high * 1e-9
    for _ in range(_BISECTIONS):
        middle = np.sqrt(low * high)
        is_rejected = (
            log_e_above((number[..., None] * bet_logs(values, middle[:, None])).sum(axis=-2))
            >= log_target
        )
        low, high = np.where(is_rejected, middle, low), np.where(is_rejected, high, middle)
    # Where even the start was never shown to be too low, nothing is.
    limits[at] = np.where(low > start, low, 0.0)
    return limits


def _tally(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Different counts (c, v) of each row and how many flights have them: the limits do not depend
    on the flights' order.
    """
    rows = [np.unique(row[np.isfinite(row)], return_counts=True) for row in counts]
    width = max((values.size for values, _ in rows), default=0)
    values, number = np.zeros((len(rows), max(width, 1))), np.zeros((len(rows), max(width, 1)))
    for row, (distinct, times) in enumerate(rows):
        values[row, : distinct.size], number[row, : distinct.size] = distinct, times
    return values, number


# How strongly excursions cluster: limits of the variance of the counts per flight over their
# mean, from the flights themselves.
#
# With X the count of a flight, Var X / E X = E[X^2] / E X - E X. The first term is the mean
# count as one excursion meets it, with the spread of a ratio of sums (Cochran 1977, Sampling
# Techniques, section 6.3). Clusters larger than any that was seen are what such an estimate
# cannot know; the upper limit counts one flight more, with twice the largest count seen. Pure:
# arrays in, arrays out.

_QUIET_TILT, _QUIET_TILT_ANYTIME, _QUIET_WEIGHT_ANYTIME = 30.0, 6.0, 0.75
"""What a corner without an excursion is judged by: the largest tilt of ``upper_limits``, the first
of its mixture.
"""


def dispersion_limits(counts: FloatArray, error: float) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits (c,) of variance over mean from counts (c, n), NaN marking none; each
    fails with about ``error``.

    0 and inf where nothing was counted. The upper limit is never below 1.
    """
    is_counted = np.isfinite(counts)
    values = np.where(is_counted, counts, 0.0)
    flights = is_counted.sum(axis=1).astype(float)
    reach = -float(normal_quantile(error))

    def limit_with(more: FloatArray, sign: float) -> FloatArray:
        first, second, third, fourth = (
            (values**power).sum(axis=1) + more**power for power in (1, 2, 3, 4)
        )
        some = first > 0.0
        total = np.where(some, first, 1.0)
        ratio = second / total
        standard_error = (
            np.sqrt(np.maximum(fourth - 2.0 * ratio * third + ratio**2 * second, 0.0)) / total
        )
        number = np.maximum(flights + (more > 0.0), 1.0)
        limit: FloatArray = np.where(
            some,
            ratio + sign * reach * standard_error - total / number,
            np.inf if sign > 0.0 else 0.0,
        )
        return limit

    largest = values.max(axis=1)
    return np.maximum(limit_with(np.zeros_like(largest), -1.0), 0.0), np.maximum(
        limit_with(2.0 * largest, 1.0), 1.0
    )


def quiet_flights(mean: float, dispersion: float, error: float, anytime: bool) -> int:
    """Flights without an excursion after which the upper limit of the mean count per flight is
    ``mean`` at most.

    ``anytime``: the limit that holds whenever the flying was stopped.
    """
    tilt = _QUIET_TILT_ANYTIME if anytime else _QUIET_TILT
    weight = _QUIET_WEIGHT_ANYTIME if anytime else 1.0
    kappa = dispersion + mean
    return int(
        np.ceil(np.log(1.0 / (weight * error)) / -np.log1p(mean * np.expm1(-tilt) / kappa) - 1e-9)
    )
