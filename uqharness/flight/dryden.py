"""Dryden turbulence of MIL-F-8785C at low altitude (10 to 1000 ft).

Spectra, standard deviations and sampled gusts. Axes: x along the flight path (level: along the
heading), y right, z down. ``u, v, w`` is the velocity of the air, ``p, q, r`` its rotation: q =
-dw/dx and r = +dv/dx, smoothed over the span. The aerodynamics see the aircraft's rates minus
these.

Gusts are samples of the continuous process, exact at any step. q shares the noise of w, and r that
of v, as physics requires. Samples are bit-identical on all processors. Paragraphs refer to
MIL-F-8785C (1980).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.arrays import FloatArray
from sysid.units import FT_M, KT_MPS
from uqharness.errors import BadInputError
from uqharness.flight import random_numbers as exact
from uqharness.flight.random_numbers import Normals, Pairs, Source, Split, numpy_pairs, splice
from uqharness.flight.spec import BELOW_CEILING, TURBULENCE_CEILING_M

# Shaping filters. Four noise inputs drive them: u and p of first order, v with r and w with q of
# third. A step is x' = E x + R' n with the transition matrix E and R'R the covariance of the noise
# in a step; the first sample has the stationary distribution. All operations are IEEE operations in
# fixed order: no matrix library, no contraction.

Matrix = tuple[tuple[float, ...], ...]

PAGE_STEPS = 8192
"""Steps computed at once."""
_PER_STEP = (1, 3, 3, 1)
"""Normals of u, v, w and p in a step."""

_SEGMENT_STEPS = 64
_MIN_FACTOR = 1e-290
"""Segments are so short that the product of their factors stays above this."""

# Gauss-Legendre nodes and weights, 12 nodes in -1..1.
_NODES = (
    (0.1252334085114689, 0.24914704581340277),
    (0.3678314989981802, 0.2334925365383548),
    (0.5873179542866175, 0.20316742672306592),
    (0.7699026741943047, 0.16007832854334622),
    (0.9041172563704749, 0.10693932599531843),
    (0.9815606342467192, 0.04717533638651183),
)


@dataclass(frozen=True)
class FirstOrder:
    """x' = ``keep`` x + ``noise_std`` n, of variance 1."""

    keep: float
    noise_std: float


@dataclass(frozen=True)
class Lateral:
    """w of variance 1 with the lateral spectrum, and its slope smoothed by 1/(1 + T_span s).

    States are z1 = 1/(1 + T s) noise, z2 = 1/(1 + T s) z1 and y = 1/(1 + T_span s) w, with w =
    sqrt(T) (1 + sqrt(3) T s)/(1 + T s)^2 noise = sqrt(T) (sqrt(3) z1 + (1 - sqrt(3)) z2); the slope
    is (w - y)/T_span.

    Attributes
    ----------
    to_w : tuple of float
        Factors of z1 and z2 in w.
    step : Matrix
        Transition matrix, lower triangular.
    factor : Matrix
        R, upper triangular; R'R is the covariance of a step's noise.
    start : Matrix
        Lower triangular factor of the stationary covariance.
    T_span_s : float
        Time constant of the span [s].
    """

    to_w: tuple[float, float]
    step: Matrix
    factor: Matrix
    start: Matrix
    T_span_s: float


@lru_cache(maxsize=64)
def first_order(dt_s: float, T_s: float) -> FirstOrder:
    """Return the filter 1/(1 + T s): x' = e^(-dt/T) x + sqrt(1 - e^(-2 dt/T)) n.

    Parameters
    ----------
    dt_s, T_s : float
        Step and time constant [s].
    """
    x = dt_s / T_s
    return FirstOrder(exact.exp(-x), math.sqrt(-exact.expm1(-2.0 * x)))


@lru_cache(maxsize=64)
def lateral(dt_s: float, T_s: float, T_span_s: float) -> Lateral:
    """Return the lateral filter.

    Parameters
    ----------
    dt_s, T_s, T_span_s : float
        Step, time constant of the turbulence, and time constant of the span [s].
    """
    root = math.sqrt(T_s)
    to_w = (root * math.sqrt(3.0), root * (1.0 - math.sqrt(3.0)))
    a, c = 1.0 / T_s, 1.0 / T_span_s
    A = ((-a, 0.0, 0.0), (a, -a, 0.0), (to_w[0] * c, to_w[1] * c, -c))
    B = (a, 0.0, 0.0)
    step, factor = discretise(A, B, dt_s)
    return Lateral(to_w, step, factor, exact.cholesky(_stationary(A, B)), T_span_s)


def discretise(A: Matrix, B: Sequence[float], dt: float) -> tuple[Matrix, Matrix]:
    """Return the transition matrix of x' = A x + B n over a step, and R with R'R its noise
    covariance.

    The integral of e^(A s) B B' e^(A' s) is summed by Gauss and Legendre (12 nodes, exact to
    rounding up to the shortest time constant; longer steps are divided). It is factored without
    being formed, because it is almost singular.
    """
    # Sub-intervals no longer than the shortest time constant.
    pieces = max(1, math.ceil(dt * max(abs(a) for row in A for a in row)))
    half = 0.5 * dt / pieces
    vectors = []
    for node, weight in _NODES:
        root = math.sqrt(half * weight)
        for s in (half * (1.0 - node), half * (1.0 + node)):
            vectors.append(_propagate(A, [root * b for b in B], s))
    rows = list(vectors)
    for _ in range(pieces - 1):
        vectors = [_propagate(A, vector, 2.0 * half) for vector in vectors]
        rows += vectors
    return _exponential(A, dt), _triangular(rows)


@dataclass(frozen=True)
class GustFilters:
    """Filters of the four noise inputs; v also gives r, and w gives q."""

    u: FirstOrder
    v: Lateral
    w: Lateral
    p: FirstOrder


def numpy_recursion(
    drive: FloatArray, powers: FloatArray, inverse: FloatArray, last: float
) -> FloatArray:
    """Return the states (n + 1,) of x' = keep x + drive from ``last`` on, the initial one included.

    Within a segment x[k] = keep^k (x[0] + sum of keep^-j drive[j]): a running sum for numpy.

    Parameters
    ----------
    drive : ndarray
        Drive (n,), n a multiple of the segment.
    powers, inverse : ndarray
        keep, keep^2, ... over a segment, and their inverses.
    last : float
        State before the first step.
    """
    out = np.empty(drive.size + 1)
    out[0] = last
    sums = drive.reshape(-1, powers.size) * inverse
    np.add.accumulate(sums, axis=1, out=sums)
    starts, segment_factor = [], float(powers[-1])
    for end in sums[:, -1].tolist():
        starts.append(last)
        last = (end + last) * segment_factor
    sums += np.array(starts)[:, None]
    np.multiply(sums, powers, out=out[1:].reshape(sums.shape))
    return out


Recur = Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]
"""``numpy_recursion`` or a compiled equivalent."""


class UnitGusts:
    """Gusts of unit intensity, a page at a time.

    Parameters
    ----------
    filters : GustFilters
        Shaping filters.
    normals : sequence of Source
        Noise of u, v, w and p.
    recur : Recur
        Recursion in use.
    """

    def __init__(
        self, filters: GustFilters, normals: Sequence[Source], recur: Recur = numpy_recursion
    ) -> None:
        self._normals = tuple(normals)
        self._u, self._p = _FirstOrderGusts(filters.u, recur), _FirstOrderGusts(filters.p, recur)
        self._v, self._w = _LateralGusts(filters.v, recur), _LateralGusts(filters.w, recur)
        self.keeps_noise = False
        self._page_start: tuple[UnitGusts, list[FloatArray]] | None = None

    def __deepcopy__(self, memo: object) -> UnitGusts:
        """Return gusts that continue from here; constant parts are shared."""
        other = self._copied()
        other._normals = tuple(copy.deepcopy(source) for source in self._normals)
        return other

    def _copied(self) -> UnitGusts:
        """Return a copy with its own filter states and the same noise sources."""
        other = copy.copy(self)
        other._u, other._p, other._v, other._w = (
            self._u.copy(),
            self._p.copy(),
            self._v.copy(),
            self._w.copy(),
        )
        return other

    def exchange(self, other: Callable[[int, Source], Source]) -> None:
        """Continue with other noise: ``other(place, source)`` for places 0 to 3 (u, v, w, p)."""
        self._normals = tuple(other(place, source) for place, source in enumerate(self._normals))

    def page(self) -> FloatArray:
        """Return the next samples (6, PAGE_STEPS): u, v, w, p, slope of w, slope of v."""
        noise = [
            source.take(rows * PAGE_STEPS).reshape(rows, PAGE_STEPS)
            for source, rows in zip(self._normals, _PER_STEP, strict=True)
        ]
        return self._filtered(noise)

    def branched(self, step: int, normals: Sequence[Source]) -> tuple[UnitGusts, FloatArray] | None:
        """Return gusts with other noise from a step of the last page on, and that page (6,
        PAGE_STEPS).

        None if ``keeps_noise`` was not set when the page was made.
        """
        if self._page_start is None:
            return None
        start, page_noise = self._page_start
        other, noise = start._copied(), []
        other._normals, other.keeps_noise = tuple(normals), True
        for source, old_noise in zip(normals, page_noise, strict=True):
            rows = old_noise.copy()
            rows[:, step:] = source.take(len(rows) * (PAGE_STEPS - step)).reshape(len(rows), -1)
            noise.append(rows)
        return other, other._filtered(noise)

    def _filtered(self, noise: list[FloatArray]) -> FloatArray:
        """Return a page of gusts from its noise; keep the state before it if needed."""
        self._page_start = (self._copied(), noise) if self.keeps_noise else None
        if self._page_start is not None:
            self._page_start[0]._page_start = None
        u, v, w, p = noise
        out = np.empty((6, PAGE_STEPS))
        out[0] = self._u.page(u[0])
        out[1], out[5] = self._v.page(v)
        out[2], out[4] = self._w.page(w)
        out[3] = self._p.page(p[0])
        return out


class _Recursion:
    """x' = keep x + drive from x = 0, a page at a time."""

    def __init__(self, keep: float, recur: Recur = numpy_recursion) -> None:
        self._last, self._keep, self._recur = 0.0, keep, recur
        powers = [keep]
        while len(powers) < _SEGMENT_STEPS:
            powers.append(powers[-1] * keep)
        steps = _SEGMENT_STEPS
        while steps > 1 and powers[steps - 1] < _MIN_FACTOR:
            steps //= 2
        self._powers = np.array(powers[:steps])
        self._inverse = 1.0 / np.maximum(self._powers, _MIN_FACTOR)

    def page(self, drive: FloatArray) -> FloatArray:
        """Return the states (PAGE_STEPS + 1,) of a page, the one before it first."""
        if self._keep < _MIN_FACTOR:
            out = np.concatenate([[self._last], drive])
        else:
            out = self._recur(drive, self._powers, self._inverse, self._last)
        self._last = float(out[-1])
        return out


class _FirstOrderGusts:
    """Gusts of a first-order filter."""

    def __init__(self, filter_: FirstOrder, recur: Recur) -> None:
        self._noise_std, self._has_started, self._x = (
            filter_.noise_std,
            False,
            _Recursion(filter_.keep, recur),
        )

    def copy(self) -> _FirstOrderGusts:
        """Return gusts that continue from here."""
        other = copy.copy(self)
        other._x = copy.copy(self._x)
        return other

    def page(self, noise: FloatArray) -> FloatArray:
        """Return (PAGE_STEPS,) gusts; the very first one has the stationary distribution."""
        drive = self._noise_std * noise
        if not self._has_started:
            drive[0] = noise[0]
            self._has_started = True
        return self._x.page(drive)[1:]


class _LateralGusts:
    """Gusts of the lateral filter, with their slope."""

    def __init__(self, filter_: Lateral, recur: Recur) -> None:
        self._filter, self._has_started = filter_, False
        self._states = [_Recursion(filter_.step[i][i], recur) for i in range(3)]

    def copy(self) -> _LateralGusts:
        """Return gusts that continue from here."""
        other = copy.copy(self)
        other._states = [copy.copy(state) for state in self._states]
        return other

    def page(self, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return w and its slope, each (PAGE_STEPS,), from normals (3, PAGE_STEPS)."""
        one = self._filter
        drives = [one.factor[0][i] * noise[0] for i in range(3)]
        drives[1] += one.factor[1][1] * noise[1]
        drives[2] += one.factor[1][2] * noise[1]
        drives[2] += one.factor[2][2] * noise[2]
        if not self._has_started:
            for drive, row in zip(drives, one.start, strict=True):
                drive[0] = _dot(row, noise[:, 0].tolist())
            self._has_started = True
        # The transition matrix is lower triangular: z1, z2 and y follow one after the other.
        z1 = self._states[0].page(drives[0])
        drives[1] += one.step[1][0] * z1[:-1]
        z2 = self._states[1].page(drives[1])
        drives[2] += one.step[2][0] * z1[:-1]
        drives[2] += one.step[2][1] * z2[:-1]
        y = self._states[2].page(drives[2])
        w = one.to_w[0] * z1[1:] + one.to_w[1] * z2[1:]
        return w, (w - y[1:]) / one.T_span_s


def _propagate(A: Matrix, x: list[float], t: float) -> list[float]:
    """Return e^(A t) x by Taylor's series; elements of A t are at most 1."""
    result = x
    for k in range(32, 0, -1):
        result = [a + b * t / k for a, b in zip(x, _times(A, result), strict=True)]
    return result


def _exponential(A: Matrix, t: float) -> Matrix:
    """Return e^(A t) by Taylor's series of a part of t, squared repeatedly."""
    n = len(A)
    # Scaling and squaring: the norm of the part is below 1/2.
    halvings = max(0, math.frexp(t * max(sum(abs(a) for a in row) for row in A))[1] + 1)
    part = math.ldexp(t, -halvings)
    one = tuple(tuple(float(i == j) for j in range(n)) for i in range(n))
    result = one
    for k in range(18, 0, -1):
        moved = _product(A, result)
        result = tuple(
            tuple(one[i][j] + moved[i][j] * part / k for j in range(n)) for i in range(n)
        )
    for _ in range(halvings):
        result = _product(result, result)
    return result


def _stationary(A: Matrix, B: Sequence[float]) -> list[list[float]]:
    """Solve A P + P A' + B B' = 0 for a lower triangular A, element by element."""
    n = len(A)
    P = [[0.0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            partial_sum = (
                B[i] * B[j]
                + math.fsum(A[i][k] * P[k][j] for k in range(i))
                + math.fsum(A[j][k] * P[i][k] for k in range(j))
            )
            P[i][j] = P[j][i] = -partial_sum / (A[i][i] + A[j][j])
    return P


def _triangular(rows: Sequence[Sequence[float]]) -> Matrix:
    """Return R of a QR decomposition (modified Gram-Schmidt) with positive diagonal."""
    columns = [list(column) for column in zip(*rows, strict=True)]
    n = len(columns)
    R = [[0.0] * n for _ in range(n)]
    for i, column in enumerate(columns):
        R[i][i] = math.sqrt(_dot(column, column))
        unit = [x / R[i][i] for x in column]
        for j in range(i + 1, n):
            R[i][j] = _dot(unit, columns[j])
            columns[j] = [x - R[i][j] * q for x, q in zip(columns[j], unit, strict=True)]
    return tuple(map(tuple, R))


def _product(A: Matrix, B: Matrix) -> Matrix:
    """Return the matrix product."""
    return tuple(tuple(_dot(row, column) for column in zip(*B, strict=True)) for row in A)


def _times(A: Matrix, x: Sequence[float]) -> list[float]:
    """Return the product of a matrix and a vector."""
    return [_dot(row, x) for row in A]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the correctly rounded scalar product."""
    return math.fsum(x * y for x, y in zip(a, b, strict=True))


Component = Literal["u", "v", "w", "p", "q", "r"]
COMPONENTS: tuple[Component, ...] = ("u", "v", "w", "p", "q", "r")

_STREAMS = {"u": 0, "v": 1, "w": 2, "p": 3}
_NORMALS_PER_STEP = {"u": 1, "v": 3, "w": 3, "p": 1}


@dataclass(frozen=True)
class GustSeries:
    """Gusts in heading axes at a fixed step, arrays (n,)."""

    dt_s: float
    u_mps: FloatArray
    v_mps: FloatArray
    w_mps: FloatArray
    p_radps: FloatArray
    q_radps: FloatArray
    r_radps: FloatArray

    def component(self, name: Component) -> FloatArray:
        """Return one of u, v, w [m/s], p, q, r [rad/s] by its letter."""
        series: FloatArray = getattr(self, f"{name}_mps" if name in "uvw" else f"{name}_radps")
        return series


@dataclass(frozen=True)
class DrydenParameters:
    """Scales of the turbulence at one height, airspeed and span.

    Attributes
    ----------
    V_mps, b_m : float
        True airspeed [m/s] and span [m].
    L_u_m, L_w_m : float
        Scale lengths [m]; L_v = L_u.
    sigma_u_mps, sigma_w_mps : float
        Standard deviations [m/s]; sigma_v = sigma_u.
    sigma_p_radps : float
        Standard deviation of p [rad/s].
    T_p_s, T_q_s, T_r_s : float
        Time constants of the span [s].
    """

    V_mps: float
    b_m: float
    L_u_m: float
    L_w_m: float
    sigma_u_mps: float
    sigma_w_mps: float
    sigma_p_radps: float
    T_p_s: float
    T_q_s: float
    T_r_s: float


def dryden_parameters(V_mps: float, h_m: float, W20_kt: float, b_m: float) -> DrydenParameters:
    """Return scale lengths, intensities and the span's time constants.

    Parameters
    ----------
    V_mps : float
        True airspeed [m/s].
    h_m : float
        Height above the ground [m], at most 304.8; values of 10 ft hold below 10 ft.
    W20_kt : float
        Wind at 20 ft [kt].
    b_m : float
        Span [m].

    Raises
    ------
    BadInputError
        For a height above the model's ceiling, and for values that are not positive.

    Examples
    --------
    >>> scales = dryden_parameters(20.0, 100.0, 15.0, 2.0)
    >>> f"{scales.L_w_m:.0f} m, {scales.sigma_w_mps:.3f} m/s"
    '100 m, 0.772 m/s'
    """
    _positive(V_mps=V_mps, b_m=b_m)
    if not W20_kt >= 0.0:
        raise BadInputError(f"W20_kt = {W20_kt}: the wind at 20 ft is 0 or more knots")
    if not h_m <= TURBULENCE_CEILING_M:
        raise BadInputError(
            f"h_m = {h_m:g}: the low-altitude model reaches from the ground to 304.8 m (1000 ft)"
        )
    h_ft = max(h_m / FT_M, 10.0)
    profile = 0.177 + 0.000823 * h_ft
    L_w = h_ft * FT_M  # 3.7.3.4, figure 10: L_w = h
    L_u = h_ft / exact.power(profile, 1.2) * FT_M  # 3.7.3.4, figure 10: L_u = L_v
    sigma_w = 0.1 * W20_kt * KT_MPS  # 3.7.3.4: sigma_w = 0.1 u20
    sigma_u = sigma_w / exact.power(profile, 0.4)  # 3.7.3.4, figure 11: sigma_u = sigma_v
    T_p = 4.0 * b_m / (math.pi * V_mps)
    # 3.7.5, Phi_p: sigma_p^2 is the integral over w from 0 of sigma_w^2/(V L_w) 0.8 (pi
    # L_w/4b)^(1/3) / (1 + (4 b w/pi V)^2).
    thickness = exact.power(math.pi * L_w / (4.0 * b_m), 1.0 / 3.0)
    sigma_p = sigma_w * math.sqrt(0.8 * thickness * math.pi / (2.0 * T_p) / (V_mps * L_w))
    return DrydenParameters(
        V_mps=V_mps,
        b_m=b_m,
        L_u_m=L_u,
        L_w_m=L_w,
        sigma_u_mps=sigma_u,
        sigma_w_mps=sigma_w,
        sigma_p_radps=sigma_p,
        T_p_s=T_p,
        T_q_s=4.0 * b_m / (math.pi * V_mps),  # 3.7.5, Phi_q
        T_r_s=3.0 * b_m / (math.pi * V_mps),  # 3.7.5, Phi_r
    )


def refuse_above_ceiling(turbulence: str, h_m: float) -> None:
    """Raise BadInputError if a flight starts above the range of the low-altitude model."""
    if not h_m <= TURBULENCE_CEILING_M:
        raise BadInputError(
            f'turbulence = "{turbulence}": the flight begins {h_m:.0f} m above the ground, and the'
            f" low-altitude model of MIL-F-8785C reaches to {TURBULENCE_CEILING_M:g} m (1000 ft);"
            f" {BELOW_CEILING}"
        )


def dryden_psd(
    component: Component,
    omega_radps: npt.ArrayLike,
    V_mps: float,
    h_m: float,
    W20_kt: float,
    b_m: float,
) -> FloatArray:
    """Return the one-sided spectral density over angular frequency.

    Its integral from 0 to infinity is the variance.

    Parameters
    ----------
    component : str
        One of u, v, w, p, q, r.
    omega_radps : array_like
        Angular frequencies (n,) [rad/s].
    V_mps, h_m, W20_kt, b_m : float
        As of `dryden_parameters`.

    Returns
    -------
    ndarray
        (n,) [(m/s)^2 s] for u, v, w and [(rad/s)^2 s] for p, q, r.
    """
    par = dryden_parameters(V_mps, h_m, W20_kt, b_m)
    omega = np.asarray(omega_radps, dtype=np.float64)
    if component == "u":
        T = par.L_u_m / V_mps
        return par.sigma_u_mps**2 * 2.0 * T / np.pi / (1.0 + (T * omega) ** 2)  # 3.7.1.2, Phi_u
    if component == "v":
        return _lateral_psd(omega, par.sigma_u_mps, par.L_u_m / V_mps)  # 3.7.1.2, Phi_v
    if component == "w":
        return _lateral_psd(omega, par.sigma_w_mps, par.L_w_m / V_mps)  # 3.7.1.2, Phi_w
    if component == "p":
        return (
            par.sigma_p_radps**2 * 2.0 * par.T_p_s / np.pi / (1.0 + (par.T_p_s * omega) ** 2)
        )  # 3.7.5, Phi_p
    if component == "q":
        w_psd = _lateral_psd(omega, par.sigma_w_mps, par.L_w_m / V_mps)
        return (omega / V_mps) ** 2 / (1.0 + (par.T_q_s * omega) ** 2) * w_psd  # 3.7.5, Phi_q
    if component == "r":
        v_psd = _lateral_psd(omega, par.sigma_u_mps, par.L_u_m / V_mps)
        return (omega / V_mps) ** 2 / (1.0 + (par.T_r_s * omega) ** 2) * v_psd  # 3.7.5, Phi_r
    raise BadInputError(f"component '{component}': expected one of {', '.join(COMPONENTS)}")


def dryden_sigma(
    component: Component, V_mps: float, h_m: float, W20_kt: float, b_m: float
) -> float:
    """Return the standard deviation of a component, the root of the spectrum's integral."""
    par = dryden_parameters(V_mps, h_m, W20_kt, b_m)
    if component in ("u", "v"):
        return par.sigma_u_mps
    if component == "w":
        return par.sigma_w_mps
    if component == "p":
        return par.sigma_p_radps
    if component == "q":
        return _gradient_sigma(par.sigma_w_mps, par.L_w_m, par.T_q_s * V_mps)
    if component == "r":
        return _gradient_sigma(par.sigma_u_mps, par.L_u_m, par.T_r_s * V_mps)
    raise BadInputError(f"component '{component}': expected one of {', '.join(COMPONENTS)}")


def dryden_gusts(
    n: int,
    dt_s: float,
    V_mps: float,
    h_m: float,
    W20_kt: float,
    b_m: float,
    *,
    seed: int | Sequence[int],
) -> GustSeries:
    """Return ``n`` samples of all six gusts at constant airspeed and height.

    Parameters
    ----------
    n, dt_s : int, float
        Number of samples, and step [s].
    V_mps, h_m, W20_kt, b_m : float
        As of `dryden_parameters`.
    seed : int or sequence of int
        Root seed, or a sequence that begins with it. u, v with r, w with q, and p have a stream
        each. W20 only scales the result: all intensities share one history.
    """
    return next(gust_blocks(n, dt_s, V_mps, h_m, W20_kt, b_m, seed=seed, block=max(n, 1)))


def gust_blocks(
    n: int,
    dt_s: float,
    V_mps: float,
    h_m: float,
    W20_kt: float,
    b_m: float,
    *,
    seed: int | Sequence[int],
    block: int,
) -> Iterator[GustSeries]:
    """Yield the samples of `dryden_gusts`, bit for bit, in series of at most ``block``.

    The memory needed is that of one block.
    """
    if n < 1:
        raise BadInputError(f"n = {n}: at least one sample is needed")
    gusts = DrydenGusts(dryden_parameters(V_mps, h_m, W20_kt, b_m), dt_s, seed)
    buffered = np.empty((len(COMPONENTS), 0))
    for first in range(0, n, block):
        size = min(block, n - first)
        missing = -(-(size - buffered.shape[1]) // PAGE_STEPS)
        if missing > 0:
            buffered = np.concatenate([buffered, *(gusts.page() for _ in range(missing))], axis=1)
        yield GustSeries(dt_s, *buffered[:, :size])
        buffered = buffered[:, size:]


class DrydenGusts:
    """Endless Dryden gusts, a page of PAGE_STEPS samples at a time.

    Parameters
    ----------
    parameters : DrydenParameters
        Scales of the turbulence.
    dt_s : float
        Step [s].
    seed : int or sequence of int
        As of `dryden_gusts`.
    pairs, recur : callable
        ``numpy_pairs`` and ``numpy_recursion``, or compiled equivalents.
    splits : sequence of Split
        Steps behind which the noise is that of a branch.

    Notes
    -----
    ``copy.deepcopy`` gives gusts that continue from the present state, `branched` gusts that left
    it within the last page.
    """

    def __init__(
        self,
        parameters: DrydenParameters,
        dt_s: float,
        seed: int | Sequence[int],
        pairs: Pairs = numpy_pairs,
        recur: Recur = numpy_recursion,
        splits: Sequence[Split] = (),
    ) -> None:
        _positive(dt_s=dt_s)
        par = parameters
        filters = GustFilters(
            u=first_order(dt_s, par.L_u_m / par.V_mps),
            v=lateral(dt_s, par.L_u_m / par.V_mps, par.T_r_s),
            w=lateral(dt_s, par.L_w_m / par.V_mps, par.T_q_s),
            p=first_order(dt_s, par.T_p_s),
        )
        # Slopes in time become rotations: the gust field moves past at airspeed V.
        slopes = (
            -par.sigma_w_mps / par.V_mps,  # 3.7.5: q = -dw/dx = -(dw/dt)/V
            par.sigma_u_mps / par.V_mps,  # 3.7.5: r = +dv/dx = +(dv/dt)/V
        )
        self._scales = np.array(
            [par.sigma_u_mps, par.sigma_u_mps, par.sigma_w_mps, par.sigma_p_radps, *slopes]
        )[:, None]

        self._pairs, self._steps = pairs, 0
        self._unit = UnitGusts(
            filters, [Normals(_generator(seed, name), pairs) for name in _STREAMS], recur
        )
        self.branch(*splits)

    def page(self) -> FloatArray:
        """Return the next samples (6, PAGE_STEPS) in the order of COMPONENTS [m/s, rad/s]."""
        page = self._unit.page()
        page *= self._scales
        self._steps += PAGE_STEPS
        return page

    def __deepcopy__(self, memo: object) -> DrydenGusts:
        """Return gusts that continue from here."""
        other = copy.copy(self)
        other._unit = copy.deepcopy(self._unit)
        return other

    def keep_noise(self) -> None:
        """Keep the noise of each coming page until the next, as `branched` needs."""
        self._unit.keeps_noise = True

    def branched(self, split: Split) -> tuple[DrydenGusts, FloatArray] | None:
        """Return gusts that left these at a split within the last page, and that page (6,
        PAGE_STEPS).

        None if the page's noise was not kept. Raises ValueError for a split elsewhere.
        """
        step = split.frame - (self._steps - PAGE_STEPS)
        if not 0 <= step < PAGE_STEPS:
            raise ValueError(
                f"the last page ends at step {self._steps}; received a split at {split.frame}"
            )
        normals = [
            Normals(np.random.PCG64(split.stream("turbulence", number)), self._pairs)
            for number in _STREAMS.values()
        ]
        branched = self._unit.branched(step, normals)
        if branched is None:
            return None
        other = copy.copy(self)
        other._unit, page = branched
        page *= self._scales
        return other, page

    def branch(self, *splits: Split) -> None:
        """Use other noise behind each of these splits, which lie in coming pages."""
        pairs, numbers = self._pairs, list(_NORMALS_PER_STEP.items())

        def noise(place: int, source: Source) -> Source:
            name, per_step = numbers[place]
            return splice(
                source,
                splits,
                "turbulence",
                _STREAMS[name],
                lambda g: Normals(g, pairs),
                per_step=per_step,
                done=self._steps,
            )

        self._unit.exchange(noise)


def _lateral_psd(omega: FloatArray, sigma: float, T: float) -> FloatArray:
    """Return the spectral density of v or w."""
    square = (T * omega) ** 2
    return sigma**2 * T / np.pi * (1.0 + 3.0 * square) / (1.0 + square) ** 2


def _gradient_sigma(sigma: float, L: float, smoothing: float) -> float:
    """Return the standard deviation of q or r in closed form."""
    # Integral of (w/V)^2/(1 + (smoothing w/V)^2) Phi by partial fractions, rho = smoothing/L.
    rho = smoothing / L
    return float(
        sigma
        / L
        * np.sqrt(0.5 * (3.0 / rho - 5.0 / (1.0 + rho) + (1.0 + 2.0 * rho) / (1.0 + rho) ** 2))
    )


def _generator(seed: int | Sequence[int], name: str) -> np.random.PCG64:
    """Return the bit generator of one stream."""
    entropy = [int(seed)] if isinstance(seed, int | np.integer) else [int(part) for part in seed]
    return np.random.PCG64(np.random.SeedSequence(entropy, spawn_key=(_STREAMS[name],)))


def _positive(**values: float) -> None:
    """Raise BadInputError unless all values are positive."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise BadInputError(f"{name} = {value}: must be a positive number")
