"""Kalman filters: along a linearised flight, and the extended filter of filter error.

The first half filters linearised segments and passes extra coefficients ("columns") and the start
state through the same gains. Samples of independent channels are processed one after the other
(Astrom, Automatica 16, 1980; Bierman, Factorization Methods, 1977):

    e = z - h d,   s = h P h' + r,   K = P h'/s,
    d+ = d + K e,   X+ = X - K (h X + D u),   P+ = P - K s K'
    d' = Phi d+ + defect,   X' = Phi X+ + G0 u(k) + G1 u(k+1-),   P' = Phi P+ Phi' + process noise

X is the change of the state per unit of each extra coefficient u, and of the unknown start state in
its first eight columns; u(k+1-) is u just before it may jump at row k+1. e and h X + D u over
sqrt(s) are the whitened innovations and their sensitivities. The gains do not depend on the
measurements. `sysid.effects` scores candidate effects with them.

The second half is an extended Kalman filter in lanes, used by `filter_error`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import NX, Steps
from sysid.arrays import FloatArray

# Arrays on which the compiled loops of the Kalman filter work, as named tuples.
#
# Compiled code takes named tuples as they are. The loops stand in `sysid.estimation.kalman_loops`,
# whose import loads numba.

START_COLUMNS = 8
"""Number of start states, the first columns of every pass."""


class MeasuredSystem(NamedTuple):
    """A segment's linear system with its measurements.

    Attributes
    ----------
    is_measured : array (n, m)
        Whether a channel was measured.
    z : array (n, m)
        Measurement less the reference's output; 0 where not measured.
    H, D : array (n, m, x), (n, m, 6)
        Output matrices with the states and the extra coefficients.
    phi, half_columns, defect, g0, g1, dt_s, start
        As in `sysid.aerodynamics.Steps`.
    """

    is_measured: NDArray[np.bool_]
    z: FloatArray
    H: FloatArray
    D: FloatArray
    phi: FloatArray
    half_columns: FloatArray
    defect: FloatArray
    g0: FloatArray
    g1: FloatArray
    dt_s: float
    start: FloatArray

    @classmethod
    def of(cls, steps: Steps, measured: FloatArray, output_rows: Sequence[int]) -> MeasuredSystem:
        """Combine a linear system with measurements (n, m), NaN where there are none.

        ``output_rows`` are the indices of the m channels in OUTPUTS.
        """
        # A missing measurement is 0 and flagged, so that arrays keep their shape.
        # All channels in order share the arrays of the steps.
        in_order = list(output_rows) == list(range(steps.H.shape[1]))
        rows = slice(None) if in_order else list(output_rows)
        is_measured = np.isfinite(measured)
        z = np.where(is_measured, measured - steps.y_ref[:, rows], 0.0)
        H, D, phi, half_columns, defect, g0, g1 = (
            np.ascontiguousarray(part)
            for part in (
                steps.H[:, rows],
                steps.D[:, rows],
                steps.phi,
                steps.half_columns,
                steps.defect,
                steps.g0,
                steps.g1,
            )
        )
        # Without start columns the unknown start state is the state itself.
        start = np.eye(H.shape[2], START_COLUMNS) if steps.start is None else steps.start
        return cls(
            is_measured, z, H, D, phi, half_columns, defect, g0, g1, float(steps.dt_s), start
        )


class Gains(NamedTuple):
    """Gains and innovation variances of a segment.

    Attributes
    ----------
    gain : array (n, m, x)
        Gain of each channel after the channels before it in the same sample; 0 where not measured.
    variance : array (n, m)
        Variance of its innovation; 1 where not measured.
    prior_variance : array (n, m)
        The same before any channel of the sample; 1 where not measured.
    state_variance : array (n, x)
        Variances of the predicted states, computed with ``prior_variance``; otherwise 0.
    """

    gain: FloatArray
    variance: FloatArray
    prior_variance: FloatArray
    state_variance: FloatArray

    @property
    def logdet(self) -> float:
        """Sum of the logarithms of the innovations' standard deviations."""
        return 0.5 * float(np.log(self.variance).sum())


class ColumnInputs(NamedTuple):
    """Effects of the columns on states and channels; columns count from 1, after the state.

    Attributes
    ----------
    column, coefficient : array (e,)
        Column and coefficient (index of CX ... Cn) of each input.
    values : array (n, e)
        Values at the rows.
    ends : array (n, e)
        Values just before each row.
    feedthrough : array (n, e)
        Values that act directly on the channels of each row.
    direct : array (f,)
        Columns that are added to channels.
    added : array (n, m, f)
        What they add.
    """

    column: NDArray[np.intp]
    coefficient: NDArray[np.intp]
    values: FloatArray
    ends: FloatArray
    feedthrough: FloatArray
    direct: NDArray[np.intp]
    added: FloatArray

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        inputs: Mapping[str, tuple[int, FloatArray]],
        outputs: Mapping[str, FloatArray],
        n: int,
        m: int,
        ends: Mapping[str, FloatArray] | None = None,
        feedthrough: Mapping[str, FloatArray] | None = None,
    ) -> ColumnInputs:
        """Arrange the effects of named columns.

        Parameters
        ----------
        names : sequence of str
            Columns.
        inputs : mapping
            Column to (index of the coefficient CX ... Cn, values (n,)), or to (-1, values (n, 6))
            for all six.
        outputs : mapping
            Column to the array (n, m) that it adds to the channels.
        n, m : int
            Samples and channels.
        ends, feedthrough : mapping, optional
            Column to the values just before each row, and to those that the row's channels
            measured, where they differ from the values at the row (jumps).
        """
        # A column acts on one coefficient, on all six, or on the channels directly.
        columns: list[int] = []
        coefficient: list[int] = []
        values = [np.zeros((n, 0))]
        overrides: list[list[FloatArray]] = [[np.zeros((n, 0))], [np.zeros((n, 0))]]
        for k, name in enumerate(names, 1):
            if name in inputs:
                index, column_values = inputs[name]
                indices = list(range(6)) if index < 0 else [index]
                columns += [k] * len(indices)
                coefficient += indices
                values.append(np.reshape(column_values, (n, len(indices))))
                for blocks, override in zip(overrides, (ends, feedthrough), strict=True):
                    blocks.append(
                        np.reshape((override or {}).get(name, column_values), values[-1].shape)
                    )
        # Columns are numbered from 1; column 0 is the measurement itself.
        direct = [k for k, name in enumerate(names, 1) if name in outputs]
        added = (
            np.stack([outputs[names[k - 1]] for k in direct], axis=2)
            if direct
            else np.zeros((n, m, 0))
        )
        places = [np.array(some, dtype=np.intp) for some in (columns, coefficient, direct)]
        # Without jumps the values before a row and at it share one array.
        at_rows = np.hstack(values)
        end_rows, feedthrough_rows = (
            np.hstack(blocks) if override else at_rows
            for blocks, override in zip(overrides, (ends, feedthrough), strict=True)
        )
        return cls(
            places[0],
            places[1],
            at_rows,
            end_rows,
            feedthrough_rows,
            places[2],
            np.ascontiguousarray(added),
        )


_COLUMN_BLOCK = 96
"""Columns that pass the gains together, as many as the processor's first cache holds."""


@dataclass(frozen=True)
class Process:
    """Process noise of S segments.

    Attributes
    ----------
    noise : array (S, 13)
        Variances of the states per second.
    begin : array (S, 13)
        Variances of the air states at the start.
    """

    noise: FloatArray
    begin: FloatArray

    def of(self, segments: Sequence[int]) -> Process:
        """Select some segments."""
        return Process(self.noise[list(segments)], self.begin[list(segments)])


def gains(
    system: MeasuredSystem,
    noise: FloatArray,
    air: tuple[FloatArray, FloatArray] | None,
    with_prior_variance: bool = True,
) -> Gains:
    """Compute the filter gains along a segment.

    Parameters
    ----------
    system : MeasuredSystem
        The linear system and where it was measured.
    noise : array (m,)
        Standard deviations of the sensors.
    air : tuple of two arrays (13,), optional
        Variances of the states' noise per second, and of the air states at the start. None for calm
        air: the state is not corrected, which is output error.
    with_prior_variance : bool
        Compute ``Gains.prior_variance`` and ``Gains.state_variance`` as well.

    Returns
    -------
    Gains
        Gains and innovation variances.

    Raises
    ------
    LinAlgError
        For a negative variance, and for an unstable flight that overflows.
    """
    if air is None:
        variance = np.where(system.is_measured, noise**2, 1.0)
        n, _, states = system.H.shape
        return Gains(np.zeros(system.H.shape), variance, variance, np.zeros((n, states)))
    variances, begin = air
    # A search may try negative variances.
    if min(variances.min(), begin.min()) < 0.0:
        raise np.linalg.LinAlgError("a variance below zero")
    result = Gains(*_loops().filter_gains(system, noise**2, variances, begin, with_prior_variance))
    if not np.isfinite(result.variance).all():
        raise np.linalg.LinAlgError("the covariance of the states is no number")
    return result


def variance_gradient(
    system: MeasuredSystem, filter_gains: Gains, innovations: FloatArray, variances: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Differentiate minus twice the log likelihood with the noise variances.

    Each result has two rows, the derivative of the log determinant and that of the sum of squares
    (which reduces the total).

    Parameters
    ----------
    system : MeasuredSystem
        The linear system.
    filter_gains : Gains
        From `gains`.
    innovations : array (n, m)
        Whitened, with the start state fitted.
    variances : array (13,)
        Variances of the states' noise per second, as given to `gains`.

    Returns
    -------
    array (2, m)
        With the sensors' variances.
    array (2, 13)
        With the states' variances per second; zero where those are zero.
    array (2, 13)
        With the variances of the start.
    """
    gradient: tuple[FloatArray, FloatArray, FloatArray] = _loops().backward(
        system, filter_gains, innovations * np.sqrt(filter_gains.variance), variances
    )
    return gradient


def _loops() -> ModuleType:
    """Import the compiled loops on demand, because numba takes a third of a second to load."""
    from sysid.estimation import kalman_loops

    return kalman_loops


@dataclass(frozen=True)
class Whitened:
    """A segment divided by its innovations' standard deviations; zero where nothing was measured.

    Attributes
    ----------
    innovations : array (n, m)
        Whitened innovations.
    starts : array (n, m, 8)
        Their sensitivities with the start state.
    columns : array (n, m, K)
        Their sensitivities with extra coefficients, in single precision.
    path : array (n, x)
        Predicted state less the reference, from earlier measurements.
    """

    innovations: FloatArray
    starts: FloatArray
    columns: NDArray[np.float32]
    path: FloatArray


def whiten_innovations(
    system: MeasuredSystem,
    filter_gains: Gains,
    names: Sequence[str] = (),
    inputs: Mapping[str, tuple[int, FloatArray]] | None = None,
    outputs: Mapping[str, FloatArray] | None = None,
    ends: Mapping[str, FloatArray] | None = None,
    feedthrough: Mapping[str, FloatArray] | None = None,
    without_columns: Whitened | None = None,
) -> Whitened:
    """Filter a segment, and pass columns through its gains.

    Parameters
    ----------
    system : MeasuredSystem
        The linear system with measurements.
    filter_gains : Gains
        From `gains`.
    names : sequence of str
        Columns to compute.
    inputs, outputs, ends, feedthrough : mapping, optional
        Effects of the columns, see `ColumnInputs.of`.
    without_columns : Whitened, optional
        Result of the same call without columns, which saves that pass.

    Returns
    -------
    Whitened
        With ``columns`` in the order of ``names``.
    """
    n, m, size = system.H.shape
    # One pass filters the measurements and the unknown start state.
    if without_columns is None:
        path, start_out = _whiten_states(
            system, filter_gains, np.vstack([np.zeros(size), system.start.T])
        )
        without_columns = Whitened(
            start_out[..., 0], start_out[..., 1:], np.zeros((n, m, 0), dtype=np.float32), path
        )
    if not names:
        return without_columns
    # Columns pass in blocks that fit into the cache; single precision is enough for them.
    columns, scratch_path = (
        np.zeros((n, m, len(names)), dtype=np.float32),
        np.empty_like(without_columns.path),
    )
    for begin in range(0, len(names), _COLUMN_BLOCK):
        block = names[begin : begin + _COLUMN_BLOCK]
        column_inputs = ColumnInputs.of(block, inputs or {}, outputs or {}, n, m, ends, feedthrough)
        out = np.zeros((n, m, 1 + len(block)), dtype=np.float32)
        _run_columns(
            system, filter_gains, np.zeros((size, 1 + len(block))), column_inputs, out, scratch_path
        )
        columns[:, :, begin : begin + len(block)] = out[:, :, 1:]
    return replace(without_columns, columns=columns)


def predict_from(
    begin: FloatArray, system: MeasuredSystem, filter_gains: Gains
) -> tuple[FloatArray, FloatArray]:
    """Predict the states less the reference (n, x) of a flight that begins at ``begin`` (x,).

    Also returns the whitened innovations (n, m).
    """
    # The loops propagate minus the state.
    path, innovations = _whiten_states(system, filter_gains, -np.atleast_2d(begin))
    return path, innovations[:, :, 0]


def noise_columns(
    begin: FloatArray, system: MeasuredSystem, filter_gains: Gains, variances: FloatArray
) -> FloatArray:
    """Differentiate whitened innovations with the logarithms of the states' noise variances.

    Parameters
    ----------
    begin : array (13,)
        State less the reference at the start.
    system : MeasuredSystem
    filter_gains : Gains
        From `gains`, with ``variances``.
    variances : array (13,)
        Variances of the states' noise per second.

    Returns
    -------
    array (n, m, A)
        For the A states with noise, over the innovations' standard deviations, which stay.
    """
    noisy = np.flatnonzero(variances)
    out = np.zeros((*system.z.shape, len(noisy)))
    _loops().noise_columns(system, filter_gains, np.asarray(begin), variances, noisy, out)
    return out


def _whiten_states(
    system: MeasuredSystem, filter_gains: Gains, X: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the predicted states (n, x) and the innovations with their sensitivities (n, m, c).

    Rows of ``X`` (c, x) are minus the state at the start, then others.
    """
    n, m, size = system.H.shape
    path, out = np.empty((n, size)), np.zeros((n, m, len(X)))
    if size == NX:
        scale = 1.0 / np.sqrt(filter_gains.variance)
        rows = np.array(X, order="C")
        _loops().whiten_states(system, filter_gains.gain, scale, rows, out, path)
    else:
        columns = ColumnInputs.of((), {}, {}, n, m)
        _run_columns(system, filter_gains, np.array(X.T, order="C"), columns, out, path)
    return path, out


def _run_columns(
    system: MeasuredSystem,
    filter_gains: Gains,
    X: FloatArray,
    column_inputs: ColumnInputs,
    out: NDArray[np.floating],
    path: FloatArray,
) -> None:
    """Run the compiled loop with the gains' scaling."""
    _loops().whiten_columns(
        system, filter_gains.gain, 1.0 / np.sqrt(filter_gains.variance), X, column_inputs, out, path
    )


# Extended Kalman filter in lanes: perturbed parameters and segments run side by side.
#
# Prediction by Runge-Kutta 4 at the data rate. The transition matrix is exp(A dt) to fourth order
# (for a linear f that is Runge-Kutta's own) with A = df/dx; A and the measurement's dg/dx are
# finite differences. Jategaonkar (2015), ch. 5, time-varying filter.

ModelFunction = Callable[[FloatArray, FloatArray, FloatArray], Any]


@dataclass(frozen=True)
class Model:
    """dx/dt = f(x, u, theta), y = g(x, u, theta) in lanes: x (nx, L), u (nu, L), theta (k, L).

    With ``broadcasts`` f and g accept the lane axis; else they are called lane by lane with
    vectors.
    """

    f: ModelFunction
    g: ModelFunction
    states: int
    outputs: int
    broadcasts: bool

    def rate(self, x: FloatArray, u: FloatArray, theta: FloatArray) -> FloatArray:
        """Evaluate f in lanes, (nx, L)."""
        return self._call(self.f, x, u, theta, self.states)

    def output(self, x: FloatArray, u: FloatArray, theta: FloatArray) -> FloatArray:
        """Evaluate g in lanes, (m, L)."""
        return self._call(self.g, x, u, theta, self.outputs)

    def _call(
        self, function: ModelFunction, x: FloatArray, u: FloatArray, theta: FloatArray, rows: int
    ) -> FloatArray:
        """Evaluate a function of ``rows`` values in all lanes."""
        if self.broadcasts:
            return np.asarray(function(x, u, theta), dtype=float)
        out = np.empty((rows, x.shape[1]))
        for lane in range(x.shape[1]):
            out[:, lane] = np.asarray(
                function(x[:, lane], u[:, lane], theta[:, lane]), dtype=float
            ).ravel()
        return out

    def step(
        self,
        x: FloatArray,
        k1: FloatArray,
        u_middle: FloatArray,
        u1: FloatArray,
        theta: FloatArray,
        dt: FloatArray,
    ) -> FloatArray:
        """Take one Runge-Kutta step from x, whose rate is k1.

        ``u_middle`` are the inputs half a step later, ``u1`` those at its end.
        """
        k2 = self.rate(x + 0.5 * dt * k1, u_middle, theta)
        k3 = self.rate(x + 0.5 * dt * k2, u_middle, theta)
        k4 = self.rate(x + dt * k3, u1, theta)
        return np.asarray(x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))


def make_model(
    f: ModelFunction,
    g: ModelFunction,
    x: FloatArray,
    u: FloatArray,
    theta: FloatArray,
    outputs: int,
) -> Model:
    """Build the Model of f and g, and test whether they broadcast over a lane axis.

    Parameters
    ----------
    f, g : callable
        Functions of x (nx,), u (nu,), theta (k,).
    x, u, theta : array
        A point at which both are evaluated.
    outputs : int
        Number m of outputs.

    Raises
    ------
    ValueError
        When f or g fail on single vectors, or return the wrong length or values that are not
        finite.
    """
    for name, function, rows in (("f", f, x.size), ("g", g, outputs)):
        try:
            value = np.asarray(function(x.copy(), u.copy(), theta.copy()), dtype=float)
        except Exception as error:
            raise ValueError(
                f"{name}(x, u, theta) raised {type(error).__name__}: {error}, for x of {x.size}, u"
                f" of {u.size}, theta of {theta.size} elements at the first sample; it must accept"
                " these"
            ) from error
        if value.size != rows:
            raise ValueError(
                f"{name}(x, u, theta) returned {value.size} value(s); it must return {rows}"
            )
        if not np.isfinite(value).all():
            raise ValueError(
                f"{name}(x, u, theta) is not finite at x0, theta0: {value.ravel().tolist()}; choose"
                " another start"
            )
    # A number of lanes that equals no other size, so that a wrong axis cannot pass.
    lanes = next(
        size for size in (7, 11, 13, 17, 19) if size not in (x.size, u.size, theta.size, outputs)
    )
    shift = 1.0 + 1e-3 * np.arange(lanes)
    xs, us, thetas = (
        x[:, None] * shift + 1e-4 * np.arange(lanes),
        u[:, None] * shift,
        theta[:, None] * shift,
    )
    # Functions broadcast if both ways of calling them agree.
    looped = Model(f, g, x.size, outputs, False)
    batched = Model(f, g, x.size, outputs, True)
    try:
        with np.errstate(all="ignore"):
            same = all(
                np.shape(batched_value := getattr(batched, kind)(xs, us, thetas)) == (rows, lanes)
                and np.allclose(
                    batched_value,
                    getattr(looped, kind)(xs, us, thetas),
                    rtol=1e-10,
                    atol=1e-13,
                    equal_nan=True,
                )
                for kind, rows in (("rate", x.size), ("output", outputs))
            )
    # A function written for vectors may raise anything for a lane axis: it does not broadcast.
    except Exception:
        same = False
    return batched if same else looped


@dataclass(frozen=True)
class Record:
    """Segments padded to one length n.

    Attributes
    ----------
    u : array (n, nu, s)
        Inputs.
    z : array (n, m, s)
        Measured outputs, NaN where missing or padded.
    dt : array (n - 1, s)
        Steps [s], 0 in the padding.
    lengths : tuple of int
        Samples of each segment.
    zero_order_hold : bool
        Inputs are constant between samples.
    middle : array (n - 1, nu, s), optional
        Inputs half-way to the next sample. None: u[k] when held, else the mean of both ends.
    """

    u: FloatArray
    z: FloatArray
    dt: FloatArray
    lengths: tuple[int, ...]
    zero_order_hold: bool
    middle: FloatArray | None = None


@dataclass(frozen=True)
class Innovations:
    """Innovations of every sample, output and lane (n, m, W); lanes are points times segments.

    With S the covariance of the raw innovations, S = L L', e/sqrt(s) = L^-1 raw and
    ln det S = sum ln s.

    Attributes
    ----------
    raw : array (n, m, W)
        z - g(predicted x); NaN where missing.
    e : array (n, m, W)
        Innovation of an output given those before it in the same sample; 0 where missing.
    s : array (n, m, W)
        Variance of ``e``; 1 where missing.
    """

    raw: FloatArray
    e: FloatArray
    s: FloatArray


def run_filter(
    model: Model,
    record: Record,
    theta: FloatArray,
    q: FloatArray,
    r: FloatArray,
    x0: FloatArray,
    *,
    p0: FloatArray,
    difference: FloatArray,
    every: int,
) -> Innovations | None:
    """Filter every point through every segment; None if a value stops being finite.

    The update takes the outputs one by one, which for uncorrelated noise is the joint update
    without an inverse (Kaminski, Bryson and Schmidt, IEEE Trans. Automatic Control 16, 1971).

    Parameters
    ----------
    model : Model
        Dynamics and outputs.
    record : Record
        Padded segments.
    theta : array (k, P)
        Parameters of P points.
    q : array (nx, P)
        Process-noise variances per second.
    r : array (m, P)
        Standard deviations of the measurement noise.
    x0 : array (nx, P, s)
        Initial states.
    p0 : array (nx, nx)
        Initial covariance.
    difference : array (nx,)
        State steps of the Jacobians.
    every : int
        Samples between renewals of the Jacobians.
    """
    n, m, segments = record.z.shape
    points, nx = theta.shape[1], model.states
    lanes = points * segments
    lane_theta = np.repeat(theta, segments, axis=1)
    wide_theta = np.tile(lane_theta, nx + 1)
    x = x0.reshape(nx, lanes).copy()
    P = np.repeat(p0[:, :, None], lanes, axis=2)
    Q, R = np.repeat(q, segments, axis=1), np.repeat(r**2, segments, axis=1)
    diagonal = np.arange(nx)
    offsets = np.concatenate([np.zeros((nx, 1)), np.diag(difference)], axis=1)  # (nx, nx+1)
    raw, e_all, s_all = (np.empty((n, m, lanes)) for _ in range(3))
    complete = np.asarray(np.isfinite(record.z).all(axis=2))
    phi, H = np.zeros((nx, nx, lanes)), np.zeros((m, nx, lanes))
    # Products reuse one array, because allocation would cost more than the product.
    work = np.empty_like(P)

    def jacobian(
        function: Callable[[FloatArray, FloatArray, FloatArray], FloatArray], u: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return values (rows, lanes) and Jacobians (rows, nx, lanes) of a function at x in every
        lane.
        """
        perturbed = (x[:, None, :] + offsets[:, :, None]).reshape(nx, -1)
        blocks = function(perturbed, np.tile(u, nx + 1), wide_theta).reshape(-1, nx + 1, lanes)
        return blocks[:, 0], (blocks[:, 1:] - blocks[:, :1]) / difference[None, :, None]

    with np.errstate(all="ignore"):
        for k in range(n):
            renew_jacobians = k % every == 0
            u = np.tile(record.u[k], points)
            if renew_jacobians:
                y, H = jacobian(model.output, u)
            else:
                y = model.output(x, u, lane_theta)
            raw[k] = np.tile(record.z[k], points) - y
            # Update by one output after the other.
            correction = np.zeros_like(x)
            for j in range(m):
                h = H[j]
                e = raw[k, j] - np.einsum("aw,aw->w", h, correction)
                PH = np.einsum("abw,bw->aw", P, h)
                s = np.einsum("aw,aw->w", h, PH) + R[j]
                gain = PH / s
                if not complete[k, j]:
                    # A missing output has no innovation, no gain and unit variance: it adds nothing
                    # to the likelihood.
                    missing = np.isnan(raw[k, j])
                    e, s, gain = (
                        np.where(missing, 0.0, e),
                        np.where(missing, 1.0, s),
                        np.where(missing, 0.0, gain),
                    )
                e_all[k, j], s_all[k, j] = e, s
                correction += gain * e
                P -= np.multiply(gain[:, None], PH[None], out=work)
            x = x + correction
            if k == n - 1:
                break
            # Propagate to the next sample.
            u1 = u if record.zero_order_hold else np.tile(record.u[k + 1], points)
            u_middle = (
                0.5 * (u + u1) if record.middle is None else np.tile(record.middle[k], points)
            )
            dt = np.tile(record.dt[k], points)
            if renew_jacobians:
                rate, A = jacobian(model.rate, u)
                phi = _transition(A * dt)
            else:
                rate = model.rate(x, u, lane_theta)
            x = model.step(x, rate, u_middle, u1, lane_theta, dt)
            # The noise of a step, int Phi(s) Q Phi(s)' ds by Simpson with Phi(dt/2) = (1 + Phi)/2.
            third = Q * (dt / 3.0)
            P[diagonal, diagonal] += third
            np.einsum("abw,bcw->acw", phi, P, out=work)
            np.einsum("abw,cbw->acw", work, phi, out=P)
            np.multiply(phi, 0.5 * third, out=work)
            P += work
            P += work.transpose(1, 0, 2)
            P[diagonal, diagonal] += third
            if k % 100 == 0 and not (np.abs(x) < 1e100).all():
                return None
    if not (
        np.isfinite(e_all).all()
        and (np.abs(e_all) < 1e100).all()
        and np.isfinite(s_all).all()
        and (s_all > 0).all()
    ):
        return None
    return Innovations(raw, e_all, s_all)


def _transition(X: FloatArray) -> FloatArray:
    """Compute exp(X) of X (nx, nx, L) to fourth order."""
    identity = np.eye(X.shape[0])[:, :, None]
    out = identity + X / 4.0
    for order in (3.0, 2.0, 1.0):
        out = identity + np.einsum("abw,bcw->acw", X, out) / order
    return np.asarray(out)
