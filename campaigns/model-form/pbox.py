"""What the bounds do to a mission: the loiter's cross-track p-box from bounds by parts, and as
published; is the truth inside?

    python -m campaigns.model-form.pbox --seeds 40 --out campaigns/model-form/results

Bounds are made from the study's flight in still air and flown at all corners and 16 points between
them, in light turbulence, by the batch engine. The aircraft that flew for the bounds flies the same
air beside them. One small file a seed and case; the same command resumes an interrupted run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from campaigns.library.study import failure_lines, run_seeds, study_parser, uqharness_command
from sysid.model_form.components import variation
from sysid.model_form.fit import FittedBounds, fit_bounds
from uqharness.files import scratch_folder, write_text
from uqharness.simulator.mission import find_script
from uqharness.statistics.pbox import Sample, containment, pbox
from uqharness.study.answer import area
from uqharness.text_tables import markdown_table

from .flights import BOUNDS, CASES, MODEL, Case, model_pair, noisy_twin, quiet_flight
from .judge import PUBLISHED, form_of

WAYS = ("by parts", "as published")
METRIC = "cross_track_median_m"
CALM = {case.name: case for case in CASES if case.turbulence == "none"}
MIN_INSIDE = 36 / 40
MAX_AREA = 0.2
"""Of the area as published, that of the model itself."""
_CAMPAIGN = """
[campaign]
aircraft = "{aircraft}"
mission = "{mission}"
seed = {seed}
engine = "batch"
[aleatory]
flights = {flights}
duration_s = {duration_s:g}
burn_in_s = 60
wind_mps = 3
wind_from_deg = 270
turbulence = "light"
sensor_noise = true
[epistemic]
{epistemic}
[metrics]
excursion_radius_m = [15, 25]
rearm_m = 2
"""


def run_seed(case: Case, seed: int, flights: int, duration_s: float) -> dict[str, Any]:
    """Return areas [m] of the cross-track p-boxes, their medians, and whether the aircraft's own
    flights lie inside."""
    result: dict[str, Any] = {"case": case.name, "seed": seed}
    result |= {"flights": flights, "duration_s": duration_s}
    settings = {"seed": 20161201 + seed, "flights": flights, "duration_s": duration_s}
    settings |= {"mission": find_script("loiter")}
    with scratch_folder("model-form") as scratch:
        truth = fly_samples(scratch.path / "truth", case.aircraft, 'method = "none"', settings)
        for way, fitted in _fits(case, seed).items():
            folder = scratch.path / way.replace(" ", "-")
            folder.mkdir()
            form_of(fitted, 50.0).write(folder / "model-form.json")
            corners = 'method = "corners"\nbounds = "model-form.json"'
            samples = fly_samples(folder, MODEL, corners, settings)
            result[way] = {
                "area": area(samples),
                "median": list(pbox(samples).quantile(0.5)),
                "flown": containment(truth, samples).verdict,
            }
    return result | {"flown_median": float(np.median(truth[0].values))}


def _fits(case: Case, seed: int) -> dict[str, dict[str, FittedBounds]]:
    calm = quiet_flight(case, BOUNDS, 10 * seed)
    with model_pair(calm.measured) as pair:
        noisy = noisy_twin(calm, pair, (seed, CASES.index(case), 0), (1.0,))
    residuals = noisy.knowing(noisy.sizes[1.0])
    published = {}
    for c, fitted in fit_bounds(residuals, options=PUBLISHED).items():
        rate = variation(residuals, c, fitted.bounds).rate
        published[c] = replace(fitted, bounds=replace(fitted.bounds, walk_rate=rate))
    return {WAYS[0]: fit_bounds(residuals), WAYS[1]: published}


def fly_samples(
    folder: Path, aircraft: str, epistemic: str, settings: Mapping[str, Any]
) -> list[Sample]:
    """Fly a campaign in ``folder``, and return its flights' medians by epistemic sample."""
    folder.mkdir(exist_ok=True)
    text = _CAMPAIGN.format(aircraft=aircraft, epistemic=epistemic, **settings)
    path, out = folder / "campaign.toml", folder / "out"
    path.write_text(text, encoding="utf-8")
    uqharness_command("campaign", "run", path, "--out", out, "--workers", 1)
    groups = pd.read_parquet(out / "cases.parquet").groupby("epistemic_id", sort=True)
    return [Sample(str(name), np.sort(part[METRIC].dropna().to_numpy())) for name, part in groups]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return means over seeds, as markdown."""
    lines = []
    for case in CALM:
        seeds = [row for row in rows if row["case"] == case]
        for way in WAYS if seeds else ():
            low, high = np.mean([row[way]["median"] for row in seeds], axis=0)
            inside = sum(row[way]["flown"] != "outside" for row in seeds)
            line = {"case": case, "bounds": way, "seeds": str(len(seeds))}
            line["area [m]"] = f"{np.mean([row[way]['area'] for row in seeds]):.3g}"
            line["median, best to worst [m]"] = f"{low:.2f} to {high:.2f}"
            line["flown aircraft's [m]"] = f"{np.mean([row['flown_median'] for row in seeds]):.2f}"
            lines.append(line | {"it is inside": f"{inside} of {len(seeds)}"})
    return markdown_table(lines)


def verdict(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """List failures: a p-box wider than MAX_AREA allows where the model itself flies; the
    aircraft's flights outside theirs."""
    new, old = WAYS
    failures = []
    for name, case in CALM.items():
        seeds = [row for row in rows if row["case"] == name]
        if not seeds:
            continue
        areas = [np.mean([row[way]["area"] for row in seeds]) for way in (new, old)]
        share = 100.0 * float(areas[0] / areas[1])
        if case.aircraft == MODEL and share > 100.0 * MAX_AREA:
            failures.append(f"{name}: the p-box has {share:.0f} % of the area as published")
        inside = float(np.mean([row[new]["flown"] != "outside" for row in seeds]))
        if inside < MIN_INSIDE:
            words = f"in {100 * inside:.0f} % of the seeds"
            failures.append(f"{name}: the flown aircraft lies inside its p-box {words}")
    return failures


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    parser = study_parser(__doc__, out="pbox/ and pbox.md", seeds=40)
    parser.add_argument("--flights", type=int, default=8, metavar="N", help="a corner (default 8)")
    parser.add_argument("--duration-s", type=float, default=180.0, metavar="T", help="scored (180)")
    parser.add_argument("--cases", nargs="+", default=list(CALM), choices=list(CALM))
    args = parser.parse_args(arguments)

    def run(name: str) -> dict[str, Any]:
        case, _, seed = name.rpartition("-")
        return run_seed(CALM[case], int(seed), args.flights, args.duration_s)

    names = [f"{c}-{seed:03d}" for seed in args.seeds for c in CALM if c in args.cases]
    rows = run_seeds(args.out / "pbox", names, run)
    failures = verdict(rows)
    text = table(rows) + failure_lines(failures, "P-boxes are as asked for.")
    write_text(args.out / "pbox.md", text)
    print(text)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
