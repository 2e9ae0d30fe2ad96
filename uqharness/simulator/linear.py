"""Linear model about a trim, and the names of its modes.

`linearise` differentiates the accelerations of the JSBSim model by central differences. `modes`
names the eigenvalues by the shapes of their eigenvectors. `mode_intervals` draws members of a model
form and returns an interval for each mode.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sysid.aerodynamics import COEFFICIENTS, regressors
from sysid.arrays import FloatArray
from sysid.units import FT_M, SLUG_FT3_KGPM3
from uqharness.arguments import instance
from uqharness.errors import BadInputError
from uqharness.simulator import engine
from uqharness.simulator.aircraft import Aircraft, open_aircraft
from uqharness.simulator.forced_state import BodyState, force_state
from uqharness.simulator.mass import mass_properties
from uqharness.simulator.trim import Trim, force_near_trim

if TYPE_CHECKING:
    from sysid.model_form import ModelForm

STATE_NAMES = ("u", "v", "w", "p", "q", "r", "phi", "theta")
LONGITUDINAL = (0, 2, 4, 7)
LATERAL = (1, 3, 5, 6)
MODE_NAMES = ("short_period", "phugoid", "third", "dutch_roll", "roll", "spiral", "other")
"""Names that `modes` gives, in its order."""

# Central-difference steps [m/s, rad/s, rad]; controls use a thousandth of their range.
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
# Accelerations [m/s2, rad/s2] that a trim of this aircraft may leave; find_trim leaves under 1e-6.
_TRIM_TOLERANCE = 1e-4


@dataclass(frozen=True)
class LinearModel:
    """dx/dt = A x + B u about a trim.

    Attributes
    ----------
    trim : Trim
        The trim.
    A : ndarray
        (8, 8), x = (u, v, w, p, q, r, phi, theta) in m/s, rad/s, rad.
    B : ndarray
        (8, m), u in the controls' own units.
    controls : tuple of str
        Names of the m controls.
    """

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
    """One mode; a conjugate pair is listed once.

    Attributes
    ----------
    name : str
        One of `MODE_NAMES`.
    real, imag : float
        Eigenvalue [1/s], imaginary part not negative.
    wn_radps, zeta : float
        Natural frequency [rad/s] and damping ratio, -real/wn.
    """

    name: str
    real: float
    imag: float
    wn_radps: float
    zeta: float


MAX_DECAY_PER_STEP = 0.2
"""Largest decay in a step of JSBSim, real part times step; its time constant is then 11 % short."""


def step_notes(all_modes: Sequence[Mode], dt_s: float) -> list[str]:
    """Return a note if the roll decays too fast for JSBSim's step.

    JSBSim integrates body rates by Euler's rule: in a step it multiplies a roll rate that decays as
    exp(lambda t) by 1 + lambda dt.

    Parameters
    ----------
    all_modes : sequence of Mode
    dt_s : float
        JSBSim's step.

    Examples
    --------
    >>> for note in step_notes([Mode("roll", -50.0, 0.0, 50.0, 1.0)], 0.01):
    ...     print(note)
    roll decays in 20 ms, but in 14 ms in steps of 10 ms: set dt_s in airframe.toml to 0.002
    """
    notes = []
    for real in (m.real for m in all_modes if m.name == "roll" and m.imag == 0.0):
        factor = 1.0 + real * dt_s
        if factor >= 1.0 - MAX_DECAY_PER_STEP:
            continue
        if factor <= -1.0:
            simulated = "grows"
        elif factor <= 0.0:
            simulated = "changes its sign at each step"
        else:
            simulated = f"in {-1e3 * dt_s / math.log(factor):.2g} ms"
        notes.append(
            f"roll decays in {-1e3 / real:.2g} ms, but {simulated} in steps of {1e3 * dt_s:.3g} ms:"
            f" set dt_s in airframe.toml to {_rounded_down(-MAX_DECAY_PER_STEP / real):g}"
        )
    return notes


def _rounded_down(step_s: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not above a step."""
    power = 10.0 ** math.floor(math.log10(step_s))
    return max(k * power for k in (1.0, 2.0, 5.0) if k * power <= step_s * (1.0 + 1e-9))


def linearise(aircraft: Aircraft, trim: Trim) -> LinearModel:
    """Linearise the model about a trim.

    Parameters
    ----------
    aircraft : Aircraft
        The aircraft.
    trim : Trim
        A converged trim of it.

    Returns
    -------
    LinearModel
        A by central differences of the accelerations and exact attitude kinematics, B likewise.

    Raises
    ------
    BadInputError
        If the trim did not converge or belongs to another aircraft.

    Notes
    -----
    A control is a surface position: actuators are not part of the model. Thrust follows its map at
    fixed throttle. A control system that was brought to rest for the trim stays there; for a change
    of command, B holds the final effect. B is NaN if the control system sets body rates, because it
    then answers with another rate, not with an acceleration.
    """
    instance("trim", trim, Trim, "a Trim, as find_trim gives it,")
    if not trim.converged:
        raise BadInputError(f"cannot linearise: {trim.reason}")
    condition = trim.condition
    centre, base = trim.state, dict(trim.controls)

    # Around a trim with settled controls, the control system must stay as it is.
    def accelerations(state: BodyState, controls: dict[str, float]) -> NDArray[np.float64]:
        if trim.equilibrium is not None and controls == base:
            return force_near_trim(aircraft, trim, state, controls)
        return force_state(
            aircraft,
            state,
            controls,
            condition.altitude_m,
            condition.properties,
            equilibrium=trim.equilibrium,
        )[0]

    def derivative(state: BodyState, controls: dict[str, float]) -> NDArray[np.float64]:
        acceleration = accelerations(state, controls)
        # Exact attitude kinematics: phi' and theta' from body rates.
        turning = state.q * np.sin(state.phi) + state.r * np.cos(state.phi)
        phi_dot = state.p + np.tan(state.theta) * turning
        theta_dot = state.q * np.cos(state.phi) - state.r * np.sin(state.phi)
        return np.array([*acceleration, phi_dot, theta_dot])

    # A trim of another aircraft would give a linear model of no flight condition.
    has_controls = aircraft.card.inputs.keys() >= base.keys()
    if not (has_controls and np.max(np.abs(derivative(centre, base)[:6])) <= _TRIM_TOLERANCE):
        raise BadInputError(
            f"this trim belongs to another aircraft: '{aircraft.name}' is not in steady flight"
            " there; trim it first"
        )
    A = np.empty((8, 8))
    for column, name in enumerate(STATE_NAMES):
        A[:, column] = _central(
            lambda h, name=name: derivative(
                replace(centre, **{name: getattr(centre, name) + h}), base
            ),  # type: ignore[misc]
            _STEP[name],
        )
    names = tuple(base)
    B = np.full((8, len(names)), np.nan)
    for column, name in enumerate(
        names if trim.equilibrium is None or not trim.equilibrium.free else ()
    ):
        low, high = aircraft.card.inputs[name].limits
        B[:, column] = _central(
            lambda h, name=name: derivative(  # type: ignore[misc]
                centre, base | {name: base[name] + h}
            ),
            1e-3 * (high - low),
        )
    return LinearModel(trim, A, B, names)


def _central(function: Callable[[float], NDArray[np.float64]], step: float) -> NDArray[np.float64]:
    """Return the central difference of a function at 0."""
    return (function(step) - function(-step)) / (2.0 * step)


def modes(model: LinearModel) -> list[Mode]:
    """Return the modes of A, named by their eigenvectors; every eigenvalue appears once.

    The four roots with the largest share of u, w, q, theta are longitudinal, the others lateral.
    Longitudinal roots: short_period has the largest ratio of incidence to airspeed, phugoid the
    smallest; a pair between two real roots is ``third``, the third oscillatory mode of an aircraft
    with little static stability. Lateral roots: dutch_roll has the largest ratio of sideslip to
    bank; of the others the faster is roll, the slower spiral. A pair formed by roll and spiral
    (lateral phugoid) is ``other``.

    Parameters
    ----------
    model : LinearModel
        A linear model about a trim.

    Returns
    -------
    list of Mode
        In the order of `MODE_NAMES`. Two real roots in place of a pair are two entries of one name.
        In a steep turn axes are coupled; the name is then that of the nearest mode of straight
        flight.

    References
    ----------
    B. Etkin and L. D. Reid, Dynamics of Flight, 3rd edition, sections 6.5 and 6.8.
    """
    values, vectors = np.linalg.eig(model.A)
    V = model.trim.condition.V_mps
    size = np.abs(vectors)
    # Multiplied by airspeed, angles and rates have the unit of u, v, w.
    energy = (size * np.where(np.arange(8) < 3, 1.0, V)[:, None]) ** 2
    share = energy[list(LONGITUDINAL)].sum(axis=0) / energy.sum(axis=0)
    blocks = _conjugate_blocks(values)
    # All choices of blocks with four roots; a real 8 x 8 matrix always has one.
    choices = [
        chosen
        for count in range(2, 5)
        for chosen in itertools.combinations(blocks, count)
        if sum(map(len, chosen)) == 4
    ]
    longitudinal = max(choices, key=lambda chosen: sum(share[k] for block in chosen for k in block))
    # What remains is lateral.
    lateral = [block for block in blocks if block not in longitudinal]
    incidence = np.arctan2(size[2], size[0])  # 0 where airspeed alone moves, pi/2 where alpha does
    sideslip = np.arctan2(size[1], V * size[6])
    named_blocks = _longitudinal_names(list(longitudinal), values, incidence)
    named_blocks += _lateral_names(lateral, values, sideslip)
    named_blocks.sort(key=lambda item: MODE_NAMES.index(item[0]))
    return [_mode(name, values[block[0]]) for name, block in named_blocks]


def _conjugate_blocks(values: NDArray[np.complex128]) -> list[tuple[int, ...]]:
    """Return the indices of each real root and of each pair, the upper half first."""
    upper = [k for k, value in enumerate(values) if value.imag > 0]
    lower = [k for k, value in enumerate(values) if value.imag < 0]
    blocks: list[tuple[int, ...]] = [(k,) for k, value in enumerate(values) if value.imag == 0]
    for k in upper:
        # LAPACK gives exact conjugates; equal pairs must not share one lower half.
        conjugate = values[k].conjugate()
        partner = min(
            lower,
            key=lambda j, target=conjugate: abs(values[j] - target),  # type: ignore[misc]
        )
        lower.remove(partner)
        blocks.append((k, partner))
    return blocks


_NamedBlocks = list[tuple[str, tuple[int, ...]]]


def _longitudinal_names(
    blocks: list[tuple[int, ...]], values: NDArray[np.complex128], incidence: NDArray[np.float64]
) -> _NamedBlocks:
    """Name blocks of four roots by their share of incidence; within a name the fastest first."""
    ranked = sorted(blocks, key=lambda block: (-incidence[block[0]], -abs(values[block[0]])))
    if [len(block) for block in ranked] == [1, 2, 1]:
        return [("short_period", ranked[0]), ("phugoid", ranked[2]), ("third", ranked[1])]
    # Two pairs, a pair and two real roots, or four real roots.
    half = 2 if len(ranked) == 4 else 1 if len(ranked[0]) == 2 else 2
    return [("short_period", block) for block in ranked[:half]] + [
        ("phugoid", block) for block in ranked[half:]
    ]


def _lateral_names(
    blocks: list[tuple[int, ...]], values: NDArray[np.complex128], sideslip: NDArray[np.float64]
) -> _NamedBlocks:
    """Name blocks of four roots by their share of sideslip."""
    ranked = sorted(blocks, key=lambda block: -sideslip[block[0]])
    pairs, reals = ([b for b in ranked if len(b) == n] for n in (2, 1))
    if len(pairs) == 2:
        return [("dutch_roll", pairs[0]), ("other", pairs[1])]
    if pairs and ranked[-1] == pairs[0]:
        return [("dutch_roll", block) for block in reals] + [("other", pairs[0])]
    dutch, remaining = (pairs, reals) if pairs else (reals[:2], reals[2:])
    roll, spiral = sorted(remaining, key=lambda block: -abs(values[block[0]]))
    return [*(("dutch_roll", block) for block in dutch), ("roll", roll), ("spiral", spiral)]


def _mode(name: str, value: complex) -> Mode:
    """Return a mode of an eigenvalue."""
    value = complex(value)
    wn = abs(value)
    return Mode(name, value.real, value.imag, wn, -value.real / wn if wn > 0 else float("nan"))


# Intervals of the modes: the slopes of the coefficients' errors over the flight states.

MODE_MEMBERS = 1000
"""Members that `mode_intervals` draws."""


@dataclass(frozen=True)
class ModeInterval:
    """A mode over the members of a model form.

    Attributes
    ----------
    real, wn_radps, zeta : (float, float)
        Interval over the members that have the mode in the same form; NaN if none has.
    share : float
        Share of the members that have it in this form: a pair, or so many real roots.
    unstable : float
        Share of all members with a root of this name and a positive real part.
    """

    real: tuple[float, float]
    wn_radps: tuple[float, float]
    zeta: tuple[float, float]
    share: float
    unstable: float


def mode_intervals(
    aircraft: Aircraft, model: LinearModel, form: ModelForm, seed: int = 0
) -> list[ModeInterval]:
    """Return an interval for each of `modes`, in their order, at the form's confidence.

    Parameters
    ----------
    aircraft : Aircraft
        Lengths of its card take precedence over those of its XML.
    model : LinearModel
        Nominal.
    form : ModelForm
        Intervals of the coefficients' errors: their polynomials have the covariance s2 f (X'X)^-1.
    seed : int
        Of the members.

    Notes
    -----
    Members differ in the slopes of the errors at the trim. The errors themselves are taken as
    trimmed, and the trim as that of the nominal model.
    """
    rng = np.random.default_rng(seed)
    A = model.A + _error_slopes(aircraft, model, form, rng)
    members = [modes(replace(model, A=matrix)) for matrix in A]
    nominal = modes(model)
    names = [mode.name for mode in nominal]
    confidence = form.confidence
    ends = [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence]
    out = []
    for index, mode in enumerate(nominal):
        order = names[:index].count(mode.name)
        alike = []
        unstable = 0
        for member in members:
            same = [m for m in member if m.name == mode.name]
            unstable += any(m.real > 0.0 for m in same)
            if len(same) == names.count(mode.name) and (same[order].imag > 0) == (mode.imag > 0):
                alike.append(same[order])
        intervals: list[tuple[float, float]] = []
        for key in ("real", "wn_radps", "zeta"):
            values = [getattr(m, key) for m in alike] or [np.nan]
            low, high = np.quantile(values, ends)
            intervals.append((float(low), float(high)))
        real, frequency, damping = intervals
        shares = len(alike) / len(members), unstable / len(members)
        out.append(ModeInterval(real, frequency, damping, *shares))
    return out


def _error_slopes(
    aircraft: Aircraft, model: LinearModel, form: ModelForm, rng: np.random.Generator
) -> FloatArray:
    """Return what the slopes of the coefficients' errors add to A, (MODE_MEMBERS, 8, 8)."""
    trim = model.trim
    centre = trim.state
    fdm = open_aircraft(aircraft)
    fdm["ic/h-sl-ft"] = trim.condition.altitude_m / FT_M
    engine.run_ic(fdm)
    rho = fdm["atmosphere/rho-slugs_ft3"] * SLUG_FT3_KGPM3
    body = mass_properties(fdm, aircraft.card.reference)
    # Flight states at the trim, and a step to either side in each state of A.
    steps = np.array([_STEP[name] for name in STATE_NAMES])
    points = np.vstack([np.diag(steps), -np.diag(steps)])
    x = np.array([getattr(centre, name) for name in STATE_NAMES]) + points
    u, v, w = x[:, 0], x[:, 1], x[:, 2]
    speed = np.sqrt(u**2 + v**2 + w**2)
    flight_states = {
        "V_mps": speed,
        "alpha_rad": np.arctan2(w, u),
        "beta_rad": np.arcsin(v / speed),
        **{f"{name}_radps": x[:, 3 + i] for i, name in enumerate("pqr")},
        "phi_rad": x[:, 6],
        "theta_rad": x[:, 7],
    }
    positions = {
        f"{name}_pos_deg": trim.positions_deg.get(name, 0.0)
        for name in ("elevator", "aileron", "rudder")
    } | {"throttle_pct": trim.controls.get("throttle", 0.0)}
    flight_states |= {name: np.full(16, value) for name, value in positions.items()}
    slopes = np.empty((MODE_MEMBERS, 6, 8))
    for row, name in enumerate(COEFFICIENTS):
        bounds = form.coefficients[name]
        values = regressors(bounds.normalised(flight_states), bounds.terms)
        gradient = (values[:8] - values[8:]) / (2.0 * steps[:, None])
        from sysid.distributions import student_quantile

        z = float(student_quantile(0.5 + 0.5 * form.confidence, 1e6))
        scale = bounds.t_at(form.confidence) / z
        covariance = scale**2 * bounds.s2 * bounds.leverage_factor * bounds.XtX_inv
        variance, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
        draws = rng.standard_normal((MODE_MEMBERS, len(variance))) * np.sqrt(
            np.maximum(variance, 0.0)
        )
        slopes[:, row] = (bounds.beta_hat + draws @ axes.T) @ gradient.T
    pressure_area = 0.5 * rho * trim.condition.V_mps**2 * body.S
    added = np.zeros((MODE_MEMBERS, 8, 8))
    added[:, :3] = slopes[:, :3] * pressure_area / body.mass
    moments = slopes[:, 3:] * (pressure_area * body.lengths)[:, None]
    added[:, 3:6] = np.linalg.inv(body.inertia) @ moments
    return added
