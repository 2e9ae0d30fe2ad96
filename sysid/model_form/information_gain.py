"""What more data would do to a model-form interval: the answer of the linear model, before anybody
has flown.

With C = (X'X)^-1 of the data behind the interval and K = Z'Z of further data, in the same
normalised states,

    C+ = (X'X + K)^-1                                                           (1)
    n+ = n + n_Z,   dof+ = n+/f - m,   t+ = t(dof+)                             (2)
    beta+ = C+ (X'X beta_hat + K b),  b = beta + noise of variance f s2 K^-1    (3)

(1), (2): least squares, the residual's variance s2 and colour f being what they are
(model_form.py). (3): a width depends on beta+ because bounds are stretched to hold zero. What is
believed of beta today is not beta_hat +- its standard error: far from the data that would be a
model error as large as the interval, and an interval is wide there for want of knowledge, not for
error. Terms are as likely to be up as down, with one size for all, which beta_hat tells (empirical
Bayes; Efron and Morris, JASA 68 (1973) 117). The mean over futures is taken (preposterior analysis:
Raiffa and Schlaifer, "Applied Statistical Decision Theory" (1961), ch. 5).

Data narrow f x'Cx, the *parameter part*, and t. They do not narrow s2: what scatters about the best
polynomial, be it noise or a term that is missing, stays."""

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
_MAX_STATES = 400  # at which the mean over draws is taken


@dataclass(frozen=True)
class Information:
    """What some data say about one coefficient: Z'Z (m, m) over its terms, n samples, smallest and
    largest state (k,).
    """

    ZtZ: FloatArray
    n: float
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Width:
    """Mean widths over states. total: of the bounds; parameter: 2 t sqrt(f s2 x'Cx), from the
    uncertainty of the polynomial.
    """

    total: float
    parameter: float


def information(
    bounds: CoefficientBounds, states: Mapping[str, FloatArray], weight: float = 1.0
) -> Information:
    """Of data at states (n,). weight: samples of the data behind ``bounds`` that one of these is
    worth (ratio of the rates).

    Raises KeyError for a missing state.
    """
    x = stack(states, bounds.states)
    # Data count where they are: clamping is for the interval's use, not for its making.
    z = regressors((x - bounds.centre) / bounds.scale, bounds.terms)
    return Information(weight * (z.T @ z), weight * len(z), x.min(axis=0), x.max(axis=0))


def with_more_data(
    bounds: CoefficientBounds, additional: Sequence[Information], scatter: float = 1.0
) -> CoefficientBounds:
    """The interval as it will be with ``additional`` data, but for beta, which nobody knows yet.

    scatter: residual variance of the further data over that of the data behind ``bounds``; the
    pooled one is expected. The envelope box grows with the data; its largest leverage is not known
    without the samples and stays."""
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
        # What persists and how sure that is are the model's; samples alone do not change them, and
        # noise is in no width.
        return updated
    t = float(student_quantile(0.5 + 0.5 * bounds.confidence, dof))
    return replace(updated, s2=bounds.s2 * (bounds.n + scatter * added) / n, dof=dof, t=t)


def asymptotic(bounds: CoefficientBounds) -> CoefficientBounds:
    """The limit of endless data: no parameter part left, all else as it is."""
    if bounds.parts is not None:
        return replace(bounds, XtX_inv=np.zeros_like(bounds.XtX_inv))
    t = float(normal_quantile(0.5 + 0.5 * bounds.confidence))
    return replace(bounds, XtX_inv=np.zeros_like(bounds.XtX_inv), dof=float("inf"), t=t)


def parameter_variance(
    bounds: CoefficientBounds, states: Mapping[str, FloatArray], outside: Outside = "grow"
) -> FloatArray:
    """(n,) f s2 x'Cx: variance of the fitted polynomial at states."""
    return bounds.leverage_factor * bounds.s2 * bounds.leverage(bounds.normalised(states, outside))


def width(
    bounds: CoefficientBounds, states: Mapping[str, FloatArray], outside: Outside = "grow"
) -> Width:
    """Mean widths of an interval over states (n,)."""
    low, high = bounds.bounds(states, outside=outside)
    parameter = 2.0 * bounds.t * np.sqrt(parameter_variance(bounds, states, outside))
    return Width(float(np.mean(high - low)), float(np.mean(parameter)))


def belief(bounds: CoefficientBounds) -> tuple[FloatArray, FloatArray]:
    """Mean (m,) and covariance (m, m) of beta: beta_hat is N(beta, f s2 C), beta is N(0, v I), v
    where beta_hat is likeliest.

    Terms are of normalised states, so that one size for all of them has a meaning. Where model
    error was taken apart from noise, beta_hat and its covariance are a posterior already."""
    if bounds.parts is not None:
        return bounds.beta_hat, bounds.leverage_factor * bounds.s2 * bounds.XtX_inv
    S = bounds.leverage_factor * bounds.s2 * bounds.XtX_inv
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    values = np.maximum(values, 0.0)
    b = vectors.T @ bounds.beta_hat

    def neg2_log_likelihood(log_v: float) -> float:
        total = np.exp(log_v) + values
        return float(np.sum(np.log(total) + b**2 / total))

    top = float(np.log(max(float(b @ b), 1e-300)))
    # The likelihood may have two maxima: the best of a grid, then refined beside it.
    grid = np.linspace(top - 30.0, top, 121)
    best = float(grid[int(np.argmin([neg2_log_likelihood(g) for g in grid]))])
    v = float(
        np.exp(
            optimize.minimize_scalar(
                neg2_log_likelihood, bounds=(best - 0.25, best + 0.25), method="bounded"
            ).x
        )
    )
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
    """Mean widths that ``future`` (from `after` or `for_ever`) will have, over states and over what
    may be learnt of beta.
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
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    noise = np.random.default_rng(seed).standard_normal((len(mean), draws))
    # Antithetic: the draws have the mean that they should.
    y = X @ (mean[:, None] + root @ np.hstack([noise, -noise]))
    total = np.maximum(y + half[:, None], 0.0) - np.minimum(y - half[:, None], 0.0)
    return Width(float(np.mean(total)), width(future, states, outside).parameter)


def thinned(
    states: Mapping[str, FloatArray], names: Sequence[str], max_states: int
) -> dict[str, FloatArray]:
    """At most ``max_states`` of the states, evenly chosen."""
    n = len(states[names[0]])
    rows = np.linspace(0, n - 1, min(n, max_states)).round().astype(int)
    return {name: np.asarray(states[name])[rows] for name in names}


def weighted_quartiles(values: FloatArray, weights: FloatArray) -> FloatArray:
    """(3,) of values (n,) that count by weights (n,) >= 0; NaN where all weights are 0."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    if not total[-1] > 0.0:
        return np.full(3, np.nan)
    at = np.searchsorted(total / total[-1], [0.25, 0.5, 0.75])
    return np.asarray(values[order][np.minimum(at, len(values) - 1)])


def speed_power(speeds_mps: FloatArray, variances: FloatArray, counts: FloatArray) -> float:
    """b of variance ~ V^b, from stretches of flight with these mean speeds (p,), residual variances
    (p,) and samples (p,).

    Noise of a sensor becomes noise of a coefficient through the dynamic pressure: b is -4 in still
    air; gusts make it less steep. 0 where the speeds do not tell: fewer than three, within 5 %, or
    a standard error above 1."""
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
    error = np.sqrt(float(w @ (y - b * x) ** 2) / sxx / max(valid.sum() - 2, 1))
    return b if error <= 1.0 else 0.0


def mean_power(middle: FloatArray, low: float, high: float, power: float) -> float:
    """Mean of V^power over a distribution known by its quartiles (3,), smallest and largest value,
    straight lines in between.
    """
    at = np.interp(
        np.linspace(0.005, 0.995, 100), [0.0, 0.25, 0.5, 0.75, 1.0], [low, *middle, high]
    )
    return float(np.mean(at**power))


# Which manoeuvres to fly: greedily those that narrow an interval most, for each second, in the
# mission's flight states.
#
# The measure is the mean half-width of the prediction interval over the states of the mission:
# a design for prediction where it is needed (I-optimality; Studden, Ann. Math. Stat. 42 (1971)
# 1613), not for parameters as such. Greedy: the best manoeuvre, then the next best given that
# one.

_FLIGHT_CHOICE_MAX_STATES = 500


@dataclass(frozen=True)
class Offer:
    """A manoeuvre that could be flown: ``seconds`` it takes, ``group`` of those that need no
    transition between them.
    """

    group: str
    seconds: float
    information: Information


@dataclass(frozen=True)
class Choice:
    """One choice: index of the offer, seconds with the transition that it needs, mean half-width
    once it is flown.
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
    """Offers to fly within ``budget_s`` seconds, best first; an offer may be taken several times.

    transition_s: what the first offer of a group costs besides. Empty when no offer fits, or none
    narrows anything."""
    thinned_states = thinned(states, bounds.states, _FLIGHT_CHOICE_MAX_STATES)
    X = regressors(bounds.normalised(thinned_states, outside), bounds.terms)
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
            more = offer.information
            half = _half_width(bounds, X, M + more.ZtZ, n + more.n)
            rate = (half_width - half) / seconds
            if best is None or rate > best[0]:
                best = rate, Choice(index, seconds, half)
        if best is None or not best[0] > 0.0:
            return choices
        choice = best[1]
        more = offers[choice.index].information
        M, n, half_width, remaining_s = (
            M + more.ZtZ,
            n + more.n,
            choice.half_width,
            remaining_s - choice.seconds,
        )
        visited_groups.add(offers[choice.index].group)
        choices.append(choice)


def _half_width(bounds: CoefficientBounds, X: FloatArray, M: FloatArray, n: float) -> float:
    t = bounds.t
    if bounds.parts is None:
        t = float(
            student_quantile(
                0.5 + 0.5 * bounds.confidence, n / bounds.leverage_factor - len(bounds.terms)
            )
        )
    h = np.einsum("ni,in->n", X, np.linalg.solve(M, X.T))
    return float(np.mean(bounds.half_width(h, t)))
