"""The identification examples of the dissertation's chapter 2, flown, logged, re-imported, identified: Tables 2.4, 2.5 and 2.6.

    python -m campaigns.identification.reproduce --out campaigns/identification/results

Truths are the synthetic aircraft with dynamic stall (Tables 2.4, 2.5: models SL and SLM) and the E-SPAARO's reference
truth (Table 2.6). Each is flown three times by scripts/flight-*.xml in light turbulence with Table 2.1's noise, written
as DataFlash and read back; identified from the first flight, by filter error, because output error's bounds do not hold in
turbulence.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from campaigns.identification import round_trip
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
from sysid.arrays import FloatArray
from sysid.estimation.filter_error import filter_error
from sysid.estimation.results import FilterErrorFit
from uqharness.errors import BadInputError
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
from uqharness.simulator.aircraft import PROJECT_ROOT, find_aircraft

MAX_ITERATIONS = 30  # a model of the right form needs some 20
PUBLISHED = PROJECT_ROOT / "tests" / "reference"
_STATE_ORDER = tuple(
    STATES.index(n)
    for n in (
        "V_mps",
        "alpha_rad",
        "beta_rad",
        "p_radps",
        "q_radps",
        "r_radps",
        "phi_rad",
        "theta_rad",
    )
)


@dataclass(frozen=True)
class Case:
    """One table: the aircraft flown, the one whose card and parameters are identified, and what its model lacks."""

    name: str
    table: str
    flown: str
    model: str
    build: Build
    held: tuple[str, ...] = ()
    held_value: float = 0.0
    about: str = ""


CASES = (
    Case(
        "SL",
        "2.4",
        "synthetic_stall",
        "synthetic_stall",
        wind_axis_build,
        about="lift without separation",
    ),
    Case(
        "SLM",
        "2.5",
        "synthetic_stall",
        "synthetic_stall",
        wind_axis_build,
        ("Cm_q",),
        about="lift without separation, no pitch damping",
    ),
    Case(
        "E-SPAARO",
        "2.6",
        "espaaro_truth",
        "espaaro",
        body_axis_build,
        about="Table 2.6's terms, four effects missing",
    ),
    Case(
        "right form",
        "2.6",
        "espaaro",
        "espaaro",
        body_axis_build,
        about="Table 2.6's terms, which are all there is",
    ),
)


@dataclass(frozen=True)
class Data:
    """Manoeuvres of a flight as filter error takes them: per segment start (13,), inputs (n, 5) and half-way between (n-1, 5),
    outputs (n, 11), times (n,)."""

    x0: list[FloatArray]
    u: list[FloatArray]
    u_middle: list[FloatArray]
    z: list[FloatArray]
    t: list[FloatArray]


def read_data(path: Path, aircraft_name: str, step_s: float = FINE_STEP_S) -> Data:
    """A log's manoeuvres. Surface positions are what the model's own actuators make of the logged commands, step by step."""
    aircraft = find_aircraft(aircraft_name)
    flight = prepare(path.stem, read_flight(path, aircraft), ())
    servos = actuators(aircraft, CONTROLS)
    record = flight.record
    columns = control_columns(())
    # Over the whole flight, not manoeuvre by manoeuvre: where an actuator stands at a start follows from what went before.
    positions = [
        servos[c].follow_with_midpoints(record[column], record.dt_s, step_s)
        for c, column in zip(CONTROLS, columns, strict=True)
    ]
    rho = record["rho_kgpm3"]
    u = np.column_stack([*(rows for rows, _ in positions), rho])
    u_middle = np.column_stack([*(between for _, between in positions), 0.5 * (rho[:-1] + rho[1:])])
    out = Data([], [], [], [], [])
    for segment, piece, z in zip(
        segments(flight, ()), flight.pieces, measured_outputs(flight, OUTPUTS), strict=True
    ):
        out.x0.append(start_state(*segment.start[list(_STATE_ORDER)]))
        out.u.append(u[piece.rows])
        out.u_middle.append(u_middle[piece.rows.start : piece.rows.stop - 1])
        out.z.append(z)
        out.t.append(segment.time_s - segment.time_s[0])
    return out


def identify(
    case: Case,
    data: Data,
    start: Mapping[str, float] | None = None,
    free: Sequence[str] | None = None,
) -> FilterErrorFit:
    """Filter error from the card's first guesses (or ``start``), over all of the model's parameters or those of ``free``."""
    card = find_aircraft(case.model).card
    known = dict(zip(parameters(tuple(card.parameters)), card.parameters.values(), strict=True))
    names = tuple(n for n in known if n not in case.held)
    equations = AirEquations(
        case.build, names, dict.fromkeys(case.held, case.held_value), passing_mps=PASSING_MPS
    )
    guesses = {n: known[n].initial or 0.0 for n in names} | dict(start or {})
    theta = np.array([guesses[n] for n in names])
    bounds = [known[n].bounds or (-np.inf, np.inf) for n in names]
    noise = np.array([card.sensors.noise_std[n] for n in OUTPUTS])
    return filter_error(
        equations.f,
        equations.g,
        data.x0,
        theta,
        data.u,
        data.z,
        data.t,
        names=names,
        bounds=bounds,
        free=free,
        process_noise=NOISY,
        process_noise_start=NOISE_START,
        noise_start=noise,
        x0_std=STATE_STD,
        u_middle=data.u_middle,
        max_iterations=MAX_ITERATIONS,
    )


def published(table: str) -> pd.DataFrame:
    """The dissertation's table, by parameter."""
    return pd.read_csv(
        PUBLISHED / f"table_{table.replace('.', '_')}.csv", comment="#", index_col="parameter"
    )


def true_values(case: Case, names: Sequence[str]) -> FloatArray:
    """What the flown aircraft's XML says."""
    from uqharness.simulator.aircraft import open_aircraft

    fdm = open_aircraft(find_aircraft(case.flown))
    return np.array([fdm[f"aero/{name}"] for name in names])


def side_by_side(case: Case, fit: FilterErrorFit) -> pd.DataFrame:
    """true, published (+/- bound), ours (+/- std); errors in percent of the truth and in standard errors."""
    names = list(fit.names)
    out = pd.DataFrame({"true": true_values(case, names)}, index=pd.Index(names, name="parameter"))
    print_ = published(case.table).reindex(names)
    out["published"], out["published_bound"] = print_["published"], print_["published_bound"]
    out["ours"], out["std"] = fit.theta, fit.std
    out["std_crb"] = fit.std_crb
    out["status"] = [fit.status[n] for n in names]
    scale = out["true"].abs().replace(0.0, np.nan)
    if case.table != "2.6":  # Table 2.6's estimates are themselves the truth flown here
        out["published_error_pct"] = 100.0 * (out["published"] - out["true"]).abs() / scale
        out["published_error_bounds"] = (out["published"] - out["true"]).abs() / out[
            "published_bound"
        ]
    out["error_pct"] = 100.0 * (out["ours"] - out["true"]).abs() / scale
    out["error_stds"] = (out["ours"] - out["true"]).abs() / out["std"]
    return out


def summary(table: pd.DataFrame) -> dict[str, float]:
    """Median relative error [percent] and the share of parameters within 1.96 standard errors, ours and published."""
    counted = table[table["status"] == "identified"]
    out = {
        "parameters": float(len(table)),
        "identified": float(len(counted)),
        "median_error_pct": float(counted["error_pct"].median()),
        "covered_95": float((counted["error_stds"] <= 1.96).mean()),
        "covered_95_crb": float(
            (counted["error_stds"] * counted["std"] <= 1.96 * counted["std_crb"]).mean()
        ),
        "median_error_stds": float(counted["error_stds"].median()),
    }
    if "published_error_pct" in table:
        out["published_median_error_pct"] = float(table["published_error_pct"].median())
        out["published_covered_95"] = float((table["published_error_bounds"] <= 1.96).mean())
    return out


def markdown(case: Case, table: pd.DataFrame, numbers: Mapping[str, float]) -> str:
    """The table as text."""
    lines = [
        f"## Table {case.table}: {case.name} ({case.about})",
        "",
        "| parameter | true | published | ± bound | ours | ± std | published error | our error | our error / std |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in table.iterrows():
        cells = [f"{row[c]:.4g}" for c in ("true", "published", "published_bound", "ours", "std")]
        cells += [
            f"{row[c]:.1f} %" if c in row else "" for c in ("published_error_pct", "error_pct")
        ]
        cells.append(f"{row['error_stds']:.1f}")
        lines.append(
            f"| `{name}` | "
            + " | ".join(c.replace("nan %", "–").replace("nan", "–") for c in cells)
            + " |"
        )
    said = (
        f"Ours: median error {numbers['median_error_pct']:.2f} % of the true value; "
        f"{100 * numbers['covered_95']:.0f} % of {numbers['identified']:.0f} parameters within 1.96 standard errors "
        f"({100 * numbers['covered_95_crb']:.0f} % within 1.96 Cramer-Rao bounds)."
    )
    if "published_median_error_pct" in numbers:
        said += (
            f" Published: {numbers['published_median_error_pct']:.1f} %; "
            f"{100 * numbers['published_covered_95']:.0f} % within 1.96 bounds."
        )
    if "converged" in table and not table["converged"].all():
        said += " The search did NOT converge: estimates and standard errors are those of where it stopped."
    return "\n".join([*lines, "", said, ""])


def run_seed(
    seed: int, folder: Path, cases: Sequence[Case] = CASES, turbulence: str = "light"
) -> dict[str, tuple[pd.DataFrame, FilterErrorFit]]:
    """Fly, read back and identify every case with one seed."""
    logs = {
        name: fly_flights(name, folder, seed, turbulence, fine=True)
        for name in dict.fromkeys(c.flown for c in cases)
    }
    out = {}
    for case in cases:
        begun = time.perf_counter()
        fit = identify(case, read_data(logs[case.flown][0], case.model))
        out[case.name] = side_by_side(case, fit), fit
        state = "converged" if fit.converged else "NOT converged"
        print(
            f"{case.name}: {state}, {fit.iterations} iterations, {time.perf_counter() - begun:.0f} s",
            file=sys.stderr,
        )
        for warning in fit.warnings:
            print(f"  {warning}", file=sys.stderr)
    return out


def pooled(tables: Sequence[pd.DataFrame]) -> dict[str, float]:
    """Over several seeds' tables of one case: what `summary` says of all estimates together."""
    return {"seeds": float(len(tables)), **summary(pd.concat(tables))}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        help="folder for logs, tables.md, tables.csv and summary.json",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the first flight (default 1)")
    parser.add_argument(
        "--seeds", type=int, default=1, help="repeat with seeds 10 apart and pool (default 1)"
    )
    parser.add_argument(
        "--cases", nargs="+", default=[c.name for c in CASES], choices=[c.name for c in CASES]
    )
    parser.add_argument(
        "--turbulence", default="light", choices=("none", "light", "moderate"), help="default light"
    )
    parser.add_argument(
        "--no-round-trip", action="store_true", help="leave out the round trip (round_trip.py)"
    )
    chosen = parser.parse_args(arguments)
    try:
        return _study(chosen)
    except BadInputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _study(chosen: argparse.Namespace) -> int:
    """All that was chosen; exit code 0, or 1 where a fit did not converge or the round trip does not tell the forms apart."""
    cases = [c for c in CASES if c.name in chosen.cases]
    found: dict[str, list[pd.DataFrame]] = {case.name: [] for case in cases}
    converged = True
    for seed in range(chosen.seed, chosen.seed + 10 * chosen.seeds, 10):
        folder = chosen.out / f"seed-{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        for name, (table, fit) in run_seed(seed, folder, cases, chosen.turbulence).items():
            found[name].append(table.assign(case=name, seed=seed, converged=fit.converged))
            converged = converged and fit.converged
        _write(chosen.out, cases, found)
    print((chosen.out / "tables.md").read_text(encoding="utf-8"))
    told = True
    if not chosen.no_round_trip:
        trips = round_trip.run(chosen.out / "round-trip", chosen.seed)
        print(round_trip.markdown(trips))
        told = round_trip.says_which(trips)
    return 0 if converged and told else 1


def _write(
    folder: Path, cases: Sequence[Case], found: Mapping[str, Sequence[pd.DataFrame]]
) -> None:
    """Tables of the first seed as text, all of them as CSV, the figures pooled over seeds."""
    numbers = {case.name: pooled(found[case.name]) for case in cases}
    texts = [markdown(case, found[case.name][0], summary(found[case.name][0])) for case in cases]
    for name, row in numbers.items():
        texts.append(
            f"{name}, {row['seeds']:.0f} seed(s): median error {row['median_error_pct']:.2f} %, "
            f"{100 * row['covered_95']:.0f} % of {row['identified']:.0f} intervals cover the truth "
            f"(Cramer-Rao: {100 * row['covered_95_crb']:.0f} %).\n"
        )
    (folder / "tables.md").write_text("\n".join(texts), encoding="utf-8")
    pd.concat([table for tables in found.values() for table in tables]).to_csv(
        folder / "tables.csv"
    )
    (folder / "summary.json").write_text(json.dumps(numbers, indent=1), encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
