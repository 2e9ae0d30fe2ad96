"""Quantiles and tails against scipy.stats."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from sysid import distributions as own

P = np.array([1e-9, 1e-4, 0.025, 0.3, 0.5, 0.8, 0.975, 1.0 - 1e-6])
X = np.array([1e-3, 0.2, 1.0, 4.0, 30.0])


@pytest.mark.parametrize(
    ("result", "expected"),
    [
        (own.normal_quantile(P), stats.norm.ppf(P)),
        (own.normal_tail(X), stats.norm.sf(X)),
        *(
            (own.student_quantile(P, dof), stats.t.ppf(P, dof))
            for dof in (0.7, 3, 41.5, 1e6, np.inf)
        ),
        *((own.chi2_quantile(P, dof), stats.chi2.ppf(P, dof)) for dof in (1, 2, 60)),
        *((own.chi2_upper_quantile(P, dof), stats.chi2.isf(P, dof)) for dof in (1, 2, 60)),
        *((own.chi2_tail(X, dof), stats.chi2.sf(X, dof)) for dof in (1, 2, 60)),
        *((own.f_upper_quantile(P[1:], 1, dof), stats.f.isf(P[1:], 1, dof)) for dof in (5, 800)),
        *((own.f_tail(X, 3, dof), stats.f.sf(X, 3, dof)) for dof in (5, 800)),
        *((own.gamma_tail(X, shape), stats.gamma.sf(X, shape)) for shape in (0.4, 7.0)),
    ],
)
def test_they_are_those_of_scipy_stats(result: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(result, expected, rtol=1e-9)
    assert not np.allclose(result, 1.001 * expected, rtol=1e-5)


@pytest.mark.parametrize(
    "module", ["sysid.distributions", "uqharness.statistics.pbox", "sysid.model_form.model_form"]
)
def test_scipy_stats_is_not_loaded(module: str) -> None:
    request = f"import sys, {module}; sys.exit('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", request], check=False).returncode == 0
