"""Score tests of candidate effects on whitened innovations: who explains what is left, and can the
data separate them.

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
from sysid.effects.prediction import White
from sysid.estimation import coloured_information

Index = NDArray[np.intp]
Estimate = tuple[float, float, float]
"""Value, standard error corrected for colour, and that of white residuals."""
DEPENDENT = 1e-5
"""Share of a column that must be left after the free parameters' part is taken out; less is no
information.
"""


@dataclass(frozen=True)
class Evidence:
    """Sums of whitened columns and innovations over groups of segments.

    gram (G, K, K), score (G, K): Y'Y and Y'e of each group; group (S,): that of each segment;
    prior (K,): information from elsewhere.
    held        names of the columns that ``white`` has, in its order; None: all. Others it makes
                again or does not have.
    remembered  results of `corrected_each`: a search needs the same columns again and again
    """

    names: tuple[str, ...]
    gram: FloatArray
    score: FloatArray
    group: Index
    prior: FloatArray
    white: Sequence[White]
    held: tuple[str, ...] | None = None
    remembered: dict[frozenset[str], dict[str, Estimate]] = field(default_factory=dict, init=False)

    def index(self, names: Iterable[str]) -> Index:
        """Positions (n,) of those unknowns in ``gram`` and ``score``.

        Raises KeyError for a name that is not there.
        """
        return np.array([self._where[n] for n in names], dtype=np.intp)

    @cached_property
    def _where(self) -> dict[str, int]:
        return {n: i for i, n in enumerate(self.names)}

    @cached_property
    def everything(self) -> tuple[FloatArray, FloatArray]:
        """Information (n, n), prior included, and score (n,), summed over all manoeuvres."""
        return self.gram.sum(axis=0) + np.diag(self.prior), self.score.sum(axis=0)

    def part(self, segments: NDArray[np.bool_] | None) -> tuple[FloatArray, FloatArray]:
        """(K, K) information and (K,) score of some segments, whole groups of them, priors
        included. Raises ValueError.
        """
        if segments is None:
            return self.everything
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
        if self.held is None:
            return w.columns[:, :, some].astype(np.float64)
        names = np.array([self.names[k] for k in some], dtype=str)
        here = np.isin(names, self.held)
        out = np.empty((*w.residual.shape, len(names)))
        out[:, :, here] = w.columns[:, :, [self.held.index(n) for n in names[here]]]
        if missing := names[~here].tolist():
            if w.more is None:
                raise KeyError(missing[0])
            out[:, :, ~here] = w.more(missing)
        return out

    def step(self, held: Sequence[str] = ()) -> tuple[FloatArray, float]:
        """Gauss-Newton step of all columns but those held (K,), and its length in standard
        errors.
        """
        _, u = self.everything
        delta = self.fitted(self.index(n for n in self.names if n not in held))
        return delta, math.sqrt(max(float(delta @ u), 0.0))

    def fitted(self, free: Index) -> FloatArray:
        """(K,) estimates of the free columns, 0 elsewhere."""
        G, u = self.everything
        out = np.zeros(len(self.names))
        out[free] = solve(G[np.ix_(free, free)], u[free, None])[:, 0]
        return out

    def taken_out(self, values: Mapping[str, float]) -> Evidence:
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


def gather(
    white: Iterable[White],
    names: Sequence[str],
    group: Sequence[int] | NDArray[np.bool_],
    prior: Mapping[str, float],
    held: Sequence[str] | None = None,
) -> Evidence:
    """Evidence from filtered segments. group (S,): whose sums are kept together, 0 and up; prior:
    kind of column (its name up to the first /) -> standard deviation known beforehand; held: names
    of the columns that it has at hand, None: all. Those of candidates are most of the memory that
    evidence would take."""
    K, groups = len(names), np.asarray(group, dtype=np.intp)
    gram, score = np.zeros((groups.max() + 1, K, K)), np.zeros((groups.max() + 1, K))
    kept: list[White] = []
    at = None if held is None else [list(names).index(n) for n in held]
    for s, w in enumerate(white):
        flat = w.columns.reshape(-1, K)
        scale = np.sqrt(np.einsum("ij,ij->j", flat, flat, dtype=np.float64))
        # Columns differ by many powers of ten; single precision is for columns of unit length.
        unit = flat / np.where(scale > 0.0, scale, 1.0).astype(np.float32)
        gram[groups[s]] += (unit.T @ unit).astype(np.float64) * np.outer(scale, scale)
        score[groups[s]] += flat.astype(np.float64).T @ w.residual.ravel()
        kept.append(w if at is None else replace(w, columns=w.columns[:, :, at]))
    known = np.array([1.0 / prior.get(n.split("/")[0], math.inf) ** 2 for n in names])
    return Evidence(
        tuple(names), gram, score, groups, known, kept, None if held is None else tuple(held)
    )


def solve(G: FloatArray, right: FloatArray) -> FloatArray:
    """G x = right for an information matrix whose lost directions get nothing."""
    if not len(G):
        return np.zeros_like(right)
    scale = np.sqrt(np.maximum(np.diagonal(G), 0.0))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(G / np.outer(scale, scale))
    kept = values > 1e-9 * max(values[-1], 1e-300)
    basis = vectors[:, kept]
    return np.asarray(
        (basis @ ((basis.T @ (right / scale[:, None])) / values[kept][:, None])) / scale[:, None]
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


def shared(
    evidence: Evidence, names: Sequence[str], at: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Information (n, n) of the unknowns ``names``, everything else but effects taken out, and that
    times their values there (n,): what evidence of other flights adds to. at: values about which
    the columns are."""
    G, u = evidence.everything
    own = [n for n in evidence.names if n not in names and not n.startswith("effect/")]
    information, left = projected(G, u, evidence.index(own), evidence.index(names))
    return information, left + information @ np.array([at[n] for n in names])


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
    evidence: Evidence,
    free: Sequence[str],
    candidates: Sequence[str],
    segments: NDArray[np.bool_] | None = None,
) -> Scores:
    """Equation (LM) for every candidate; NaN where the data hold nothing of it that the free
    columns do not.
    """
    G, u = evidence.part(segments)
    b, c = evidence.index(free), evidence.index(candidates)
    x = solve(G[np.ix_(b, b)], np.column_stack([G[np.ix_(b, c)], u[b]]))
    own = np.diagonal(G)[c]
    g = own - np.einsum("bc,bc->c", G[np.ix_(b, c)], x[:, :-1])
    left = u[c] - G[np.ix_(c, b)] @ x[:, -1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(own > 0.0, g / own, 0.0)
        g = np.where(share > DEPENDENT, g, np.nan)
        return Scores(tuple(candidates), left / g, g, left / np.sqrt(g), left**2 / g, share)


def corrected(evidence: Evidence, free: Sequence[str], candidate: str) -> Estimate:
    """Estimate of one candidate, its standard error by the residuals' colour after the fit, and the
    error were they white.
    """
    return corrected_each(evidence, [*free, candidate], [candidate])[candidate]


def corrected_each(
    evidence: Evidence, names: Sequence[str], wanted: Sequence[str]
) -> dict[str, Estimate]:
    """`corrected` of each of the ``wanted`` among the columns ``names``, all estimated together:
    what the fit leaves, and so its colour, is the same for all of them and computed once."""
    known = evidence.remembered.setdefault(frozenset(names), {})
    if not known.keys() >= {*wanted}:
        known |= _corrected(
            evidence,
            names,
            [*wanted, *(n for n in names if n.startswith("effect/") and n not in wanted)],
        )
    return {n: known[n] for n in wanted}


def _corrected(
    evidence: Evidence, names: Sequence[str], wanted: Sequence[str]
) -> dict[str, Estimate]:
    names, some = list(names), evidence.index(names)
    G = evidence.everything[0][np.ix_(some, some)]
    delta = evidence.fitted(some)[some]
    # What the others leave of a column.
    alone, g = np.zeros((len(some), len(wanted))), np.empty(len(wanted))
    places = [names.index(name) for name in wanted]
    for k, c in enumerate(places):
        b = np.flatnonzero(np.arange(len(some)) != c)
        alone[b, k], alone[c, k] = -solve(G[np.ix_(b, b)], G[b, c][:, None])[:, 0], 1.0
        g[k] = G[c] @ alone[:, k]
    own, left = [], []
    for w in evidence.white:
        columns = evidence.series(w, some)
        own.append(columns @ alone)
        left.append(np.where(w.is_measured, w.residual - columns @ delta, np.nan))
    bracket = np.diagonal(coloured_information(own, left))
    # Where the data hold nothing of a column, as of a rate limit that is never reached, it has no
    # standard error.
    with np.errstate(invalid="ignore", divide="ignore"):
        plain = 1.0 / np.sqrt(np.where(g > 0.0, g, np.nan))
        std = np.maximum(np.sqrt(np.maximum(bracket, 0.0)) * plain**2, plain)
    return {
        n: (float(delta[c]), float(std[k]), float(plain[k]))
        for k, (n, c) in enumerate(zip(wanted, places, strict=True))
    }


def agreement(
    evidence: Evidence, free: Sequence[str], candidate: str, part: NDArray[np.bool_]
) -> tuple[float, float]:
    """(gain on the other segments of the value estimated on ``part``, difference of the two
    estimates in standard errors).

    The free columns are fitted anew on either side: only the effect itself is carried over.
    """
    sides = [scores(evidence, free, [candidate], side) for side in (part, ~part)]
    (a, ga), (b, gb) = ((float(s.estimate[0]), float(s.information[0])) for s in sides)
    gain = gb * (2.0 * a * b - a * a)  # 2 u a - g a^2 with u = g b
    return gain, (a - b) / math.sqrt(1.0 / ga + 1.0 / gb)


def likeness(
    evidence: Evidence, free: Sequence[str], first: str, others: Sequence[str]
) -> FloatArray:
    """Correlation (C,) of what is left of a column with what is left of others, the free columns
    taken out.
    """
    left, _ = projected(
        *evidence.everything, evidence.index(free), evidence.index([first, *others])
    )
    size = np.sqrt(np.maximum(np.diagonal(left), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(left[0, 1:] / (size[0] * size[1:]))
