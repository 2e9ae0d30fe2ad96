"""The identification examples of the dissertation's chapter 2, flown, logged, re-imported,
identified: Tables 2.4, 2.5 and 2.6.

    python -m campaigns.identification.reproduce --out campaigns/identification/results
    python -m campaigns.identification.reproduce --jsbsim --seed 51 --seeds 5 --out DIR

Truths are the synthetic aircraft with dynamic stall (Tables 2.4, 2.5: models SL and SLM) and the
E-SPAARO's reference truth (Table 2.6). Each is flown three times by scripts/flight-*.xml in light
turbulence with Table 2.1's noise, written as DataFlash and read back; identified from the first
flight, by filter error, because output error's bounds do not hold in turbulence.

--jsbsim identifies the E-SPAARO with Table 2.6's terms as a user does, by `uqharness identify`:
jsbsim.csv has a row a seed and parameter, and exit code 1 means that the intervals do not cover 90
to 98 %.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.identification.air_equations import (
    NOISE_START,
    NOISY,
    OUTPUTS,
    STATE_STD,
    AirEquations,
    Build,
    body_axis_build,
    parameters,
    start_state,
    wind_axis_build,
)
from campaigns.identification.flights import FINE_STEP_S, PASSING_MPS, fly_flights
from campaigns.library.study import exit_code, log_progress, published_table, study_parser
from sysid.arrays import FloatArray
from sysid.estimation.filter_error import filter_error
from sysid.estimation.results import FilterErrorFit
from uqharness.api.identification import identify as identify_through_jsbsim
from uqharness.replay.flights import (
    control_columns,
    measured_outputs,
    prepare,
    read_flight,
    segments,
)
from uqharness.replay.model import CONTROLS
from uqharness.replay.replay import STATES
from uqharness.simulator.actuators import actuators
from uqharness.simulator.aircraft import find_aircraft, open_aircraft

COVERED = (0.90, 0.98)
MAX_ITERATIONS = 30  # a model of the right form needs some 20
_STATES = "V_mps alpha_rad beta_rad p_radps q_radps r_radps phi_rad theta_rad"
_STATE_ORDER = [STATES.index(name) for name in _STATES.split()]


@dataclass(frozen=True)
class Case:
    """One table: the aircraft that flies, the one whose card and parameters are identified, and
    what its model lacks."""

    name: str
    table: str
    aircraft: str
    model: str
    build: Build
    omitted: tuple[str, ...] = ()


_STALL = ("synthetic_stall", "synthetic_stall", wind_axis_build)
CASES = (
    Case("SL", "2.4", *_STALL),  # lacks the loss of lift by separation
    Case("SLM", "2.5", *_STALL, ("Cm_q",)),  # lacks pitch damping as well
    Case("E-SPAARO", "2.6", "espaaro_truth", "espaaro", body_axis_build),  # lacks four effects
    Case("right form", "2.6", "espaaro", "espaaro", body_axis_build),  # lacks nothing
)


@dataclass(frozen=True)
class Data:
    """Manoeuvres of a flight as filter error takes them: per segment start (13,), inputs (n, 5) and
    half-way between (n-1, 5), outputs (n, 11), times (n,)."""

    x0: list[FloatArray]
    u: list[FloatArray]
    u_middle: list[FloatArray]
    z: list[FloatArray]
    t: list[FloatArray]


def read_data(path: Path, aircraft_name: str, step_s: float = FINE_STEP_S) -> Data:
    """Read a log's manoeuvres. Surface positions follow from the logged commands by the model's
    actuators, step by step."""
    aircraft = find_aircraft(aircraft_name)
    flight = prepare(path.stem, read_flight(path, aircraft), ())
    servos = actuators(aircraft, CONTROLS)
    record = flight.record
    columns = control_columns(())
    # Over all of the flight: an actuator's position at a manoeuvre's start follows from before.
    positions = [
        servos[c].follow_with_midpoints(record[column], record.dt_s, step_s)
        for c, column in zip(CONTROLS, columns, strict=True)
    ]
    rho = record["rho_kgpm3"]
    u = np.column_stack([*(rows for rows, _ in positions), rho])
    u_middle = np.column_stack([*(between for _, between in positions), 0.5 * (rho[:-1] + rho[1:])])
    data = Data([], [], [], [], [])
    for segment, piece, z in zip(
        segments(flight, ()), flight.pieces, measured_outputs(flight, OUTPUTS), strict=True
    ):
        data.x0.append(start_state(*segment.start[_STATE_ORDER]))
        data.u.append(u[piece.rows])
        data.u_middle.append(u_middle[piece.rows.start : piece.rows.stop - 1])
        data.z.append(z)
        data.t.append(segment.time_s - segment.time_s[0])
    return data


def identify(
    case: Case,
    data: Data,
    start: Mapping[str, float] | None = None,
    free: Sequence[str] | None = None,
) -> FilterErrorFit:
    """Fit by filter error from the card's first guesses (or ``start``), over all of the model's
    parameters or those of ``free``."""
    card = find_aircraft(case.model).card
    priors = dict(zip(parameters(tuple(card.parameters)), card.parameters.values(), strict=True))
    names = tuple(name for name in priors if name not in case.omitted)
    fixed = dict.fromkeys(case.omitted, 0.0)
    equations = AirEquations(case.build, names, fixed, passing_mps=PASSING_MPS)
    guesses = {name: priors[name].initial or 0.0 for name in names} | dict(start or {})
    return filter_error(
        equations.f,
        equations.g,
        data.x0,
        np.array([guesses[name] for name in names]),
        data.u,
        data.z,
        data.t,
        names=names,
        bounds=[priors[name].bounds or (-np.inf, np.inf) for name in names],
        free=free,
        process_noise=NOISY,
        process_noise_start=NOISE_START,
        noise_start=np.array([card.sensors.noise_std[name] for name in OUTPUTS]),
        x0_std=STATE_STD,
        u_middle=data.u_middle,
        max_iterations=MAX_ITERATIONS,
    )


def published(table: str) -> pd.DataFrame:
    """Read the dissertation's table, by parameter."""
    return published_table(table, index_col="parameter")


def true_values(case: Case, names: Sequence[str]) -> FloatArray:
    """Read the values of the flown aircraft's XML."""
    fdm = open_aircraft(find_aircraft(case.aircraft))
    return np.array([fdm[f"aero/{name}"] for name in names])


def side_by_side(case: Case, fit: FilterErrorFit) -> pd.DataFrame:
    """Return true, published (+/- bound), ours (+/- std); errors in percent of the truth and in
    standard errors."""
    names = list(fit.names)
    table = pd.DataFrame(
        {"true": true_values(case, names)}, index=pd.Index(names, name="parameter")
    )
    print_ = published(case.table).reindex(names)
    table["published"] = print_["published"]
    table["published_bound"] = print_["published_bound"]
    table["ours"], table["std"], table["std_crb"] = fit.theta, fit.std, fit.std_crb
    table["status"] = [fit.status[name] for name in names]
    scale = table["true"].abs().replace(0.0, np.nan)
    if case.table != "2.6":  # Table 2.6's estimates are themselves the truth flown here
        error = (table["published"] - table["true"]).abs()
        table["published_error_pct"] = 100.0 * error / scale
        table["published_error_bounds"] = error / table["published_bound"]
    error = (table["ours"] - table["true"]).abs()
    table["error_pct"], table["error_stds"] = 100.0 * error / scale, error / table["std"]
    return table


def summary(table: pd.DataFrame) -> dict[str, float]:
    """Return the median relative error [%] and the share of parameters within 1.96 standard errors,
    ours and published."""
    counted = table[table["status"] == "identified"]
    within_crb = counted["error_stds"] * counted["std"] <= 1.96 * counted["std_crb"]
    numbers = {
        "parameters": float(len(table)),
        "identified": float(len(counted)),
        "median_error_pct": float(counted["error_pct"].median()),
        "covered_95": float((counted["error_stds"] <= 1.96).mean()),
        "covered_95_crb": float(within_crb.mean()),
        "median_error_stds": float(counted["error_stds"].median()),
    }
    if "published_error_pct" in table:
        numbers["published_median_error_pct"] = float(table["published_error_pct"].median())
        numbers["published_covered_95"] = float((table["published_error_bounds"] <= 1.96).mean())
    return numbers


def run_seed(
    seed: int, folder: Path, cases: Sequence[Case] = CASES, turbulence: str = "light"
) -> dict[str, tuple[pd.DataFrame, FilterErrorFit]]:
    """Fly, read back and identify every case with one seed."""
    logs = {
        name: fly_flights(name, folder, seed, turbulence, fine=True)
        for name in dict.fromkeys(case.aircraft for case in cases)
    }
    results = {}
    for case in cases:
        start = time.perf_counter()
        fit = identify(case, read_data(logs[case.aircraft][0], case.model))
        results[case.name] = side_by_side(case, fit), fit
        state = "converged" if fit.converged else "NOT converged"
        seconds = time.perf_counter() - start
        log_progress(f"{case.name}: {state}, {fit.iterations} iterations, {seconds:.0f} s")
        for warning in fit.warnings:
            log_progress(f"  {warning}")
    return results


def through_jsbsim(seed: int, folder: Path, turbulence: str) -> pd.DataFrame:
    """Return true value, estimate and standard error of every parameter of the E-SPAARO, by
    `uqharness identify` from the log of a seed's flight."""
    log = fly_flights("espaaro", folder, seed, turbulence, fine=True)[0]
    fit = identify_through_jsbsim("espaaro", log, start="initial")
    fdm = open_aircraft(find_aircraft("espaaro"))
    columns = {"true": [fdm[name] for name in fit.names], "ours": fit.theta, "std": fit.std}
    table = pd.DataFrame(columns, index=pd.Index(fit.names, name="parameter"))
    table["z"] = (table["ours"] - table["true"]) / table["std"]
    return table.assign(seed=seed, method=fit.method, converged=fit.converged)


def covered(table: pd.DataFrame) -> float:
    """Return the share of the intervals that hold the truth; a parameter without an estimate counts
    as one that does not."""
    return float((table["z"].abs() <= 1.96).mean())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out="logs, tables.csv and summary.json")
    option, names = parser.add_argument, [case.name for case in CASES]
    option("--seed", type=int, default=1, help="of the first flight (1)")
    option("--seeds", type=int, default=1, help="repeat with seeds 10 apart and pool (1)")
    option("--cases", nargs="+", default=names, choices=names)
    airs = ("none", "light", "moderate")
    option("--turbulence", default="light", choices=airs, help="default light")
    option("--jsbsim", action="store_true", help="the right form by `uqharness identify` instead")
    args = parser.parse_args(arguments)
    return exit_code(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    """Run all chosen cases; exit code 1 where a fit did not converge or JSBSim's intervals do not
    cover."""
    cases = [case for case in CASES if case.name in args.cases]
    tables: dict[str, list[pd.DataFrame]] = {case.name: [] for case in cases}
    jsbsim, converged = [], True
    for seed in range(args.seed, args.seed + 10 * args.seeds, 10):
        folder = args.out / f"seed-{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        if args.jsbsim:
            jsbsim.append(through_jsbsim(seed, folder, args.turbulence))
            pd.concat(jsbsim).to_csv(args.out / "jsbsim.csv")
            continue
        for name, (table, fit) in run_seed(seed, folder, cases, args.turbulence).items():
            tables[name].append(table.assign(case=name, seed=seed, converged=fit.converged))
            converged = converged and fit.converged
    if not args.jsbsim:
        _write(args.out, tables)
        return 0 if converged else 1
    pooled = pd.concat(jsbsim)
    share, rms = covered(pooled), float(np.sqrt(np.nanmean(pooled["z"] ** 2)))
    print(
        f"{100 * share:.0f} % of {len(pooled)} intervals hold the truth, rms of error/std {rms:.2f}"
    )
    return 0 if COVERED[0] <= share <= COVERED[1] and pooled["converged"].all() else 1


def _write(folder: Path, tables: Mapping[str, Sequence[pd.DataFrame]]) -> None:
    """Write and print all tables, and the figures of each case pooled over seeds."""
    every = {name: pd.concat(parts) for name, parts in tables.items()}
    pd.concat(every.values()).to_csv(folder / "tables.csv")
    numbers = {
        name: {"seeds": float(len(tables[name])), **summary(table)} for name, table in every.items()
    }
    (folder / "summary.json").write_text(json.dumps(numbers, indent=1), encoding="utf-8")
    for name, table in every.items():
        print(f"\n{name}\n{table.drop(columns='case').to_string(float_format='%.4g')}")
    print(pd.DataFrame(numbers).to_string(float_format="%.4g"))


if __name__ == "__main__":
    raise SystemExit(main())
