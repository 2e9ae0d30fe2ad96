"""Which parameters the data can tell apart: rank of the scaled information, variance inflation, and who goes with whom.

Belsley, Kuh and Welsch, "Regression Diagnostics" (1980): columns scaled to unit length, the singular directions of the
scaled matrix, variance inflation. A parameter that takes part in a direction without information has no estimate,
whatever its formal bound; the others keep theirs (estimable functions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray

RANK_TOLERANCE = (
    1e-9  # of the scaled information matrix's eigenvalues, against finite-difference error
)
PARTICIPATION = 1e-2  # share of a parameter in a lost direction above which it is lost itself
INFLATION_WARNING = 1e4  # variance inflation worth a sentence


@dataclass(frozen=True)
class Identifiability:
    """identified (k,); reason per parameter ("" if identified); vif (k,), inf where nothing is known; inverse (k, k):
    pseudo-inverse of the information, exact for the identified parameters; notes: sentences on near-collinear sets."""

    identified: NDArray[np.bool_]
    reason: tuple[str, ...]
    vif: FloatArray
    inverse: FloatArray
    notes: tuple[str, ...]


def assess(
    information: FloatArray, names: tuple[str, ...], tolerance: float = RANK_TOLERANCE
) -> Identifiability:
    """Judge the (k, k) information matrix of the parameters `names` (any units; it is scaled here)."""
    k = len(names)
    length = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    informed = length > 0.0
    reason = ["" if ok else "no effect on any output in these data" for ok in informed]
    inverse, vif = np.zeros((k, k)), np.full(k, np.inf)
    notes: list[str] = []
    index = np.flatnonzero(informed)
    if index.size:
        scale = length[index]
        scaled = information[np.ix_(index, index)] / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(scaled)
        lost = values < tolerance * max(1.0, values[-1])
        kept = vectors[:, ~lost] / np.sqrt(values[~lost])
        part = kept @ kept.T
        inverse[np.ix_(index, index)] = part / np.outer(scale, scale)
        vif[index] = np.diagonal(part)
        for column in np.flatnonzero(lost):
            share = np.abs(vectors[:, column])
            group = np.flatnonzero(share > PARTICIPATION)
            for member in group:
                others = [names[index[other]] for other in group if other != member]
                reason[index[member]] = (
                    f"collinear with {', '.join(others)}: only a combination can be estimated"
                )
        vif[[i for i in range(k) if reason[i]]] = np.inf
        notes += _inflation_notes(
            values[~lost], vectors[:, ~lost], part, [names[i] for i in index], reason, index
        )
    identified = np.array([not text for text in reason])
    return Identifiability(identified, tuple(reason), vif, inverse, tuple(notes))


def _inflation_notes(
    values: FloatArray,
    vectors: FloatArray,
    inverse: FloatArray,
    names: list[str],
    reason: list[str],
    index: NDArray[np.intp],
) -> list[str]:
    """One sentence if variance inflation exceeds the limit: by how much, and the weakest direction's members."""
    inflation = np.diagonal(inverse)
    worst = [
        i
        for i in np.argsort(-inflation)
        if inflation[i] > INFLATION_WARNING and not reason[index[i]]
    ]
    if not worst:
        return []
    share = np.abs(vectors[:, 0]) / np.abs(vectors[:, 0]).max()
    group = [names[i] for i in np.argsort(-share) if share[i] > 0.2]
    return [
        (
            f"near-collinear: {', '.join(group)} (variance inflation up to {inflation[worst[0]]:.3g}, condition index "
            f"{np.sqrt(values[-1] / values[0]):.3g}); their bounds are wide for that reason"
        )
    ]


def masked_covariance(covariance: FloatArray, identified: NDArray[np.bool_]) -> FloatArray:
    """`covariance` with NaN in every row and column of a parameter that is not identified."""
    out = covariance.copy()
    out[~identified, :] = np.nan
    out[:, ~identified] = np.nan
    return out
