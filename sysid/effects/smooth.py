"""Fit a smooth term of one state, or one times a second, where no form of the catalogue fits.

    f(x) = b0 + b1 x + sum over j of z_j(x) v_j,    v ~ N(0, tau^2 I)                         (S)

The term is a cubic spline on even knots. The z_j are scaled so that sum v_j^2 is the integral of
f''^2 (O'Sullivan, Statistical Science 1, 1986), with the best straight line subtracted. The line's
part that the model has as parameters is left to these. G and u are the information and score of the
z_j, with the other columns projected out ((LM) of `information`), c is the dispersion. Then

    R(tau) = sum over i of [ tau^2 w_i^2 / (1 + tau^2 d_i) - ln(1 + tau^2 d_i) ],             (R)
    G/c = V d V',   w = V'u/c

is twice the increase of the restricted log likelihood over tau = 0. Smoothing by REML maximises
it. c reduces the information for coloured residuals (Rao and Scott, Annals of Statistics 12, 1984).
The band is that of the posterior (Nychka, JASA 83, 1988).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import tuned
from sysid.effects.catalogue import VARIABLES, coefficient_effect, words
from sysid.effects.information import DEPENDENT, Information, project_out, solve
from sysid.estimation import sandwich_covariance

SPANS = 10
"""Spans between knots over the range of the data.

The penalty, not the knots, limits the curvature; bumps narrower than two spans are smoothed.
"""
_LINE = 2
"""Number of columns of the straight line."""
_TAUS = np.logspace(-8.0, 8.0, 161)
"""Grid of tau^2 d, with d the largest of (R)."""


@dataclass(frozen=True)
class SmoothTerm:
    """Functions of ``state`` over the range of ``knots``, multiplied by the variable ``times`` if
    there is one.

    ``turn`` (B, K) holds the B-spline coefficients of each column: the line's two, then the z_j,
    the smoothest first.
    """

    coefficient: str
    state: str
    times: str | None
    knots: FloatArray
    turn: FloatArray

    @property
    def label(self) -> str:
        """``Cm_of_alpha``, ``CY_of_alpha_times_dr``: letters, digits and underscores alone."""
        return f"{self.coefficient}_of_{self.state}" + (
            f"_times_{self.times}" if self.times else ""
        )

    @property
    def ends(self) -> tuple[float, float]:
        """Range of the state in the data; beyond it the columns are constant."""
        return float(self.knots[3]), float(self.knots[-4])

    @property
    def unit(self) -> str:
        """The state's unit."""
        return VARIABLES[self.state]

    @property
    def name(self) -> str:
        """The term in words."""
        subject = coefficient_effect(self.coefficient, self.state).name.partition(" due to ")[0]
        times = f", times {words(self.times)}," if self.times else ""
        return f"smooth term of {words(self.state)}{times} in {subject}"

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns among the unknowns."""
        return tuple(f"smooth/{self.label}/{k}" for k in range(self.turn.shape[1]))

    def at(self, x: FloatArray) -> FloatArray:
        """Return the columns (n, K) at values (n,) of the state, with 1 for the second variable."""
        return _splines(x, self.knots) @ self.turn

    def inputs(self, variables: Mapping[str, FloatArray]) -> dict[str, tuple[int, FloatArray]]:
        """Return the columns along a flight, in the form of `prediction.Columns.inputs`.

        ``variables`` holds values (n,) of each variable.
        """
        rows = self.at(variables[self.state]) * (
            variables[self.times][:, None] if self.times else 1.0
        )
        return {
            n: (COEFFICIENTS.index(self.coefficient), rows[:, k])
            for k, n in enumerate(self.columns)
        }


def smooth_term(
    coefficient: str, state: str, times: str | None, variables: Mapping[str, FloatArray]
) -> SmoothTerm | None:
    """Return the term over the range of the data, from values (n,) of the variables.

    None if the state does not vary.
    """
    x = variables[state]
    low, high = float(x.min()), float(x.max())
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return None
    inner = np.linspace(low, high, SPANS + 1)
    step = inner[1] - inner[0]
    knots = np.concatenate([low + step * np.arange(-3, 0), inner, high + step * np.arange(1, 4)])
    # Products of second derivatives are quadratic in each span: two Gauss points integrate them
    # exactly.
    middle = 0.5 * (inner[1:] + inner[:-1])
    bend = _splines(
        np.concatenate([middle - step / math.sqrt(12.0), middle + step / math.sqrt(12.0)]), knots, 2
    )
    values, vectors = np.linalg.eigh(0.5 * step * bend.T @ bend)
    free = vectors[:, _LINE:] / np.sqrt(values[_LINE:])
    # The B-spline coefficients of a straight line are means of knots.
    centre = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0 - float(x.mean())
    line = np.column_stack([np.ones_like(centre), centre])
    weight = np.ones_like(x) if times is None else variables[times]
    rows = _splines(x, knots) * weight[:, None]
    part, *_ = np.linalg.lstsq(rows @ line, rows @ free, rcond=None)
    return SmoothTerm(coefficient, state, times, knots, np.hstack([line, free - line @ part]))


def _splines(x: FloatArray, knots: FloatArray, derivative: int = 0) -> FloatArray:
    """Return B-splines (n, B) or their derivative at values (n,)."""
    # Imported here: it takes a tenth of a second to load, and few flights need a smooth term.
    from scipy.interpolate import BSpline

    return np.asarray(
        BSpline(knots, np.eye(len(knots) - 4), 3)(np.clip(x, knots[3], knots[-4]), derivative)
    )


@dataclass(frozen=True)
class SmoothFit:
    """A term smoothed by REML.

    Attributes
    ----------
    values, cov : (K,) and (K, K) array
        Estimates and covariance of its columns; zero for those that the model has already.
    estimated : (K,) array
        Which columns are estimated.
    edf : float
        Effective degrees of freedom.
    ratio : float
        Twice the gained log likelihood: (R) and the line's part.
    merit : float
        ``ratio`` less twice the number of parameters.
    p : float
        Probability of such a gain by chance.
    precision : (K,) array
        1/tau^2 of the z_j, 0 of the line.
    dispersion : float
        c.
    """

    term: SmoothTerm
    values: FloatArray
    cov: FloatArray
    estimated: NDArray[np.bool_]
    edf: float
    ratio: float
    merit: float
    p: float
    precision: FloatArray
    dispersion: float

    @property
    def estimated_columns(self) -> tuple[str, ...]:
        """Names of the estimated columns."""
        return tuple(n for n, k in zip(self.term.columns, self.estimated, strict=True) if k)

    @property
    def column_values(self) -> dict[str, float]:
        """Values of the estimated columns by name."""
        return dict(zip(self.estimated_columns, self.values[self.estimated].tolist(), strict=True))

    def curve(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the curve and its standard error (n,) at values of the state."""
        rows = self.term.at(x)
        return rows @ self.values, np.sqrt(np.einsum("nk,kj,nj->n", rows, self.cov, rows))

    def stands_out(self, terms_tried: int) -> bool:
        """Return whether the term is significant as the best of so many, at level
        `FAMILY_ERROR_RATE`.
        """
        return self.p * terms_tried < tuned.FAMILY_ERROR_RATE


def fit_smooth(
    information: Information,
    free: Sequence[str],
    terms: Sequence[SmoothTerm],
    dispersion: float = 1.0,
) -> list[SmoothFit]:
    """Fit each of the terms alone beside the ``free`` columns."""
    G, u = information.total
    c = information.index([n for t in terms for n in t.columns])
    g, score, diagonal = (
        part / dispersion
        for part in (*project_out(G, u, information.index(free), c), np.diagonal(G)[c])
    )
    edges = np.cumsum([0, *(len(t.columns) for t in terms)]).tolist()
    parts = (slice(*ends) for ends in pairwise(edges))
    return [
        _fit_term(t, g[k, k], score[k], diagonal[k], dispersion)
        for t, k in zip(terms, parts, strict=True)
    ]


def _fit_term(
    term: SmoothTerm, G: FloatArray, u: FloatArray, diagonal: FloatArray, dispersion: float
) -> SmoothFit:
    """Fit a term from its projected information, score, and the information's diagonal before
    projection.
    """
    estimated = np.diagonal(G) > DEPENDENT * diagonal
    line, bends = np.flatnonzero(estimated[:_LINE]), _LINE + np.flatnonzero(estimated[_LINE:])
    ratio, precision = 0.0, np.zeros(len(u))
    gained = float(u[line] @ solve(G[np.ix_(line, line)], u[line, None])[:, 0])
    g, score = project_out(G, u, line, bends)
    d, V = np.linalg.eigh(g)
    w, d = V.T @ score, np.maximum(d, 0.0)
    if len(d) and d[-1] > 0.0:
        taus = _TAUS / d[-1]
        grown = 1.0 + np.outer(taus, d)
        risen = np.sum(taus[:, None] * w**2 / grown - np.log(grown), axis=1)
        ratio = max(0.0, float(risen.max()))
        precision[bends] = 1.0 / taus[int(np.argmax(risen))]
    some = np.concatenate([line, bends]) if ratio > 0.0 else line
    cov = np.zeros((len(u), len(u)))
    cov[np.ix_(some, some)] = solve(
        G[np.ix_(some, some)] + np.diag(precision[some]), np.eye(len(some))
    )
    mine = np.isin(np.arange(len(u)), some)
    edf, total, count = float(np.sum(cov * G)), ratio + gained, len(line)
    # A variance at its bound counts half (Self and Liang, JASA 82, 1987).
    p = float(special.chdtrc(count + 1, total)) if count else 0.5 * float(special.chdtrc(1, total))
    return SmoothFit(
        term, cov @ u, cov, mine, edf, total, total - 2.0 * (count + 1), p, precision, dispersion
    )


def colour_dispersion(
    information: Information, free: Sequence[str], fit: SmoothFit, residual: Sequence[FloatArray]
) -> float:
    """Return the dispersion c of a term, at least 1.

    It is the trace of the sandwich covariance of the smoothed term over that for white residuals
    ((n, m) per segment), in units of the term's covariance.
    """
    G, _ = information.total
    b, c = information.index(free), information.index(fit.estimated_columns)
    part = solve(G[np.ix_(b, b)], G[np.ix_(b, c)])
    projected_columns = [
        information.series(w, c) - information.series(w, b) @ part for w in information.white
    ]
    weight = fit.cov[np.ix_(fit.estimated, fit.estimated)]
    white = sum(np.einsum("nmk,nml->kl", a, a) for a in projected_columns)
    values, vectors = np.linalg.eigh(weight)
    root = np.sqrt(np.maximum(values, 0.0)) * vectors
    coloured = sandwich_covariance(projected_columns, list(residual), root.T)
    return max(1.0, float(np.trace(coloured) / np.sum(weight * white)))


def held_out_gain(
    information: Information, free: Sequence[str], fit: SmoothFit, part: NDArray[np.bool_]
) -> float:
    """Return the gain in 2 ln L on the other segments of the curve estimated on ``part``.

    `compare_parts` does the same for an effect.
    """
    b, c = information.index(free), information.index(fit.estimated_columns)
    (G, u), (other, score) = (
        project_out(*information.of_segments(segments), b, c) for segments in (part, ~part)
    )
    v = np.linalg.solve(G + fit.dispersion * np.diag(fit.precision[fit.estimated]), u)
    return float(2.0 * v @ score - v @ other @ v)


Form = Callable[[FloatArray], FloatArray]
_POWERS: Mapping[str, Form] = {
    "square": lambda x: x**2,
    "cube": lambda x: x**3,
    "magnitude": np.abs,
    "magnitude times itself": lambda x: np.abs(x) * x,
}
_FORMS_AT_KNOTS: Mapping[str, Callable[[float, float, FloatArray], FloatArray]] = {
    "kink at": lambda a, wide, x: np.maximum(x - a, 0.0),
    "step at": lambda a, wide, x: np.tanh((x - a) / wide),
    "hump at": lambda a, wide, x: np.exp(-(((x - a) / wide) ** 2)),
    "dead zone to": lambda a, wide, x: x - np.clip(x, -abs(a), abs(a)),
}


def named_forms(knots: FloatArray) -> dict[str, Form]:
    """Return named forms as functions of the state: powers, and kinks, steps, humps and dead zones
    at each knot.
    """
    places, wide = knots[4:-4], float(knots[4] - knots[3])
    placed = {
        f"{n} {a if n.endswith('at') else abs(a):.3g}": partial(f, a, wide)
        for n, f in _FORMS_AT_KNOTS.items()
        for a in places.tolist()
    }
    return {**_POWERS, **placed}


def similar_forms(fit: SmoothFit, x: FloatArray, weight: FloatArray) -> list[tuple[str, float]]:
    """Return the correlation of the curve with each kind of named form, the most similar first.

    Straight lines are removed from both; forms with a place are evaluated at the best knot. ``x``
    (n,) is the state at the data, ``weight`` (n,) the second variable there, or ones.
    """
    line = np.column_stack([np.ones_like(x), x]) * weight[:, None]

    def bending(values: FloatArray) -> FloatArray:
        """Return values without their straight line, of unit length."""
        y = values * weight
        remainder = y - line @ np.linalg.lstsq(line, y, rcond=None)[0]
        # A form that is a line at the data (a magnitude on one side of zero) leaves rounding only.
        size = float(np.linalg.norm(remainder))
        return (
            remainder / size if size > 1e-6 * float(np.linalg.norm(y)) else np.zeros_like(remainder)
        )

    curve_shape = bending(fit.curve(x)[0])
    every = sorted(
        ((n, float(curve_shape @ bending(f(x)))) for n, f in named_forms(fit.term.knots).items()),
        key=lambda r: -abs(r[1]),
    )
    best: dict[str, tuple[str, float]] = {}
    for name, correlation in every:
        best.setdefault(
            next((k for k in _FORMS_AT_KNOTS if name.startswith(k)), name), (name, correlation)
        )
    return list(best.values())
