"""What refinement does to the loiter's p-box: is |cross-track| surer with the missing effects in the model than without?

    python -m campaigns.model-form.refined --seeds 40 --out campaigns/model-form/results

The reference truth flies two train flights and a test flight in still air, with noise; the model is refined with them, and both
models fly the loiter in light turbulence, each within the bounds of its own flights. One small file a seed; the same command goes
on where it was.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError
from uqharness.files import scratch_folder, write_text
from uqharness.text_tables import markdown_table

from .flights import MODEL
from .reproduce import seed_range

METRICS = ("cross_track_median_m",)
LEAST_NARROWER = 36 / 40
_FLOWN = ("flight-ident", "flight-bounds", "flight-validation")


def run_seed(seed: int) -> dict[str, Any]:
    """Widths of the p-boxes [m] before and after, verdict and effects of one refinement."""
    with scratch_folder("model-form") as scratch:
        paths = []
        for number, script in enumerate(_FLOWN):
            paths.append(str(scratch.path / f"{script}.parquet"))
            said = [
                "fly",
                "espaaro_truth",
                "--script",
                script,
                "--noise",
                "--seed",
                str(100 * seed + number),
            ]
            _command([*said, "--out", paths[-1]])
        out = scratch.path / "refined"
        said = [
            "refine",
            MODEL,
            "--train",
            *paths[:2],
            "--test",
            paths[2],
            "--out",
            str(out),
            "--workers",
            "1",
            "--no-figures",
        ]
        _command(said)
        found = json.loads((out / "refinement.json").read_text(encoding="utf-8"))
    effects = [f"{e.get('coefficient') or e['subsystem']} {e['term']}" for e in found["effects"]]
    widths = {
        r["metric"]: (r["width_before"], r["width_after"])
        for r in found["gap"]["test"]["pbox"]["metrics"]
    }
    return {
        "seed": seed,
        "verdict": found["verdict"],
        "effects": effects,
        "widths": {m: widths[m] for m in METRICS},
    }


def _command(arguments: list[str]) -> None:
    from uqharness.cli.main import main as command

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = command(arguments)
    if code == 2:
        raise BadInputError(f"{arguments[0]}: {said.getvalue().strip()}")


def narrower(rows: Sequence[Mapping[str, Any]], metric: str) -> int:
    """In how many seeds the p-box is narrower after than before."""
    return sum(r["widths"][metric][1] < r["widths"][metric][0] for r in rows)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Means over seeds, as markdown."""
    out = []
    for metric in METRICS:
        before, after = (sum(r["widths"][metric][k] for r in rows) / len(rows) for k in (0, 1))
        out.append(
            {
                "metric": metric,
                "seeds": str(len(rows)),
                "width before [m]": f"{before:.3g}",
                "after [m]": f"{after:.3g}",
                "narrower in": f"{narrower(rows, metric)} of {len(rows)}",
            }
        )
    return markdown_table(out)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; the process's exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for refined/ and refined.md"
    )
    parser.add_argument(
        "--seeds",
        type=seed_range,
        default="40",
        metavar="N|A-B",
        help="how many from 1 on, or which (default 40)",
    )
    chosen = parser.parse_args(arguments)
    place = chosen.out / "refined"
    place.mkdir(parents=True, exist_ok=True)
    for seed in chosen.seeds:
        path = place / f"{seed:03d}.json"
        if not path.exists():
            write_text(path, json.dumps(run_seed(seed)) + "\n")
            print(f"seed {seed} done", file=sys.stderr, flush=True)
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(place.glob("*.json"))]
    share = narrower(rows, METRICS[0]) / len(rows)
    failed = share < LEAST_NARROWER
    text = table(rows) + (
        "\nToo few are narrower after than before.\n" if failed else "\nRefinement narrows it.\n"
    )
    write_text(chosen.out / "refined.md", text)
    print(text)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
