"""What the bounds do to a mission: the loiter's cross-track p-box from bounds by parts, and as published; is the truth inside?

    python -m campaigns.model-form.pbox --seeds 40 --out campaigns/model-form/results

Bounds are made from the study's own flight in still air and flown at all corners and 16 points between them, in light turbulence,
by the batch engine. The aircraft that flew for the bounds flies the same air beside them. One small file a seed and case; the same
command goes on where it was.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid.model_form.components import variation
from sysid.model_form.fit import FittedBounds, fit_bounds
from uqharness.errors import BadInputError
from uqharness.files import scratch_folder, write_text
from uqharness.simulator.mission import find_script
from uqharness.statistics.pbox import Sample, containment, pbox
from uqharness.study.answer import area
from uqharness.text_tables import markdown_table

from .flights import BOUNDS, CASES, MODEL, Case, model_pair, noisy_twin, quiet_flight
from .judge import PUBLISHED, form_of
from .reproduce import seed_range

WAYS = ("by parts", "as published")
METRIC = "cross_track_median_m"
FLOWN = tuple(c for c in CASES if c.turbulence == "none")
LEAST_INSIDE = 36 / 40
MOST_AREA = 0.2
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
    """Areas [m] of the cross-track p-boxes, their medians, and whether the flown aircraft's own flights lie inside."""
    made = _fits(case, seed)
    out: dict[str, Any] = {
        "case": case.name,
        "seed": seed,
        "flights": flights,
        "duration_s": duration_s,
    }
    with scratch_folder("model-form") as scratch:
        settings = {
            "seed": 20161201 + seed,
            "flights": flights,
            "duration_s": duration_s,
            "mission": find_script("loiter"),
        }
        truth = _flown(scratch.path / "truth", case.flown, 'method = "none"', settings)
        for way, fitted in made.items():
            folder = scratch.path / way.replace(" ", "-")
            folder.mkdir()
            form_of(fitted, 50.0).write(folder / "model-form.json")
            samples = _flown(
                folder, MODEL, 'method = "corners"\nbounds = "model-form.json"', settings
            )
            found = containment(truth, samples)
            out[way] = {
                "area": area(samples),
                "median": list(pbox(samples).quantile(0.5)),
                "flown": found.verdict,
            }
        out["flown_median"] = float(np.median(truth[0].values))
    return out


def _fits(case: Case, seed: int) -> dict[str, dict[str, FittedBounds]]:
    quiet = quiet_flight(case, BOUNDS, 10 * seed)
    with model_pair(quiet.measured) as pair:
        noisy = noisy_twin(quiet, pair, (seed, CASES.index(case), 0), (1.0,))
    residuals = noisy.knowing(noisy.sizes[1.0])
    published = fit_bounds(residuals, options=PUBLISHED)
    rates = {c: variation(residuals, c, f.bounds).rate for c, f in published.items()}
    rated = {
        c: replace(f, bounds=replace(f.bounds, walk_rate=rates[c])) for c, f in published.items()
    }
    return {WAYS[0]: fit_bounds(residuals), WAYS[1]: rated}


def _flown(
    folder: Path, aircraft: str, epistemic: str, settings: Mapping[str, Any]
) -> list[Sample]:
    from uqharness.cli.main import main as command

    folder.mkdir(exist_ok=True)
    text = _CAMPAIGN.format(aircraft=aircraft, epistemic=epistemic, **settings)
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = command(
            [
                "campaign",
                "run",
                str(folder / "campaign.toml"),
                "--out",
                str(folder / "out"),
                "--workers",
                "1",
            ]
        )
    if code == 2:
        raise BadInputError(f"{folder.name}: {said.getvalue().strip()}")
    cases = pd.read_parquet(folder / "out" / "cases.parquet")
    groups = cases.groupby("epistemic_id", sort=True)
    return [Sample(str(name), np.sort(part[METRIC].dropna().to_numpy())) for name, part in groups]


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Means over seeds, as markdown."""
    out = []
    for case in FLOWN:
        mine = [r for r in rows if r["case"] == case.name]
        for way in WAYS if mine else ():
            low, high = np.mean([r[way]["median"] for r in mine], axis=0)
            wide, flown = (
                np.mean([r[way]["area"] for r in mine]),
                np.mean([r["flown_median"] for r in mine]),
            )
            out.append(
                {
                    "case": case.name,
                    "bounds": way,
                    "seeds": str(len(mine)),
                    "area [m]": f"{wide:.3g}",
                    "median, best to worst [m]": f"{low:.2f} to {high:.2f}",
                    "flown aircraft's [m]": f"{flown:.2f}",
                    "it is inside": f"{sum(r[way]['flown'] != 'outside' for r in mine)} of {len(mine)}",
                }
            )
    return markdown_table(out)


def verdict(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What fails, in words: a p-box wider than MOST_AREA says where the model itself flies; flown aircraft outside theirs."""
    new, old = WAYS
    out = []
    for case in FLOWN:
        mine = [r for r in rows if r["case"] == case.name]
        if not mine:
            continue
        share = float(
            np.mean([r[new]["area"] for r in mine]) / np.mean([r[old]["area"] for r in mine])
        )
        if case.flown == MODEL and share > MOST_AREA:
            out.append(f"{case.name}: the p-box has {100 * share:.0f} % of the area as published")
        inside = float(np.mean([r[new]["flown"] != "outside" for r in mine]))
        if inside < LEAST_INSIDE:
            out.append(
                f"{case.name}: the flown aircraft lies inside its p-box in {100 * inside:.0f} % of the seeds"
            )
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for pbox/ and pbox.md")
    parser.add_argument(
        "--seeds",
        type=seed_range,
        default="40",
        metavar="N|A-B",
        help="how many from 1 on, or which (default 40)",
    )
    parser.add_argument("--flights", type=int, default=8, metavar="N", help="a corner (default 8)")
    parser.add_argument(
        "--duration-s", type=float, default=180.0, metavar="T", help="scored (default 180)"
    )
    parser.add_argument(
        "--cases", nargs="+", default=[c.name for c in FLOWN], choices=[c.name for c in FLOWN]
    )
    chosen = parser.parse_args(arguments)
    place = chosen.out / "pbox"
    place.mkdir(parents=True, exist_ok=True)
    for seed in chosen.seeds:
        for case in (c for c in FLOWN if c.name in chosen.cases):
            path = place / f"{case.name}-{seed:03d}.json"
            if not path.exists():
                write_text(
                    path, json.dumps(run_seed(case, seed, chosen.flights, chosen.duration_s)) + "\n"
                )
                print(f"{case.name}, seed {seed} done", file=sys.stderr, flush=True)
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(place.glob("*.json"))]
    failures = verdict(rows)
    text = (
        table(rows)
        + "\n"
        + ("\n".join(f"- fails: {f}" for f in failures) or "P-boxes are as asked for.")
        + "\n"
    )
    write_text(chosen.out / "pbox.md", text)
    print(text)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
