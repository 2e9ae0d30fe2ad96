"""Measures what the estimator finds in air of other kinds.

    python -m tests.gust_fields.examine [FAMILY...] [--seconds S] [--w20-kt W] [--seeds N]
        [--effect KEY --t T]

Per family and seed, flights without a missing effect, or with the effect KEY of the battery at the
size that three flights of 90 s in light turbulence see at |t| T: gains of moments without a candidate, the
air that was found, the largest |t| of scales of the vanes and of any candidate, and the share of
parameters whose 95 % interval has the truth."""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.effects import scores
from sysid.parallel import SERIAL
from tests.gust_fields.fields import FAMILIES, Setting
from tests.gust_fields.flights import fly_in
from tests.helpers.sixdof import Airframe
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.effects import Effect
from tests.hidden_effects.flights import Flight
from tests.hidden_effects.manoeuvres import card
from uqharness.identification.linearised import (
    ModelState,
    StagedModels,
    effect_columns,
    gust_refit,
    make_setup,
    setup_in_gusts,
)
from uqharness.refinement.candidates import candidate_effects
from uqharness.refinement.estimators import PredictionErrorEstimator
from uqharness.replay.flights import read_flights
from uqharness.simulator import find_aircraft

SPEEDS, STRENGTHS, COVERED = (20.5, 23.5), (0.9, 1.1), 1.96
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
) -> list[Path]:
    """Fly and write two flights of a family."""
    paths = []
    for k, (V, strength) in enumerate(zip(SPEEDS, STRENGTHS, strict=True)):
        flown = card(100 * seed + k, V, seconds=seconds, strength=strength, first=5 * k, h_m=80.0)
        airframe = Airframe()
        at = Setting(V, 80.0, w20_kt, airframe.b, 1.6, seconds, 100 * seed + k)
        record = fly_in(Flight(flown, airframe, effects), family, at)
        paths.append(folder / f"{family}-{seed}-{k}.parquet")
        record.write(paths[-1])
    return paths


def measure(paths: list[Path]) -> Finding:
    """Estimate the flights' air from the true parameters and score every candidate."""
    begun = time.perf_counter()
    aircraft = find_aircraft("espaaro")
    flights, measured = read_flights(paths, aircraft, align=False)
    setup = setup_in_gusts(aircraft, make_setup(aircraft, flights, measured))
    names = [n for n in aircraft.card.parameters if n.startswith("aero/")]
    with StagedModels(aircraft, setup) as bench:
        fdm = bench.model.open(aircraft.dt_s)
        truth = {n: float(fdm[n]) for n in names}
        start = ModelState(truth, {}, ())
        air = gust_refit(
            bench.model, bench.direct_model, setup, start, names, {}, SERIAL, tune=True
        )
        effects = candidate_effects(air.setup, names, ())
        columns = effect_columns(air.setup, air.fit.probes, air.fit.trajectory, effects)
        estimator = PredictionErrorEstimator(air.gusts)
        evidence = estimator.information(air.setup, air.fit, columns)
    free = list(air.fit.columns[0].names)
    keys = [e.key for e in effects]
    t = dict(zip(keys, np.abs(scores(evidence, free, keys).t).tolist(), strict=True))
    largest = max((k for k in t if np.isfinite(t[k])), key=lambda k: t[k])
    return Finding(
        air.gusts.words,
        tuple(air.gusts.moments.tolist()),
        tuple(t.get(v, float("nan")) for v in VANES),
        (largest, t[largest]),
        coverage(air.fit.evidence, air.fit.trajectory.point.values, truth),
        time.perf_counter() - begun,
    )


def coverage(evidence, estimates, truth):  # type: ignore[no-untyped-def]
    """Share of parameters whose 95 % interval has the truth."""
    information, _ = evidence.total
    std = np.sqrt(np.diag(np.linalg.pinv(information)))
    place = {n: k for k, n in enumerate(evidence.names)}
    inside = [abs(estimates[n] - truth[n]) <= COVERED * std[place[n]] for n in truth if n in place]
    return float(np.mean(inside))


def main() -> None:
    """Measure the families of the command line and print a row of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("families", nargs="*", default=list(FAMILIES))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--w20-kt", type=float, default=15.0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--effect", choices=sorted(ENTRIES), metavar="KEY")
    parser.add_argument("--t", type=float, default=30.0)
    request = parser.parse_args()
    effects = (ENTRIES[request.effect].effect(request.t, "light"),) if request.effect else ()
    for family in request.families:
        for seed in range(request.seeds):
            with tempfile.TemporaryDirectory() as folder:
                paths = write_flights(
                    family, seed, request.seconds, request.w20_kt, Path(folder), effects
                )
                row = measure(paths)
            gains = " ".join(f"{g:9.0f}" for g in row.moments)
            vanes = " ".join(f"{t:5.1f}" for t in row.vane_t)
            print(
                f"{family:18} {seed} {gains}  vanes {vanes}  {row.largest[1]:5.1f}"
                f" {row.largest[0]:34} {row.covered:.2f} {row.seconds:4.0f} s  {row.air}",
                flush=True,
            )


if __name__ == "__main__":
    main()
