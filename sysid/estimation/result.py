"""What the estimators hand on: frozen records, no behaviour beyond what can be read off them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray


@dataclass(frozen=True)
class OutputErrorFit:
    """Maximum-likelihood estimate of k parameters from m outputs; see `sysid.output_error`.

    theta (k,)             estimate, each in its parameter's unit; a parameter not identified stays at (or drifts little
                           from) its start and has no standard error
    std, std_crb (k,)      corrected for coloured residuals / Cramer-Rao bound; NaN if not identified
    cov, cov_crb (k, k)    their covariances, NaN in the rows and columns of parameters that are not identified
    status, reason         per name: "identified" | "not-identified" | "fixed", and why
    noise_cov (m, m)       residual covariance, corrected for the degrees of freedom spent
    residual               measured minus model, (n, m) or a list of them as `measured` was given; NaN at dropouts
    vif (k,)               variance inflation, uncentred; inf where not identified
    cost_history           negative log-likelihood (concentrated over R, constants dropped) of each accepted point
    whiteness (m,)         p-value of the Ljung-Box test per output
    """

    names: tuple[str, ...]
    theta: FloatArray
    std: FloatArray
    std_crb: FloatArray
    cov: FloatArray
    cov_crb: FloatArray
    status: dict[str, str]
    reason: dict[str, str]
    vif: FloatArray
    noise_cov: FloatArray
    residual: FloatArray | list[FloatArray]
    whiteness: FloatArray
    converged: bool
    warnings: list[str]
    iterations: int
    n_simulations: int
    cost: float
    cost_history: FloatArray


@dataclass(frozen=True)
class FilterErrorFit(OutputErrorFit):
    """As OutputErrorFit, residual being the one-step innovations, and:

    process_noise_cov (x, x)  diagonal spectral density Q of the process noise, state unit^2/s (variance Q dt a step)
    noise_cov (m, m)          measurement noise R
    process_noise_std (x,)    standard error of diag Q; NaN where Q is zero: the data ask for no noise there
    x0                        initial state (x,) used, one a segment
    """

    process_noise_cov: FloatArray
    process_noise_std: FloatArray
    x0: list[FloatArray]


@dataclass(frozen=True)
class Regression:
    """Linear least squares, y = X theta + residual; see `sysid.equation_error`.

    theta, std, std_white (k,)  estimate, coloured and white standard errors; NaN where not identified
    cov (k, k)                  the coloured covariance        s2: residual variance, n - rank degrees of freedom
    r2                          about the mean if X spans a constant, else about zero
    vif (k,)                    uncentred variance inflation, inf where not identified
    """

    names: tuple[str, ...]
    theta: FloatArray
    std: FloatArray
    std_white: FloatArray
    cov: FloatArray
    status: dict[str, str]
    reason: dict[str, str]
    vif: FloatArray
    r2: float
    s2: float
    residual: FloatArray
    warnings: list[str]


@dataclass(frozen=True)
class SelectionStep:
    """One decision of `sysid.stepwise`.

    action     "enter" | "remove" | "stop"          name, index: the regressor judged
    partial_f  its partial F under white residuals   effective_f  the same with the coloured standard error: the decider
    threshold  what effective_f was held against     r2, press, pse  of the model after the step
    """

    action: str
    name: str
    index: int
    partial_f: float
    effective_f: float
    threshold: float
    r2: float
    press: float
    pse: float


@dataclass(frozen=True)
class Selection:
    """Chosen regressors: selected (indices into X, ascending), theta (len(selected),), std, the final Regression."""

    names: tuple[str, ...]
    selected: list[int]
    theta: FloatArray
    std: FloatArray
    r2: float
    history: list[SelectionStep]
    regression: Regression | None
    warnings: list[str]


def split(stacked: FloatArray, edges: list[int]) -> list[FloatArray]:
    """Rows of `stacked` cut into segments at `edges` (0, n1, n1+n2, ...)."""
    return [stacked[start:stop] for start, stop in itertools.pairwise(edges)]


def correlation(cov: FloatArray) -> FloatArray:
    """Correlation matrix of a covariance; NaN where it has NaN."""
    deviation = np.sqrt(np.diagonal(cov))
    return np.asarray(cov / np.outer(deviation, deviation))
