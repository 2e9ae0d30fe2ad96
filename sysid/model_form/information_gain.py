"""Information gain: what further data would do to a model-form interval, before they are flown.

`uqharness.next_flight` plans manoeuvres with it. With C = (X'X)^-1 of the data behind the interval
and K = Z'Z of further data, in the same normalised states,

    C+ = (X'X + K)^-1                                                           (1)
    n+ = n + n_Z,   dof+ = n+/f - m,   t+ = t(dof+)                             (2)
    beta+ = C+ (X'X beta_hat + K b),  b = beta + noise of variance f s2 K^-1    (3)

(1), (2): least squares, with the same residual variance s2 and colour f (`model_form`). (3): a
width depends on beta+, because bounds are stretched to include zero. The prior of beta is not
beta_hat +- its standard error: far from the data that would be a model error as large as the
interval, which is wide there for lack of data, not for error. Terms have mean zero and one common
size, estimated from beta_hat (empirical Bayes; Efron and Morris, JASA 68 (1973) 117). The mean over
possible data is taken (preposterior analysis: Raiffa and Schlaifer, "Applied Statistical Decision
Theory" (1961), ch. 5).

Data reduce f x'Cx, the *parameter part*, and t. They do not reduce s2: the scatter about the best
polynomial, noise or a missing term, stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from sysid.aerodynamics import regressors, stack
from sysid.arrays import FloatArray
from sysid.distributions import normal_quantile, student_quantile
from sysid.model_form.model_form import CoefficientBounds, Outside

DRAWS = 200
_MAX_STATES = 400
"""States at which the mean over draws is taken."""


@dataclass(frozen=True)
class BoundInformation:
    """Information of some data on one coefficient.

    Attributes
    ----------
    ZtZ : array (m, m)
        Z'Z over its terms.
    n : float
        Samples.
    low, high : array (k,)
        Smallest and largest value of each state.
    """

    ZtZ: FloatArray
    n: float
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Width:
    """Mean widths over states [-].

    Attributes
    ----------
    total : float
        Of the bounds.
    parameter : float
        2 t sqrt(f s2 x'Cx), from the uncertainty of the polynomial.
    """

    total: float
    parameter: float


def information(
    bounds: CoefficientBounds, states: Mapping[str, FloatArray], weight: float = 1.0
) -> BoundInformation:
    """Compute the information of data at states (n,).

    Parameters
    ----------
    bounds : CoefficientBounds
        Terms and normalisation.
    states : mapping of str to array (n,)
        Flight states of the data.
    weight : float
        Samples of the data behind ``bounds`` that count as much as one of these (ratio of the
        rates).

    Returns
    -------
    Information
        Z'Z, weighted.

    Raises
    ------
    KeyError
        For a missing state.
    """
    x = stack(states, bounds.states)
    # States are not clamped here: clamping applies when an interval is used, not when it is made.
    z = regressors((x - bounds.centre) / bounds.scale, bounds.terms)
    return BoundInformation(weight * (z.T @ z), weight * len(z), x.min(axis=0), x.max(axis=0))


def with_more_data(
    bounds: CoefficientBounds, additional: Sequence[BoundInformation], scatter: float = 1.0
) -> CoefficientBounds:
    """Predict the interval with additional data, except for beta, which is unknown.

    The envelope box grows with the data; its largest leverage stays, as it depends on the samples.

    Parameters
    ----------
    bounds : CoefficientBounds
        Current interval.
    additional : sequence of Information
        Further data.
    scatter : float
        Residual variance of the further data over that of the data behind ``bounds``; the pooled
        one is expected.

    Returns
    -------
    CoefficientBounds
        By (1) and (2).
    """
    if not additional:
        return bounds
    C = np.linalg.inv(np.linalg.inv(bounds.XtX_inv) + sum(item.ZtZ for item in additional))  # (1)
    added = sum(item.n for item in additional)
    n = bounds.n + added
    n_effective = n / bounds.leverage_factor
    dof = n_effective - len(bounds.terms)  # (2)
    low, high = (
        np.min([bounds.hull.low, *(item.low for item in additional)], axis=0),
        np.max([bounds.hull.high, *(item.high for item in additional)], axis=0),
    )
    updated = replace(
        bounds,
        XtX_inv=0.5 * (C + C.T),
        n=round(n),
        n_effective=n_effective,
        hull=replace(bounds.hull, low=low, high=high),
    )
    if bounds.parts is not None:
        # The persistent part and its uncertainty do not change with more samples, and noise is in
        # no width.
        return updated
    t = float(student_quantile(0.5 + 0.5 * bounds.confidence, dof))
    return replace(updated, s2=bounds.s2 * (bounds.n + scatter * added) / n, dof=dof, t=t)


def asymptotic(bounds: CoefficientBounds) -> CoefficientBounds:
    """Return the limit of unlimited data: the parameter part vanishes, all else stays."""
    if bounds.parts is not None:
        return replace(bounds, XtX_inv=np.zeros_like(bounds.XtX_inv))
    t = float(normal_quantile(0.5 + 0.5 * bounds.confidence))
    return replace(bounds, XtX_inv=np.zeros_like(bounds.XtX_inv), dof=float("inf"), t=t)


def parameter_variance(
    bounds: CoefficientBounds, states: Mapping[str, FloatArray], outside: Outside = "grow"
) -> FloatArray:
    """Compute f s2 x'Cx (n,), the variance of the fitted polynomial at states."""
    return bounds.leverage_factor * bounds.s2 * bounds.leverage(bounds.normalised(states, outside))


def width(
    bounds: CoefficientBounds, states: Mapping[str, FloatArray], outside: Outside = "grow"
) -> Width:
    """Compute the mean widths of an interval over states (n,)."""
    low, high = bounds.bounds(states, outside=outside)
    parameter = 2.0 * bounds.t * np.sqrt(parameter_variance(bounds, states, outside))
    return Width(float(np.mean(high - low)), float(np.mean(parameter)))


def belief(bounds: CoefficientBounds) -> tuple[FloatArray, FloatArray]:
    """Return prior mean (m,) and covariance (m, m) of beta.

    beta_hat is N(beta, f s2 C) and beta is N(0, v I), with v of maximum likelihood. Terms are of
    normalised states, so that a common size is meaningful. Where model error was separated from
    noise, beta_hat and its covariance are a posterior already.
    """
    if bounds.parts is not None:
        return bounds.beta_hat, bounds.leverage_factor * bounds.s2 * bounds.XtX_inv
    S = bounds.leverage_factor * bounds.s2 * bounds.XtX_inv
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    values = np.maximum(values, 0.0)
    b = vectors.T @ bounds.beta_hat

    def neg2_log_likelihood(log_v: float) -> float:
        total = np.exp(log_v) + values
        return float(np.sum(np.log(total) + b**2 / total))

    # Search v between negligible and the size of beta_hat itself.
    top = float(np.log(max(float(b @ b), 1e-300)))
    # The likelihood may have two maxima: take the best of a grid and refine it.
    grid = np.linspace(top - 30.0, top, 121)
    best = float(grid[int(np.argmin([neg2_log_likelihood(g) for g in grid]))])
    v = float(
        np.exp(
            optimize.minimize_scalar(
                neg2_log_likelihood, bounds=(best - 0.25, best + 0.25), method="bounded"
            ).x
        )
    )
    # Posterior of beta: shrunk towards zero along the eigenvectors.
    shrink = v / (v + values)
    return vectors @ (shrink * b), (vectors * (shrink * values)) @ vectors.T


def expected_width(
    current: CoefficientBounds,
    future: CoefficientBounds,
    states: Mapping[str, FloatArray],
    outside: Outside = "grow",
    draws: int = DRAWS,
    seed: int = 1,
) -> Width:
    """Compute the expected mean widths of a future interval.

    The mean is taken over states and over possible values of beta.

    Parameters
    ----------
    current : CoefficientBounds
        The interval as it is.
    future : CoefficientBounds
        From `with_more_data` or `asymptotic`.
    states : mapping of str to array (n,)
        Flight states of interest.
    outside : {"grow", "clamp"}
        Behaviour outside the data.
    draws, seed : int
        Random draws of beta.

    Returns
    -------
    Width
        Total and parameter part [-].
    """
    thinned_states = thinned(states, current.states, _MAX_STATES)
    z = future.normalised(thinned_states, outside)
    X = regressors(z, future.terms)
    half = future.half_width(future.leverage(z), future.t)
    mean, covariance = belief(current)
    if future.XtX_inv.any():
        M = np.linalg.inv(current.XtX_inv)
        K, C = np.linalg.inv(future.XtX_inv) - M, future.XtX_inv
        covariance = C @ (K @ covariance @ K + current.leverage_factor * current.s2 * K) @ C  # (3)
        mean = C @ (M @ current.beta_hat + K @ mean)
    # Draw beta from its predictive distribution.
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    noise = np.random.default_rng(seed).standard_normal((len(mean), draws))
    # Antithetic draws have the exact mean.
    y = X @ (mean[:, None] + root @ np.hstack([noise, -noise]))
    total = np.maximum(y + half[:, None], 0.0) - np.minimum(y - half[:, None], 0.0)
    return Width(float(np.mean(total)), width(future, states, outside).parameter)


def thinned(
    states: Mapping[str, FloatArray], names: Sequence[str], max_states: int
) -> dict[str, FloatArray]:
    """Return at most ``max_states`` of the states, evenly spaced."""
    n = len(states[names[0]])
    rows = np.linspace(0, n - 1, min(n, max_states)).round().astype(int)
    return {name: np.asarray(states[name])[rows] for name in names}


def weighted_quartiles(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Compute the quartiles (3,) of values (n,) with weights (n,) >= 0; NaN if all weights are 0.

    Examples
    --------
    >>> import numpy as np
    >>> weighted_quartiles(np.array([1.0, 2.0, 3.0, 4.0]), np.ones(4)).tolist()
    [1.0, 2.0, 3.0]
    """
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    if not total[-1] > 0.0:
        return np.full(3, np.nan)
    at = np.searchsorted(total / total[-1], [0.25, 0.5, 0.75])
    return np.asarray(values[order][np.minimum(at, len(values) - 1)])


def speed_power(speeds_mps: FloatArray, variances: FloatArray, counts: FloatArray) -> float:
    """Estimate b of variance ~ V^b from parts of flights.

    Sensor noise enters a coefficient through the dynamic pressure: b is -4 in still air; gusts make
    it less steep.

    Parameters
    ----------
    speeds_mps, variances, counts : array (p,)
        Mean speed [m/s], residual variance and samples of each part.

    Returns
    -------
    float
        0 where the speeds do not determine it: fewer than three, within 5 %, or a standard error
        above 1.
    """
    valid = (variances > 0.0) & (counts > 0.0) & np.isfinite(variances)
    if valid.sum() < 3:
        return 0.0
    x, y, w = (
        np.log(speeds_mps[valid]),
        np.log(variances[valid]),
        counts[valid] / counts[valid].sum(),
    )
    x, y = x - w @ x, y - w @ y
    sxx = float(w @ x**2)
    if np.ptp(x) < np.log(1.05) or not sxx > 0.0:
        return 0.0
    b = float(w @ (x * y)) / sxx
    standard_error = np.sqrt(float(w @ (y - b * x) ** 2) / sxx / max(valid.sum() - 2, 1))
    return b if standard_error <= 1.0 else 0.0


def mean_power(middle: FloatArray, low: float, high: float, power: float) -> float:
    """Compute the mean of V^power over a distribution given by quartiles (3,) and extremes.

    The distribution function is linear in between.
    """
    at = np.interp(
        np.linspace(0.005, 0.995, 100), [0.0, 0.25, 0.5, 0.75, 1.0], [low, *middle, high]
    )
    return float(np.mean(at**power))


# Choice of manoeuvres: greedily those that narrow an interval most per second.
#
# The measure is the mean half-width of the prediction interval over the mission's flight states:
# a design for prediction (I-optimality; Studden, Ann. Math. Stat. 42 (1971) 1613), not for
# parameters. Greedy: the best manoeuvre, then the next best given that one.

_FLIGHT_CHOICE_MAX_STATES = 500


@dataclass(frozen=True)
class Offer:
    """A manoeuvre that could be flown.

    Attributes
    ----------
    group : str
        Manoeuvres of one group need no transition between them.
    seconds : float
        Duration [s].
    information : Information
        Of its data.
    """

    group: str
    seconds: float
    information: BoundInformation


@dataclass(frozen=True)
class Choice:
    """A chosen manoeuvre.

    Attributes
    ----------
    index : int
        Of the offer.
    seconds : float
        With the transition that it needs [s].
    half_width : float
        Mean half-width once it is flown [-].
    """

    index: int
    seconds: float
    half_width: float


def choose(
    bounds: CoefficientBounds,
    offers: Sequence[Offer],
    states: Mapping[str, FloatArray],
    budget_s: float,
    transition_s: float,
    outside: Outside = "grow",
) -> list[Choice]:
    """Choose offers to fly within a time budget, best first.

    Parameters
    ----------
    bounds : CoefficientBounds
        Interval to narrow.
    offers : sequence of Offer
        An offer may be chosen several times.
    states : mapping of str to array (n,)
        Flight states of the mission.
    budget_s, transition_s : float
        Time budget, and extra time for the first offer of a group [s].
    outside : {"grow", "clamp"}
        Behaviour outside the data.

    Returns
    -------
    list of Choice
        Empty if no offer fits or none narrows the interval.
    """
    thinned_states = thinned(states, bounds.states, _FLIGHT_CHOICE_MAX_STATES)
    X = regressors(bounds.normalised(thinned_states, outside), bounds.terms)
    # Add the best offer per second until none fits or helps.
    M: FloatArray = np.asarray(np.linalg.inv(bounds.XtX_inv), dtype=np.float64)
    n = float(bounds.n)
    choices: list[Choice] = []
    half_width, remaining_s, visited_groups = _half_width(bounds, X, M, n), budget_s, set[str]()
    while True:
        best: tuple[float, Choice] | None = None
        for index, offer in enumerate(offers):
            seconds = offer.seconds + (0.0 if offer.group in visited_groups else transition_s)
            if seconds > remaining_s + 1e-9:
                continue
            information = offer.information
            half = _half_width(bounds, X, M + information.ZtZ, n + information.n)
            rate = (half_width - half) / seconds
            if best is None or rate > best[0]:
                best = rate, Choice(index, seconds, half)
        if best is None or not best[0] > 0.0:
            return choices
        choice = best[1]
        information = offers[choice.index].information
        M, n, half_width, remaining_s = (
            M + information.ZtZ,
            n + information.n,
            choice.half_width,
            remaining_s - choice.seconds,
        )
        visited_groups.add(offers[choice.index].group)
        choices.append(choice)


def _half_width(bounds: CoefficientBounds, X: FloatArray, M: FloatArray, n: float) -> float:
    """Compute the mean half-width at regressors X (n, m) for information M (m, m) and n samples."""
    t = bounds.t
    if bounds.parts is None:
        t = float(
            student_quantile(
                0.5 + 0.5 * bounds.confidence, n / bounds.leverage_factor - len(bounds.terms)
            )
        )
    h = np.einsum("ni,in->n", X, np.linalg.solve(M, X.T))
    return float(np.mean(bounds.half_width(h, t)))
