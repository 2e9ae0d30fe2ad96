"""Known truth for the studies: linear longitudinal and lateral motion of an E-SPAARO-like aircraft,
with turbulence.

Perturbations about level flight at 22.2 m/s in sea-level air, x body along the flight path at trim.
Derivatives are nondimensional, as in the body-axis build-up CX CZ Cm / CY Cl Cn; surfaces in
degrees. The motion is integrated exactly for inputs held over each sample (matrix exponential);
gusts come in five times a sample, so that they move the aircraft within it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import signal
from scipy.linalg import expm

from sysid.arrays import FloatArray

G, RHO, MASS, IXX, IYY, IZZ, IXZ = 9.81, 1.225, 21.34, 6.055, 8.26, 11.51, 0.25
S, C, B, V0 = 1.97, 0.53, 3.66, 22.2
QS = 0.5 * RHO * V0**2 * S
DT = 0.02
FINE = 5
"""Steps a sample in turbulence. With one, gusts would begin to act at the next sample, and a filter
that assumes so look right."""
DEG = np.pi / 180.0

# E-SPAARO flight estimates (dissertation Table 2.6); CX_V, CZ_V and CZ_q are not printed there.
LON_TRUTH = {
    "CX_alpha": 0.30,
    "CX_V": -0.12,
    "CZ_alpha": -3.34,
    "CZ_V": -0.60,
    "CZ_q": -4.0,
    "CZ_de": 0.036,
    "Cm_alpha": -0.487,
    "Cm_q": -13.8,
    "Cm_de": -0.014,
}
LAT_TRUTH = {
    "CY_beta": -0.298,
    "CY_p": -0.075,
    "CY_r": 0.135,
    "CY_dr": 0.0023,
    "Cl_beta": -0.01,
    "Cl_p": -0.296,
    "Cl_r": 0.0094,
    "Cl_da": 0.0024,
    "Cl_dr": -0.0003,
    "Cn_beta": 0.0473,
    "Cn_p": -0.0225,
    "Cn_r": -0.075,
    "Cn_da": -7e-6,
    "Cn_dr": -0.0011,
}
LON_BIASES = {"bias_ax": 0.0, "bias_az": 0.0, "bias_qdot": 0.0}
LAT_BIASES = {"bias_ay": 0.0, "bias_pdot": 0.0, "bias_rdot": 0.0}
# Table 2.1: V m/s; alpha, beta rad; theta, phi rad; p, q, r rad/s; ax, ay, az m/s2
LON_NOISE = np.array([0.5, 0.1 * DEG, 0.2 * DEG, 0.5 * DEG, 0.16, 0.16])
LAT_NOISE = np.array([0.1 * DEG, 0.2 * DEG, 0.2 * DEG, 0.5 * DEG, 0.16])


def _longitudinal_accelerations(x: Any, u: Any, theta: Any) -> tuple[Any, Any]:
    """Return perturbation specific forces ax, az at the CG, m/s2."""
    cxa, cxv, cza, czv, czq, czd, _, _, _, bx, bz, _ = theta
    ax = QS / MASS * (cxv * x[0] / V0 + cxa * x[1]) + bx
    az = QS / MASS * (czv * x[0] / V0 + cza * x[1] + czq * C / (2.0 * V0) * x[2] + czd * u[0]) + bz
    return ax, az


def longitudinal_rate(x: Any, u: Any, theta: Any) -> FloatArray:
    """Return dx/dt of V, alpha, q, theta (m/s, rad, rad/s, rad); V and vane include the gust; u =
    elevator."""
    ax, az = _longitudinal_accelerations(x, u, theta)
    cma, cmq, cmd, bias = theta[6], theta[7], theta[8], theta[11]
    moment = QS * C / IYY * (cma * x[1] + cmq * C / (2.0 * V0) * x[2] + cmd * u[0]) + bias
    return np.array([ax - G * x[3], az / V0 + x[2], moment, 0.0 * moment + x[2]])


def longitudinal_output(x: Any, u: Any, theta: Any) -> FloatArray:
    """Return V, alpha, q, theta, ax, az."""
    ax, az = _longitudinal_accelerations(x, u, theta)
    return np.array([x[0] + 0.0 * ax, x[1] + 0.0 * ax, x[2] + 0.0 * ax, x[3] + 0.0 * ax, ax, az])


def _lateral_acceleration(x: Any, u: Any, theta: Any) -> Any:
    h = B / (2.0 * V0)
    return (
        QS / MASS * (theta[0] * x[0] + theta[1] * h * x[1] + theta[2] * h * x[2] + theta[3] * u[1])
        + theta[14]
    )


def lateral_rate(x: Any, u: Any, theta: Any) -> FloatArray:
    """Return dx/dt of beta, p, r, phi (rad, rad/s, rad/s, rad); u = aileron, rudder."""
    _, _, _, _, clb, clp, clr, cla, cld, cnb, cnp, cnr, cna, cnd, _, bias_p, bias_r = theta
    h, ay = B / (2.0 * V0), _lateral_acceleration(x, u, theta)
    roll = QS * B * (clb * x[0] + clp * h * x[1] + clr * h * x[2] + cla * u[0] + cld * u[1])
    yaw = QS * B * (cnb * x[0] + cnp * h * x[1] + cnr * h * x[2] + cna * u[0] + cnd * u[1])
    det = IXX * IZZ - IXZ**2
    p_dot = (IZZ * roll + IXZ * yaw) / det + bias_p
    r_dot = (IXZ * roll + IXX * yaw) / det + bias_r
    return np.array([ay / V0 - x[2] + G / V0 * x[3], p_dot, r_dot, x[1] + 0.0 * p_dot])


def lateral_output(x: Any, u: Any, theta: Any) -> FloatArray:
    """Return beta, p, r, phi, ay."""
    ay = _lateral_acceleration(x, u, theta)
    return np.array([x[0] + 0.0 * ay, x[1] + 0.0 * ay, x[2] + 0.0 * ay, x[3] + 0.0 * ay, ay])


def matrices(
    plane: Plane, theta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return A (4, 4), B (4, nu), state bias (4,), C (m, 4), D (m, nu) and output bias (m,) of the
    (linear) equations."""
    probes = 4 + plane.inputs + 1
    x, u = np.zeros((4, probes)), np.zeros((plane.inputs, probes))
    x[:, :4], u[:, 4:-1] = np.eye(4), np.eye(plane.inputs)
    lanes = theta[:, None] * np.ones(probes)
    out = []
    for function in (plane.rate, plane.output):
        value = function(x, u, lanes)
        bias = value[:, -1]
        out += [value[:, :4] - bias[:, None], value[:, 4:-1] - bias[:, None], bias]
    return out[0], out[1], out[2], out[3], out[4], out[5]


@dataclass(frozen=True)
class Plane:
    """One of the two motions: names, true values, noise (m,), and its equations, which also take
    lanes."""

    name: str
    truth: dict[str, float]
    biases: dict[str, float]
    noise: FloatArray
    inputs: int
    rate: Callable[[Any, Any, Any], FloatArray]
    output: Callable[[Any, Any, Any], FloatArray]

    @property
    def names(self) -> list[str]:
        """Parameters and biases, in the order of theta."""
        return [*self.truth, *self.biases]

    def draw(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw true values +-25 % about nominal, biases of sensor size, and a start off by up to 30
        % (biases 0)."""
        nominal = np.array(list(self.truth.values()))
        true = nominal * rng.uniform(0.75, 1.25, nominal.size)
        start = nominal * rng.uniform(0.7, 1.3, nominal.size)
        biases = rng.normal(0.0, [0.1, 0.1, 0.02], len(self.biases))
        return np.concatenate([true, biases]), np.concatenate([start, np.zeros(len(self.biases))])


LONGITUDINAL = Plane(
    "longitudinal", LON_TRUTH, LON_BIASES, LON_NOISE, 1, longitudinal_rate, longitudinal_output
)
LATERAL = Plane("lateral", LAT_TRUTH, LAT_BIASES, LAT_NOISE, 2, lateral_rate, lateral_output)


def manoeuvres(plane: Plane, lengths: list[int]) -> list[FloatArray]:
    """Make inputs (n, nu) in degrees: 3-2-1-1 and doublets, one pattern a segment, alternating
    between surfaces."""
    out = []
    for number, n in enumerate(lengths):
        time = np.arange(n) * DT
        u = np.zeros((n, plane.inputs))
        unit = (0.3, 0.5, 0.4, 0.7)[number % 4]
        steps = ((1, 1, 1, -1, -1, 1, -1), (1, -1))[number % 2]
        for surface in range(plane.inputs):
            begin = 0.6 + (surface + number) % plane.inputs * 3.2
            size = (4.0, 3.0)[number % 2] * (1.0, -1.0)[number // 2 % 2] * (1.0, 1.5)[surface]
            for position, sign in enumerate(steps):
                u[
                    (time >= begin + position * unit) & (time < begin + (position + 1) * unit),
                    surface,
                ] = size * sign
        out.append(u)
    return out


def simulate(
    plane: Plane, theta: FloatArray, inputs: list[FloatArray], gusts: list[FloatArray] | None = None
) -> list[FloatArray]:
    """Return outputs (n, m) a segment from zero perturbation; gusts (FINE n, 4): increments of the
    states by moving air, FINE a sample."""
    fine = 1 if gusts is None else FINE
    A, Bm, xb, Cm, D, yb = matrices(plane, theta)
    n = A.shape[0]
    nu = Bm.shape[1]
    joint = np.zeros((n + nu + 1, n + nu + 1))
    joint[:n, :n], joint[:n, n : n + nu], joint[:n, -1] = A, Bm, xb
    exact = expm(joint * (DT / fine))
    phi, gamma, drift = exact[:n, :n], exact[:n, n : n + nu], exact[:n, -1]
    values, vectors = np.linalg.eig(phi)
    inverse = np.linalg.inv(vectors)
    out = []
    for number, u in enumerate(inputs):
        forcing = np.repeat(u @ gamma.T + drift, fine, axis=0)
        if gusts is not None:
            forcing = forcing + gusts[number]
        modal = forcing @ inverse.T  # x(k+1) = phi x(k) + forcing(k), mode by mode
        z = np.zeros((fine * len(u), n), dtype=complex)
        for mode in range(n):
            z[1:, mode] = signal.lfilter([1.0], [1.0, -values[mode]], modal[:-1, mode])
        x = (z[::fine] @ vectors.T).real
        out.append(x @ Cm.T + u @ D.T + yb)
    return out


def dryden(
    plane: Plane,
    lengths: list[int],
    wind_kt: float,
    rng: np.random.Generator,
    height_m: float = 100.0,
) -> list[FloatArray]:
    """Draw increments (FINE n, 4) a segment of the air-relative states as Dryden gusts change
    (MIL-F-8785C, low altitude).

    wind_kt: wind at 20 ft, 15 = light. Longitudinal: u_g on V, w_g on alpha; lateral: v_g on beta.
    First and second order forming filters discretised exactly; the gradient terms (p_g, q_g, r_g)
    are left out.
    """
    feet = height_m / 0.3048
    shape = 0.177 + 0.000823 * feet
    sigma_w = 0.1 * wind_kt * 0.514444
    sigma_u = sigma_w / shape**0.4
    length_w, length_u = height_m, feet / shape**1.2 * 0.3048
    out = []
    for n in (FINE * length for length in lengths):
        increments = np.zeros((n, 4))
        if plane.name == "longitudinal":
            increments[:, 0] = np.diff(_first_order(sigma_u, length_u / V0, n + 1, rng))
            increments[:, 1] = np.diff(_second_order(sigma_w, length_w / V0, n + 1, rng)) / V0
        else:
            increments[:, 0] = np.diff(_second_order(sigma_u, length_u / V0, n + 1, rng)) / V0
        out.append(increments)
    return out


def _first_order(sigma: float, tau: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Draw stationary samples (n,), FINE a record's, of sigma sqrt(2 tau)/(1 + tau s) driven by
    white noise."""
    a = np.exp(-DT / FINE / tau)
    white = rng.normal(size=n) * sigma * np.sqrt(1.0 - a**2)
    white[0] = rng.normal() * sigma
    return np.asarray(signal.lfilter([1.0], [1.0, -a], white))


def _second_order(sigma: float, tau: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Draw stationary samples (n,), FINE a record's, of sigma sqrt(tau) (1 + sqrt(3) tau s)/(1 +
    tau s)^2 driven by white noise."""
    A = np.array([[0.0, 1.0], [-1.0 / tau**2, -2.0 / tau]])
    gain = np.array([0.0, 1.0])
    out = sigma * np.sqrt(tau) / tau**2 * np.array([1.0, np.sqrt(3.0) * tau])
    stationary = np.array([[tau**3 / 4.0, 0.0], [0.0, tau / 4.0]])
    phi = expm(A * (DT / FINE))
    step = stationary - phi @ stationary @ phi.T
    root = np.linalg.cholesky(step + 1e-18 * np.eye(2))
    assert np.allclose(A @ stationary + stationary @ A.T + np.outer(gain, gain), 0.0)
    x = np.linalg.cholesky(stationary) @ rng.normal(size=2)
    series = np.empty(n)
    noise = rng.normal(size=(n, 2)) @ root.T
    for k in range(n):
        series[k] = out @ x
        x = phi @ x + noise[k]
    return series


def fly(
    plane: Plane, theta: FloatArray, lengths: list[int], wind_kt: float, rng: np.random.Generator
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return inputs (n, nu) and noisy measurements (n, m) a segment; wind_kt 0 = calm air."""
    inputs = manoeuvres(plane, lengths)
    gusts = dryden(plane, lengths, wind_kt, rng) if wind_kt > 0.0 else None
    clean = simulate(plane, theta, inputs, gusts)
    return inputs, [part + rng.normal(size=part.shape) * plane.noise for part in clean]
