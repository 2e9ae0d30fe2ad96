"""Dryden turbulence after MIL-F-8785C, low altitude (10 to 1000 ft): spectra, standard deviations and sampled gusts.

Axes: x along the flight path (level: along the heading), y right, z down. ``u, v, w`` is the velocity of the air;
``p, q, r`` the rotation of the AIR: q = -dw/dx and r = +dv/dx, smoothed over the span. An aircraft's aerodynamics see
its own rates less these.

The gusts are samples of the continuous process, exact at any step (``gust_filters``). q comes from the noise of w and r from that
of v, so that they belong together. The samples are the same bytes on every processor. Paragraphs: MIL-F-8785C (1980).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.arrays import FloatArray
from sysid.units import FT_M, KT_MPS
from uqharness.errors import BadInputError
from uqharness.flight import exact
from uqharness.flight.branching import Source, Split, spliced
from uqharness.flight.gust_filters import (
    PAGE_STEPS,
    GustFilters,
    Recur,
    UnitGusts,
    first_order,
    lateral,
    numpy_recursion,
)
from uqharness.flight.normals import Normals, Pairs, numpy_pairs
from uqharness.flight.spec import BELOW_CEILING, TURBULENCE_CEILING_M

Component = Literal["u", "v", "w", "p", "q", "r"]
COMPONENTS: tuple[Component, ...] = ("u", "v", "w", "p", "q", "r")

_STREAMS = {"u": 0, "v": 1, "w": 2, "p": 3}
_PER_STEP = {"u": 1, "v": 3, "w": 3, "p": 1}


@dataclass(frozen=True)
class GustSeries:
    """Gusts in heading axes at a fixed step, arrays of shape (n,)."""

    dt_s: float
    u_mps: FloatArray
    v_mps: FloatArray
    w_mps: FloatArray
    p_radps: FloatArray
    q_radps: FloatArray
    r_radps: FloatArray

    def component(self, name: Component) -> FloatArray:
        """One of u, v, w, p, q, r by its letter."""
        series: FloatArray = getattr(self, f"{name}_mps" if name in "uvw" else f"{name}_radps")
        return series


@dataclass(frozen=True)
class DrydenParameters:
    """Scales of the turbulence at one height, airspeed and span."""

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
    """Scale lengths, intensities and the span's time constants.

    ``h_m`` is the height above the ground; below 10 ft the values of 10 ft hold. L_v = L_u and sigma_v = sigma_u.
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
    # 3.7.5, Phi_p: sigma_p^2 = integral of sigma_w^2/(V L_w) 0.8 (pi L_w/4b)^(1/3) / (1 + (4 b w/pi V)^2) over w from 0
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
    """Raise BadInputError if a flight begins higher than the low-altitude model reaches."""
    if not h_m <= TURBULENCE_CEILING_M:
        raise BadInputError(
            f'turbulence = "{turbulence}": the flight begins {h_m:.0f} m above the ground, and the low-altitude model of '
            f"MIL-F-8785C reaches to {TURBULENCE_CEILING_M:g} m (1000 ft); {BELOW_CEILING}"
        )


def dryden_psd(
    component: Component,
    omega_radps: npt.ArrayLike,
    V_mps: float,
    h_m: float,
    W20_kt: float,
    b_m: float,
) -> FloatArray:
    """One-sided spectral density over angular frequency; its integral from 0 to infinity is the variance.

    Unit (m/s)^2 s for u, v, w and (rad/s)^2 s for p, q, r.
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
    """Standard deviation: the root of the spectrum's integral, in closed form for all six."""
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
    seed: int | Sequence[int],
) -> GustSeries:
    """``n`` samples of all six gusts at constant airspeed and height.

    ``seed`` is the root seed or a sequence that begins with it, such as (root, aleatory id). u, v with r, w with q, and
    p draw from a stream each; W20 scales the result and nothing else: all intensities share one history.
    """
    return next(gust_blocks(n, dt_s, V_mps, h_m, W20_kt, b_m, seed, max(n, 1)))


def gust_blocks(
    n: int,
    dt_s: float,
    V_mps: float,
    h_m: float,
    W20_kt: float,
    b_m: float,
    seed: int | Sequence[int],
    block: int,
) -> Iterator[GustSeries]:
    """The same ``n`` samples, to the bit, as series of at most ``block``: the memory of a day is that of a block."""
    if n < 1:
        raise BadInputError(f"n = {n}: at least one sample is needed")
    gusts = DrydenGusts(dryden_parameters(V_mps, h_m, W20_kt, b_m), dt_s, seed)
    held = np.empty((len(COMPONENTS), 0))
    for first in range(0, n, block):
        size = min(block, n - first)
        missing = -(-(size - held.shape[1]) // PAGE_STEPS)
        if missing > 0:
            held = np.concatenate([held, *(gusts.page() for _ in range(missing))], axis=1)
        yield GustSeries(dt_s, *held[:, :size])
        held = held[:, size:]


class DrydenGusts:
    """The same samples without end, a page of PAGE_STEPS at a time.

    ``seed`` as of ``dryden_gusts``; behind each of ``splits`` the noise is another. ``pairs`` and ``recur`` may be compiled forms
    of ``numpy_pairs`` and ``numpy_recursion``.
    ``copy.deepcopy`` gives gusts that go on from where these stand; ``branched`` those that left within the last page.
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
        """The next samples, (6, PAGE_STEPS) with the rows of COMPONENTS [m/s, rad/s]."""
        page = self._unit.page()
        page *= self._scales
        self._steps += PAGE_STEPS
        return page

    def __deepcopy__(self, memo: object) -> DrydenGusts:
        other = copy.copy(self)
        other._unit = copy.deepcopy(self._unit)
        return other

    def keep_noise(self) -> None:
        """Keep the noise of the pages to come, each until the next: what ``branched`` needs."""
        self._unit.keeps_noise = True

    def branched(self, split: Split) -> tuple[DrydenGusts, FloatArray] | None:
        """Gusts that left these at a split within the last page, and that page (6, PAGE_STEPS); they go on behind it.

        None where the page's noise was not kept. Raises ValueError for a split elsewhere.
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
        found = self._unit.branched(step, normals)
        if found is None:
            return None
        other = copy.copy(self)
        other._unit, page = found
        page *= self._scales
        return other, page

    def branch(self, *splits: Split) -> None:
        """Other noise behind each of these splits, which lie in pages to come."""
        pairs, numbers = self._pairs, list(_PER_STEP.items())

        def noise(place: int, source: Source) -> Source:
            name, per_step = numbers[place]
            return spliced(
                source,
                splits,
                "turbulence",
                _STREAMS[name],
                lambda g: Normals(g, pairs),
                per_step,
                self._steps,
            )

        self._unit.exchange(noise)


def _lateral_psd(omega: FloatArray, sigma: float, T: float) -> FloatArray:
    square = (T * omega) ** 2
    return sigma**2 * T / np.pi * (1.0 + 3.0 * square) / (1.0 + square) ** 2


def _gradient_sigma(sigma: float, L: float, smoothing: float) -> float:
    # Integral of (w/V)^2/(1 + (smoothing w/V)^2) Phi by partial fractions, rho = smoothing/L.
    rho = smoothing / L
    return float(
        sigma
        / L
        * np.sqrt(0.5 * (3.0 / rho - 5.0 / (1.0 + rho) + (1.0 + 2.0 * rho) / (1.0 + rho) ** 2))
    )


def _generator(seed: int | Sequence[int], name: str) -> np.random.PCG64:
    entropy = [int(seed)] if isinstance(seed, int | np.integer) else [int(part) for part in seed]
    return np.random.PCG64(np.random.SeedSequence(entropy, spawn_key=(_STREAMS[name],)))


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise BadInputError(f"{name} = {value}: must be a positive number")
