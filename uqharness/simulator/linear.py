"""Linearise the nonlinear JSBSim model about a trim and name its modes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uqharness.arguments import instance
from uqharness.errors import BadInputError
from uqharness.simulator.aircraft import Aircraft
from uqharness.simulator.forced_state import BodyState, force_state
from uqharness.simulator.trim import Trim, force_beside

STATES = ("u", "v", "w", "p", "q", "r", "phi", "theta")
LONGITUDINAL = (0, 2, 4, 7)
LATERAL = (1, 3, 5, 6)

# Central-difference steps: m/s, rad/s and rad; controls take a thousandth of their span.
_STEP = {
    "u": 0.05,
    "v": 0.05,
    "w": 0.05,
    "p": 1e-3,
    "q": 1e-3,
    "r": 1e-3,
    "phi": 1e-3,
    "theta": 1e-3,
}
# Accelerations [m/s2, rad/s2] of an aircraft in the trim that was found for it; find_trim leaves less than 1e-6.
_STILL = 1e-4


@dataclass(frozen=True)
class LinearModel:
    """dx/dt = A x + B u about a trim. x = (u, v, w, p, q, r, phi, theta) in m/s, rad/s, rad; u in the controls' own units."""

    trim: Trim
    A: NDArray[np.float64]
    B: NDArray[np.float64]
    controls: tuple[str, ...]

    def __repr__(self) -> str:
        return (
            f"LinearModel(A {self.A.shape}, B {self.B.shape}, controls {', '.join(self.controls)})"
        )


@dataclass(frozen=True)
class Mode:
    """One mode: a conjugate pair is listed once, with its positive imaginary part; wn in rad/s, zeta = -real/wn."""

    name: str
    real: float
    imag: float
    wn_radps: float
    zeta: float


def linearise(aircraft: Aircraft, trim: Trim) -> LinearModel:
    """A (8, 8) and B (8, controls) by central differences of the model's accelerations and exact attitude kinematics.

    Actuators are outside (a control here is a surface position) and thrust follows its map at fixed throttle. A control system that
    was brought to rest stands as it rested in the trim; what it makes of a control is what it ends at, and NaN where the body rates
    are its own: it answers with another rate, not with another acceleration. Raises BadInputError if the trim did not converge or
    is of another aircraft.
    """
    instance("trim", trim, Trim, "a Trim, as find_trim gives it,")
    if not trim.converged:
        raise BadInputError(f"cannot linearise: {trim.reason}")
    condition = trim.condition
    centre, base = trim.state, dict(trim.controls)

    def accelerations(state: BodyState, controls: dict[str, float]) -> NDArray[np.float64]:
        if trim.rest is not None and controls == base:
            return force_beside(aircraft, trim, state, controls)
        return force_state(
            aircraft, state, controls, condition.altitude_m, condition.properties, rest=trim.rest
        )[0]

    def derivative(state: BodyState, controls: dict[str, float]) -> NDArray[np.float64]:
        acceleration = accelerations(state, controls)
        turning = state.q * np.sin(state.phi) + state.r * np.cos(state.phi)
        phi_dot = state.p + np.tan(state.theta) * turning
        theta_dot = state.q * np.cos(state.phi) - state.r * np.sin(state.phi)
        return np.array([*acceleration, phi_dot, theta_dot])

    known = aircraft.card.inputs.keys() >= base.keys()
    if not (known and np.max(np.abs(derivative(centre, base)[:6])) <= _STILL):
        raise BadInputError(
            f"this trim is not of aircraft '{aircraft.name}', which is not in steady flight there; find its own"
        )
    A = np.empty((8, 8))
    for column, name in enumerate(STATES):
        A[:, column] = _central(
            lambda h, name=name: derivative(
                replace(centre, **{name: getattr(centre, name) + h}), base
            ),  # type: ignore[misc]
            _STEP[name],
        )
    names = tuple(base)
    B = np.full((8, len(names)), np.nan)
    for column, name in enumerate(names if trim.rest is None or not trim.rest.free else ()):
        low, high = aircraft.card.inputs[name].limits
        B[:, column] = _central(
            lambda h, name=name: derivative(centre, base | {name: base[name] + h}),  # type: ignore[misc]
            1e-3 * (high - low),
        )
    return LinearModel(trim, A, B, names)


def _central(function: Callable[[float], NDArray[np.float64]], step: float) -> NDArray[np.float64]:
    return (function(step) - function(-step)) / (2.0 * step)


def modes(model: LinearModel) -> list[Mode]:
    """The modes of A by name: two longitudinal pairs (short_period, phugoid), dutch_roll, roll and spiral.

    Each eigenvalue counts once: the four whose eigenvectors are most longitudinal, conjugates kept together, make the longitudinal
    modes. A pair that has split into two real roots keeps its name on both. In a steep turn the axes are coupled and a
    name says only what the mode is nearest to.
    """
    values, vectors = np.linalg.eig(model.A)
    # Angles and rates are weighed against velocities by the airspeed, so that the share of each set has one unit.
    weight = np.ones(8)
    weight[3:] = model.trim.condition.V_mps
    energy = np.abs(vectors * weight[:, None]) ** 2
    share = energy[list(LONGITUDINAL)].sum(axis=0) / energy.sum(axis=0)
    # A conjugate pair is one block: its upper half stands for both.
    blocks = [
        [k] if value.imag == 0 else [k, int(np.argmin(np.abs(values - value.conjugate())))]
        for k, value in enumerate(values)
        if value.imag >= 0
    ]
    choices = [
        [k for block in chosen for k in block]
        for count in range(2, 5)
        for chosen in itertools.combinations(blocks, count)
        if sum(map(len, chosen)) == 4
    ]
    longitudinal = max(choices, key=lambda chosen: float(share[chosen].sum()))
    lateral = [k for k in range(8) if k not in longitudinal]
    return _longitudinal_modes(values[longitudinal]) + _lateral_modes(values[lateral])


def _longitudinal_modes(values: NDArray[np.complex128]) -> list[Mode]:
    by_speed = values[np.argsort(-np.abs(values))]
    found: list[Mode] = []
    for name, pair in (("short_period", by_speed[:2]), ("phugoid", by_speed[2:])):
        found += _pair(name, pair)
    return found


def _lateral_modes(values: NDArray[np.complex128]) -> list[Mode]:
    oscillating = [value for value in values if value.imag > 0]
    real = sorted((value.real for value in values if value.imag == 0), key=abs)
    if len(oscillating) == 1:
        return [
            _mode("dutch_roll", oscillating[0]),
            _mode("roll", real[-1]),
            _mode("spiral", real[0]),
        ]
    if len(oscillating) == 2:
        # Roll and spiral have joined: a lateral phugoid, slower than the Dutch roll.
        slow, fast = sorted(oscillating, key=abs)
        return [_mode("dutch_roll", fast), _mode("roll", slow), _mode("spiral", slow)]
    return [
        _mode("dutch_roll", real[1]),
        _mode("dutch_roll", real[2]),
        _mode("roll", real[3]),
        _mode("spiral", real[0]),
    ]


def _pair(name: str, pair: NDArray[np.complex128]) -> list[Mode]:
    if pair[0].imag != 0:
        return [_mode(name, complex(pair[0].real, abs(pair[0].imag)))]
    return [_mode(name, value) for value in pair]


def _mode(name: str, value: complex) -> Mode:
    value = complex(value)
    wn = abs(value)
    return Mode(name, value.real, value.imag, wn, -value.real / wn if wn > 0 else float("nan"))
