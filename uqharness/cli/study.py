"""``uqharness study``: from flights to a statement about performance, before and after refinement, in one command."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path

from uqharness.errors import BadInputError

_EXAMPLE = """examples:
  uqharness study campaigns/chain/chain.toml --out campaigns/chain/results
  uqharness study mine.toml --out results --workers 8

Flights (flown, or logs of your own), identification, model-form bounds, a campaign over their corners, refinement, and the
same again with the refined model; DIR/study.json says what was done, DIR/report.html shows it. See docs/study.md.
The same command goes on after any stop; a stage whose inputs and options are as they were is not run again.
Exit codes: 0 done, 1 done and some stage's answer is no (which, is said), 2 bad input, 130 interrupted."""


def register(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``study`` to a parser."""
    parser = commands.add_parser(
        "study",
        help="the whole chain: flights to p-boxes, before and after refinement",
        description="Run a study file stage by stage, or go on with it.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("study", type=Path, metavar="STUDY.toml", help="what to do with which flights")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the results, made if need be")
    parser.add_argument("--workers", type=int, metavar="N", help="processes of each stage (default: one per core)")
    parser.add_argument("--json", action="store_true", help="print study.json, and where the report is")
    parser.set_defaults(handler=_run)


def _run(args: argparse.Namespace) -> int:
    # Imported here: `uqharness --help` should not wait for the numerical libraries.
    from uqharness.project_files import find_campaign
    from uqharness.report.pages.index import write_report
    from uqharness.study.run import run_chain
    from uqharness.study.spec import read_chain

    if args.workers is not None and args.workers < 1:
        raise BadInputError(f"--workers {args.workers}: at least 1")
    spec = read_chain(find_campaign(args.study, "chain.toml"))
    command = shlex.join(["uqharness", "study", str(args.study), "--out", str(args.out)])
    try:
        document = run_chain(args.run_words, spec, args.out, args.workers, command, _say)
    except KeyboardInterrupt:
        print(f"{args.out}: stopped; what is done is kept, the same command goes on from here", file=sys.stderr)
        raise
    report = write_report(args.out)
    no = [row["name"] for row in document["stages"] if row["exit"] == 1]
    if args.json:
        print(json.dumps(document | {"report": str(report)}))
    else:
        print(f"{document['study']}: {document['question']}")
        for sentence in document["verdict"]:
            print(f"  {sentence['text']}")
        if no:
            print(f"  answered no: {', '.join(no)}; what they said is in {args.out / 'log'}")
        print(f"report: {report}")
    return 1 if no else 0


def _say(text: str) -> None:
    """A line per stage on a terminal, nothing in a pipe."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)
