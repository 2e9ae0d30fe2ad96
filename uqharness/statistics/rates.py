"""Limits of a rate from counts per flight, without assuming that a flight's events are independent.

``X`` is the count of one flight, mu its mean. Flights are independent; the events within a flight
need not be. `uqharness.statistics.decide` and the campaign tables use two inequalities:

* lower side, for X >= 0: for 0 <= k < 1 the product over flights of 1 + k (X/m - 1) has mean <= 1
  while mu <= m, so that it ever exceeds 1/a with probability at most a (Ville's inequality;
  Waudby-Smith and Ramdas, doi 10.1093/jrsssb/qkad009);
* upper side: with E[X^2] <= kappa mu, E[exp(-s X)] <= 1 - mu (1 - exp(-s kappa))/kappa. Proof: (1 -
  exp(-s x))/x is convex in x, so Jensen's inequality under the distribution weighted by x gives E[1
  - exp(-s X)] >= mu (1 - exp(-s kappa))/kappa. Without such an assumption no number of flights
  bounds a mean from above (Bahadur and Savage 1956).

The assumption is a largest ratio ``dispersion`` = Var X / E X (1: Poisson; 3: excursions come in
clusters), for which kappa = dispersion + mu. It must hold at the tested mean only: above it the
ratio may grow in proportion to the mean, because E[X^2]/mu^2 is what matters.

A flight may end early, with a share M of its time not flown. The rate per length flown is r =
E X / (1 - E M), so that E[X + r M] = r: limits test Y = X + m M for each m. The upper side needs
E[exp(-s Y)] <= 1 - r (1 - exp(-s kappa))/kappa with kappa = dispersion + r. Complete flights
fulfil it by the assumption above. In a flight that ended early with X <= dispersion, Y <= kappa,
where exp(-s Y) lies below its chord 1 - Y (1 - exp(-s kappa))/kappa. Both parts together fulfil it,
whatever the share of flights that end early. So ``dispersion`` must also be at least the count of
any flight that ended early.
"""

from __future__ import annotations

import numpy as np
from scipy.special import betaincinv, logsumexp

from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile

# Bets k of the lower side: small for rates near the tested one, large for rates far above it.
_BETS = np.array([0.01, 0.03, 0.06, 0.12, 0.2, 0.35, 0.5, 0.7])
# s kappa of the upper side's mixture; the first serves flights without any excursion, as in most
# cells.
_TILTS = np.array([6.0, 2.0, 1.0, 0.5, 0.25, 0.1])
_TILT_WEIGHTS = np.array([0.75, 0.08, 0.07, 0.05, 0.03, 0.02])
_CHERNOFF_TILTS = np.geomspace(1e-3, 30.0, 80)
_BISECTIONS = 45
_DISPERSIONS = (1e-3, 1e6)


def observed_dispersion(counts: FloatArray) -> FloatArray:
    """Compute variance over mean of the counts (..., n); NaN marks no flight.

    1 where it is undefined: fewer than 2 flights, or no event.

    Examples
    --------
    >>> import numpy as np
    >>> float(observed_dispersion(np.array([0.0, 2.0, np.nan])))
    2.0
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
    """Compute the logarithm of each bet's factor on each count (...), giving (..., bets).

    ``mean`` is the tested mean count per flight, above 0.
    """
    ratio = counts[..., None] / np.asarray(mean)[..., None]
    logs: FloatArray = np.log1p(_BETS * (ratio - 1.0))
    return logs


def log_e_above(bets: FloatArray) -> FloatArray:
    """Compute the log evidence that the mean is above the tested one.

    ``bets`` (..., bets) are sums of `bet_logs` over flights; the bets' mean is an e-value.
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
    """Compute the log evidence that the mean count is below ``mean``.

    Parameters
    ----------
    flights, total : array
        Flights, and their excursions.
    mean : float or array
        Tested mean count per flight.
    dispersion : array
        Variance over mean that is allowed for, at least ``assumed``. It may come from the data: a
        larger one gives less evidence.
    assumed : float
        Dispersion that chooses the tilts before the first flight.
    missing : array, optional
        As in `upper_limits`.

    Returns
    -------
    array
        Logarithm of the e-value.
    """
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
    """Compute the log bound of the probability of so few excursions (c,) if ``mean`` is true.

    Arguments as in `upper_limits`.
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
    """Compute the largest dispersions (c,) for which the upper limit is at most ``mean``.

    0 where no dispersion allows it. Other arguments as in `upper_limits`.
    """
    flights, total = np.asarray(flights, float), np.asarray(total, float)
    time_missing = np.zeros_like(total) if missing is None else np.asarray(missing, float)
    means = np.full_like(total, mean)
    low, high = np.full_like(total, _DISPERSIONS[0]), np.full_like(total, _DISPERSIONS[1])
    # Not even the smallest dispersion allows it.
    impossible = _log_error(flights, total, means, low, assumed, time_missing) > np.log(error)
    for _ in range(_BISECTIONS):
        middle = np.sqrt(low * high)
        allowed = _log_error(flights, total, means, middle, assumed, time_missing) <= np.log(error)
        low, high = np.where(allowed, middle, low), np.where(allowed, high, middle)
    return np.where(impossible, 0.0, low)


def upper_limits(
    flights: FloatArray,
    total: FloatArray,
    dispersion: FloatArray,
    error: float,
    assumed: float | None = None,
    missing: FloatArray | None = None,
) -> FloatArray:
    """Compute upper limits of the mean count per flight.

    For a number of flights fixed beforehand, by Chernoff's bound. With ``assumed`` they are valid
    at any stopping time, by the mixture over tilts.

    Parameters
    ----------
    flights, total : array (c,)
        Flights, and their excursions.
    dispersion : array (c,)
        Variance over mean that is allowed for; at least the largest count of a flight that ended
        early.
    error : float
        Probability with which each limit may be too low.
    assumed : float, optional
        Dispersion fixed before the first flight.
    missing : array (c,), optional
        Sum over flights of the share of time not flown. Limits are then of the count per flight's
        length *flown*.

    Returns
    -------
    array (c,)
        inf without flights, or if too little was flown.
    """
    flights, total, dispersion = (np.asarray(item, float) for item in (flights, total, dispersion))
    time_missing = np.zeros_like(total) if missing is None else np.asarray(missing, float)

    def log_error(mean: FloatArray) -> FloatArray:
        return _log_error(flights, total, mean, dispersion, assumed, time_missing)

    # Bracket the limit from above, then bisect.
    high = np.maximum(total / np.maximum(flights, 1.0), 1.0 / np.maximum(flights, 1.0))
    log_target = np.log(error)
    for _ in range(40 if time_missing.any() else 200):
        too_low = (log_error(high) > log_target) & (flights > 0)
        if not too_low.any():
            break
        high = np.where(too_low, 2.0 * high, high)
    unlimited = (log_error(high) > log_target) | (flights <= 0)
    low = np.zeros_like(high)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        rejected = log_error(middle) <= log_target
        low, high = np.where(rejected, low, middle), np.where(rejected, middle, high)
    return np.where(unlimited, np.inf, high)


def share_upper(events: FloatArray, flights: FloatArray, error: float) -> FloatArray:
    """Compute upper limits (c,) of the share of flights with an event (Clopper and Pearson 1934).

    Only independence of flights is assumed. Each limit is too low with probability ``error`` at
    most; 1 without flights.
    """
    events, flights = np.asarray(events, float), np.asarray(flights, float)
    has_flight_without = events < flights
    limits: FloatArray = np.where(
        has_flight_without,
        betaincinv(
            np.where(has_flight_without, events + 1.0, 1.0),
            np.where(has_flight_without, flights - events, 1.0),
            1.0 - error,
        ),
        1.0,
    )
    return limits


def lower_limits(counts: FloatArray, error: float) -> FloatArray:
    """Compute lower limits (c,) of the mean count per flight, valid at any stopping time.

    Parameters
    ----------
    counts : array (c, n)
        NaN marks no flight.
    error : float
        Probability with which each limit may be too high.

    Returns
    -------
    array (c,)
        0 where nothing was counted.
    """
    # Only rows with an event have a positive limit.
    values, number = _tally(counts)
    has_events = (values > 0) & (number > 0)
    at = np.flatnonzero(has_events.any(axis=-1))
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
    # If not even the smallest mean was rejected, the limit is 0.
    limits[at] = np.where(low > start, low, 0.0)
    return limits


def _tally(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distinct counts (c, v) of each row and the number of flights with each.

    Limits then do not depend on the flights' order.
    """
    rows = [np.unique(row[np.isfinite(row)], return_counts=True) for row in counts]
    width = max((values.size for values, _ in rows), default=0)
    values, number = np.zeros((len(rows), max(width, 1))), np.zeros((len(rows), max(width, 1)))
    for row, (distinct, times) in enumerate(rows):
        values[row, : distinct.size], number[row, : distinct.size] = distinct, times
    return values, number


# Limits of the dispersion (variance over mean) of the counts per flight, from the flights alone.
#
# With X the count of a flight, Var X / E X = E[X^2] / E X - E X. The first term is a ratio of sums
# with a known standard error (Cochran 1977, Sampling Techniques, section 6.3). The estimate cannot
# include larger clusters than those observed; the upper limit counts one flight more, with twice
# the largest count.

_QUIET_TILT, _QUIET_TILT_ANYTIME, _QUIET_WEIGHT_ANYTIME = 30.0, 6.0, 0.75
"""Tilts for a corner without an excursion: the largest of ``upper_limits``, and the first
of its mixture.
"""


def dispersion_limits(counts: FloatArray, error: float) -> tuple[FloatArray, FloatArray]:
    """Compute lower and upper limits (c,) of variance over mean from counts (c, n).

    NaN marks no flight; each limit fails with probability of about ``error``. 0 and inf where
    nothing was counted. The upper limit is at least 1.
    """
    is_counted = np.isfinite(counts)
    values = np.where(is_counted, counts, 0.0)
    flights = is_counted.sum(axis=1).astype(float)
    reach = -float(normal_quantile(error))

    def limit_with(more: FloatArray, sign: float) -> FloatArray:
        """Compute one limit with one more flight of ``more`` events."""
        # Power sums of the counts and of the extra flight.
        first, second, third, fourth = (
            (values**power).sum(axis=1) + more**power for power in (1, 2, 3, 4)
        )
        has_events = first > 0.0
        total = np.where(has_events, first, 1.0)
        # E[X^2]/E X as a ratio of sums, with its standard error.
        ratio = second / total
        standard_error = (
            np.sqrt(np.maximum(fourth - 2.0 * ratio * third + ratio**2 * second, 0.0)) / total
        )
        number = np.maximum(flights + (more > 0.0), 1.0)
        limit: FloatArray = np.where(
            has_events,
            ratio + sign * reach * standard_error - total / number,
            np.inf if sign > 0.0 else 0.0,
        )
        return limit

    largest = values.max(axis=1)
    return np.maximum(limit_with(np.zeros_like(largest), -1.0), 0.0), np.maximum(
        limit_with(2.0 * largest, 1.0), 1.0
    )


def quiet_flights(mean: float, dispersion: float, error: float, anytime: bool) -> int:
    """Return the flights without an excursion that bring the upper limit of the mean down to
    ``mean``.

    Parameters
    ----------
    mean : float
        Mean count per flight.
    dispersion : float
        Variance over mean that is allowed for.
    error : float
        Probability of error.
    anytime : bool
        Use the limit that holds at any stopping time.

    Returns
    -------
    int
        Number of flights.

    Examples
    --------
    >>> quiet_flights(0.1, 1.0, 0.05, anytime=False)
    32
    """
    tilt = _QUIET_TILT_ANYTIME if anytime else _QUIET_TILT
    weight = _QUIET_WEIGHT_ANYTIME if anytime else 1.0
    kappa = dispersion + mean
    return int(
        np.ceil(np.log(1.0 / (weight * error)) / -np.log1p(mean * np.expm1(-tilt) / kappa) - 1e-9)
    )
