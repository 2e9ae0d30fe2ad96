"""Information: normal equations of whitened innovations, score tests of candidate effects, and
covariances.

With columns b of the parameters already free and one column c per candidate (start states projected
out of all of them),

    g = G_cc - G_cb G_bb^-1 G_bc,   u = u_c - G_cb G_bb^-1 u_b,   estimate u/g,   t = u/sqrt(g),
    gain u^2/g          (LM)

the gain being twice the rise of the log likelihood: Rao's score (Lagrange multiplier) test. Where
residuals are coloured, t is corrected as standard errors are (coloured.py). Sums are kept by
segment, so that any part of the flights can be fitted and any other asked whether it agrees."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.effects.coloured_innovations import InnovationColour, innovation_colour
from sysid.effects.prediction import (
    Columns,
    FilteredSegment,
    MadeColumns,
    White,
    minus_twice_log,
    whitened,
)
from sysid.estimation import coloured_information

Index = NDArray[np.intp]
Estimate = tuple[float, float, float]
"""Value, standard error corrected for colour, and that of white residuals."""
DEPENDENT = 1e-5
"""Share of a column that must be left after the free parameters' part is taken out; less is no
information.
"""


@dataclass(frozen=True)
class Information:
    """Sums of whitened columns and innovations over groups of segments.

    gram (G, K, K), score (G, K): Y'Y and Y'e of each group; group (S,): that of each segment;
    prior (K,): information from elsewhere.
    stored : names of the columns that ``white`` has, in its order; None: all. Others are computed
        again, or are missing.
    cache : results of `corrected_estimates`; a search needs the same columns many times
    """

    names: tuple[str, ...]
    gram: FloatArray
    score: FloatArray
    group: Index
    prior: FloatArray
    white: Sequence[White]
    stored: tuple[str, ...] | None = None
    cache: dict[frozenset[str], dict[str, Estimate]] = field(default_factory=dict, init=False)

    def index(self, names: Iterable[str]) -> Index:
        """Positions (n,) of those unknowns in ``gram`` and ``score``.

        Raises KeyError for a name that is not there.
        """
        return np.array([self._where[n] for n in names], dtype=np.intp)

    @cached_property
    def _where(self) -> dict[str, int]:
        return {n: i for i, n in enumerate(self.names)}

    @cached_property
    def total(self) -> tuple[FloatArray, FloatArray]:
        """Information (n, n), prior included, and score (n,), summed over all manoeuvres."""
        return self.gram.sum(axis=0) + np.diag(self.prior), self.score.sum(axis=0)

    def of_segments(self, segments: NDArray[np.bool_] | None) -> tuple[FloatArray, FloatArray]:
        """(K, K) information and (K,) score of some segments, whole groups of them, priors
        included. Raises ValueError.
        """
        if segments is None:
            return self.total
        some = np.unique(self.group[segments])
        if np.isin(self.group, some).sum() != np.sum(segments):
            raise ValueError("segments of one group are in no two parts")
        return self.gram[some].sum(axis=0) + np.diag(self.prior), self.score[some].sum(axis=0)

    @property
    def confirming(self) -> NDArray[np.bool_] | None:
        """(S,) segments not of the first group, which confirm what that says and it them; None
        where it is alone.
        """
        part = self.group > 0
        return part if part.any() and not part.all() else None

    def series(self, w: White, some: Index) -> FloatArray:
        """(n, m, C) columns of a segment.

        Raises KeyError for one that is neither held nor made again.
        """
        if self.stored is None:
            return w.columns[:, :, some].astype(np.float64)
        names = np.array([self.names[k] for k in some], dtype=str)
        is_stored = np.isin(names, self.stored)
        out = np.empty((*w.residual.shape, len(names)))
        out[:, :, is_stored] = w.columns[:, :, [self.stored.index(n) for n in names[is_stored]]]
        if missing := names[~is_stored].tolist():
            if w.more is None:
                raise KeyError(missing[0])
            out[:, :, ~is_stored] = w.more(missing)
        return out

    def step(self, fixed: Sequence[str] = ()) -> tuple[FloatArray, float]:
        """Gauss-Newton step of all columns but those held (K,), and its length in standard
        errors.
        """
        _, u = self.total
        delta = self.estimates(self.index(n for n in self.names if n not in fixed))
        return delta, math.sqrt(max(float(delta @ u), 0.0))

    def estimates(self, free: Index) -> FloatArray:
        """(K,) estimates of the free columns, 0 elsewhere."""
        G, u = self.total
        out = np.zeros(len(self.names))
        out[free] = solve(G[np.ix_(free, free)], u[free, None])[:, 0]
        return out

    def without_values(self, values: Mapping[str, float]) -> Information:
        """The evidence as it would be had the columns ``values`` not been in the model flown: their
        part is back in the residual.

        So one flight, flown with the effects chosen, serves to choose again.
        """
        v = np.zeros(len(self.names))
        v[self.index(values)] = [*values.values()]
        used = np.flatnonzero(v)
        white = [
            replace(w, residual=w.residual + self.series(w, used) @ v[used]) for w in self.white
        ]
        return replace(self, score=self.score + self.gram @ v, white=white)

    def residual(self, delta: FloatArray) -> list[FloatArray]:
        """[(n, m)] whitened innovations after a change of the columns, NaN where nothing was
        measured.
        """
        used = np.flatnonzero(delta)
        return [
            np.where(w.is_measured, w.residual - self.series(w, used) @ delta[used], np.nan)
            for w in self.white
        ]


def normal_equations(
    white: Iterable[White],
    names: Sequence[str],
    group: Sequence[int] | NDArray[np.bool_],
    prior: Mapping[str, float],
    stored: Sequence[str] | None = None,
) -> Information:
    """Information from filtered segments.

    Parameters
    ----------
    group : (S,) whose sums are kept together, 0 and up
    prior : kind of column (its name up to the first /) -> standard deviation known beforehand
    stored : names of the columns to keep; None: all. Those of candidates would take most of the
        memory
    """
    K, groups = len(names), np.asarray(group, dtype=np.intp)
    gram, score = np.zeros((groups.max() + 1, K, K)), np.zeros((groups.max() + 1, K))
    segments: list[White] = []
    at = None if stored is None else [list(names).index(n) for n in stored]
    for s, w in enumerate(white):
        flat = w.columns.reshape(-1, K)
        scale = np.sqrt(np.einsum("ij,ij->j", flat, flat, dtype=np.float64))
        # Columns differ by many powers of ten; single precision is for columns of unit length.
        unit = flat / np.where(scale > 0.0, scale, 1.0).astype(np.float32)
        gram[groups[s]] += (unit.T @ unit).astype(np.float64) * np.outer(scale, scale)
        score[groups[s]] += flat.astype(np.float64).T @ w.residual.ravel()
        segments.append(w if at is None else replace(w, columns=w.columns[:, :, at]))
    prior_information = np.array([1.0 / prior.get(n.split("/")[0], math.inf) ** 2 for n in names])
    return Information(
        tuple(names),
        gram,
        score,
        groups,
        prior_information,
        segments,
        None if stored is None else tuple(stored),
    )


def solve(G: FloatArray, right: FloatArray) -> FloatArray:
    """G x = right for an information matrix whose lost directions get nothing."""
    if not len(G):
        return np.zeros_like(right)
    scale = np.sqrt(np.maximum(np.diagonal(G), 0.0))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(G / np.outer(scale, scale))
    determined = values > 1e-9 * max(values[-1], 1e-300)
    basis = vectors[:, determined]
    return np.asarray(
        (basis @ ((basis.T @ (right / scale[:, None])) / values[determined][:, None]))
        / scale[:, None]
    )


def projected(
    G: FloatArray, u: FloatArray, free: Index, some: Index
) -> tuple[FloatArray, FloatArray]:
    """Information (C, C) and score (C,) of columns ``some`` with those that are ``free`` taken out,
    as in (LM).
    """
    x = solve(G[np.ix_(free, free)], np.column_stack([G[np.ix_(free, some)], u[free]]))
    return G[np.ix_(some, some)] - G[np.ix_(some, free)] @ x[:, :-1], u[some] - G[
        np.ix_(some, free)
    ] @ x[:, -1]


def marginal_information(
    information: Information, names: Sequence[str], values: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Information (n, n) of the unknowns ``names`` with everything else but effects projected out,
    and its product (n,) with their estimates: both add up over independent flights.

    values : about which the columns are
    """
    G, u = information.total
    nuisance = [n for n in information.names if n not in names and not n.startswith("effect/")]
    marginal, score = projected(G, u, information.index(nuisance), information.index(names))
    return marginal, score + marginal @ np.array([values[n] for n in names])


@dataclass(frozen=True)
class Scores:
    """Of candidates c, given free columns: estimate, information g, t, gain (all (C,)), share: what
    of a column is its own.
    """

    names: tuple[str, ...]
    estimate: FloatArray
    information: FloatArray
    t: FloatArray
    gain: FloatArray
    share: FloatArray


def scores(
    information: Information,
    free: Sequence[str],
    candidates: Sequence[str],
    segments: NDArray[np.bool_] | None = None,
) -> Scores:
    """Equation (LM) for every candidate; NaN where the data hold nothing of it that the free
    columns do not.
    """
    G, u = information.of_segments(segments)
    b, c = information.index(free), information.index(candidates)
    x = solve(G[np.ix_(b, b)], np.column_stack([G[np.ix_(b, c)], u[b]]))
    diagonal = np.diagonal(G)[c]
    g = diagonal - np.einsum("bc,bc->c", G[np.ix_(b, c)], x[:, :-1])
    u_projected = u[c] - G[np.ix_(c, b)] @ x[:, -1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(diagonal > 0.0, g / diagonal, 0.0)
        g = np.where(share > DEPENDENT, g, np.nan)
        return Scores(
            tuple(candidates),
            u_projected / g,
            g,
            u_projected / np.sqrt(g),
            u_projected**2 / g,
            share,
        )


def corrected_estimate(information: Information, free: Sequence[str], candidate: str) -> Estimate:
    """Estimate of one candidate, its standard error by the residuals' colour after the fit, and the
    error were they white.
    """
    return corrected_estimates(information, [*free, candidate], [candidate])[candidate]


def corrected_estimates(
    information: Information, names: Sequence[str], requested: Sequence[str]
) -> dict[str, Estimate]:
    """`corrected` of each of the ``requested`` among the columns ``names``, all estimated together:
    what the fit leaves, and so its colour, is the same for all of them and computed once."""
    estimates = information.cache.setdefault(frozenset(names), {})
    if not estimates.keys() >= {*requested}:
        estimates |= _compute_corrected(
            information,
            names,
            [*requested, *(n for n in names if n.startswith("effect/") and n not in requested)],
        )
    return {n: estimates[n] for n in requested}


def _compute_corrected(
    information: Information, names: Sequence[str], requested: Sequence[str]
) -> dict[str, Estimate]:
    names, some = list(names), information.index(names)
    G = information.total[0][np.ix_(some, some)]
    delta = information.estimates(some)[some]
    # What the others leave of a column.
    combination, g = np.zeros((len(some), len(requested))), np.empty(len(requested))
    places = [names.index(name) for name in requested]
    for k, c in enumerate(places):
        b = np.flatnonzero(np.arange(len(some)) != c)
        combination[b, k], combination[c, k] = -solve(G[np.ix_(b, b)], G[b, c][:, None])[:, 0], 1.0
        g[k] = G[c] @ combination[:, k]
    projected_columns, residuals = [], []
    for w in information.white:
        columns = information.series(w, some)
        projected_columns.append(columns @ combination)
        residuals.append(np.where(w.is_measured, w.residual - columns @ delta, np.nan))
    bracket = np.diagonal(coloured_information(projected_columns, residuals))
    # Where the data hold nothing of a column, as of a rate limit that is never reached, it has no
    # standard error.
    with np.errstate(invalid="ignore", divide="ignore"):
        plain = 1.0 / np.sqrt(np.where(g > 0.0, g, np.nan))
        std = np.maximum(np.sqrt(np.maximum(bracket, 0.0)) * plain**2, plain)
    return {
        n: (float(delta[c]), float(std[k]), float(plain[k]))
        for k, (n, c) in enumerate(zip(requested, places, strict=True))
    }


def agreement(
    information: Information, free: Sequence[str], candidate: str, part: NDArray[np.bool_]
) -> tuple[float, float]:
    """(gain on the other segments of the value estimated on ``part``, difference of the two
    estimates in standard errors).

    The free columns are fitted anew on either side: only the effect itself is carried over.
    """
    sides = [scores(information, free, [candidate], side) for side in (part, ~part)]
    (a, ga), (b, gb) = ((float(s.estimate[0]), float(s.information[0])) for s in sides)
    gain = gb * (2.0 * a * b - a * a)  # 2 u a - g a^2 with u = g b
    return gain, (a - b) / math.sqrt(1.0 / ga + 1.0 / gb)


def column_correlations(
    information: Information, free: Sequence[str], first: str, candidates: Sequence[str]
) -> FloatArray:
    """Correlation (C,) of what is left of a column with what is left of others, the free columns
    taken out.
    """
    projected_information, _ = projected(
        *information.total, information.index(free), information.index([first, *candidates])
    )
    size = np.sqrt(np.maximum(np.diagonal(projected_information), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(projected_information[0, 1:] / (size[0] * size[1:]))


# The colour of innovations is estimated with the model.

COLOUR_TURNS = 2
"""Estimates of the innovations' colour, one after the other."""
COLOURS_TRIED = 6
"""Candidates that are given a colour of the innovations of their own."""


def with_colour(
    followed: Sequence[FilteredSegment],
    columns: Sequence[Columns],
    prior: Mapping[str, float],
    colour: InnovationColour | None = None,
    *,
    fixed: bool = False,
) -> tuple[InnovationColour | None, Information]:
    """The innovations' colour beside the best parameters, or ``fixed``, and information with it.

    From an estimate of the colour on, by turns: parameters given the colour, the colour given the
    parameters (Cochrane and Orcutt, JASA 44, 1949).
    """

    def information(colour: InnovationColour | None) -> Information:
        white = whitened(followed, columns, colour)
        return normal_equations(white, columns[0].names, [0] * len(white), prior)

    current = information(colour)
    if fixed:
        return colour, current
    plain = information(None) if colour else current
    for _ in range(COLOUR_TURNS):
        colour = innovation_colour(plain.residual(current.step()[0]))
        if colour is None:
            return None, plain
        current = information(colour)
    return colour, current


def least_cost(colour: InnovationColour | None, information: Information) -> float:
    """Minus twice the log likelihood after a step to the estimates of all columns, and the penalty
    of the colour.
    """
    delta, score = information.step()[0], information.total[1]
    penalty = colour.penalty if colour else 0.0
    return minus_twice_log(information.white) - float(delta @ score) + penalty


def likeliest_colour(
    followed: Sequence[FilteredSegment],
    columns: MadeColumns,
    fitted: tuple[InnovationColour | None, Information],
    plain: Information,
    required_gains: Mapping[str, float],
    prior: Mapping[str, float],
) -> InnovationColour | None:
    """The colour of the likeliest model: the one fitted, or that with one candidate.

    What an effect leaves is coloured, too. A colour that is estimated without the effect absorbs
    it, |t| 10 in place of 60. So each of the strongest candidates is given a colour of its own
    (profile likelihood), and decides the colour if it gains what is required of it.

    Parameters
    ----------
    columns : those of the model and of its candidates
    fitted : the colour estimated with the model, and information of its columns with that
    plain : information of all columns without a colour
    required_gains : candidate -> gain in 2 ln L that is required of it
    """
    colour, information = fitted
    free = list(information.names)
    gains = np.nan_to_num(scores(plain, free, [*required_gains]).gain)
    strongest = [[*required_gains][k] for k in np.argsort(-gains)[:COLOURS_TRIED]]
    base_cost = least_cost(colour, information)
    for key in strongest:
        with_effect = [columns.some(k, [*free, key]) for k in range(len(columns))]
        trial = with_colour(followed, with_effect, prior)
        cost = least_cost(*trial) + required_gains[key]
        if cost < base_cost:
            base_cost, colour = cost, trial[0]
    return colour
