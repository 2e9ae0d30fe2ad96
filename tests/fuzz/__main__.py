"""``python -m tests.fuzz``: the command line of the fuzzer.

Exit codes: 0 no findings, 1 findings, 2 bad arguments.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from tests.fuzz.formats import SOUND, all_formats
from tests.fuzz.harness import Counts, Outcome, Worker, by_number, by_time, run

_EXAMPLE = """examples:
  python -m tests.fuzz --seconds 60
  python -m tests.fuzz --inputs 1000 --seed 5000 --format log-ulg --format log-tlog
  python -m tests.fuzz --reproduce log-ulg 5017"""


def main(argv: list[str] | None = None) -> int:
    """Run the fuzzer or reproduce one input; the exit code."""
    formats = all_formats()
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz",
        description="Mutated inputs of every format, each with a judged outcome.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    amount = parser.add_mutually_exclusive_group()
    amount.add_argument(
        "--seconds", type=float, metavar="N", help="for so long, formats in turn (default 60)"
    )
    amount.add_argument("--inputs", type=int, metavar="N", help="so many of each format")
    parser.add_argument(
        "--seed", type=int, default=0, metavar="S", help="first seed of each format (default 0)"
    )
    parser.add_argument(
        "--format",
        action="append",
        choices=sorted(formats),
        metavar="F",
        help="this format alone (repeatable)",
    )
    parser.add_argument("--list", action="store_true", help="name the formats")
    parser.add_argument("--json", action="store_true", help="machine-readable output")
    parser.add_argument(
        "--reproduce",
        nargs=2,
        metavar=("FORMAT", "SEED"),
        help="write one input here and show its outcome",
    )
    args = parser.parse_args(argv)
    if args.list:
        print("\n".join(formats))
        return 0
    if args.reproduce:
        name, seed = args.reproduce
        if name not in formats or not seed.lstrip("-").isdigit() or int(seed) < SOUND:
            parser.error(
                f"--reproduce {name} {seed}: a format (see --list) and a seed from {SOUND} are"
                " needed"
            )
        return _reproduce(name, int(seed))
    if args.seed < 0:
        parser.error(f"--seed {args.seed}: must not be negative")
    names = args.format or list(formats)
    counts = {name: Counts() for name in names}
    if args.inputs is not None:
        wanted = by_number(names, args.seed, args.inputs)
    else:
        wanted = by_time(
            {n: formats[n].share for n in names}, counts, args.seed, args.seconds or 60.0
        )
    findings: list[Outcome] = []

    def tell(found: Outcome) -> None:
        findings.append(found)
        print(f"({found.name}, {found.seed}): {found.what}", file=sys.stderr, flush=True)

    run(wanted, counts, tell)
    if args.json:
        print(
            json.dumps(
                {
                    "formats": {n: asdict(c) for n, c in counts.items()},
                    "findings": [asdict(f) for f in findings],
                }
            )
        )
    else:
        print(table(counts))
    return 1 if findings else 0


def table(counts: dict[str, Counts]) -> str:
    """Counts per format as text."""
    head = (
        f"{'format':<22}{'inputs':>8}{'results':>9}{'refusals':>9}{'findings':>9}{'slowest s':>11}{'largest MB':>12}"
        "  seeds"
    )
    rows = [head]
    for name, c in counts.items():
        seeds = f"{c.seeds[0]}-{c.seeds[1]}" if c.seeds else "none"
        rows.append(
            f"{name:<22}{c.inputs:>8}{c.results:>9}{c.refusals:>9}{c.findings:>9}{c.slowest_s:>11.2f}{c.largest_MB:>12.0f}"
            f"  {seeds}"
        )
    sums = [
        sum(getattr(c, key) for c in counts.values())
        for key in ("inputs", "results", "refusals", "findings")
    ]
    most = [
        max((getattr(c, key) for c in counts.values()), default=0.0)
        for key in ("slowest_s", "largest_MB")
    ]
    rows.append(
        f"{'all':<22}{sums[0]:>8}{sums[1]:>9}{sums[2]:>9}{sums[3]:>9}{most[0]:>11.2f}{most[1]:>12.0f}"
    )
    return "\n".join(rows)


def _reproduce(name: str, seed: int) -> int:
    folder = Path(f"fuzz-{name}-{seed}")
    for file, content in all_formats()[name].make(seed).items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    with Worker() as worker:
        found = worker.attempt(name, seed)
    print(f"{folder}: written")
    print(f"{found.outcome} in {found.seconds:.2f} s, {found.megabytes:.0f} MB: {found.what}")
    return 1 if found.outcome == "finding" else 0


if __name__ == "__main__":
    sys.exit(main())
