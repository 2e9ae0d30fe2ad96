"""``uqharness study``: from flights to a statement about performance, before and after refinement.

A study file lists flights and stages. Stages with unchanged inputs are skipped, so the same command
resumes.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path

from uqharness.cli.options import add_out, add_workers, describe
from uqharness.cli.progress import print_line
from uqharness.files import find_campaign
from uqharness.report import write_report
from uqharness.study import read_chain, run_chain

_EXAMPLE = """
  uqharness study campaigns/chain/chain.toml --out campaigns/chain/results
  uqharness study mine.toml --out results --workers 8

Stages: flights (simulated or logged), identification, model-form bounds, a campaign over their
corners, refinement, and the same again with the refined model. DIR/study.json lists the stages,
DIR/report.html shows the results (see docs/study.md). The same command resumes after an
interruption; a stage with unchanged inputs and options is not repeated."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``study``."""
    text = "Run a study file stage by stage, or resume it."
    describe(parser, _run, text, _EXAMPLE, no="done, and a stage that is named answered no")
    parser.add_argument(
        "study", type=Path, metavar="STUDY.toml", help="the study file: flights and stages"
    )
    add_out(parser)
    add_workers(parser)


def _run(args: argparse.Namespace) -> int:
    """Run or resume the study; return exit code 1 where a stage answered no."""
    spec = read_chain(find_campaign(args.study, "chain.toml"))
    command = shlex.join(["uqharness", "study", str(args.study), "--out", str(args.out)])
    try:
        document = run_chain(args.run_words, spec, args.out, args.workers, command, print_line)
    except KeyboardInterrupt:
        print(
            f"{args.out}: stopped; finished stages are kept, the same command resumes",
            file=sys.stderr,
        )
        raise
    report = write_report(args.out).path
    # Stages that ran but answered no, such as a comparison above the noise floor.
    no = [row["name"] for row in document["stages"] if row["exit"] == 1]
    if args.json:
        print(json.dumps(document | {"report": str(report)}))
    else:
        answer = document["answer"]
        print(f"{document['question']} {answer['answer']}")
        for part in ("why", "lacked", "next"):
            if answer[part]:
                print(answer[part])
        print(f"Report: {report}")
    return 1 if no else 0
