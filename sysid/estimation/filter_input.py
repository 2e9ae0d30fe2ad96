"""Input of filter_error: padded records, and first guesses of noise and scale read off the data."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.arrays import FloatArray, as_array, as_free, as_parameters, as_segments, is_many
from sysid.estimation.ekf import Model, Record


def read_record(
    x0: Any, u: Any, z: Any, t: Any, held: bool, u_middle: Any = None
) -> tuple[Record, FloatArray]:
    """Padded record and initial states (nx, s). Raises ValueError where segments disagree."""
    outputs = as_segments(z, "z", dropouts=True)
    times = [part[:, 0] for part in as_segments(t, "t", dropouts=False)]
    empty = [np.zeros((part.shape[0], 1)) for part in outputs]
    inputs = empty if u is None else as_segments(u, "u", dropouts=False)
    lengths = [part.shape[0] for part in outputs]
    if [part.shape[0] for part in inputs] != lengths or [part.size for part in times] != lengths:
        raise ValueError(
            f"samples per segment differ: z {lengths}, u {[part.shape[0] for part in inputs]}, t "
            f"{[p.size for p in times]}; give u, z and t at the same samples"
        )
    for number, time in enumerate(times):
        if time.size < 2 or not (np.diff(time) > 0.0).all():
            raise ValueError(
                f"t of segment {number} does not increase at every sample (or has fewer than 2); sort or split it"
            )
    each = (
        is_many(x0) or np.ndim(x0) == 2
    )  # a vector a segment, be they arrays, lists or the rows of one array
    starts = [as_parameters(part, "x0") for part in (x0 if each else [x0] * len(lengths))]
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
    middle = None if u_middle is None else _middle(u_middle, inputs, longest)
    return Record(U, Z, dt, tuple(lengths), held, middle), np.column_stack(starts)


def _middle(u_middle: Any, inputs: list[FloatArray], longest: int) -> FloatArray:
    """Inputs half-way between samples, padded (longest - 1, nu, s)."""
    found = as_segments(u_middle, "u_middle", dropouts=False)
    wanted = [(part.shape[0] - 1, part.shape[1]) for part in inputs]
    if [part.shape for part in found] != wanted:
        raise ValueError(
            f"u_middle has segments of shape {[part.shape for part in found]}; half-way between the samples of u there are {wanted}"
        )
    out = np.zeros((longest - 1, inputs[0].shape[1], len(inputs)))
    for index, part in enumerate(found):
        out[: len(part), :, index], out[len(part) :, :, index] = part, inputs[index][-1]
    return out


def noisy_states(chosen: Any, nx: int) -> NDArray[np.intp]:
    """Indices of the states that process noise acts on; None chooses all. Raises ValueError."""
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


def positive_vector(value: ArrayLike, size: int, what: str) -> FloatArray:
    """``value`` as a vector (size,) of finite positive numbers; one number serves all. Raises ValueError that names ``what``."""
    vector = np.broadcast_to(as_array(value, what), (size,)).astype(float)
    if not (np.isfinite(vector).all() and (vector > 0.0).all()):
        raise ValueError(f"{what} is {vector.tolist()}; give {size} positive numbers")
    return vector


def output_spread(record: Record) -> FloatArray:
    """Standard deviation (m,) of each output, its size where it is constant."""
    flat = record.z.transpose(0, 2, 1).reshape(-1, record.z.shape[1])
    deviation, size = np.nanstd(flat, axis=0), np.nanmax(np.abs(flat), axis=0)
    return np.where(deviation > 1e-12 * size, deviation, np.where(size > 0.0, size, 1.0))


def measurement_noise(record: Record) -> FloatArray:
    """First guess (m,) from third differences, which smooth motion does not reach: var = 20 sigma^2."""
    out = np.empty(record.z.shape[1])
    spread = output_spread(record)
    for channel in range(out.size):
        rough = np.diff(record.z[:, channel, :], n=3, axis=0)
        rough = rough[np.isfinite(rough)]
        out[channel] = (
            np.sqrt(np.mean(rough**2) / 20.0) if rough.size > 10 else 0.1 * spread[channel]
        )
    return np.maximum(out, 1e-4 * spread)


def state_scale(
    model: Model, record: Record, theta: FloatArray, initial: FloatArray, spread: FloatArray
) -> FloatArray:
    """How far (nx,) each state may be off: the change that moves an output by its own spread; else its size, or 1."""
    nx = model.states
    scale = np.empty(nx)
    x, u = initial[:, :1], record.u[0, :, :1]
    base = model.output(x, u, theta[:, None])[:, 0]
    for index in range(nx):
        size = max(float(np.abs(initial[index]).max()), 1e-3)
        shifted = x.copy()
        shifted[index] += 1e-4 * size
        slope = np.abs(model.output(shifted, u, theta[:, None])[:, 0] - base) / (1e-4 * size)
        reach = [
            spread[c] / slope[c] for c in range(base.size) if slope[c] * size > 1e-9 * spread[c]
        ]
        scale[index] = min(reach) if reach else max(float(np.abs(initial[index]).max()), 1.0)
    return scale
