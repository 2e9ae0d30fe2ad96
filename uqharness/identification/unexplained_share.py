"""Intervals of parameters whose model leaves part of the flight unexplained.

Standard errors shrink with the number of samples because errors of different samples are taken as
independent. What a wrong model leaves is not: in an ordinary flight, controls answer the motion,
so that a missing term acts along the same directions in every stretch of the flight. The flight is
therefore a sample of clusters (Kish, "Survey Sampling", 1965, section 5.4): B blocks of time whose
errors share the part rho of their variance count as B / (1 + (B - 1) rho) blocks.

rho is the share of the whitened innovations that the filter should not have left: what is
predictable from their past, or what exceeds the variance that noise and gusts explain. Of each
parameter it is the mean over the channels that determine it. A model that explains its flight has
white innovations of unit variance, rho = 0, and standard errors as they were.
"""

from __future__ import annotations

import numpy as np

from sysid.arrays import FloatArray
from sysid.effects import Evidence
from sysid.effects.score import solve
from sysid.estimation import colour

BLOCK_S = 10.0
"""Length of a block of time, s: several short periods, Dutch rolls and gusts."""


def design_effects(evidence: Evidence, seconds: float) -> FloatArray:
    """Return the factor (K,) by which each column's variance exceeds that of independent blocks.

    Parameters
    ----------
    evidence : Evidence
        Whitened columns and innovations of all segments.
    seconds : float
        Length of the flight, s.
    """
    information, score = evidence.everything
    delta = solve(information, score[:, None])[:, 0]
    residual = evidence.residual(delta)
    shares = _unexplained(residual)
    inverse = solve(information, np.eye(len(information)))
    weights = np.zeros((len(information), len(shares)))
    indices = np.arange(len(evidence.names))
    for w in evidence.white:
        # How much each channel says of each column, the others estimated beside it.
        alone = evidence.series(w, indices) @ inverse
        weights += np.einsum("nmk,nmk->km", alone, alone)
    total = weights.sum(axis=1)
    rho = (weights @ shares) / np.where(total > 0.0, total, 1.0)
    blocks = max(1.0, seconds / BLOCK_S)
    return np.asarray(1.0 + (blocks - 1.0) * rho)


def _unexplained(residual: list[FloatArray]) -> FloatArray:
    """Return the share (m,) of each channel's whitened innovations that the filter should not have
    left.
    """
    coloured = np.clip(np.nan_to_num(colour(residual).predictable), 0.0, 1.0)
    together = np.concatenate(residual)
    finite = np.isfinite(together)
    square = np.where(finite, together**2, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
    # Innovations that are smaller than predicted hide nothing.
    excess = np.where(square > 1.0, 1.0 - 1.0 / np.maximum(square, 1.0), 0.0)
    return np.asarray(np.maximum(coloured, excess))


def tempered(evidence: Evidence, wider: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Combine the data with the priors after the data's standard errors are widened.

    Parameters
    ----------
    evidence : Evidence
        Information of data and priors.
    wider : ndarray of shape (K,)
        Factors on the standard errors that the data alone give.

    Returns
    -------
    step : ndarray of shape (K,)
        From the values flown to the estimates.
    cov : ndarray of shape (K, K)
        Covariance of the estimates.
    """
    information, score = evidence.of_data
    weight = np.outer(1.0 / wider, 1.0 / wider)
    widened = information * weight
    # The data's own estimate stays where it is; only its weight beside the priors changes.
    alone = solve(information, score[:, None])[:, 0]
    pull = np.zeros(len(score)) if evidence.pull is None else evidence.pull
    total = widened + np.diag(evidence.prior)
    step = solve(total, (widened @ alone + evidence.prior * pull)[:, None])[:, 0]
    return step, solve(total, np.eye(len(total)))
