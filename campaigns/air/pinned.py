"""A vehicle without aerodynamics, held on heading and airspeed in the air of the E-SPAARO: what its
aerodynamics would see.

A stiff feedback holds it; recorded are the total wind less the steady wind and the rotation of the
air, both in heading axes.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sysid.arrays import FloatArray
from uqharness.errors import BadInputError
from uqharness.files import PROJECT_ROOT, scratch_folder
from uqharness.flight.dryden import COMPONENTS, FT_M, KT_MPS, Component, dryden_gusts
from uqharness.simulator import engine
from uqharness.simulator.staging import Staging

Source = Literal["jsbsim", "host", "plain-tustin", "plain-milspec"]

AIR_XML = PROJECT_ROOT / "aircraft" / "espaaro" / "Systems" / "air.xml"
VEHICLE = Path(__file__).parent / "pinned.xml"
BURN_IN_S = 120.0
"""Left out of every record; JSBSim's filters start at rest and the slowest time constant is some 12
s."""


@dataclass(frozen=True)
class Condition:
    """One measurement. ``heading_deg`` counts clockwise from the direction the wind blows from (0:
    into the wind)."""

    heading_deg: float
    V_mps: float = 22.2
    h_m: float = 100.0
    W20_kt: float = 30.0
    b_m: float = 3.66
    wind_mps: float = 3.0
    wind_from_deg: float = 250.0
    phi_deg: float = 0.0
    theta_deg: float = 0.0
    dt_s: float = 0.01
    duration_s: float = 3600.0
    seed: int = 1

    @property
    def psi_rad(self) -> float:
        """True heading in 0..2 pi."""
        return float(np.radians((self.wind_from_deg + self.heading_deg) % 360.0))


@dataclass(frozen=True)
class Gusts:
    """Gusts that the aerodynamics met, in heading axes, after the burn-in: arrays (n,) by
    component, m/s and rad/s."""

    source: Source
    condition: Condition
    series: dict[Component, FloatArray]

    def q_slope_correlation(self) -> float:
        """Correlate q with dw/dt; negative when q is the air's rotation -dw/dx."""
        return self._slope_correlation("q", "w")

    def r_slope_correlation(self) -> float:
        """Correlate r with dv/dt; positive when r is the air's rotation +dv/dx."""
        return self._slope_correlation("r", "v")

    def _slope_correlation(self, rate: Component, velocity: Component) -> float:
        r, v = self.series[rate], self.series[velocity]
        return float(np.corrcoef(0.5 * (r[1:] + r[:-1]), np.diff(v))[0, 1])


def write_vehicle(folder: Path, b_m: float, air_xml: Path | None) -> Staging:
    """Write the aircraft ``pinned`` below ``folder``, with or without the air system, ready for
    ``open_fdm``."""
    staging = Staging(folder, "pinned")
    home = staging.folder
    (home / "Systems").mkdir(parents=True, exist_ok=True)
    if air_xml is not None:
        shutil.copyfile(air_xml, home / "Systems" / "air.xml")
    system = '<system file="air"/>' if air_xml is not None else ""
    text = VEHICLE.read_text(encoding="utf-8").format(span_m=b_m, system=system)
    (home / "pinned.xml").write_text(text, encoding="utf-8")
    return staging


def open_pinned(staging: Staging, condition: Condition, settings: dict[str, float]) -> Any:
    """Initialise the vehicle on ``condition``, with ``settings`` (property: value) made before."""
    fdm = engine.open_fdm(staging, condition.dt_s)
    psi = condition.psi_rad
    wind_n, wind_e = steady_wind_mps(condition)
    north, east = condition.V_mps * np.cos(psi) + wind_n, condition.V_mps * np.sin(psi) + wind_e
    start = {
        "atmosphere/randomseed": condition.seed,
        "pin/north-fps": north / FT_M,
        "pin/east-fps": east / FT_M,
        "pin/height-ft": condition.h_m / FT_M,
        "pin/phi-rad": np.radians(condition.phi_deg),
        "pin/theta-rad": np.radians(condition.theta_deg),
        "pin/psi-rad": psi,
        "ic/lat-geod-deg": 45.0,
        "ic/h-sl-ft": condition.h_m / FT_M,
        "ic/phi-deg": condition.phi_deg,
        "ic/theta-deg": condition.theta_deg,
        "ic/psi-true-deg": np.degrees(psi),
        "ic/vn-fps": north / FT_M,
        "ic/ve-fps": east / FT_M,
        "ic/vd-fps": 0.0,
    }
    for name, value in {**start, **settings}.items():
        fdm[name] = float(value)
    engine.run_ic(fdm)
    return fdm


def steady_wind_mps(condition: Condition) -> tuple[float, float]:
    """Return the velocity of the air, north and east."""
    towards = np.radians(condition.wind_from_deg + 180.0)
    return condition.wind_mps * float(np.cos(towards)), condition.wind_mps * float(np.sin(towards))


def measure(source: Source, condition: Condition) -> Gusts:
    """Fly the pinned vehicle and record the gusts that its aerodynamics would use."""
    plain = source.startswith("plain")
    settings = {
        "air/wind-mps": condition.wind_mps,
        "air/wind-from-deg": condition.wind_from_deg,
        "air/turbulence-w20-kt": condition.W20_kt,
        "air/turbulence-source": 0.0 if source == "jsbsim" else 1.0,
    }
    with scratch_folder() as scratch:
        staging = write_vehicle(scratch.path, condition.b_m, None if plain else AIR_XML)
        fdm = open_pinned(staging, condition, {} if plain else settings)
    if plain:
        _start_plain(fdm, source, condition)
    return _record(fdm, source, condition)


def _start_plain(fdm: Any, source: Source, condition: Condition) -> None:
    # As in JSBSim's manual: wind in atmosphere/wind-..., turbulence on after initialising.
    wind_n, wind_e = steady_wind_mps(condition)
    fdm["atmosphere/wind-north-fps"] = wind_n / FT_M
    fdm["atmosphere/wind-east-fps"] = wind_e / FT_M
    fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = (
        condition.W20_kt * KT_MPS / FT_M
    )
    fdm["atmosphere/turbulence/milspec/severity"] = 3.0
    fdm["atmosphere/turb-type"] = 4.0 if source == "plain-tustin" else 3.0


def _record(fdm: Any, source: Source, condition: Condition) -> Gusts:
    skip = round(BURN_IN_S / condition.dt_s)
    n = skip + round(condition.duration_s / condition.dt_s)
    plain = [f"atmosphere/{axis}-turb-rad_sec" for axis in "pqr"]
    names = (*_WIND, *(plain if source.startswith("plain") else _RATES), *_ATTITUDE)
    getters = [engine.handle(fdm, name).get_double_value for name in names]
    setters, inputs = [], np.empty((n, 0))
    if source == "host":
        gusts = dryden_gusts(
            n,
            condition.dt_s,
            condition.V_mps,
            condition.h_m,
            condition.W20_kt,
            condition.b_m,
            seed=condition.seed,
        )
        setters = [engine.handle(fdm, f"air/host/{name}").set_double_value for name in _HOST]
        inputs = np.column_stack([gusts.component(name) for name in COMPONENTS])
    rows = np.empty((n, len(getters)))
    for k, values in enumerate(inputs.tolist()):
        for write, value in zip(setters, values, strict=True):
            write(value)
        fdm.run()
        rows[k] = [get() for get in getters]
    if not np.all(np.isfinite(rows[-1])):
        raise BadInputError(f"{source}: the air turned to NaN")
    return Gusts(source, condition, _in_heading_axes(rows[skip:], condition))


_WIND = tuple(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down"))
_RATES = tuple(f"air/{axis}-gust-rad_sec" for axis in "pqr")
_ATTITUDE = tuple(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi"))
_HOST = ("u-mps", "v-mps", "w-mps", "p-rad_sec", "q-rad_sec", "r-rad_sec")


def _in_heading_axes(rows: FloatArray, condition: Condition) -> dict[Component, FloatArray]:
    north, east, down, p, q, r, phi, theta, psi = rows.T
    wind_n, wind_e = steady_wind_mps(condition)
    gust_n, gust_e = north * FT_M - wind_n, east * FT_M - wind_e
    in_plane = q * np.sin(phi) + r * np.cos(phi)
    return {
        "u": gust_n * np.cos(psi) + gust_e * np.sin(psi),
        "v": gust_e * np.cos(psi) - gust_n * np.sin(psi),
        "w": down * FT_M,
        "p": p * np.cos(theta) + in_plane * np.sin(theta),
        "q": q * np.cos(phi) - r * np.sin(phi),
        "r": in_plane * np.cos(theta) - p * np.sin(theta),
    }
