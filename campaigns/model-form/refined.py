"""What refinement does to the loiter's p-box: is |cross-track| surer with the missing effects in
the model than without?

    python -m campaigns.model-form.refined --seeds 40 --out campaigns/model-form/results

The reference truth flies two train flights and a test flight in still air, with noise; the model is
refined with them, and both models fly the loiter in light turbulence, each within the bounds of its
own flights. One small file a seed; the same command resumes an interrupted run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from campaigns.library.study import run_seeds, study_parser, uqharness_command
from uqharness.files import scratch_folder, write_text
from uqharness.text_tables import markdown_table

from .flights import MODEL, TRUTH

METRIC = "cross_track_median_m"
MIN_NARROWER = 36 / 40
SCRIPTS = ("flight-ident", "flight-bounds", "flight-validation")


def run_seed(seed: int) -> dict[str, Any]:
    """Return the widths of the p-boxes [m] before and after, verdict and effects of one
    refinement."""
    with scratch_folder("model-form") as scratch:
        paths, out = (
            [scratch.path / f"{script}.parquet" for script in SCRIPTS],
            scratch.path / "refined",
        )
        for number, (script, path) in enumerate(zip(SCRIPTS, paths, strict=True)):
            noise = ("--noise", "--seed", 100 * seed + number)
            uqharness_command("fly", TRUTH, "--script", script, *noise, "--out", path)
        data = ("--train", *paths[:2], "--test", paths[2])
        options = ("--out", out, "--workers", 1, "--no-figures")
        uqharness_command("refine", MODEL, *data, *options)
        result = json.loads((out / "refinement.json").read_text(encoding="utf-8"))
    effects = [f"{e.get('coefficient') or e['subsystem']} {e['term']}" for e in result["effects"]]
    rows = {row["metric"]: row for row in result["gap"]["test"]["pbox"]["metrics"]}
    widths = {METRIC: (rows[METRIC]["width_before"], rows[METRIC]["width_after"])}
    return {"seed": seed, "verdict": result["verdict"], "effects": effects, "widths": widths}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and return the process's exit code."""
    args = study_parser(__doc__, out="refined/ and refined.md", seeds=40).parse_args(arguments)
    names = [f"{seed:03d}" for seed in args.seeds]
    rows = run_seeds(args.out / "refined", names, lambda name: run_seed(int(name)))
    text, failed = table(rows)
    write_text(args.out / "refined.md", text)
    print(text)
    return 1 if failed else 0


def table(rows: Sequence[Mapping[str, Any]]) -> tuple[str, bool]:
    """Return means over seeds as markdown, and whether too few p-boxes are narrower after than
    before."""
    widths = [row["widths"][METRIC] for row in rows]
    narrower = sum(after < before for before, after in widths)
    before, after = (sum(pair[k] for pair in widths) / len(rows) for k in (0, 1))
    row = {"metric": METRIC, "seeds": str(len(rows)), "width before [m]": f"{before:.3g}"}
    row |= {"after [m]": f"{after:.3g}", "narrower in": f"{narrower} of {len(rows)}"}
    failed = narrower / len(rows) < MIN_NARROWER
    words = "Too few are narrower after than before." if failed else "Refinement narrows it."
    return f"{markdown_table([row])}\n{words}\n", failed


if __name__ == "__main__":
    raise SystemExit(main())
