"""Measure the turbulence that reaches the aerodynamics, against MIL-F-8785C.

A vehicle without aerodynamics is held on a fixed heading and airspeed by a stiff feedback, in the air of
``aircraft/espaaro/Systems/air.xml``, and what its aerodynamics would see is recorded: total wind less steady wind, and
the rotation of the air, both in heading axes. Each source flies several headings to the wind; plain JSBSim, without
that system, flies beside them.

    python -m uqharness.air_check --out results/air
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.signal import welch

from uqharness import engine
from uqharness.dryden import COMPONENTS, FT_M, KT_MPS, Component, dryden_gusts, dryden_psd, dryden_sigma
from uqharness.errors import BadInputError
from uqharness.project_files import PROJECT_ROOT

Array = npt.NDArray[np.float64]
Source = Literal["jsbsim", "host", "plain-tustin", "plain-milspec"]

AIR_XML = PROJECT_ROOT / "aircraft" / "espaaro" / "Systems" / "air.xml"
BANDS_HZ = ((0.02, 0.1), (0.1, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 10.0))
BURN_IN_S = 120.0
"""Left out of every record; JSBSim's filters start at rest and the slowest time constant is some 12 s."""

VEHICLE = """<?xml version="1.0"?>
<fdm_config name="pinned" version="2.0" release="ALPHA">
  <fileheader>
    <author>uqharness</author>
    <description>Held on a commanded velocity and attitude; no aerodynamics</description>
  </fileheader>
  <metrics>
    <wingarea unit="M2">1.97</wingarea> <wingspan unit="M">{span_m}</wingspan> <chord unit="M">0.53</chord>
    <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location>
    <location name="EYEPOINT" unit="M"><x>0</x><y>0</y><z>0</z></location>
    <location name="VRP" unit="M"><x>0</x><y>0</y><z>0</z></location>
  </metrics>
  <mass_balance negated_crossproduct_inertia="false">
    <ixx>1</ixx> <iyy>1</iyy> <izz>1</izz> <emptywt unit="SLUG">1</emptywt>
    <location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location>
  </mass_balance>
  <ground_reactions/>
  <external_reactions>
    <property value="0">pin/north-fps</property>
    <property value="0">pin/east-fps</property>
    <property value="0">pin/height-ft</property>
    <property value="0">pin/phi-rad</property>
    <property value="0">pin/theta-rad</property>
    <property value="0">pin/psi-rad</property>
    <force name="north" frame="LOCAL">
      <function>
        <product> <v>5</v> <difference> <p>pin/north-fps</p> <p>velocities/v-north-fps</p> </difference> </product>
      </function>
      <location unit="M"><x>0</x><y>0</y><z>0</z></location> <direction><x>1</x><y>0</y><z>0</z></direction>
    </force>
    <force name="east" frame="LOCAL">
      <function>
        <product> <v>5</v> <difference> <p>pin/east-fps</p> <p>velocities/v-east-fps</p> </difference> </product>
      </function>
      <location unit="M"><x>0</x><y>0</y><z>0</z></location> <direction><x>0</x><y>1</y><z>0</z></direction>
    </force>
    <force name="up" frame="LOCAL">
      <function>
        <sum>
          <v>32.17</v> <product> <v>5</v> <p>velocities/v-down-fps</p> </product>
          <product> <v>6</v> <difference> <p>pin/height-ft</p> <p>position/h-sl-ft</p> </difference> </product>
        </sum>
      </function>
      <location unit="M"><x>0</x><y>0</y><z>0</z></location> <direction><x>0</x><y>0</y><z>-1</z></direction>
    </force>
    <moment name="roll" frame="BODY">
      <function>
        <difference>
          <product> <v>25</v> <difference> <p>pin/phi-rad</p> <p>attitude/phi-rad</p> </difference> </product>
          <product> <v>10</v> <p>velocities/p-rad_sec</p> </product>
        </difference>
      </function>
      <direction><x>1</x><y>0</y><z>0</z></direction>
    </moment>
    <moment name="pitch" frame="BODY">
      <function>
        <difference>
          <product> <v>25</v> <difference> <p>pin/theta-rad</p> <p>attitude/theta-rad</p> </difference> </product>
          <product> <v>10</v> <p>velocities/q-rad_sec</p> </product>
        </difference>
      </function>
      <direction><x>0</x><y>1</y><z>0</z></direction>
    </moment>
    <moment name="yaw" frame="BODY">
      <function>
        <difference>
          <product>
            <v>25</v>
            <sin> <difference> <p>pin/psi-rad</p> <p>attitude/psi-rad</p> </difference> </sin>
          </product>
          <product> <v>10</v> <p>velocities/r-rad_sec</p> </product>
        </difference>
      </function>
      <direction><x>0</x><y>0</y><z>1</z></direction>
    </moment>
  </external_reactions>
  {system}
  <aerodynamics/>
</fdm_config>
"""


@dataclass(frozen=True)
class Condition:
    """One measurement. ``heading_deg`` counts clockwise from the direction the wind blows from (0: into the wind)."""

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
class Seen:
    """What the aerodynamics met, in heading axes, after the burn-in: arrays (n,) by component, m/s and rad/s."""

    source: Source
    condition: Condition
    series: dict[Component, Array]

    def q_slope_correlation(self) -> float:
        """Correlation of q with dw/dt; negative when q is the air's rotation -dw/dx."""
        w, q = self.series["w"], self.series["q"]
        return float(np.corrcoef(0.5 * (q[1:] + q[:-1]), np.diff(w))[0, 1])

    def r_slope_correlation(self) -> float:
        """Correlation of r with dv/dt; positive when r is the air's rotation +dv/dx."""
        v, r = self.series["v"], self.series["r"]
        return float(np.corrcoef(0.5 * (r[1:] + r[:-1]), np.diff(v))[0, 1])


@dataclass(frozen=True)
class Row:
    """One component of one flight against the specification. Ratios are measured over specified."""

    source: str
    heading_deg: float
    component: str
    sd_spec: float
    sd_measured: float
    sd_ratio: float
    sd_ratio_error: float
    """One standard deviation of sd_ratio by counting, 1/sqrt(2 dof), if the spectrum is as specified."""
    band_ratios: tuple[float, ...]
    band_errors: tuple[float, ...]
    """One standard deviation of each band's mean density ratio."""

    def within(self, tolerance: float, confidence: float = 0.9999) -> bool:
        """Whether all ratios are 1, to ``tolerance`` (of amplitude; twice that of density) on top of counting statistics."""
        sigmas = float(stats.norm.isf((1.0 - confidence) / 2.0))
        good = abs(self.sd_ratio - 1.0) <= tolerance + sigmas * self.sd_ratio_error
        return good and all(
            abs(ratio - 1.0) <= 2.0 * tolerance + sigmas * error
            for ratio, error in zip(self.band_ratios, self.band_errors, strict=True)
        )


def write_vehicle(folder: Path, b_m: float, air_xml: Path | None) -> Path:
    """Write ``pinned/pinned.xml`` below ``folder``, with or without the air system; the folder for ``open_fdm``."""
    home = folder / "pinned"
    (home / "Systems").mkdir(parents=True, exist_ok=True)
    if air_xml is not None:
        shutil.copyfile(air_xml, home / "Systems" / "air.xml")
    system = '<system file="air"/>' if air_xml is not None else ""
    (home / "pinned.xml").write_text(VEHICLE.format(span_m=b_m, system=system), encoding="utf-8")
    return folder


def open_pinned(folder: Path, condition: Condition, settings: dict[str, float]) -> Any:
    """The vehicle initialised on ``condition``, with ``settings`` (property: value) made before initialising."""
    fdm = engine.open_fdm(folder, "pinned", condition.dt_s, aircraft_path=folder)
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
    """Velocity of the air, north and east."""
    towards = np.radians(condition.wind_from_deg + 180.0)
    return condition.wind_mps * float(np.cos(towards)), condition.wind_mps * float(np.sin(towards))


def measure(source: Source, condition: Condition) -> Seen:
    """Fly the pinned vehicle and record the gusts that its aerodynamics would use."""
    with tempfile.TemporaryDirectory() as name:
        plain = source.startswith("plain")
        folder = write_vehicle(Path(name), condition.b_m, None if plain else AIR_XML)
        fdm = open_pinned(folder, condition, {} if plain else _air_settings(source, condition))
    if plain:
        _start_plain(fdm, source, condition)
    return _record(fdm, source, condition)


def _air_settings(source: Source, condition: Condition) -> dict[str, float]:
    return {
        "air/wind-mps": condition.wind_mps,
        "air/wind-from-deg": condition.wind_from_deg,
        "air/turbulence-w20-kt": condition.W20_kt,
        "air/turbulence-source": 0.0 if source == "jsbsim" else 1.0,
    }


def _start_plain(fdm: Any, source: Source, condition: Condition) -> None:
    # JSBSim as its manual has it: wind in atmosphere/wind-..., the turbulence switched on after initialising.
    wind_n, wind_e = steady_wind_mps(condition)
    fdm["atmosphere/wind-north-fps"] = wind_n / FT_M
    fdm["atmosphere/wind-east-fps"] = wind_e / FT_M
    fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = condition.W20_kt * KT_MPS / FT_M
    fdm["atmosphere/turbulence/milspec/severity"] = 3.0
    fdm["atmosphere/turb-type"] = 4.0 if source == "plain-tustin" else 3.0


def _record(fdm: Any, source: Source, condition: Condition) -> Seen:
    skip = round(BURN_IN_S / condition.dt_s)
    n = skip + round(condition.duration_s / condition.dt_s)
    rates = [f"atmosphere/{axis}-turb-rad_sec" for axis in "pqr"] if source.startswith("plain") else _RATES
    getters = [engine.handle(fdm, name).get_double_value for name in (*_WIND, *rates, *_ATTITUDE)]
    rows = np.empty((n, len(getters)))
    run = fdm.run
    if source == "host":
        gusts = dryden_gusts(
            n, condition.dt_s, condition.V_mps, condition.h_m, condition.W20_kt, condition.b_m, condition.seed
        )
        setters = [engine.handle(fdm, f"air/host/{name}").set_double_value for name in _HOST]
        values = np.column_stack([gusts.component(name) for name in COMPONENTS]).tolist()
        for k in range(n):
            for put, value in zip(setters, values[k], strict=True):
                put(value)
            run()
            rows[k] = [get() for get in getters]
    else:
        for k in range(n):
            run()
            rows[k] = [get() for get in getters]
    if not np.all(np.isfinite(rows[-1])):
        raise BadInputError(f"{source}: the air turned to NaN")
    return Seen(source, condition, _in_heading_axes(rows[skip:], condition))


_WIND = tuple(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down"))
_RATES = tuple(f"air/{axis}-gust-rad_sec" for axis in "pqr")
_ATTITUDE = tuple(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi"))
_HOST = ("u-mps", "v-mps", "w-mps", "p-rad_sec", "q-rad_sec", "r-rad_sec")


def _in_heading_axes(rows: Array, condition: Condition) -> dict[Component, Array]:
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


def spectrum(series: Array, dt_s: float) -> tuple[Array, Array]:
    """Welch estimate, one-sided: frequency in Hz and density per Hz (16384 samples a segment, Hann, half overlap)."""
    frequency, density = welch(series, fs=1.0 / dt_s, nperseg=min(16384, len(series)), detrend=False)
    return frequency[1:], density[1:]


def specified_density(component: Component, frequency_hz: Array, condition: Condition) -> Array:
    """The specification's density per Hz."""
    args = (condition.V_mps, condition.h_m, condition.W20_kt, condition.b_m)
    return 2.0 * np.pi * dryden_psd(component, 2.0 * np.pi * frequency_hz, *args)


def compare(seen: Seen) -> list[Row]:
    """Standard deviation and band means of all six components, with their counting errors."""
    condition = seen.condition
    rows = []
    for component in COMPONENTS:
        series = seen.series[component]
        sigma = dryden_sigma(component, condition.V_mps, condition.h_m, condition.W20_kt, condition.b_m)
        measured = float(np.sqrt(np.mean(series**2)))
        record_s = len(series) * condition.dt_s
        frequency, density = spectrum(series, condition.dt_s)
        ratio = density / specified_density(component, frequency, condition)
        inside = [(frequency >= low) & (frequency < high) for low, high in BANDS_HZ]
        rows.append(
            Row(
                source=seen.source,
                heading_deg=condition.heading_deg,
                component=component,
                sd_spec=sigma,
                sd_measured=measured,
                sd_ratio=measured / sigma,
                sd_ratio_error=1.0 / np.sqrt(2.0 * variance_dof(component, condition, record_s)),
                band_ratios=tuple(float(np.mean(ratio[band])) for band in inside),
                # A band of width B in a record of length T has 2 B T degrees of freedom; 0.95 survive the window.
                band_errors=tuple(float(np.sqrt(1.0 / (0.95 * (high - low) * record_s))) for low, high in BANDS_HZ),
            )
        )
    return rows


def variance_dof(component: Component, condition: Condition, record_s: float) -> float:
    """Degrees of freedom of a variance: 2 T (integral of S)^2 / integral of S^2, S the specified density per Hz."""
    frequency = np.geomspace(1e-5, 50.0, 4000)
    density = specified_density(component, frequency, condition)
    return float(2.0 * record_s * np.trapezoid(density, frequency) ** 2 / np.trapezoid(density**2, frequency))


def markdown(rows: Sequence[Row], correlations: Mapping[tuple[str, float], tuple[float, float]]) -> str:
    """Two tables: standard deviations (ratio to the specification) and band means of the spectra."""
    lines = [
        "| source | heading to wind, deg | " + " | ".join(COMPONENTS) + " | corr(q, dw) | corr(r, dv) |",
        "|---" * 10 + "|",
    ]
    keys = list(dict.fromkeys((row.source, row.heading_deg) for row in rows))
    found = {(row.source, row.heading_deg, row.component): row for row in rows}
    for source, heading in keys:
        cells = " | ".join(f"{found[source, heading, name].sd_ratio:.3f}" for name in COMPONENTS)
        q_corr, r_corr = correlations[source, heading]
        lines.append(f"| {source} | {heading:.0f} | {cells} | {q_corr:+.2f} | {r_corr:+.2f} |")
    error = " | ".join(f"{max(row.sd_ratio_error for row in rows if row.component == c):.3f}" for c in COMPONENTS)
    lines += [f"| counting error (1 sd) | | {error} | | |", ""]
    labels = [f"{low:g}-{high:g} Hz" for low, high in BANDS_HZ]
    lines += ["| source | component | " + " | ".join(labels) + " |", "|---" * (2 + len(labels)) + "|"]
    for source in dict.fromkeys(row.source for row in rows):
        for name in COMPONENTS:
            bands = np.array([row.band_ratios for row in rows if row.source == source and row.component == name])
            cells = " | ".join(f"{low:.2f}..{high:.2f}" for low, high in zip(bands.min(0), bands.max(0), strict=True))
            lines.append(f"| {source} | {name} | {cells} |")
    errors = " | ".join(f"{error:.2f}" for error in rows[0].band_errors)
    lines += [f"| counting error (1 sd) | | {errors} |", ""]
    return "\n".join(lines)


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """One line a component and flight."""
    bands = [f"psd_ratio_{low:g}_{high:g}_hz" for low, high in BANDS_HZ]
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(
            ["source", "heading_deg", "component", "sd_spec", "sd_measured", "sd_ratio", "sd_ratio_error", *bands]
        )
        for row in rows:
            values = (row.sd_spec, row.sd_measured, row.sd_ratio, row.sd_ratio_error, *row.band_ratios)
            writer.writerow([row.source, row.heading_deg, row.component, *(f"{value:.5g}" for value in values)])


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0: both sources are as specified; 1: one is not; 2: bad input."""
    parser = argparse.ArgumentParser(prog="python -m uqharness.air_check", description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for air.csv, air.md and air.svg")
    parser.add_argument("--hours", type=float, default=1.0, help="flight time per source and heading (default 1)")
    parser.add_argument("--headings-deg", type=float, nargs="+", default=[0.0, 90.0, 180.0, 270.0])
    parser.add_argument("--w20-kt", type=float, default=30.0, help="wind at 20 ft (default 30, moderate)")
    parser.add_argument("--height-m", type=float, default=100.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    args = parser.parse_args(argv)
    try:
        rows, flights = run_all(args.headings_deg, args.hours, args.w20_kt, args.height_m, args.seed)
        args.out.mkdir(parents=True, exist_ok=True)
    except (BadInputError, OSError) as error:
        print(f"air_check: {error}", file=sys.stderr)
        return 2
    correlations: dict[tuple[str, float], tuple[float, float]] = {
        (seen.source, seen.condition.heading_deg): (seen.q_slope_correlation(), seen.r_slope_correlation())
        for seen in flights
    }
    table = markdown(rows, correlations)
    write_csv(rows, args.out / "air.csv")
    (args.out / "air.md").write_text(table, encoding="utf-8")
    from uqharness.air_plot import plot_air

    plot_air(flights, args.out / "air.svg")
    good = all(row.within(0.03) for row in rows if row.source in ("jsbsim", "host"))
    if args.json:
        print(json.dumps({"as_specified": good, "rows": [asdict(row) for row in rows]}))
    else:
        print(table)
        print("both sources are as specified" if good else "NOT as specified (3 % of amplitude beyond counting errors)")
    return 0 if good else 1


def run_all(
    headings_deg: Sequence[float], hours: float, W20_kt: float, h_m: float, seed: int
) -> tuple[list[Row], list[Seen]]:
    """All four airs at all headings; progress on a terminal."""
    if not hours > 0.0:
        raise BadInputError(f"--hours {hours}: must be positive")
    rows: list[Row] = []
    flights: list[Seen] = []
    sources: tuple[Source, ...] = ("jsbsim", "host", "plain-tustin", "plain-milspec")
    for source in sources:
        for index, heading in enumerate(headings_deg):
            if sys.stderr.isatty():
                print(f"{source}, {heading:.0f} deg to the wind", file=sys.stderr)
            condition = Condition(
                heading_deg=heading, W20_kt=W20_kt, h_m=h_m, duration_s=3600.0 * hours, seed=seed + index
            )
            flights.append(measure(source, condition))
            rows += compare(flights[-1])
    return rows, flights


if __name__ == "__main__":
    sys.exit(main())
