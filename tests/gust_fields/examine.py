"""Measures `refine` in air of other kinds.

    python -m tests.gust_fields.examine [FAMILY...] [--seconds S] [--w20-kt W] [--height-m H] [--rate-hz R]
        [--seeds N] [--kinds KIND...] [--refine]

Per family, kind of flight (`KINDS`) and seed: gains of moments without a candidate, the air that was
estimated, the largest |t| of scales of the vanes and of any candidate, and the share of parameters
whose 95 % interval has the truth. With --refine `refine` runs instead, on two flights and a test
flight. Stock aircraft (`SPEEDS_OF`) are flown by JSBSim, in its own turbulence."""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from sysid.effects import score_tests
from sysid.parallel import SERIAL
from sysid.record import FlightRecord
from sysid.units import FT_M
from tests.gust_fields.fields import FAMILIES, Setting
from tests.gust_fields.flights import fly_in
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.answers import canonical, stands_for
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.gusts import KNOT
from tests.hidden_effects.manoeuvres import card
from uqharness.cli.main import main as uqharness
from uqharness.identification.linearised import (
    effect_columns,
    make_flight_data,
    one_step_estimates,
    stage_models,
    with_jumping_flights,
)
from uqharness.refinement.baseline import fit_in_turbulence, fit_without_effects
from uqharness.refinement.candidates import candidate_effects
from uqharness.refinement.estimators import PredictionErrorEstimator
from uqharness.replay.flights import read_flights
from uqharness.simulator import find_aircraft

SPEEDS, STRENGTHS, COVERED = (20.5, 23.5, 22.0), (0.9, 1.1, 1.0), 1.96
KINDS: dict[str, tuple[Effect, ...]] = {
    "null": (),
    "effect": (Effect("CX", "q_hat", 13.8),),
    "vane": (Effect("sensor.beta_rad", "scale", 0.3),),
    "outside": (Effect("Cn", "step(beta)", 0.005, "tanh(beta/0.05)"),),
    "flap": (Effect("Cm", "flap", 0.04, "where(sin(0.9*t_s) > 0.0, 1.0, 0.0)"),),
    "triple": (Effect("Cl", "alpha*beta*r_hat", 60.0),),
}
"""What the model lacks: nothing, an effect of |t| 60 in three flights of 90 s, a vane that reads too
much, forms that are not in the catalogue: a step in sideslip, a flap that no log has, a product of
three states."""
OUTSIDE = {"outside": "Cn:", "flap": "Cm:", "triple": "Cl:"}
"""Coefficients of the forms that are not in the catalogue."""
SPEEDS_OF = {
    "sgs126": (30, 36, 33),
    "sgs233": (28, 33, 30),
    "c172x": (50, 55, 52),
    "c172p": (50, 55, 52),
}
"""Stock aircraft of JSBSim, and the speeds of three flights [m/s]."""
_FORCE = """<function name="aero/missing"> <product>
    <property>aero/qbar-psf</property> <property>metrics/Sw-sqft</property>
    <property>metrics/cbarw-ft</property> {}
</product> </function>
"""
STOCK = {
    "effect": _FORCE.format(2 * "<property>aero/beta-rad</property>" + "<value>1.0</value>"),
    "outside": _FORCE.format(
        """<table> <independentVar lookup="row">aero/beta-rad</independentVar>
    <tableData> -1 -0.02
    -0.02 -0.02
    0.02 0.02
    1 0.02 </tableData> </table>"""
    ),
    "flap": _FORCE.format(
        """<ifthen> <gt> <sin> <product> <value>0.9</value>
    <property>simulation/sim-time-sec</property> </product> </sin> <value>0</value> </gt>
    <value>0.01</value> <value>0</value> </ifthen>"""
    ),
}
"""What stock aircraft lack, as functions of the pitching moment."""
OF_KIND = {"effect": "CX:q_hat", "vane": "sensor.beta_rad:scale"}
VANES = ("effect/sensor.alpha_rad/scale", "effect/sensor.beta_rad/scale")


@dataclass(frozen=True)
class Finding:
    """Of one null: gains of moments (3,), |t| of alpha's and beta's scale, the largest |t| of all
    candidates with its key, share of parameters whose interval covers."""

    air: str
    moments: tuple[float, ...]
    vane_t: tuple[float, ...]
    largest: tuple[str, float]
    covered: float
    seconds: float


def write_flights(
    family: str,
    seed: int,
    seconds: float,
    w20_kt: float,
    folder: Path,
    effects: tuple[Effect, ...] = (),
    count: int = 2,
    *,
    h_m: float = 80.0,
    rate_hz: float = 50.0,
) -> list[Path]:
    """Fly and write up to three flights of a family."""
    manoeuvres = {"seconds": seconds, "h_m": h_m, "rate_hz": rate_hz}
    paths = []
    for k, (V, strength) in enumerate(zip(SPEEDS[:count], STRENGTHS[:count], strict=True)):
        flight = card(100 * seed + k, V, strength=strength, first=5 * k, **manoeuvres)
        airframe = Airframe()
        at = Setting(V, h_m, w20_kt, airframe.b, 1.6, seconds, 100 * seed + k)
        record = fly_in(Flight(flight, airframe, effects), family, at)
        paths.append(folder / f"{family}-{seed}-{k}.parquet")
        record.write(paths[-1])
    return paths


def jsbsim_flights(
    name: str, kind: str, seed: int, seconds: float, w20_kt: float, folder: Path
) -> tuple[Path, list[Path]]:
    """Fly a stock aircraft in JSBSim's own turbulence (MIL-F-8785C, atmosphere/turb-type 3).

    Returns the aircraft that `refine` is given, and three flights of one that has the effect.
    """
    models = [folder / index / name for index in ("given", "truth")]
    for model in models:
        assert uqharness(["instrument", name, "--out", str(model), "--no-check", "--quiet"]) == 0
    xml = models[1] / f"{name}.xml"
    text = xml.read_text(encoding="utf-8")
    place = text.index('<function name="uq/scaled/PITCH">')
    xml.write_text(text[:place] + STOCK.get(kind, "") + text[place:], encoding="utf-8")
    air = {"turb-type": 3, "turbulence/milspec/severity": 3}
    air["turbulence/milspec/windspeed_at_20ft_AGL-fps"] = w20_kt * KNOT / FT_M
    settings = [w for k, v in air.items() for w in ("--set", f"atmosphere/{k}={v}")]
    paths = []
    for k, mission in enumerate(("doublets", "3-2-1-1", "doublets")):
        path = folder / f"{kind}-{seed}-{k}.parquet"
        words = ["fly", str(models[1]), "--mission", mission, "--noise", "--quiet"]
        words += ["--speed-mps", str(SPEEDS_OF[name][k]), "--altitude-m", "500"]
        words += settings if w20_kt else []
        words += ["--seed", str(100 * seed + k + 1), "--duration-s", str(seconds)]
        assert uqharness([*words, "--out", str(path)]) == 0
        record = FlightRecord.read(path)
        scale = 1.3 if kind == "vane" else 1.0
        record.with_columns({"beta_rad": scale * record["beta_rad"]}).write(path)
        paths.append(path)
    return models[0], paths


def run_refine(aircraft: str | Path, paths: list[Path], kind: str, out: Path) -> str:
    """Return in words whether `refine` was right, its verdict, effects and coverage."""
    *train, test = map(str, paths)
    words = ["refine", str(aircraft), "--train", *train, "--test", test, "--out", str(out)]
    start = time.process_time()
    uqharness([*words, "--no-pbox", "--no-figures", "--workers", "1"])
    seconds = time.process_time() - start
    document = json.loads((out / "refinement.json").read_text(encoding="utf-8"))
    sets = [stands_for(e) for e in document["effects"]]
    is_stock = str(aircraft) != "espaaro"
    key = "Cm:beta^2" if kind == "effect" and is_stock else OF_KIND.get(kind)
    coefficient = "Cm:" if is_stock else OUTSIDE.get(kind, "")
    is_named = any(key in names for names in sets)
    false = sum(
        not any(k.startswith(coefficient) for k in names) if kind in OUTSIDE else key not in names
        for names in sets
    )
    verdict = document["verdict"]
    if kind == "null":
        right = verdict == "no-missing-effect"
    elif kind in OUTSIDE:
        right = verdict == "unexplained" or any(coefficient in k for n in sets for k in n)
    else:
        right = is_named
    truth, z = Airframe().coefficients, {}
    for name, row in document["parameters"].items():
        if row["std"]:
            # The scales of a stock aircraft's coefficients are 1, its offsets 0.
            default = 1.0 if "/scale/" in name else 0.0
            true_value = truth.get(name.removeprefix("aero/"), default)
            z[name.removeprefix("aero/")] = (row["value"] - true_value) / row["std"]
    largest = sorted(z, key=lambda name: -abs(z[name]))[:3]
    errors = " ".join(f"{name} {z[name]:.1f}" for name in largest)
    effects = ", ".join(
        f"{canonical(e)} {e['value']:.3g} t {e['evidence']['t']:.1f}" for e in document["effects"]
    )
    refused = document.get("best_refused") or {}
    return (
        f"{'right' if right else 'WRONG'} {verdict:17} false {false} covered"
        f" {np.mean(np.abs([*z.values()]) < COVERED):.2f} ({errors}) {seconds:4.0f} s"
        f"  {effects or '-'}"
        f"  refused {refused.get('effect')} {refused.get('t') or 0.0:.1f}"
        f"  {[w['words'][:90] for w in document['remaining']['where'][:2]]}"
    )


def measure(paths: list[Path]) -> Finding:
    """Estimate parameters and air from output error's answer, and score every candidate."""
    start = time.perf_counter()
    aircraft = find_aircraft("espaaro")
    flights, measured = read_flights(paths, aircraft, align=False)
    data = make_flight_data(aircraft, flights, measured)
    names = tuple(aircraft.card.parameters)
    limits = {n: c.bounds or (-np.inf, np.inf) for n, c in aircraft.card.parameters.items()}
    with stage_models(aircraft, data) as models:
        fdm = models.model.open(aircraft.dt_s)
        truth = {n: float(fdm[n]) for n in names if n.startswith("aero/")}
        data = with_jumping_flights(data, models.model)
        replayed = fit_without_effects(aircraft, models, data, names, limits, SERIAL)
        air = fit_in_turbulence(aircraft, models, data, replayed, limits, SERIAL)
    effects = candidate_effects(air.data, names, ())
    columns = effect_columns(air.data, air.fit.probes, air.fit.trajectory, effects)
    estimator = PredictionErrorEstimator(air.turbulence)
    evidence = estimator.information(air.data, air.fit, columns, effects)
    free = list(air.fit.columns[0].names)
    keys = [e.key for e in effects]
    t = dict(zip(keys, np.abs(score_tests(evidence, free, keys).t).tolist(), strict=True))
    largest = max((k for k in t if np.isfinite(t[k])), key=lambda k: t[k])
    estimates = one_step_estimates(evidence, [n for n in truth if n in free], air.fit).items()
    return Finding(
        air.turbulence.words,
        tuple(air.turbulence.moments.tolist()),
        tuple(t.get(v, float("nan")) for v in VANES),
        (largest, t[largest]),
        float(np.mean([abs(value - truth[n]) <= COVERED * std for n, (value, std) in estimates])),
        time.perf_counter() - start,
    )


def main() -> None:
    """Measure the families of the command line and print a row of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("families", nargs="*", default=[*FAMILIES, *SPEEDS_OF])
    parser.add_argument("--seconds", type=float, default=45.0)
    parser.add_argument("--w20-kt", type=float, default=15.0)
    parser.add_argument("--height-m", type=float, default=80.0)
    parser.add_argument("--rate-hz", type=float, default=50.0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=["null"])
    parser.add_argument("--refine", action="store_true")
    request = parser.parse_args()
    if unknown := {*request.families} - {*FAMILIES, *SPEEDS_OF}:
        parser.error(
            f"no family {', '.join(unknown)}; there are {', '.join([*FAMILIES, *SPEEDS_OF])}"
        )
    seeds = range(request.first, request.first + request.seeds)
    for family, kind, seed in product(request.families, request.kinds, seeds):
        with tempfile.TemporaryDirectory() as folder:
            setting = (seed, request.seconds, request.w20_kt, Path(folder))
            aircraft: str | Path = "espaaro"
            if family in SPEEDS_OF:
                aircraft, paths = jsbsim_flights(family, kind, *setting)
            else:
                paths = write_flights(
                    family,
                    *setting,
                    KINDS[kind],
                    3 if request.refine else 2,
                    h_m=request.height_m,
                    rate_hz=request.rate_hz,
                )
            if request.refine:
                answer = run_refine(aircraft, paths, kind, Path(folder) / "out")
                print(f"{family:14} {kind:8} {seed} {answer}", flush=True)
                continue
            row = measure(paths)
        gains = " ".join(f"{g:9.0f}" for g in row.moments)
        vanes = " ".join(f"{t:5.1f}" for t in row.vane_t)
        print(
            f"{family:18} {kind:8} {seed} {gains}  vanes {vanes}  {row.largest[1]:5.1f}"
            f" {row.largest[0]:34} {row.covered:.2f} {row.seconds:4.0f} s  {row.air}",
            flush=True,
        )


if __name__ == "__main__":
    main()
