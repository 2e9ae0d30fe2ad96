"""Quantiles and tails of the usual distributions: the functions of scipy.special that scipy.stats
calls.

scipy.stats itself takes over a second to load, and some 0.1 ms a number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import special


def normal_quantile(p: Any) -> Any:
    """Where the standard normal distribution has the probability p below it."""
    return special.ndtri(p)


def normal_tail(x: Any) -> Any:
    """Probability of the standard normal distribution above x."""
    return special.ndtr(-np.asarray(x))


def student_quantile(p: Any, dof: Any) -> Any:
    """Where Student's t of so many degrees of freedom has the probability p below it; NaN where
    they are not above 0.
    """
    dof = np.asarray(dof, dtype=np.float64)
    finite = special.stdtrit(np.where(np.isinf(dof), 1.0, dof), p)
    return np.where(np.isposinf(dof), special.ndtri(p), np.where(dof > 0.0, finite, np.nan))[()]


def chi2_quantile(p: Any, dof: Any) -> Any:
    """Where chi-squared of so many degrees of freedom has the probability p below it."""
    return 2.0 * special.gammaincinv(0.5 * np.asarray(dof, dtype=np.float64), p)


def chi2_upper_quantile(p: Any, dof: Any) -> Any:
    """Where it has the probability p above it."""
    return special.chdtri(dof, p)


def chi2_tail(x: Any, dof: Any) -> Any:
    """Probability of chi-squared above x."""
    return special.chdtrc(dof, x)


def f_upper_quantile(p: Any, dof: Any, dof_below: Any) -> Any:
    """Where Fisher's F has the probability p above it."""
    return special.fdtri(dof, dof_below, 1.0 - np.asarray(p, dtype=np.float64))


def f_tail(x: Any, dof: Any, dof_below: Any) -> Any:
    """Probability of Fisher's F above x."""
    return special.fdtrc(dof, dof_below, x)


def gamma_tail(x: Any, shape: Any) -> Any:
    """Probability of the gamma distribution of scale 1 above x."""
    return special.gammaincc(shape, x)
