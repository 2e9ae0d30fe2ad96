"""Measures the intervals of `identify` on ordinary flights of JSBSim's stock aircraft.

    python -m tests.ordinary_flights.examine [AIRCRAFT...] [--seeds N] [--seconds S]
        [--gusts tustin milspec culp] [--vanes true wrong none] [--w20-mps W] [--straight]

Per aircraft, gusts and vanes: how many of the derivatives that it identified have the truth in
their 95 % interval, how many intervals have a half-width below the value and below twice the value,
the air data's errors inside their intervals, and CPU time. Each flight starts from another wrong
model. The derivatives outside are listed with their errors in standard deviations.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.record import FlightRecord
from tests.ordinary_flights.truth import GUSTS, STOCK, TERMS, Weather, cruise, fly, write_model
from uqharness.identification.identify import identify
from uqharness.identification.replay_fit import Identification
from uqharness.replay.flights import read_flights
from uqharness.simulator import find_aircraft

VANES = ("true", "wrong", "none")
WRONG = {"V_mps": (1.05, 0.0), "alpha_rad": (1.3, 0.03), "beta_rad": (1.2, -0.04)}
"""Scale and offset of each channel of an uncalibrated probe."""


@dataclass(frozen=True)
class Derivative:
    """One derivative: its truth, and estimate, standard error, correlation-free, and label."""

    name: str
    truth: float
    value: float
    std: float
    basis: str

    @property
    def inside(self) -> bool:
        """Return whether the 95 % interval has the truth."""
        return abs(self.value - self.truth) <= 1.96 * self.std


def with_vanes(record: FlightRecord, vanes: str) -> FlightRecord:
    """Return the record with true, uncalibrated, or no vanes."""
    if vanes == "wrong":
        return record.with_columns(
            {c: scale * record[c] + offset for c, (scale, offset) in WRONG.items()}
        )
    if vanes == "none":
        columns = {n: v for n, v in record.columns.items() if n not in ("alpha_rad", "beta_rad")}
        return FlightRecord(columns, replace(record.metadata))
    return record


def derivatives(name: str, result: Identification) -> list[Derivative]:
    """Return the identified derivatives beside the truth; CX's slope is that of cruise."""
    at, out = cruise(name), []
    identified = list(result.identified)
    value = dict(zip(result.names, result.theta.tolist(), strict=True))
    for coefficient, states in TERMS.items():
        for state in states:
            weights = {f"aero/{coefficient}_{state}": 1.0}
            if coefficient == "CX":
                weights["aero/CX_alpha2"] = 2.0 * at.alpha
            used = {n: w for n, w in weights.items() if n in value}
            if not used or not all(n in identified for n in used):
                continue
            g = np.array([used.get(n, 0.0) for n in identified])
            out.append(
                Derivative(
                    f"{coefficient}_{state}",
                    at.slopes[coefficient][state],
                    sum(w * value[n] for n, w in used.items()),
                    float(np.sqrt(g @ result.cov @ g)),
                    result.labels.get(f"aero/{coefficient}_{state}", ""),
                )
            )
    return out


def air_data_inside(result: Identification, vanes: str) -> list[bool]:
    """Return whether each error of the air data lies in its interval."""
    out = []
    for channel, (scale, offset) in WRONG.items():
        truth = (
            {"scale": scale, "offset": offset}
            if vanes == "wrong"
            else {"scale": 1.0, "offset": 0.0}
        )
        for kind, true_value in truth.items():
            if (estimate := result.nuisance.get(f"sensor.{channel}/{kind}")) is not None:
                out.append(abs(estimate[0] - true_value) <= 1.96 * estimate[1])
    return out


def estimate(
    name: str, record: FlightRecord, model: Path, folder: Path
) -> tuple[Identification, float]:
    """Identify the model from the record; return the result and CPU seconds."""
    path = folder / f"{name}.parquet"
    record.write(path)
    begin = time.process_time()
    aircraft = find_aircraft(model)
    flights, measured = read_flights([path], aircraft)
    # The record has surface positions.
    result = identify(aircraft, flights, measured, workers=1, ideal_servos=True)
    return result, time.process_time() - begin


def table_row(rows: Iterable[Derivative], air: list[bool], seconds: float) -> str:
    """Return one row of the table."""
    rows = list(rows)
    inside = sum(r.inside for r in rows)
    narrow = [sum(1.96 * r.std < k * abs(r.truth) for r in rows) for k in (1, 2)]
    return (
        f"{inside:4d} of {len(rows):<4d} half-width < value {narrow[0]:3d}, < 2 values"
        f" {narrow[1]:3d}; air data {sum(air)} of {len(air)}; {seconds:.0f} s"
    )


def main() -> None:
    """Measure what the command line names and print a row of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("aircraft", nargs="*", default=list(STOCK))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--gusts", nargs="+", choices=list(GUSTS), default=list(GUSTS))
    parser.add_argument("--vanes", nargs="+", choices=VANES, default=list(VANES))
    parser.add_argument("--w20-mps", type=float, default=7.0)
    parser.add_argument("--straight", action="store_true", help="no turns, so no steps of commands")
    request = parser.parse_args()
    total: dict[str, list[Derivative]] = {v: [] for v in request.vanes}
    for name in request.aircraft:
        for gusts in request.gusts:
            rows: dict[str, list[Derivative]] = {v: [] for v in request.vanes}
            air: dict[str, list[bool]] = {v: [] for v in request.vanes}
            seconds = 0.0
            for seed in range(request.first_seed, request.first_seed + request.seeds):
                weather = Weather(gusts, request.w20_mps, turns=not request.straight)
                record = fly(name, seed, request.seconds, weather)
                with tempfile.TemporaryDirectory() as text:
                    folder = Path(text)
                    model = write_model(name, folder, seed)
                    for vanes in request.vanes:
                        flight = with_vanes(record, vanes)
                        result, cpu_s = estimate(name, flight, model, folder)
                        rows[vanes] += derivatives(name, result)
                        air[vanes] += air_data_inside(result, vanes)
                        seconds += cpu_s
            for vanes in request.vanes:
                total[vanes] += rows[vanes]
                text = table_row(rows[vanes], air[vanes], seconds / max(1, len(request.vanes)))
                print(f"{name:8} {gusts:8} {vanes:6} {text}", flush=True)
                for row in rows[vanes]:
                    if not row.inside:
                        print(
                            f"    {row.name:10} {row.value:9.4g} +- {1.96 * row.std:.2g}, truth"
                            f" {row.truth:.4g}"
                        )
    for vanes, rows_of in total.items():
        outside = Counter(r.name for r in rows_of if not r.inside)
        print(f"all {vanes:6} {table_row(rows_of, [], 0.0)} outside: {dict(outside)}")


if __name__ == "__main__":
    main()
