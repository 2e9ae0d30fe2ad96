"""Information: normal equations of whitened innovations, score tests of candidate effects, and
covariances.

For free columns b (parameters and chosen effects) and the column c of one candidate, with the start
states projected out of all of them,

    g = G_cc - G_cb G_bb^-1 G_bc,   u = u_c - G_cb G_bb^-1 u_b,   estimate u/g,   t = u/sqrt(g),
    gain u^2/g          (LM)

The gain is twice the increase of the log likelihood: Rao's score (Lagrange multiplier) test. With
coloured residuals t is corrected like standard errors (`sysid.estimation.coloured_residuals`). Sums
are kept by group of segments, so that one part of the flights can be fitted and another confirm it.
"""

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
    LazyColumns,
    WhitenedSegment,
    neg2_log_likelihood,
    whiten_changes,
)
from sysid.estimation import sandwich_covariance

Index = NDArray[np.intp]
CorrectedEstimate = tuple[float, float, float]
"""Value, standard error corrected for colour, and that of white residuals."""
DEPENDENT = 1e-5
"""Share of a column that must remain after projection on the free columns; less is no
information.
"""


@dataclass(frozen=True)
class PastMoments:
    """Moments of columns and innovations with past innovations of vanes and gyros, by group.

    A damping derivative and the colour of the innovations are the autoregressive and the
    moving-average part of one process. With the colour taken to be certain, standard errors in a
    frozen field were half of the errors. So all its weights are estimated with the parameters, in
    each of these T channels from all P past innovations.

    Attributes
    ----------
    gram : (G, P, P) array
    moments : (G, T, P, K + 1) array
        With the K columns and the innovations.
    """

    gram: FloatArray
    moments: FloatArray

    def weights(self, groups: Index) -> FloatArray:
        """Return the weights (T, P, K + 1) that fit columns and innovations of groups best."""
        moments = self.moments[groups].sum(axis=0)
        T, P, size = moments.shape
        weights = solve(self.gram[groups].sum(axis=0), np.hstack([*moments]))
        return weights.reshape(P, T, size).swapaxes(0, 1)

    def projected(self, groups: Index) -> FloatArray:
        """Return what these weights take of the information and score, (K, K + 1)."""
        moments = self.moments[groups].sum(axis=0)
        return np.tensordot(moments[:, :, :-1], self.weights(groups), ([0, 1], [0, 1]))

    def without_values(self, values: FloatArray) -> PastMoments:
        """Return the moments after columns times ``values`` (K,) are added to the innovations."""
        moments = self.moments.copy()
        moments[..., -1] += moments[..., :-1] @ values
        return replace(self, moments=moments)


@dataclass(frozen=True)
class Information:
    """Normal equations of whitened columns and innovations, by group of segments.

    Attributes
    ----------
    names : tuple of str
        The K columns.
    gram, score : (G, K, K) and (G, K) array
        Y'Y and Y'e of each group.
    group : (S,) array
        Group of each segment.
    prior : (K,) array
        Prior information.
    white : sequence of WhitenedSegment
        The filtered segments.
    stored : tuple of str or None
        Columns that ``white`` holds, in its order; None for all. Others are computed on demand.
    past : PastMoments or None
        Moments with past innovations if these have a colour.
    cache : dict
        Results of `corrected_estimates`, which a search needs many times.
    """

    names: tuple[str, ...]
    gram: FloatArray
    score: FloatArray
    group: Index
    prior: FloatArray
    white: Sequence[WhitenedSegment]
    stored: tuple[str, ...] | None = None
    past: PastMoments | None = None
    cache: dict[frozenset[str], dict[str, CorrectedEstimate]] = field(
        default_factory=dict, init=False
    )

    def index(self, names: Iterable[str]) -> Index:
        """Return the positions (n,) of columns in ``gram`` and ``score``.

        Raises KeyError for an unknown name.
        """
        return np.array([self._where[n] for n in names], dtype=np.intp)

    @cached_property
    def _where(self) -> dict[str, int]:
        return {n: i for i, n in enumerate(self.names)}

    @cached_property
    def total(self) -> tuple[FloatArray, FloatArray]:
        """Information (K, K), prior included, and score (K,) of all segments."""
        return self._of_groups(np.arange(len(self.gram)))

    def of_segments(self, segments: NDArray[np.bool_] | None) -> tuple[FloatArray, FloatArray]:
        """Return information (K, K), prior included, and score (K,) of some segments.

        Raises ValueError if a group is in it only in part.
        """
        if segments is None:
            return self.total
        some = np.unique(self.group[segments])
        if np.isin(self.group, some).sum() != np.sum(segments):
            raise ValueError("all segments of a group must lie in one part")
        return self._of_groups(some)

    def _of_groups(self, groups: Index) -> tuple[FloatArray, FloatArray]:
        """Return information (K, K), prior included, and score (K,) of groups."""
        G, u = self.gram[groups].sum(axis=0), self.score[groups].sum(axis=0)
        if self.past is not None:
            inside = self.past.projected(groups)
            G, u = G - inside[:, :-1], u - inside[:, -1]
        return G + np.diag(self.prior), u

    @cached_property
    def _weights(self) -> FloatArray | None:
        """Weights (T, P, K + 1) of past innovations per unit of each column and of the
        innovations.
        """
        return None if self.past is None else self.past.weights(np.arange(len(self.gram)))

    @property
    def with_fixed_colour(self) -> Information:
        """The information if the colour of the innovations is taken to be certain."""
        return replace(self, past=None)

    @property
    def confirming(self) -> NDArray[np.bool_] | None:
        """Mask (S,) of the segments outside the first group, which confirm the others; None if
        there is one group.
        """
        part = self.group > 0
        return part if part.any() and not part.all() else None

    def series(self, w: WhitenedSegment, some: Index) -> FloatArray:
        """Return columns (n, m, C) of a segment, past innovations projected out.

        Raises KeyError for a column that is neither stored nor computed on demand.
        """
        out = self._white_columns(w, some)
        if w.past is not None and self._weights is not None:
            out[:, w.motion] -= np.moveaxis(w.past @ self._weights[:, :, some], 0, 1)
        return out

    def innovations(self, w: WhitenedSegment) -> FloatArray:
        """Return the innovations (n, m) of a segment, past innovations projected out."""
        if w.past is None or self._weights is None:
            return w.residual
        out = w.residual.copy()
        out[:, w.motion] -= w.past @ self._weights[:, :, -1].T
        return out

    def _white_columns(self, w: WhitenedSegment, some: Index) -> FloatArray:
        """Return columns (n, m, C) of a segment."""
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
        """Return the Gauss-Newton step (K,) of all columns except ``fixed``, and its length in
        standard errors.
        """
        _, u = self.total
        delta = self.estimates(self.index(n for n in self.names if n not in fixed))
        return delta, math.sqrt(max(float(delta @ u), 0.0))

    def estimates(self, free: Index) -> FloatArray:
        """Return estimates (K,) of the free columns, 0 for the others."""
        G, u = self.total
        out = np.zeros(len(self.names))
        out[free] = solve(G[np.ix_(free, free)], u[free, None])[:, 0]
        return out

    def without_values(self, values: Mapping[str, float]) -> Information:
        """Return the information of a model without the effects ``values`` (by name).

        Their contribution is added to the residuals again, so that effects can be selected anew
        from replays with some of them.
        """
        v = np.zeros(len(self.names))
        v[self.index(values)] = [*values.values()]
        used = np.flatnonzero(v)
        white = [
            replace(w, residual=w.residual + self._white_columns(w, used) @ v[used])
            for w in self.white
        ]
        past = None if self.past is None else self.past.without_values(v)
        return replace(self, score=self.score + self.gram @ v, white=white, past=past)

    def residual(self, delta: FloatArray) -> list[FloatArray]:
        """Return whitened innovations (n, m) of each segment after a change ``delta`` (K,) of the
        estimates; NaN where nothing was measured.
        """
        used = np.flatnonzero(delta)
        return [
            np.where(
                w.is_measured, self.innovations(w) - self.series(w, used) @ delta[used], np.nan
            )
            for w in self.white
        ]


def normal_equations(
    white: Iterable[WhitenedSegment],
    names: Sequence[str],
    group: Sequence[int] | NDArray[np.bool_],
    prior: Mapping[str, float],
    stored: Sequence[str] | None = None,
) -> Information:
    """Sum the normal equations of filtered segments.

    Parameters
    ----------
    white : iterable of WhitenedSegment
        Filtered segments.
    names : sequence of str
        Their columns.
    group : (S,) array
        Group of each segment, from 0.
    prior : mapping
        Kind of column (its name up to the first /) to its prior standard deviation.
    stored : sequence of str, optional
        Columns to keep, by default all. Those of candidates would take most of the memory.

    Returns
    -------
    Information
    """
    K, groups = len(names), np.asarray(group, dtype=np.intp)
    gram, score = np.zeros((groups.max() + 1, K, K)), np.zeros((groups.max() + 1, K))
    segments: list[WhitenedSegment] = []
    past: PastMoments | None = None
    at = None if stored is None else [list(names).index(n) for n in stored]
    for s, w in enumerate(white):
        flat = w.columns.reshape(-1, K)
        scale = np.sqrt(np.einsum("ij,ij->j", flat, flat, dtype=np.float64))
        # Single precision needs columns of unit length: they differ by many powers of ten.
        unit = flat / np.where(scale > 0.0, scale, 1.0).astype(np.float32)
        gram[groups[s]] += (unit.T @ unit).astype(np.float64) * np.outer(scale, scale)
        score[groups[s]] += flat.astype(np.float64).T @ w.residual.ravel()
        if w.past is not None:
            if past is None:
                P, T = w.past.shape[1], len(w.motion)
                past = PastMoments(np.zeros((len(gram), P, P)), np.zeros((len(gram), T, P, K + 1)))
            past.gram[groups[s]] += w.past.T @ w.past
            for t, channel in enumerate(w.motion):
                series = np.column_stack([w.columns[:, channel], w.residual[:, channel]])
                past.moments[groups[s], t] += w.past.T @ series
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
        past,
    )


def solve(G: FloatArray, right: FloatArray) -> FloatArray:
    """Solve G x = right for an information matrix; undetermined directions of x are zero."""
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


def project_out(
    G: FloatArray, u: FloatArray, free: Index, some: Index
) -> tuple[FloatArray, FloatArray]:
    """Return information (C, C) and score (C,) of columns ``some`` with the ``free`` ones projected
    out, as in (LM).
    """
    x = solve(G[np.ix_(free, free)], np.column_stack([G[np.ix_(free, some)], u[free]]))
    return G[np.ix_(some, some)] - G[np.ix_(some, free)] @ x[:, :-1], u[some] - G[
        np.ix_(some, free)
    ] @ x[:, -1]


def marginal_information(
    information: Information, names: Sequence[str], values: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the information (n, n) of columns with the other parameters projected out.

    Also returns its product (n,) with their estimates; both add up over independent flights.
    ``values`` are the values about which the model was linearised. Effects are not in the model.
    """
    G, u = information.total
    nuisance = [n for n in information.names if n not in names and not n.startswith("effect/")]
    marginal, score = project_out(G, u, information.index(nuisance), information.index(names))
    return marginal, score + marginal @ np.array([values[n] for n in names])


@dataclass(frozen=True)
class Scores:
    """Score tests of C candidates, equation (LM).

    Attributes
    ----------
    names : tuple of str
    estimate, information, t, gain : (C,) array
        u/g, g, t and gain.
    share : (C,) array
        Share of each column that is orthogonal to the free columns.
    """

    names: tuple[str, ...]
    estimate: FloatArray
    information: FloatArray
    t: FloatArray
    gain: FloatArray
    share: FloatArray


def score_tests(
    information: Information,
    free: Sequence[str],
    candidates: Sequence[str],
    segments: NDArray[np.bool_] | None = None,
) -> Scores:
    """Evaluate (LM) for every candidate; NaN where its column depends on the free columns."""
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


def corrected_estimate(
    information: Information, free: Sequence[str], candidate: str
) -> CorrectedEstimate:
    """Return a candidate's estimate, its standard error for coloured residuals, and that for white
    ones.
    """
    return corrected_estimates(information, [*free, candidate], [candidate])[candidate]


def corrected_estimates(
    information: Information, names: Sequence[str], requested: Sequence[str]
) -> dict[str, CorrectedEstimate]:
    """Return `corrected_estimate` of the ``requested`` columns, all ``names`` estimated jointly.

    The residuals and their colour are the same for all of them and computed once.
    """
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
) -> dict[str, CorrectedEstimate]:
    """Compute the estimates of `corrected_estimates`."""
    names, some = list(names), information.index(names)
    G = information.total[0][np.ix_(some, some)]
    delta = information.estimates(some)[some]
    # Project each column on the others.
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
        innovations = information.innovations(w)
        residuals.append(np.where(w.is_measured, innovations - columns @ delta, np.nan))
    # Projected on the others, a column has the information g alone. One without information, such
    # as a rate limit that is never reached, has no standard error.
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.where(g > 0.0, 1.0 / g, np.nan)
    covariance = sandwich_covariance(projected_columns, residuals, np.diag(np.nan_to_num(variance)))
    plain = np.sqrt(variance)
    std = np.maximum(np.sqrt(np.maximum(np.diagonal(covariance), 0.0)), plain)
    return {
        n: (float(delta[c]), float(std[k]), float(plain[k]))
        for k, (n, c) in enumerate(zip(requested, places, strict=True))
    }


def compare_parts(
    information: Information, free: Sequence[str], candidate: str, part: NDArray[np.bool_]
) -> tuple[float, float]:
    """Compare a candidate between two parts of the flights.

    Returns the gain on the other segments of the value estimated on ``part``, and the difference
    of the two parts' estimates in standard errors. The free columns are estimated in each part.
    """
    sides = [score_tests(information, free, [candidate], side) for side in (part, ~part)]
    (a, ga), (b, gb) = ((float(s.estimate[0]), float(s.information[0])) for s in sides)
    gain = gb * (2.0 * a * b - a * a)  # 2 u a - g a^2 with u = g b
    return gain, (a - b) / math.sqrt(1.0 / ga + 1.0 / gb)


def column_correlations(
    information: Information, free: Sequence[str], first: str, candidates: Sequence[str]
) -> FloatArray:
    """Return correlations (C,) of a column with others, the free columns projected out of all."""
    projected_information, _ = project_out(
        *information.total, information.index(free), information.index([first, *candidates])
    )
    size = np.sqrt(np.maximum(np.diagonal(projected_information), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(projected_information[0, 1:] / (size[0] * size[1:]))


# The colour of innovations is estimated with the model.

COLOUR_ITERATIONS = 2
"""Iterations between parameters and the innovations' colour."""
COLOUR_CANDIDATES = 6
"""Candidates for which the innovations' colour is estimated again."""


def fit_colour(
    followed: Sequence[FilteredSegment],
    columns: Sequence[Columns],
    prior: Mapping[str, float],
    colour: InnovationColour | None = None,
    *,
    fixed: bool = False,
) -> tuple[InnovationColour | None, Information]:
    """Estimate the innovations' colour with the parameters, and the information given it.

    Parameters given the colour and the colour given the parameters alternate (Cochrane and Orcutt,
    JASA 44, 1949). With ``fixed`` the colour stays.
    """
    changes = [f.with_columns(columns[k]).columns for k, f in enumerate(followed)]
    return _fit_colour(followed, columns[0].names, changes, prior, colour, fixed=fixed)


def _fit_colour(
    followed: Sequence[FilteredSegment],
    names: Sequence[str],
    changes: Sequence[NDArray[np.float32]],
    prior: Mapping[str, float],
    colour: InnovationColour | None = None,
    *,
    fixed: bool = False,
    plain: Information | None = None,
) -> tuple[InnovationColour | None, Information]:
    """Return `fit_colour` from the innovations' ``changes`` (n, m, K) with the columns.

    ``plain`` is the information without a colour, of these columns at least.
    """

    def information(colour: InnovationColour | None) -> Information:
        """Return the normal equations with a colour."""
        white = whiten_changes(followed, changes, colour)
        return normal_equations(white, names, [0] * len(white), prior)

    if plain is None:
        current = information(colour)
        if fixed:
            return colour, current
        plain = information(None) if colour else current
        step = current.step()[0]
    else:
        step = plain.estimates(plain.index(names))[plain.index(names)]
    for _ in range(COLOUR_ITERATIONS):
        delta = np.zeros(len(plain.names))
        delta[plain.index(names)] = step
        colour = innovation_colour(plain.residual(delta))
        if colour is None:
            return None, plain if plain.names == tuple(names) else information(None)
        current = information(colour)
        step = current.step()[0]
    return colour, current


def least_cost(colour: InnovationColour | None, information: Information) -> float:
    """Return minus twice the log likelihood at the estimates of all columns, plus the colour's
    penalty.
    """
    information = information.with_fixed_colour
    delta, score = information.step()[0], information.total[1]
    penalty = colour.penalty if colour else 0.0
    # Models are compared with the air of each free.
    square = sum(w.air_square for w in information.white)
    return neg2_log_likelihood(information.white) - square - float(delta @ score) + penalty


def likeliest_colour(
    followed: Sequence[FilteredSegment],
    columns: LazyColumns,
    fitted: tuple[InnovationColour | None, Information],
    plain: Information,
    required_gains: Mapping[str, float],
    prior: Mapping[str, float],
) -> InnovationColour | None:
    """Return the innovations' colour of the likeliest model: without or with one candidate.

    Residuals of a missing effect are coloured. A colour that is estimated without the effect
    absorbs it: |t| falls from 60 to 10. So the colour is estimated with each of the strongest
    candidates in turn (profile likelihood), and one that gains what is required of it decides.

    Parameters
    ----------
    columns : LazyColumns
        Columns of the model and of all candidates.
    fitted : tuple
        The colour estimated with the model, and the information given it.
    plain : Information
        Information of all columns without a colour.
    required_gains : mapping
        Candidate to the gain in 2 ln L that is required of it.
    prior : mapping
        As in `normal_equations`.
    """
    colour, information = fitted
    free = list(information.names)
    gains = np.nan_to_num(score_tests(plain, free, [*required_gains]).gain)
    strongest = [[*required_gains][k] for k in np.argsort(-gains)[:COLOUR_CANDIDATES]]
    base_cost = least_cost(colour, information)
    # One pass through the filter serves all colours.
    some = [*free, *strongest]
    passed = [f.with_columns(columns.some(k, some)).columns for k, f in enumerate(followed)]
    white = whiten_changes(followed, passed, None)
    shared = normal_equations(white, some, [0] * len(white), prior)
    for place, key in enumerate(strongest, len(free)):
        with_effect = [np.take(change, [*range(len(free)), place], 2) for change in passed]
        trial = _fit_colour(followed, [*free, key], with_effect, prior, plain=shared)
        cost = least_cost(*trial) + required_gains[key]
        if cost < base_cost:
            base_cost, colour = cost, trial[0]
    return colour
