"""Stepwise regression: selection of candidate regressors.

Draper and Smith's forward selection with backward elimination by partial F, as used for aircraft
models by Klein, V., Batterson, J. G. and Murphy, P. C., NASA TP-1916 (1981). The deciding F uses
the coloured standard error, so that correlated samples do not count as independent evidence. PSE:
Barron (1984) as in Klein and Morelli (2006), ch. 5; PRESS: Allen (1974).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.arrays import FloatArray, as_names
from sysid.distributions import f_upper_quantile
from sysid.estimation.equation_error import checked_regressors, equation_error, segment_edges
from sysid.estimation.results import ParameterSelection, Regression, SelectionStep

ALPHA_ENTER = 0.01
"""Level of the F test to enter, divided by the number of candidates."""
ALPHA_REMOVE = 0.05
"""Level of the F test to remove, divided likewise."""
SHORTLIST = 5
"""Best candidates by partial F for which the coloured F is computed."""
TOLERANCE = 1e-8
"""Smallest share of a candidate that the chosen regressors do not explain."""


def stepwise(
    X: ArrayLike,
    y: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    keep: Sequence[int] = (),
    f_enter: float | None = None,
    f_remove: float | None = None,
    segments: Sequence[int] | None = None,
    max_terms: int | None = None,
) -> ParameterSelection:
    """Choose columns of X to model y; deterministic, ties go to the lower index.

    A constant is a candidate like any other, if X has a column of ones; force it by `keep`.

    Parameters
    ----------
    X : array_like
        (n, k) candidate regressors, each in its own unit.
    y : array_like
        (n,) response.
    names : sequence of str, optional
        k unique names; by default x0, x1, ...
    keep : sequence of int
        Indices always in the model.
    f_enter, f_remove : float, optional
        Thresholds of the effective F [-]; by default the 1 % and 5 % points of F(1, n - p), shared
        out over the candidates (Bonferroni), so that pure noise lets in any term at all once in a
        hundred data sets.
    segments : sequence of int, optional
        Lengths of continuous records stacked in X, y.
    max_terms : int, optional
        Stop at so many.

    Returns
    -------
    Selection
        ``selected`` indices, ``theta`` and ``std`` of them, and the ``history``, which tells every
        decision with its statistic.

    Raises
    ------
    ValueError
        As `equation_error`, and for keep outside 0..k-1 or f_remove above f_enter.

    References
    ----------
    V. Klein, E. A. Morelli, Aircraft System Identification, 2006: stepwise regression.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid
    >>> rng = np.random.default_rng(1)
    >>> X = rng.standard_normal((200, 4))
    >>> sysid.stepwise(X, 3.0 * X[:, 2] + 0.1 * rng.standard_normal(200)).selected
    [2]
    """
    regressors, response = checked_regressors(X, y)
    n, k = regressors.shape
    labels = as_names(names, k, "x")
    segment_edges(segments, n)
    if any(not 0 <= index < k for index in keep):
        raise ValueError(f"keep holds {list(keep)}; allowed are indices 0 to {k - 1}")
    if f_enter is not None and f_remove is not None and f_remove > f_enter:
        raise ValueError(
            f"f_remove {f_remove} exceeds f_enter {f_enter}: terms would enter and leave endlessly;"
            " lower it"
        )
    data = _Data(regressors, response, labels, segments)
    candidates = max(k - len(set(keep)), 1)
    chosen, history = sorted(set(keep)), list[SelectionStep]()
    visited = {tuple(chosen)}
    limit = min(max_terms if max_terms is not None else k, n - 1)
    while True:
        # Thresholds by Bonferroni over the candidates.
        freedom = max(n - len(chosen) - 1, 1)
        enter = (
            f_enter
            if f_enter is not None
            else float(f_upper_quantile(ALPHA_ENTER / candidates, 1, freedom))
        )
        remove = (
            f_remove
            if f_remove is not None
            else min(enter, float(f_upper_quantile(ALPHA_REMOVE / candidates, 1, freedom)))
        )
        entering = data.best_entry(chosen, enter) if len(chosen) < limit else None
        if entering is None:
            break
        index, partial, effective = entering
        if not effective > enter:
            history.append(data.step("stop", index, partial, effective, enter, chosen))
            break
        chosen = sorted([*chosen, index])
        history.append(data.step("enter", index, partial, effective, enter, chosen))
        # Remove terms that the new one made superfluous.
        while len(chosen) > max(len(set(keep)), 1):
            weakest, partial, effective = data.weakest(chosen, set(keep) | {index})
            if weakest < 0 or effective >= remove:
                break
            chosen = [other for other in chosen if other != weakest]
            history.append(data.step("remove", weakest, partial, effective, remove, chosen))
        # A set of terms that was chosen before would repeat for ever.
        if tuple(chosen) in visited:
            break
        visited.add(tuple(chosen))
    final = data.fit(chosen) if chosen else None
    return ParameterSelection(
        names=tuple(labels[index] for index in chosen),
        selected=chosen,
        theta=final.theta if final else np.zeros(0),
        std=final.std if final else np.zeros(0),
        r2=final.r2 if final else 0.0,
        history=history,
        regression=final,
        warnings=list(final.warnings) if final else ["no candidate explains y"],
    )


@dataclass(frozen=True)
class _Data:
    """The record under selection, and the statistics of its models."""

    X: FloatArray
    y: FloatArray
    names: tuple[str, ...]
    segments: Sequence[int] | None

    def fit(self, chosen: list[int]) -> Regression:
        """Regress y on the chosen columns."""
        return equation_error(
            self.X[:, chosen], self.y, names=[self.names[i] for i in chosen], segments=self.segments
        )

    def basis(self, chosen: list[int]) -> FloatArray:
        """Return orthonormal columns (n, p) that span the chosen regressors."""
        part = self.X[:, chosen]
        return (
            np.asarray(np.linalg.qr(part / np.maximum(np.abs(part).max(axis=0), 1e-300))[0])
            if chosen
            else np.zeros((self.y.size, 0))
        )

    def best_entry(self, chosen: list[int], threshold: float) -> tuple[int, float, float] | None:
        """Return (index, partial F, effective F) of the candidate to enter; None if y is explained.

        It is the first of the SHORTLIST best by partial F that passes ``threshold``, else the best.
        """
        q = self.basis(chosen)
        residual = self.y - q @ (q.T @ self.y)
        ssr = float(residual @ residual)
        if ssr <= 1e-24 * float(self.y @ self.y):
            return None
        partial = np.full(self.X.shape[1], -np.inf)
        for index in range(self.X.shape[1]):
            size = float(np.linalg.norm(self.X[:, index]))
            if index in chosen or size == 0.0:
                continue
            candidate = self.X[:, index] / size
            # Gram-Schmidt, twice for the sake of rounding.
            candidate = candidate - q @ (q.T @ candidate)
            candidate = candidate - q @ (q.T @ candidate)
            length = float(np.linalg.norm(candidate))
            if length < TOLERANCE:
                continue
            gain = float(candidate @ residual / length) ** 2
            partial[index] = gain * (self.y.size - len(chosen) - 1) / max(ssr - gain, 1e-30 * ssr)
        order = [int(i) for i in np.argsort(-partial, kind="stable") if np.isfinite(partial[i])][
            :SHORTLIST
        ]
        first: tuple[int, float, float] | None = None
        for index in order:
            entry = (index, float(partial[index]), self.effective([*chosen, index], index))
            first = first or entry
            if entry[2] > threshold:
                return entry
        return first

    def effective(self, chosen: list[int], index: int) -> float:
        """Return (theta/std)^2 of one regressor with the coloured standard error."""
        fit = self.fit(sorted(chosen))
        position = sorted(chosen).index(index)
        if not np.isfinite(fit.std[position]):
            return 0.0
        return (
            float((fit.theta[position] / fit.std[position]) ** 2)
            if fit.std[position] > 0.0
            else np.inf
        )

    def weakest(self, chosen: list[int], protected: set[int]) -> tuple[int, float, float]:
        """Return the chosen regressor with the smallest effective F; -1 if all are protected."""
        fit = self.fit(chosen)
        with np.errstate(divide="ignore", invalid="ignore"):
            effective = np.nan_to_num((fit.theta / fit.std) ** 2, nan=0.0)
            partial = np.nan_to_num((fit.theta / fit.std_white) ** 2, nan=0.0)
        order = [p for p in np.argsort(effective, kind="stable") if chosen[p] not in protected]
        if not order:
            return -1, np.inf, np.inf
        return chosen[order[0]], float(partial[order[0]]), float(effective[order[0]])

    def step(
        self,
        action: str,
        index: int,
        partial: float,
        effective: float,
        threshold: float,
        chosen: list[int],
    ) -> SelectionStep:
        """Record a decision with R2, PRESS and PSE of the resulting model."""
        n, p = self.y.size, len(chosen)
        q = self.basis(chosen)
        residual = self.y - q @ (q.T @ self.y)
        leverage = np.sum(q**2, axis=1)
        press = float(np.sum((residual / np.maximum(1.0 - leverage, 1e-12)) ** 2))
        mean_square = float(residual @ residual) / n
        # PSE = SSR/n + sigma_max^2 p/n with sigma_max^2 the variance about the mean (Klein and
        # Morelli, ch. 5)
        pse = mean_square + float(np.var(self.y, ddof=1)) * p / n
        r2 = self.fit(chosen).r2 if chosen else 0.0
        return SelectionStep(
            action, self.names[index], index, partial, effective, threshold, r2, press, pse
        )
