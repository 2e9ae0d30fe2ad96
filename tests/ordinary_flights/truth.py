"""Stock aircraft of JSBSim as truth: ordinary flights under an autopilot, and their derivatives.

`fly` flies legs and turns in wind and JSBSim's turbulence and returns a noisy record; `derivatives`
perturbs the state of the same simulator about cruise; `write_model` writes an aircraft of linear
terms with wrong values, from which the estimator starts. Gear, propeller with its slipstream and
torque, and tables are the stock aircraft's; the linear model has none of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jsbsim
import numpy as np
from scipy.optimize import least_squares

from sysid.arrays import FloatArray
from sysid.record import FlightRecord, Metadata
from sysid.units import FT_M, LBF_N, SLUG_FT2_KGM2, SLUG_FT3_KGPM3, SLUG_KG
from uqharness.commands.authoring import author
from uqharness.requests.authoring import AuthorRequest
from uqharness.simulator import engine

DT_S, LOG_EVERY, SETTLING_S = 0.01, 2, 20.0
CONTROLS = ("elevator", "aileron", "rudder")
COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
NOISE_STD = {
    "V_mps": 0.3,
    **dict.fromkeys(("alpha_rad", "beta_rad"), 0.003),
    **dict.fromkeys(("phi_rad", "theta_rad"), 0.005),
    "psi_rad": 0.01,
    **dict.fromkeys(("p_radps", "q_radps", "r_radps"), 0.004),
    **dict.fromkeys(("ax_mps2", "ay_mps2", "az_mps2"), 0.1),
    **dict.fromkeys(("vn_mps", "ve_mps", "vd_mps"), 0.1),
    "h_m": 0.5,
}
STATES = ("alpha", "beta", "p", "q", "r", "de", "da", "dr")
TERMS = {
    "CX": ("alpha",),
    "CY": ("beta", "p", "r", "da", "dr"),
    "CZ": ("alpha", "q", "de"),
    "Cl": ("beta", "p", "r", "da", "dr"),
    "Cm": ("alpha", "q", "de"),
    "Cn": ("beta", "p", "r", "da", "dr"),
}
"""Derivatives whose intervals are judged: 22."""
GUSTS = {"tustin": 4, "milspec": 3, "culp": 2}


@dataclass(frozen=True)
class Stock:
    """A stock aircraft in cruise: airspeed [m/s], height [m], and whether it has an engine."""

    name: str
    V_mps: float
    h_m: float
    powered: bool = True


STOCK = {
    "c172p": Stock("c172p", 50.0, 300.0),
    "737": Stock("737", 110.0, 300.0),
    "minisgs": Stock("minisgs", 9.0, 900.0, powered=False),
}
_POSITIONS = ("fcs/elevator-pos-rad", "fcs/left-aileron-pos-rad", "fcs/rudder-pos-rad")
_FORCES = ("forces/fbx-aero-lbs", "forces/fby-aero-lbs", "forces/fbz-aero-lbs")
_MOMENTS = ("moments/l-aero-lbsft", "moments/m-aero-lbsft", "moments/n-aero-lbsft")


def open_fdm(stock: Stock, settings: Mapping[str, float]) -> Any:
    """Return an instance that is initialised with properties, in still air, engines running."""
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    fdm.load_model(stock.name)
    fdm.set_dt(DT_S)
    for name, value in (
        {"ic/h-sl-ft": stock.h_m / FT_M, "ic/vt-fps": stock.V_mps / FT_M, "gear/gear-cmd-norm": 0.0}
        | dict(settings)
        | ({"fcs/mixture-cmd-norm": 0.9, "propulsion/set-running": -1} if stock.powered else {})
    ).items():
        fdm[name] = value
    fdm.run_ic()
    if stock.powered:
        engine.settle_engines(fdm)
        engine.renew_forces(fdm)
    return fdm


@dataclass(frozen=True)
class Cruise:
    """Steady straight flight: angles [rad], commands, throttle, and derivatives.

    ``slopes`` maps coefficient to state to derivative, per rad, surfaces per deg; ``power`` are the
    surfaces' positions at full command, deg, with the project's signs.
    """

    alpha: float
    gamma: float
    elevator: float
    throttle: float
    slopes: Mapping[str, Mapping[str, float]]
    power: tuple[float, float, float]
    mass_kg: float
    inertia: tuple[float, float, float, float]
    S: float
    b: float
    c: float


def _settings(stock: Stock, x: FloatArray) -> dict[str, float]:
    """Return properties of the unknowns alpha, elevator, and throttle or flight-path angle."""
    alpha, elevator, third = x
    out = {"ic/alpha-rad": alpha, "fcs/elevator-cmd-norm": elevator}
    if stock.powered:
        return out | {"fcs/throttle-cmd-norm": float(np.clip(third, 0.0, 1.0)), "ic/gamma-rad": 0.0}
    return out | {"ic/gamma-rad": third}


@cache
def cruise(name: str) -> Cruise:
    """Find steady flight and the derivatives there."""
    stock = STOCK[name]

    def accelerations(x: FloatArray) -> list[float]:
        fdm = open_fdm(stock, _settings(stock, x))
        axes = ("udot-ft_sec2", "wdot-ft_sec2", "qdot-rad_sec2")
        return [fdm[f"accelerations/{a}"] for a in axes]

    start = np.array([0.04, 0.0, 0.5 if stock.powered else -0.05])
    bounds = ([-0.1, -1.0, 0.0 if stock.powered else -0.6], [0.25, 1.0, 1.0])
    x = least_squares(accelerations, start, bounds=bounds, diff_step=1e-3).x
    fdm = open_fdm(stock, _settings(stock, x))
    S, b, c = (
        fdm["metrics/Sw-sqft"] * FT_M**2,
        fdm["metrics/bw-ft"] * FT_M,
        fdm["metrics/cbarw-ft"] * FT_M,
    )
    slopes, power = _derivatives(stock, x, b, c)
    ixx, iyy, izz, ixz = (fdm[f"inertia/i{a}-slugs_ft2"] for a in ("xx", "yy", "zz", "xz"))
    return Cruise(
        alpha=float(x[0]),
        gamma=0.0 if stock.powered else float(x[2]),
        elevator=float(x[1]),
        throttle=float(x[2]) if stock.powered else 0.0,
        slopes=slopes,
        power=power,
        mass_kg=fdm["inertia/mass-slugs"] * SLUG_KG,
        inertia=tuple(SLUG_FT2_KGM2 * v for v in (ixx, iyy, izz, ixz)),
        S=S,
        b=b,
        c=c,
    )


def _derivatives(
    stock: Stock, x: FloatArray, b: float, c: float
) -> tuple[dict[str, dict[str, float]], tuple[float, float, float]]:
    """Return derivatives of the aerodynamic coefficients by central differences.

    The simulator's angle of attack changes at the rate that follows from the perturbed state.
    Attitudes far from level change that rate alone, so regression separates what depends on it. A
    linear model without it has, in each derivative, the part by way of that rate: a state changes
    the lift, which turns the flight path.
    """
    rng = np.random.default_rng(7)
    V, base = stock.V_mps, _settings(stock, x)
    size = {"alpha": 0.02, "beta": 0.03, "p": 0.02, "q": 0.004, "r": 0.02}
    surfaces = dict.fromkeys(CONTROLS, 0.1)
    rows, coefficients = [], []
    draws, attitudes = rng.choice([-1.0, 1.0], size=(48, 8)), rng.uniform(-1.0, 1.0, size=(48, 2))
    for draw, attitude in zip(draws, attitudes, strict=True):
        alpha, beta, p, q, r = draw[:5] * list(size.values())
        commands = dict(zip(CONTROLS, draw[5:] * list(surfaces.values()), strict=True))
        fdm = open_fdm(
            stock,
            base
            | {
                "ic/phi-rad": attitude[0],
                "ic/gamma-rad": attitude[1],
                "ic/alpha-rad": x[0] + alpha,
                "ic/beta-rad": beta,
                "ic/p-rad_sec": p * 2.0 * V / b,
                "ic/q-rad_sec": q * 2.0 * V / c,
                "ic/r-rad_sec": r * 2.0 * V / b,
                "fcs/elevator-cmd-norm": x[1] + commands["elevator"],
                "fcs/aileron-cmd-norm": commands["aileron"],
                "fcs/rudder-cmd-norm": commands["rudder"],
            },
        )
        positions = [np.degrees(fdm[name]) for name in _POSITIONS]
        alphadot = fdm["aero/alphadot-rad_sec"] * c / (2.0 * V)
        rows.append([1.0, alpha, beta, p, q, r, *positions, alphadot])
        force = fdm["aero/qbar-psf"] * fdm["metrics/Sw-sqft"]
        arms = np.array([b, c, b]) / FT_M
        coefficients.append(
            [fdm[n] / force for n in _FORCES]
            + [fdm[n] / (force * a) for n, a in zip(_MOMENTS, arms, strict=True)]
        )
    matrix = np.array(rows)
    matrix[:, 6] -= matrix[:, 6].mean()
    solution = np.linalg.lstsq(matrix, np.array(coefficients), rcond=None)[0]
    phi, gamma = np.array(attitudes).T
    path = np.column_stack([matrix[:, :9], np.cos(phi) * np.cos(gamma)])
    solution[:9] += np.outer(np.linalg.lstsq(path, matrix[:, 9], rcond=None)[0][:9], solution[9])
    # Positions with the project's signs: nose down, right wing down, nose left.
    sign = np.array([-np.sign(solution[6, 4]), np.sign(solution[7, 3]), -np.sign(solution[8, 5])])
    solution[6:9] *= sign[:, None]
    commands = np.abs(draws[:, 5:] * list(surfaces.values())).mean(axis=0)
    per_command = np.array(
        [np.mean((matrix[:, 6 + k]) * draws[:, 5 + k]) / commands[k] for k in range(3)]
    )
    slopes = {
        coefficient: dict(zip(STATES, solution[1:9, k].tolist(), strict=True))
        for k, coefficient in enumerate(COEFFICIENTS)
    }
    power = tuple((sign * per_command).tolist())
    return slopes, (power[0], power[1], power[2])


_READ = {
    "V_mps": ("velocities/vt-fps", FT_M),
    "alpha_rad": ("aero/alpha-rad", 1.0),
    "beta_rad": ("aero/beta-rad", 1.0),
    "phi_rad": ("attitude/phi-rad", 1.0),
    "theta_rad": ("attitude/theta-rad", 1.0),
    "psi_rad": ("attitude/psi-rad", 1.0),
    **{f"{a}_radps": (f"velocities/{a}-rad_sec", 1.0) for a in "pqr"},
    "vn_mps": ("velocities/v-north-fps", FT_M),
    "ve_mps": ("velocities/v-east-fps", FT_M),
    "vd_mps": ("velocities/v-down-fps", FT_M),
    "h_m": ("position/h-sl-ft", FT_M),
    "rho_kgpm3": ("atmosphere/rho-slugs_ft3", SLUG_FT3_KGPM3),
}
_TOTAL = tuple(f"forces/fb{a}-total-lbs" for a in "xyz")


@dataclass(frozen=True)
class Weather:
    """Kind of JSBSim's turbulence, wind at 20 ft [m/s] that sets its size, mean wind [m/s], and
    whether the autopilot flies turns in it.
    """

    gusts: str = "tustin"
    w20_mps: float = 7.0
    wind_mps: float = 4.0
    turns: bool = True


def fly(name: str, seed: int, seconds: float, weather: Weather) -> FlightRecord:
    """Fly legs and turns under an autopilot; return what its logger would have, with noise.

    The autopilot holds bank angle, height and (with an engine) airspeed, and damps pitch, roll and
    yaw; it reads the noisy sensors at 50 Hz. Turns change every 12 to 25 s.
    """
    stock, at = STOCK[name], cruise(name)
    rng = np.random.default_rng([seed, 67])
    fdm = open_fdm(stock, {**_commands(stock, at), "simulation/randomseed": seed + 1})
    fdm["atmosphere/randomseed"] = seed + 1
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    fdm["atmosphere/wind-north-fps"] = weather.wind_mps * np.cos(azimuth) / FT_M
    fdm["atmosphere/wind-east-fps"] = weather.wind_mps * np.sin(azimuth) / FT_M
    fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = weather.w20_mps / FT_M
    fdm["atmosphere/turbulence/milspec/severity"] = 3
    fdm["atmosphere/turb-rate"] = 1.0
    fdm["atmosphere/turb-gain"] = 0.3 * weather.w20_mps
    fdm["atmosphere/turb-rhythmicity"] = 0.2
    fdm["atmosphere/turb-type"] = GUSTS[weather.gusts]
    pilot = _Autopilot(stock, at, fdm, rng)
    pilot.turns = weather.turns
    manager = fdm.get_property_manager()
    nodes = {c: (manager.get_node(n), f) for c, (n, f) in _READ.items()}
    forces = [manager.get_node(n) for n in _TOTAL]
    positions = [manager.get_node(n) for n in _POSITIONS]
    mass = manager.get_node("inertia/mass-slugs")
    engines = fdm.get_propulsion().get_num_engines()
    thrusts = [
        manager.get_node(
            f"propulsion/engine[{k}]/thrust-lbs" if k else "propulsion/engine/thrust-lbs"
        )
        for k in range(engines)
    ]
    rows = []
    for step in range(round((seconds + SETTLING_S) / DT_S)):
        if step % LOG_EVERY == 0:
            row = {c: factor * node.get_double_value() for c, (node, factor) in nodes.items()}
            for axis, node in zip("xyz", forces, strict=True):
                row[f"a{axis}_mps2"] = FT_M * node.get_double_value() / mass.get_double_value()
            row["thrust_N"] = LBF_N * sum(t.get_double_value() for t in thrusts)
            for channel, std in NOISE_STD.items():
                row[channel] += std * rng.normal()
            pilot.command(step * DT_S, row)
            # The log has the commands of this row: positions that the next step reaches.
            rows.append(row)
        fdm.run()
        if step % LOG_EVERY == 0:
            for control, node, sign in zip(CONTROLS, positions, np.sign(at.power), strict=True):
                row[f"{control}_deg"] = float(sign * np.degrees(node.get_double_value()))
    first = round(SETTLING_S / (DT_S * LOG_EVERY))
    columns = {c: np.array([r[c] for r in rows[first:]]) for c in rows[0]}
    columns["time_s"] = DT_S * LOG_EVERY * np.arange(len(columns["V_mps"]))
    columns["psi_rad"] = np.mod(columns["psi_rad"], 2.0 * np.pi)
    rate = 1.0 / (DT_S * LOG_EVERY)
    metadata = Metadata(source=name, native_hz=dict.fromkeys(columns, rate))
    return FlightRecord(columns, metadata)


def _commands(stock: Stock, at: Cruise) -> dict[str, float]:
    """Return the properties of steady flight."""
    third = at.throttle if stock.powered else at.gamma
    return _settings(stock, np.array([at.alpha, at.elevator, third]))


class _Autopilot:
    """Proportional and integral loops whose gains follow from the aircraft's control powers."""

    def __init__(self, stock: Stock, at: Cruise, fdm: Any, rng: np.random.Generator) -> None:
        self.at, self.fdm, self.rng, self.powered = at, fdm, rng, stock.powered
        rho = fdm["atmosphere/rho-slugs_ft3"] * SLUG_FT3_KGPM3
        force = 0.5 * rho * stock.V_mps**2 * at.S
        ixx, iyy, izz, _ = at.inertia
        slopes, (elevator, aileron, rudder) = at.slopes, at.power
        # Angular accelerations at full command.
        self.m = force * at.c * slopes["Cm"]["de"] * abs(elevator) / iyy
        self.l = force * at.b * slopes["Cl"]["da"] * abs(aileron) / ixx
        self.n = force * at.b * slopes["Cn"]["dr"] * abs(rudder) / izz
        self.stiffness = -force * at.c * slopes["Cm"]["alpha"] / iyy
        self.rolling = -force * at.b**2 * slopes["Cl"]["p"] / (2.0 * stock.V_mps * ixx)
        self.sign = np.sign(at.power)
        self.bank, self.next_s, self.pitch_sum, self.r_slow = 0.0, 0.0, 0.0, 0.0
        self.speed_sum, self.V = 0.0, stock.V_mps
        self.h = stock.h_m
        self.theta = at.alpha + at.gamma
        self.climb = at.gamma * stock.V_mps
        self.turns = True

    def command(self, time_s: float, row: Mapping[str, float]) -> None:
        """Set the commands of a row's measurements."""
        if self.turns and time_s >= self.next_s:
            self.bank = float(self.rng.choice([-0.5, -0.3, 0.0, 0.0, 0.3, 0.5]))
            self.next_s = time_s + self.rng.uniform(12.0, 25.0)
        dt = DT_S * LOG_EVERY
        w = 0.5 * np.sqrt(max(self.stiffness, 1.0))
        error_h = np.clip(self.h + self.climb * time_s - row["h_m"], -10.0, 10.0)
        climb = np.clip(0.15 * error_h + self.climb + row["vd_mps"], -3.0, 3.0) / self.V
        self.pitch_sum = float(np.clip(self.pitch_sum + 0.1 * climb * dt, -0.15, 0.15))
        pitch = self.theta + 0.6 * climb + self.pitch_sum + 0.1 * row["phi_rad"] ** 2
        demand = w**2 * (pitch - row["theta_rad"]) - w * row["q_radps"]
        self._set("elevator", self.at.elevator + self._norm(0, demand / self.m))
        p_demand = np.clip(0.4 * self.rolling * (self.bank - row["phi_rad"]), -0.5, 0.5)
        roll = 0.5 * self.rolling * (p_demand - row["p_radps"])
        self._set("aileron", self._norm(1, roll / self.l))
        self.r_slow += dt / 3.0 * (row["r_radps"] - self.r_slow)
        self._set("rudder", self._norm(2, -0.3 * (row["r_radps"] - self.r_slow) / self.n))
        if self.powered:
            error = self.V - row["V_mps"]
            self.speed_sum = float(np.clip(self.speed_sum + 0.005 * error * dt, -0.4, 0.4))
            throttle = self.at.throttle + 0.03 * error + self.speed_sum
            for k in range(self.fdm.get_propulsion().get_num_engines()):
                name = "fcs/throttle-cmd-norm" + (f"[{k}]" if k else "")
                self.fdm[name] = float(np.clip(throttle, 0.05, 1.0))

    def _norm(self, surface: int, value: float) -> float:
        """Return a command in the simulator's sense for one in the project's."""
        return float(np.clip(self.sign[surface] * value, -0.6, 0.6))

    def _set(self, control: str, value: float) -> None:
        self.fdm[f"fcs/{control}-cmd-norm"] = float(np.clip(value, -1.0, 1.0))


def write_model(name: str, folder: Path, seed: int) -> Path:
    """Write an aircraft of linear terms, whose derivatives are 0.5 to 1.6 times the truth."""
    at, rng = cruise(name), np.random.default_rng([seed, 76])
    rows = [
        "name,value,unit,source",
        *(f"{n},{v},{u}," for n, v, u in (("S", at.S, "m2"), ("b", at.b, "m"), ("c", at.c, "m"))),
        "axes,body,,",
        f"alpha,{np.degrees(at.alpha)},deg,",
        "x_ref,0,m,",
    ]
    q = at.mass_kg * 9.81 / at.S
    q /= 0.5 * 1.19 * STOCK[name].V_mps ** 2
    for coefficient, value in (("CX", -0.03), ("CZ", -q), ("Cm", 0.0)):
        rows.append(f"{coefficient}_0,{value},1,guess")
    long = {"de": "elevator", "da": "aileron", "dr": "rudder"}
    for coefficient, states in TERMS.items():
        for state in states:
            value = at.slopes[coefficient][state] * np.exp(rng.uniform(-0.7, 0.5))
            unit = "1/deg" if state in long else "1" if state in "pqr" else "1/rad"
            rows.append(f"{coefficient}_{long.get(state, state)},{value:.6g},{unit},guess")
    table = folder / f"{name}-model.csv"
    table.write_text("\n".join(rows) + "\n")
    ixx, iyy, izz, ixz = at.inertia
    request = AuthorRequest(
        sources=[table],
        out=folder / f"{name}-model",
        mass_kg=at.mass_kg,
        ixx_kgm2=ixx,
        iyy_kgm2=iyy,
        izz_kgm2=izz,
        ixz_kgm2=ixz,
        thrust_n=0.6 * at.mass_kg * 9.81,
        pitch_speed_mps=1000.0,
        cd0=0.0,
        accept_slips=True,
    )
    author(request)
    return folder / f"{name}-model"
