"""Filter error: maximum likelihood for process and measurement noise, by the innovations of an extended Kalman filter.

    J = 1/2 sum_i [e(i)' S(i)^-1 e(i) + ln det S(i)]

over theta, the process noise Q, the logarithm of the measurement noise and, if asked, the initial states, by Fisher
scoring:

    dJ/da   = sum e_a' S^-1 e + 1/2 tr(S^-1 S_a) - 1/2 e' S^-1 S_a S^-1 e                                  (gradient)
    M_ab    = sum e_a' S^-1 e_b + 1/2 tr(S^-1 S_a S^-1 S_b)                                                (information)

Maine, R. E. and Iliff, K. W., NASA RP-1168 (1986), ch. 5-6; Jategaonkar (2015), ch. 5; Astrom, Automatica 16 (1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.arrays import FloatArray, as_bounds, as_free, as_names, as_parameters, is_many
from sysid.estimation.ekf import ModelFunction, make_model
from sysid.estimation.filter_input import (
    measurement_noise,
    noisy_states,
    output_spread,
    positive_vector,
    read_record,
    state_scale,
)
from sysid.estimation.filter_layout import Layout
from sysid.estimation.filter_report import assemble
from sysid.estimation.gauss_newton import Minimum, Told, minimise
from sysid.estimation.innovations import FilterProblem
from sysid.estimation.result import FilterErrorFit

NEAR_NOISE = 0.1  # how far the logarithm of R may move while theta is far off
FIRST_NOISE = (
    1e-3,
    1e-2,
    1e-1,
    1.0,
)  # first guesses of process noise, in the states' scale per sqrt(s)


def filter_error(
    f: ModelFunction,
    g: ModelFunction,
    x0: Any,
    theta0: ArrayLike,
    u: Any,
    z: Any,
    t: Any,
    *,
    names: Sequence[str] | None = None,
    bounds: Any = None,
    free: Any = None,
    process_noise: Any = None,
    process_noise_start: ArrayLike | None = None,
    noise_start: ArrayLike | None = None,
    x0_std: ArrayLike | None = None,
    estimate_x0: bool = False,
    hold: str = "linear",
    u_middle: Any = None,
    jacobian_every: int = 4,
    max_iterations: int = 60,
    tolerance: float = 1e-2,
    told: Told | None = None,
) -> FilterErrorFit:
    """Estimate theta (k,) of dx/dt = f(x, u, theta) + w, z = g(x, u, theta) + v from flights in turbulence.

    Parameters
    ----------
    f, g : callable
        Vectors in, vectors out: x (nx,), u (nu,), theta (k,). Written with elementwise operations on x[i], u[i], theta[i]
        (no branching on values) they are evaluated for many parameter sets at once: faster.
    x0 : array_like
        (nx,) initial state, or a list, one a segment.
    theta0 : array_like
        (k,) start.
    u, z, t : array_like
        (n, nu), (n, m), (n,) [s], or lists of them, one a segment; NaN in z is a dropout. u may be None.
    names, bounds, free
        Of theta, as in `output_error`.
    process_noise : sequence, optional
        Indices or mask of the states that have noise; by default all.
    process_noise_start, noise_start : array_like, optional
        (nx,) and (m,) starting standard deviations [state unit per sqrt(s); output unit].
    x0_std : array_like, optional
        (nx,) uncertainty of x0; by default as wide as the outputs' own spread, so that x0 matters little.
    estimate_x0 : bool
        Estimate the initial states too (one set a segment); x0_std then defaults to a thousandth.
    hold : {"linear", "zoh"}
        Inputs between samples: interpolated (measured surfaces) or held (commands).
    u_middle : array_like, optional
        (n-1, nu), or a list: inputs half-way between samples where they are known better than by `hold`.
    jacobian_every : int
        Renew the filter's Jacobians at every so many samples (4: a tenth of a second at 40 Hz).
    max_iterations, tolerance
        Stop when the next step is shorter than `tolerance` standard errors.
    told : callable, optional
        Called in each iteration of a descent with its number and the length of the next step in standard errors.

    Returns
    -------
    FilterErrorFit
        As `output_error` gives, ``residual`` being the innovations, plus ``process_noise_cov`` (nx, nx).

    Raises
    ------
    ValueError
        For inputs that disagree, times that do not increase, models that fail at x0, theta0.

    References
    ----------
    R. E. Maine, K. W. Iliff, NASA RP-1168, 1986, chapters 5 and 6. R. V. Jategaonkar, Flight Vehicle System Identification, 2015,
    chapter 5.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid
    >>> rng, t = np.random.default_rng(1), 0.05 * np.arange(400)
    >>> u, x = np.sign(np.sin(t))[:, None], np.zeros((400, 1))
    >>> for k in range(399):
    ...     x[k + 1] = x[k] + 0.05 * (-1.0 * x[k] + 2.0 * u[k]) + 0.02 * rng.standard_normal(1)
    >>> z = x + 0.05 * rng.standard_normal(x.shape)
    >>> fit = sysid.filter_error(lambda x, u, p: [p[0] * x[0] + p[1] * u[0]], lambda x, u, p: [x[0]], [0.0], [-0.5, 1.0], u, z, t)
    >>> bool(np.all(np.abs(fit.theta - [-1.0, 2.0]) < 4.0 * fit.std))
    True
    """
    theta = as_parameters(theta0)
    labels = as_names(names, theta.size, "theta")
    lower, upper = as_bounds(bounds, theta, labels)
    columns = np.flatnonzero(as_free(free, labels))
    if not isinstance(jacobian_every, int) or jacobian_every < 1:
        raise ValueError(
            f"jacobian_every is {jacobian_every!r}; give a whole number of samples, 1 or more"
        )
    if hold not in ("linear", "zoh"):
        raise ValueError(f'hold is {hold!r}; allowed are "linear" and "zoh"')
    record, initial = read_record(x0, u, z, t, hold == "zoh", u_middle)
    _n, m, segments = record.z.shape
    nx = initial.shape[0]
    counts = np.isfinite(record.z).sum(axis=(0, 2))
    if (counts == 0).any():
        raise ValueError(
            f"z output(s) {np.flatnonzero(counts == 0).tolist()} hold no sample at all; leave them out"
        )
    if counts.sum() <= columns.size:
        raise ValueError(
            f"{int(counts.sum())} measured values for {columns.size} parameters; measure more or free fewer"
        )
    model = make_model(f, g, initial[:, 0], record.u[0, :, 0], theta, m)
    noisy = noisy_states(process_noise, nx)

    spread = output_spread(record)
    measurement = (
        positive_vector(noise_start, m, "noise_start")
        if noise_start is not None
        else measurement_noise(record)
    )
    scale = state_scale(model, record, theta, initial, spread)
    deviation = (
        positive_vector(x0_std, nx, "x0_std")
        if x0_std is not None
        else scale * (1e-3 if estimate_x0 else 1.0)
    )
    layout = Layout(theta, columns, noisy, m, nx, segments, estimate_x0)
    problem = FilterProblem(
        model=model,
        record=record,
        layout=layout,
        initial=initial,
        p0=np.diag(deviation**2),
        difference=1e-5 * np.maximum(scale, np.abs(initial).max(axis=1)),
        every=jacobian_every,
        state_scale=scale,
        told=told,
    )
    process = (
        positive_vector(process_noise_start, nx, "process_noise_start")
        if process_noise_start is not None
        else None
    )
    tried = [(factor * scale) ** 2 for factor in FIRST_NOISE]
    q = process**2 if process is not None else problem.best_process_noise(theta, tried, measurement)
    start_point = layout.pack(theta, q, measurement, initial)
    low, high = layout.limits(lower, upper, scale, spread)
    start_point = np.clip(start_point, low, high)
    if problem.evaluate(start_point) is None:
        raise ValueError(
            "the filter diverges at theta0; start from other values, or from a larger noise_start"
        )
    best = _from(problem, start_point, low, high, tolerance, max_iterations)
    fit = assemble(problem, best, labels, low, high, record, is_many(z))
    if best.converged and not any(text.startswith("coloured") for text in fit.warnings):
        return fit
    other = _from_high_gain(problem, start_point, low, high, tried[-1], tolerance, max_iterations)
    return (
        fit
        if other is None or not other.cost < best.cost
        else assemble(problem, other, labels, low, high, record, is_many(z))
    )


def _from(
    problem: FilterProblem,
    point: FloatArray,
    low: FloatArray,
    high: FloatArray,
    tolerance: float,
    max_iterations: int,
) -> Minimum:
    """The minimum reached from a packed point at which the filter works.

    Far from the answer a likelihood gains most by calling the model's errors measurement noise, and then looks no further.
    With R held near what the data's third differences show, the filter stays with the data and theta comes near first.
    """
    logs = problem.layout.logs
    near_low, near_high = low.copy(), high.copy()
    near_low[logs] = np.maximum(low[logs], point[logs] - NEAR_NOISE)
    near_high[logs] = np.minimum(high[logs], point[logs] + NEAR_NOISE)
    first = _descend(problem, point, near_low, near_high, 0.3, max_iterations)
    best = _descend(problem, first.theta, low, high, tolerance, max_iterations)
    return replace(
        best,
        iterations=first.iterations + best.iterations,
        cost_history=first.cost_history + best.cost_history[1:],
    )


def _from_high_gain(
    problem: FilterProblem,
    point: FloatArray,
    low: FloatArray,
    high: FloatArray,
    q: FloatArray,
    tolerance: float,
    max_iterations: int,
) -> Minimum | None:
    """The minimum reached with theta from one-step predictions: so much process noise q (nx,) that every step starts from the data.

    They are nearly linear in theta however far off it is, where the likelihood itself may have valleys of its own.
    """
    layout = problem.layout
    noisy = point.copy()
    noisy[layout.process] = np.clip(q[layout.noisy], low[layout.process], high[layout.process])
    held_low, held_high = low.copy(), high.copy()
    for part in (layout.process, layout.logs):
        held_low[part] = held_high[part] = noisy[part]
    if problem.evaluate(noisy) is None:
        return None
    near = _descend(problem, noisy, held_low, held_high, 0.3, max_iterations).theta
    return _from(problem, near, low, high, tolerance, max_iterations)


def _descend(
    problem: FilterProblem,
    point: FloatArray,
    low: FloatArray,
    high: FloatArray,
    tolerance: float,
    max_iterations: int,
) -> Minimum:
    start = problem.evaluate(point)
    assert start is not None
    return minimise(
        problem,
        point,
        start,
        low,
        high,
        tolerance=tolerance,
        max_iterations=max_iterations,
        always_central=False,
    )
