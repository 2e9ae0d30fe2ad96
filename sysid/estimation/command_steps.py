"""Instrumental variables from steps that an autopilot's commands make on their own.

Under feedback the controls answer the gusts, and earlier motion is no instrument where gusts last
longer than the motion remembers them. What a new leg or turn commands is independent of all gusts,
before and after it. It is the part of a control that the measured motion and the control's own past
do not predict (two-stage method: Van den Hof and Schrama, Automatica 29, 1993; closed loop: Gilson
and Van den Hof, Automatica 41, 2005). Its filtered past instruments the motion that follows.

The estimator is Fuller's (Econometrica 45, 1977), nearly unbiased where instruments are many or
weak, with the standard errors of Bekker (Econometrica 62, 1994) and of Hansen, Hausman and Newey
(Journal of Business and Economic Statistics 26, 2008), by blocks of time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from sysid.arrays import FloatArray
from sysid.record import FlightRecord

TIME_CONSTANTS_S = (0.04, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
"""Time constants of the filtered steps, s: servo, roll, short period, Dutch roll, turn."""
_PAST_ROWS = 8
_MIN_SHARE, _MIN_KURTOSIS = 0.05, 10.0
"""Size of the steps in units of the control's standard deviation, and their kurtosis (3 for noise
and for what a saturation adds to the feedback)."""
_OUTPUTS = (
    *("V_mps", "alpha_rad", "beta_rad", "phi_rad", "theta_rad", "psi_rad", "h_m"),
    *("p_radps", "q_radps", "r_radps", "ax_mps2", "ay_mps2", "az_mps2"),
    *("vn_mps", "ve_mps", "vd_mps"),
)


def command_steps_of(record: FlightRecord, controls: Mapping[str, str]) -> dict[str, FloatArray]:
    """Return the unpredicted part of each control that moves in steps of its own.

    Parameters
    ----------
    record : FlightRecord
        Flight under an autopilot.
    controls : Mapping
        Control to its column.

    Returns
    -------
    dict
        Control to (n,), in units of the control's standard deviation, zero where rows are missing
        before it. Controls that only answer the motion are left out.
    """
    motion = [
        _normal(np.unwrap(np.nan_to_num(record[c])) if c == "psi_rad" else record[c])
        for c in _OUTPUTS
        if c in record
    ]
    # A turn commands the elevator by the square of the bank angle.
    if "phi_rad" in record:
        motion.append(_normal(record["phi_rad"] ** 2))
    commands = {c: _normal(record[column]) for c, column in controls.items() if column in record}
    time_s = record["time_s"]
    rows = np.arange(_PAST_ROWS, len(record))
    continuous = time_s[rows] - time_s[rows - _PAST_ROWS] < (_PAST_ROWS + 0.5) * record.dt_s
    rows = rows[continuous]
    if len(rows) < 50 * _PAST_ROWS:
        return {}
    past = [np.ones(len(rows))]
    past += [m[rows - k] for m in motion for k in range(_PAST_ROWS + 1)]
    past += [u[rows - k] for u in commands.values() for k in range(1, _PAST_ROWS + 1)]
    basis = np.linalg.qr(np.column_stack(past))[0]
    out = {}
    for control, u in commands.items():
        rest = u[rows] - basis @ (basis.T @ u[rows])
        size = float(rest.std())
        if size < _MIN_SHARE or float(np.mean((rest / size) ** 4)) < _MIN_KURTOSIS:
            continue
        out[control] = np.zeros(len(record))
        out[control][rows] = rest
    return out


def _normal(values: FloatArray) -> FloatArray:
    """Return values with mean 0 and standard deviation 1; the mean where they are missing."""
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros(len(values))
    centred = np.where(finite, values - values[finite].mean(), 0.0)
    return np.asarray(centred / max(float(centred.std()), 1e-12))


def filtered_steps(steps: Sequence[FloatArray], dt_s: float) -> FloatArray:
    """Return the steps after first-order lags of TIME_CONSTANTS_S, (n, controls x lags)."""
    lags = [lagged(s, dt_s, tau) for s in steps for tau in TIME_CONSTANTS_S]
    return np.column_stack(lags)


def lagged(values: FloatArray, dt_s: float, time_constant_s: float) -> FloatArray:
    """Return values after a first-order lag that starts at rest at the first value."""
    # Imported here: it takes half a second to load, and few flights are ordinary ones.
    from scipy.signal import lfilter

    if time_constant_s <= 0.0 or not len(values):
        return values
    keep = float(np.exp(-dt_s / time_constant_s))
    out, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])
    return np.asarray(out)


@dataclass(frozen=True)
class InstrumentalFit:
    """Fuller's estimate.

    Attributes
    ----------
    theta, cov : array (k,), (k, k)
        Estimates and covariance.
    moment, variance : float
        Square of what the instruments explain of the residual, in the square of y's unit, and its
        variance; their ratio is chi-squared with ``excess`` degrees of freedom if they are valid.
    excess : int
        Instruments beyond the parameters.
    solve : array (k, n)
        Estimates are ``solve @ y``.
    residual : array (n,)
        Residual of the centred equation.
    """

    theta: FloatArray
    cov: FloatArray
    moment: float
    variance: float
    excess: int
    solve: FloatArray
    residual: FloatArray


def fuller(
    y: FloatArray, x: FloatArray, z: FloatArray, block: FloatArray
) -> InstrumentalFit | None:
    """Estimate y = x theta + constant by Fuller's modification of limited information likelihood.

    Parameters
    ----------
    y, x, z : array (n,), (n, k), (n, m)
        Target, regressors, instruments.
    block : array of int (n,)
        Blocks of time between which errors are independent.

    Returns
    -------
    InstrumentalFit or None
        None with fewer independent instruments than regressors, or where these are collinear.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> z = rng.normal(size=(2000, 2)); e = rng.normal(size=2000)
    >>> x = z @ [1.0, 0.5] + 2.0 * e  # the regressor contains the error
    >>> fit = fuller(3.0 * x + e, x[:, None], z, np.arange(2000) // 50)
    >>> bool(abs(fit.theta[0] - 3.0) < 0.1)
    True
    """
    n, k = x.shape
    columns = np.column_stack([y, x])
    columns = columns - columns.mean(axis=0)
    scale = columns.std(axis=0)
    if np.any(scale == 0.0):
        return None
    columns = columns / scale
    u, size, _ = np.linalg.svd(z - z.mean(axis=0), full_matrices=False)
    q = u[:, size > 1e-6 * max(float(size[0]), 1e-300)]
    m = q.shape[1]
    explained = q @ (q.T @ columns)
    total, unexplained = columns.T @ columns, columns.T @ (columns - explained)
    if m < k or np.linalg.cond(unexplained) > 1e12:
        return None
    kappa = float(eigh(total, unexplained, eigvals_only=True)[0]) - 1.0 / (n - m)
    target, design = columns[:, 0], columns[:, 1:]
    weighted = design - kappa * (design - explained[:, 1:])
    information = weighted.T @ design
    if np.linalg.cond(information) > 1e12:
        return None
    inverse = np.linalg.inv(information)
    solve = inverse @ weighted.T
    theta = solve @ target
    residual = target - design @ theta
    # Bekker's scores: the part of the regressors that does not correlate with the residual.
    fitted_residual = q @ (q.T @ residual)
    square = float(residual @ residual)
    share = float(residual @ fitted_residual) / square
    clean = design - np.outer(residual, (residual @ design) / square)
    projected = q @ (q.T @ clean)
    score = ((1.0 - share) * projected - share * (clean - projected)) * residual[:, None]
    numbers, place = np.unique(block, return_inverse=True)
    sums = np.zeros((len(numbers), k))
    np.add.at(sums, place, score)
    moments = np.zeros((len(numbers), m))
    np.add.at(moments, place, q * residual[:, None])
    count = len(numbers)
    cov = count / max(1, count - 1) * inverse @ (sums.T @ sums) @ inverse
    # Errors that correlate in time make the moments larger than white ones would be.
    variance = float(np.sum(moments**2)) / m
    factor = scale[0] / scale[1:]
    return InstrumentalFit(
        theta * factor,
        cov * np.outer(factor, factor),
        scale[0] ** 2 * float(np.sum(moments.sum(axis=0) ** 2)),
        scale[0] ** 2 * max(variance, 1e-300),
        m - k,
        solve / scale[1:, None],
        residual * scale[0],
    )
