"""Filter error: maximum likelihood for process and measurement noise, by the innovations of an extended Kalman filter.

    J = 1/2 sum_i [e(i)' S(i)^-1 e(i) + ln det S(i)]

over theta, the process noise Q, the logarithm of the measurement noise and, if asked, the initial states, all by Fisher scoring:

    dJ/da   = sum e_a' S^-1 e + 1/2 tr(S^-1 S_a) - 1/2 e' S^-1 S_a S^-1 e                                  (gradient)
    M_ab    = sum e_a' S^-1 e_b + 1/2 tr(S^-1 S_a S^-1 S_b)                                                (information)

Maine, R. E. and Iliff, K. W., NASA RP-1168 (1986), ch. 5-6; Jategaonkar (2015), ch. 5; Astrom, Automatica 16 (1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.checks import Array, as_array, as_bounds, as_free, as_names, as_parameters, as_segments, is_many
from sysid.coloured import coloured_information
from sysid.diagnostics import colour, colour_warnings
from sysid.ekf import Innovations, ModelFunction, Record, make_model, run_filter
from sysid.gaussnewton import minimise
from sysid.identifiability import assess, masked_covariance
from sysid.innovations import FilterProblem, Layout
from sysid.results import FilterErrorFit


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
    jacobian_every: int | None = None,
    max_iterations: int = 60,
    tolerance: float = 1e-3,
) -> FilterErrorFit:
    """Estimate theta (k,) of dx/dt = f(x, u, theta) + w, z = g(x, u, theta) + v from flights in turbulence.

    f, g           vectors in, vectors out: x (nx,), u (nu,), theta (k,). Written with elementwise operations on x[i], u[i],
                   theta[i] (no branching on values) they are evaluated for many parameter sets at once, ten times faster.
    x0             (nx,) initial state, or a list, one a segment
    u, z, t        (n, nu), (n, m), (n,) [s], or lists of them, one a segment; NaN in z = dropout. u may be None
    names, bounds, free: of theta, as in output_error
    process_noise  indices or mask of the states that have noise, default all
    process_noise_start (nx,), noise_start (m,): starting standard deviations (state unit per sqrt(s); output unit)
    x0_std         (nx,) uncertainty of x0; default: as wide as the outputs' own spread, so that x0 matters little
    estimate_x0    estimate the initial states too (one set a segment); x0_std then defaults to the least that keeps P > 0
    hold           "linear" (measured surfaces, inputs interpolated between samples) or "zoh" (commands held)
    jacobian_every renew the filter's Jacobians at every so many samples (default 1; 5 where f or g do not vectorise)

    Returns a FilterErrorFit: as output_error's, residual = innovations, plus process_noise_cov (nx, nx).
    Raises ValueError for disagreeing inputs, times that do not increase, models that fail at x0, theta0.
    """
    theta = as_parameters(theta0)
    labels = as_names(names, theta.size, "theta")
    lower, upper = as_bounds(bounds, theta, labels)
    columns = np.flatnonzero(as_free(free, labels))
    if hold not in ("linear", "zoh"):
        raise ValueError(f'hold is {hold!r}; allowed are "linear" and "zoh"')
    record, initial = _record(x0, u, z, t, hold == "zoh")
    _n, m, segments = record.z.shape
    nx = initial.shape[0]
    counts = np.isfinite(record.z).sum(axis=(0, 2))
    if (counts == 0).any():
        raise ValueError(f"z output(s) {np.flatnonzero(counts == 0).tolist()} hold no sample at all; leave them out")
    if counts.sum() <= columns.size:
        raise ValueError(
            f"{int(counts.sum())} measured values for {columns.size} parameters; measure more or free fewer"
        )
    model = make_model(f, g, initial[:, 0], record.u[0, :, 0], theta, m)
    noisy = _noisy_states(process_noise, nx)

    spread = _spread(record)
    measurement = (
        _positive_vector(noise_start, m, "noise_start") if noise_start is not None else _measurement_noise(record)
    )
    scale = _state_scale(model, record, theta, initial, spread)
    deviation = _positive_vector(x0_std, nx, "x0_std") if x0_std is not None else scale * (1e-3 if estimate_x0 else 1.0)
    layout = Layout(theta, columns, noisy, m, nx, segments, estimate_x0)
    problem = FilterProblem(
        model=model, record=record, layout=layout, initial=initial, p0=np.diag(deviation**2),
        difference=1e-5 * np.maximum(scale, np.abs(initial).max(axis=1)),
        every=jacobian_every if jacobian_every is not None else (1 if model.broadcasts else 5),
        state_scale=scale,
    )  # fmt: skip
    process = (
        _positive_vector(process_noise_start, nx, "process_noise_start")
        if process_noise_start is not None
        else _process_noise(problem, theta, measurement, scale)
    )
    start_point = layout.pack(theta, process**2, measurement, initial)
    low, high = layout.limits(lower, upper, scale, spread)
    start_point = np.clip(start_point, low, high)
    start = problem.evaluate(start_point)
    if start is None:
        raise ValueError("the filter diverges at theta0; start from other values, or from a larger noise_start")
    best = minimise(
        problem, start_point, start, low, high, tolerance=tolerance, max_iterations=max_iterations, always_central=True
    )
    return _assemble(problem, best, labels, low, high, record, is_many(z))


def _assemble(
    problem: FilterProblem, best: Any, labels: tuple[str, ...], low: Array, high: Array, record: Record, many: bool
) -> FilterErrorFit:
    """Bounds, gate and warnings at the optimum."""
    layout = problem.layout
    again = problem.evaluate(best.theta)
    assert again is not None
    line = problem.linearise(best.theta, again[1], True)
    held = ((best.theta >= high) & (line.gradient > 0.0)) | ((best.theta <= low) & (line.gradient < 0.0))
    inside = np.flatnonzero(~held)
    every_name = layout.names(labels)
    gate = assess(line.information[np.ix_(inside, inside)], tuple(every_name[i] for i in inside))
    pieces, whites = problem.whitened(again[1])
    # (MK) of coloured.py for the innovations' share of the information; the covariance's own share is left as it stands.
    sensitivities = [piece[:, :, inside] for piece in pieces]
    plain = np.zeros((inside.size, inside.size))
    for piece in sensitivities:
        flat = np.nan_to_num(piece).reshape(-1, inside.size)
        plain += flat.T @ flat
    bracket = coloured_information(sensitivities, whites) + line.information[np.ix_(inside, inside)] - plain
    total, k_free = best.theta.size, layout.columns.size
    cov, crb, vif = np.full((total, total), np.nan), np.full((total, total), np.nan), np.full(total, np.inf)
    at = np.ix_(inside, inside)
    cov[at] = masked_covariance(gate.inverse @ bracket @ gate.inverse, gate.identified)
    crb[at] = masked_covariance(gate.inverse, gate.identified)
    vif[inside] = gate.vif
    reason = [""] * total
    for position, index in enumerate(inside):
        reason[index] = gate.reason[position]
    for index in np.flatnonzero(held).tolist():
        side, value = ("upper", high[index]) if best.theta[index] >= high[index] else ("lower", low[index])
        reason[index] = f"at its {side} bound {value:g}: the data pull it beyond, the bound decides its value"
    width = high - low
    for index in range(k_free):
        if np.isfinite(width[index]) and np.sqrt(cov[index, index]) > width[index] / np.sqrt(12.0):
            reason[index] = (
                f"standard error {np.sqrt(cov[index, index]):.3g} exceeds what its bounds alone say ({width[index]:.3g} wide)"
            )
    identified = np.array([not text for text in reason])
    cov, crb = masked_covariance(cov, identified), masked_covariance(crb, identified)

    theta, q, r, x0 = layout.unpack(best.theta, problem.initial)
    k = theta.size
    spread_cov, spread_crb, spread_vif = np.full((k, k), np.nan), np.full((k, k), np.nan), np.full(k, np.inf)
    block = np.ix_(layout.columns, layout.columns)
    spread_cov[block], spread_crb[block] = cov[:k_free, :k_free], crb[:k_free, :k_free]
    spread_vif[layout.columns] = vif[:k_free]
    status, why = dict.fromkeys(labels, "fixed"), dict.fromkeys(labels, "held at theta0 (free=)")
    warnings = [note for note in gate.notes if any(name in note for name in labels)]
    for position, index in enumerate(layout.columns):
        status[labels[index]] = "not-identified" if reason[position] else "identified"
        why[labels[index]] = reason[position]
        if reason[position]:
            warnings.append(f"{labels[index]} not identified: {reason[position]}")
    if not best.converged:
        warnings.insert(0, f"not converged: {best.message}")
    found = colour(whites)
    ratio = np.sqrt(np.diagonal(cov)[:k_free]), np.sqrt(np.diagonal(crb)[:k_free])
    warnings += colour_warnings(found, *ratio, "filter error")
    innovation = [
        np.where(np.isfinite(record.z[:length, :, s]), again[1].base.e[:length, :, s], np.nan)
        for s, length in enumerate(record.lengths)
    ]
    q_std = np.full(q.size, np.nan)
    q_std[layout.noisy] = np.sqrt(np.diagonal(cov)[k_free : k_free + layout.noisy.size])
    return FilterErrorFit(
        names=labels, theta=theta, std=np.sqrt(np.diagonal(spread_cov)), std_crb=np.sqrt(np.diagonal(spread_crb)),
        cov=spread_cov, cov_crb=spread_crb, status=status, reason=why, vif=spread_vif, noise_cov=np.diag(r**2),
        residual=innovation if many else innovation[0], whiteness=found.p_value, converged=best.converged,
        warnings=warnings, iterations=best.iterations, n_simulations=problem.runs, cost=best.cost,
        cost_history=np.array(best.cost_history), process_noise_cov=np.diag(q), process_noise_std=q_std,
        x0=[x0[:, s] for s in range(x0.shape[1])],
    )  # fmt: skip


def _record(x0: Any, u: Any, z: Any, t: Any, held: bool) -> tuple[Record, Array]:
    """Padded record and initial states (nx, s). Raises ValueError where segments disagree."""
    outputs = as_segments(z, "z", dropouts=True)
    times = [part[:, 0] for part in as_segments(t, "t", dropouts=False)]
    if u is None:
        inputs = [np.zeros((part.shape[0], 1)) for part in outputs]
    else:
        inputs = as_segments(u, "u", dropouts=False)
    lengths = [part.shape[0] for part in outputs]
    if [part.shape[0] for part in inputs] != lengths or [part.size for part in times] != lengths:
        raise ValueError(
            f"samples per segment differ: z {lengths}, u {[part.shape[0] for part in inputs]}, t {[p.size for p in times]}; "
            "give u, z and t at the same samples"
        )
    for number, time in enumerate(times):
        if time.size < 2 or not (np.diff(time) > 0.0).all():
            raise ValueError(
                f"t of segment {number} does not increase at every sample (or has fewer than 2); sort or split it"
            )
    starts = [as_parameters(part, "x0") for part in (x0 if is_many(x0) else [x0] * len(lengths))]
    if len(starts) != len(lengths) or any(part.size != starts[0].size for part in starts):
        raise ValueError(
            f"x0 has {len(starts)} vectors of {[p.size for p in starts]}, z has {len(lengths)} segments; match them"
        )
    longest, s = max(lengths), len(lengths)
    U = np.zeros((longest, inputs[0].shape[1], s))
    Z = np.full((longest, outputs[0].shape[1], s), np.nan)
    dt = np.empty((longest - 1, s))
    for index, length in enumerate(lengths):
        U[:length, :, index], U[length:, :, index] = inputs[index], inputs[index][-1]
        Z[:length, :, index] = outputs[index]
        step = np.diff(times[index])
        # Padding repeats no dynamics: with dt = 0 the filter stands still behind a segment's end.
        dt[:, index] = np.concatenate([step, np.zeros(longest - length)])
    return Record(U, Z, dt, tuple(lengths), held), np.column_stack(starts)


def _noisy_states(chosen: Any, nx: int) -> NDArray[np.intp]:
    if chosen is None:
        return np.arange(nx)
    try:
        return (
            np.flatnonzero(as_free(list(chosen), tuple(f"x{i}" for i in range(nx))))
            if len(list(chosen))
            else np.arange(0)
        )
    except ValueError as error:
        raise ValueError(f"process_noise: {error}") from None


def _positive_vector(value: ArrayLike, size: int, what: str) -> Array:
    vector = np.broadcast_to(as_array(value, what), (size,)).astype(float)
    if not (np.isfinite(vector).all() and (vector > 0.0).all()):
        raise ValueError(f"{what} is {vector.tolist()}; give {size} positive numbers")
    return vector


def _spread(record: Record) -> Array:
    """Standard deviation (m,) of each output, its size where it is constant."""
    flat = record.z.transpose(0, 2, 1).reshape(-1, record.z.shape[1])
    deviation, size = np.nanstd(flat, axis=0), np.nanmax(np.abs(flat), axis=0)
    return np.where(deviation > 1e-12 * size, deviation, np.where(size > 0.0, size, 1.0))


def _measurement_noise(record: Record) -> Array:
    """First guess (m,) from third differences, which smooth motion does not reach: var = 20 sigma^2."""
    out = np.empty(record.z.shape[1])
    spread = _spread(record)
    for channel in range(out.size):
        rough = np.diff(record.z[:, channel, :], n=3, axis=0)
        rough = rough[np.isfinite(rough)]
        out[channel] = np.sqrt(np.mean(rough**2) / 20.0) if rough.size > 10 else 0.1 * spread[channel]
    return np.maximum(out, 1e-4 * spread)


def _state_scale(model: Any, record: Record, theta: Array, initial: Array, spread: Array) -> Array:
    """How far (nx,) each state may be off: the change that moves some output by its own spread; else its size, else one."""
    nx = model.states
    scale = np.empty(nx)
    x, u = initial[:, :1], record.u[0, :, :1]
    base = model.output(x, u, theta[:, None])[:, 0]
    for index in range(nx):
        size = max(float(np.abs(initial[index]).max()), 1e-3)
        shifted = x.copy()
        shifted[index] += 1e-4 * size
        slope = np.abs(model.output(shifted, u, theta[:, None])[:, 0] - base) / (1e-4 * size)
        reach = [spread[c] / slope[c] for c in range(base.size) if slope[c] * size > 1e-9 * spread[c]]
        scale[index] = min(reach) if reach else max(float(np.abs(initial[index]).max()), 1.0)
    return scale


def _process_noise(problem: FilterProblem, theta: Array, measurement: Array, scale: Array) -> Array:
    """First guess (nx,): the best of a few multiples of the states' scale, tried side by side."""
    candidates = [1e-3, 1e-2, 1e-1, 1.0]
    best, best_cost = candidates[1], np.inf
    for factor in candidates:
        answer = problem.cost_of(theta, (factor * scale) ** 2, measurement)
        if answer is not None and answer < best_cost:
            best, best_cost = factor, answer
    return best * scale


__all__ = ["Innovations", "filter_error", "run_filter"]
