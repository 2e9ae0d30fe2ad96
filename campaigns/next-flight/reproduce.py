"""Does the next flight narrow the interval as predicted? Simulated, over many seeds, beside the
same minutes of the old manoeuvres.

    python -m campaigns.next-flight.reproduce --seeds 10 --out campaigns/next-flight/results

The model is aircraft/espaaro, the truth espaaro_truth in light turbulence with Table 2.1's noise.
Bounds come from the first seconds of scripts/flight-bounds.xml; the mission is the loiter in light
turbulence. The next flight is planned with the model alone, flown by the truth, its data are added
and the bounds are made again. The old manoeuvres are two more flights of flight-bounds. A record
that is in the folder already is not flown again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from campaigns.library.study import failure_lines, log_progress, study_parser
from sysid.aerodynamics.residuals import Cutoffs, Residuals, combine_flights
from sysid.model_form.components import WALK_CUTOFF_HZ
from sysid.model_form.fit import FitOptions, fit_bounds
from sysid.model_form.model_form import AircraftReference, Filtering, FlightUsed, ModelForm
from uqharness.errors import BadInputError
from uqharness.files import write_text
from uqharness.next_flight.plan import (
    Options,
    designs_of,
    plan_from,
    prospects,
    try_library,
    widths_over,
)
from uqharness.next_flight.points import (
    Occupancy,
    RefusedPoint,
    TestFlight,
    Trial,
    fly_points,
    fly_script,
    recorded_mission,
    residuals_of,
)
from uqharness.simulator.aircraft import content_hash, find_aircraft
from uqharness.simulator.mission import find_script
from uqharness.text_tables import markdown_table

MODEL, TRUTH = "espaaro", "espaaro_truth"
TURBULENCE = "light"
MINUTES = 2.0 * 97.25 / 60.0
"""As long as two flights of flight-bounds."""
BEGIN_S = 4.0
WITHIN = 0.2
_CUTOFFS = Cutoffs()
_MISSION_SEEDS = (901, 902, 903)


@dataclass(frozen=True)
class Case:
    """Bounds from the first ``seconds`` of flight-bounds, and the coefficient for which the next
    flight is planned."""

    name: str
    seconds: float
    coefficient: str


CASES = (
    Case("one manoeuvre, CY", 16.0, "CY"),
    Case("one manoeuvre, CX", 16.0, "CX"),
    Case("two manoeuvres, CX", 24.0, "CX"),
    Case("four manoeuvres, Cm", 40.0, "Cm"),
    Case("nine manoeuvres, CY", 97.25, "CY"),
    Case("nine manoeuvres, Cm", 97.25, "Cm"),
)


def form_from(residuals: Sequence[Residuals], designs: object = None) -> ModelForm:
    """Make bounds from flights, without details that do not affect widths."""
    model = find_aircraft(MODEL)
    merged = combine_flights(residuals)
    fitted = fit_bounds(merged, designs, FitOptions())  # type: ignore[arg-type]
    seconds = [sum(float(p.time_s[-1] - p.time_s[0]) for p in r.pieces) for r in residuals]
    flights = zip(seconds, residuals, strict=True)
    used = (FlightUsed(str(k), "", s, sum(r.lengths)) for k, (s, r) in enumerate(flights))
    cutoffs = (_CUTOFFS.all_hz, _CUTOFFS.airspeed_hz, WALK_CUTOFF_HZ)
    return ModelForm(
        AircraftReference(model.name, content_hash(model)),
        tuple(used),
        Filtering(*cutoffs, 1.0 / merged.dt_s),
        0.95,
        "grow",
        {c: f.bounds for c, f in fitted.items()},
    )


def _fly(
    flight: TestFlight, script: str, seed: int, path: Path, seconds: float | None = None
) -> Path:
    """Record a script's first seconds unless ``path`` exists. Raises BadInputError when the flight
    does not end well."""
    if not path.exists():
        ok, _, reason = fly_script(flight, find_script(script), seed, path, seconds)
        if not ok:
            path.unlink(missing_ok=True)
            raise BadInputError(f"{path.name}: {reason}")
    return path


def mission_of(folder: Path) -> Occupancy:
    """Fly the loiter with the model: three flights of four minutes in light turbulence."""
    model = find_aircraft(MODEL)
    flight = TestFlight(model, find_script("loiter"), True, BEGIN_S, TURBULENCE, noise=False)
    paths = {seed: folder / f"mission-{seed}.parquet" for seed in _MISSION_SEEDS}
    records = [_fly(flight, "loiter", seed, path, 240.0) for seed, path in paths.items()]
    return recorded_mission(records, model, _CUTOFFS.all_hz)


@dataclass
class Study:
    """The parts that all seeds share: the mission, and test points tried once a case on the
    model."""

    folder: Path
    mission: Occupancy
    options: Options
    trials: dict[float, tuple[list[Trial], list[RefusedPoint]]]

    def flight(self, aircraft: str) -> TestFlight:
        """Return the loiter in the study's turbulence, as a test flight of that aircraft."""
        return TestFlight(find_aircraft(aircraft), find_script("loiter"), True, BEGIN_S, TURBULENCE)

    def run(self, case: Case, seed: int) -> list[dict[str, object]]:
        """Return one row per coefficient. Flight seeds are 100 seed + 1 (bounds), + 2 (next), + 3
        and + 4 (old manoeuvres)."""
        model, truth, base = find_aircraft(MODEL), self.flight(TRUTH), 100 * seed
        stem, script = f"{case.seconds:g}-{seed}", "flight-bounds"
        first = self.folder / f"bounds-{stem}.parquet"
        _fly(truth, script, base + 1, first, case.seconds)
        repeats = {k: self.folder / f"old-{seed}-{k}.parquet" for k in (3, 4)}
        for k, path in repeats.items():
            _fly(truth, script, base + k, path)
        initial, *repeated = residuals_of(model, [first, *repeats.values()], _CUTOFFS)
        form, model_flight = form_from([initial]), self.flight(MODEL)
        if case.seconds not in self.trials:
            library = try_library(form, self.mission, model_flight, self.options, _CUTOFFS)
            self.trials[case.seconds] = library
        trials, refused = self.trials[case.seconds]
        setting = (self.mission, model_flight, self.options)
        plan = plan_from(form, case.coefficient, *setting, trials, refused=refused)
        path = self.folder / f"next-{case.coefficient}-{stem}.parquet"
        ok, _, reason = fly_points(truth, [p.point for p in plan.plan], base + 2, path)
        if not ok:
            raise BadInputError(f"{path.name}: {reason}")
        (new,) = residuals_of(model, [path], _CUTOFFS)
        designs = designs_of(form)
        achieved = widths_over(form_from([initial, new], designs), self.mission)
        old_achieved = widths_over(form_from([initial, *repeated], designs), self.mission)
        expected = prospects(form, self.mission, combine_flights(repeated), 1.0, trials)
        rows = []
        for c in form.coefficients:
            p = plan.prospects[c]
            row = {"case": case.name, "seed": seed, "for": case.coefficient, "coefficient": c}
            row["seconds"] = plan.end_s
            widths = {
                "now": p.current,
                "known": p.planned,
                "predicted": p.refitted,
                "achieved": achieved[c],
            }
            widths |= {"old_predicted": expected[c].refitted, "old_achieved": old_achieved[c]}
            for name, width in widths.items():
                row[name] = width.total
                if name != "known":
                    row[f"{name}_parameter"] = width.parameter
            rows.append(row | {"at_most": p.asymptotic.total})
        return rows


def narrowings(rows: pd.DataFrame) -> pd.DataFrame:
    """Return by case and coefficient means over seeds of the narrowings [%], standard errors, and
    predicted over achieved."""
    parts = ("predicted", "achieved", "old_predicted", "old_achieved")
    table = []
    for (case, coefficient), part in rows.groupby(["case", "coefficient"], sort=False):
        n = len(part)
        row: dict[str, object] = {"case": case, "coefficient": coefficient}
        row |= {"for": part["for"].iloc[0], "seeds": n}
        for name in ("known", *parts, "at_most", *(f"{name}_parameter" for name in parts)):
            start = part["now_parameter" if name.endswith("_parameter") else "now"]
            share = 100.0 * (1.0 - part[name] / start)
            row[name] = float(share.mean())
            row[f"{name}_error"] = float(share.std(ddof=1) / math.sqrt(n)) if n > 1 else math.nan
        for suffix in ("", "_parameter"):
            row[f"ratio{suffix}"] = row[f"predicted{suffix}"] / row[f"achieved{suffix}"]
        table.append(row)
    return pd.DataFrame(table)


def tables(rows: pd.DataFrame) -> str:
    """Return the study as markdown."""
    narrowing = narrowings(rows)
    text = (
        f"{rows['seed'].nunique()} seeds; narrowing in percent, ± standard error of the mean over "
        f"seeds; flights of {rows['seconds'].mean():.0f} s on average.\n"
    )
    planned = narrowing["coefficient"] == narrowing["for"]
    for part, title in (
        (narrowing[planned], "The coefficient that the flight was planned for"),
        (narrowing[~planned], "The others"),
    ):
        if len(part):
            cells = [_table_row(row) for _, row in part.iterrows()]
            text += f"\n## {title}\n\n{markdown_table(cells)}"
    return text


def _table_row(row: pd.Series) -> dict[str, str]:
    def with_error(name: str) -> str:
        return f"{row[name]:.1f} ± {row[name + '_error']:.1f}"

    return {
        "bounds from, for": str(row["case"]),
        "coefficient": str(row["coefficient"]),
        "width: predicted": with_error("predicted"),
        "achieved": with_error("achieved"),
        "ratio": f"{row['ratio']:.2f}",
        "old manoeuvres": with_error("old_achieved"),
        "endless data": f"{row['at_most']:.1f}",
        "parameter part: predicted": with_error("predicted_parameter"),
        "achieved ": with_error("achieved_parameter"),
        "ratio ": f"{row['ratio_parameter']:.2f}",
        "old manoeuvres ": with_error("old_achieved_parameter"),
    }


def verdict(narrowing: pd.DataFrame) -> list[str]:
    """List failures: a mean narrowing more than 20 % off, of the coefficient that a flight was
    planned for.

    The total width counts only where endless data would take more than a fifth of it: elsewhere it
    is scatter, which comes out anew with every flight and is not predicted.
    """
    failures = []
    for _, row in narrowing[narrowing["coefficient"] == narrowing["for"]].iterrows():
        for suffix, name in (("_parameter", "the parameter part"), ("", "the width")):
            ratio, clear = row["ratio" + suffix], suffix or row["at_most"] > 100.0 * WITHIN
            if clear and not abs(ratio - 1.0) <= WITHIN:
                words = f"predicted over achieved narrowing of {name} is {ratio:.2f}"
                failures.append(f"{row['case']}: {words}")
    return failures


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out="records, tables.md, narrowing.csv")
    parser.add_argument("--seed", type=int, default=1, help="the first (default 1)")
    parser.add_argument("--seeds", type=int, default=10, help="how many (default 10)")
    names = [case.name for case in CASES]
    parser.add_argument("--cases", nargs="+", default=names, choices=names)
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    study = Study(args.out, mission_of(args.out), Options(MINUTES), {})
    rows: list[dict[str, object]] = []
    failed: list[str] = []
    for seed in range(args.seed, args.seed + args.seeds):
        for case in (case for case in CASES if case.name in args.cases):
            try:
                rows += study.run(case, seed)
            except BadInputError as error:
                # An open-loop manoeuvre in turbulence may end on the ground: that is listed.
                failed.append(f"{case.name}, seed {seed}: {error}")
        log_progress(f"seed {seed} done")
        if rows:
            table = pd.DataFrame(rows).to_csv(index=False, lineterminator="\n")
            write_text(args.out / "narrowing.csv", table)
    if not rows:
        log_progress("\n".join(failed))
        return 1
    failures = verdict(narrowings(pd.DataFrame(rows)))
    text = tables(pd.DataFrame(rows)) + "".join(f"- left out: {f}\n" for f in failed)
    text += failure_lines(failures, "Predictions hold as asked for.")
    write_text(args.out / "tables.md", text)
    print(text)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
