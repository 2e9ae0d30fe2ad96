"""``python -m tests.fuzz``: the command line of the fuzzer.

Exit codes: 0 no findings, 1 findings, 2 bad arguments.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from tests.fuzz.formats import SOUND, Files, Format, all_formats
from tests.fuzz.harness import Counts, Outcome, Worker, by_number, by_time, run

_EXAMPLE = """examples:
  python -m tests.fuzz --seconds 60
  python -m tests.fuzz --inputs 1000 --seed 5000 --format log-ulg --format log-tlog
  python -m tests.fuzz --reproduce log-ulg 5017"""


def main(
    argv: list[str] | None = None,
    formats: dict[str, Format] | None = None,
    module: str = "tests.fuzz.worker",
) -> int:
    """Run the fuzzer or reproduce one input; the exit code. ``module`` serves ``formats``."""
    formats = formats or all_formats()
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
        return _reproduce(name, formats[name].make(int(seed)), int(seed), module)
    if args.seed < 0:
        parser.error(f"--seed {args.seed}: must not be negative")
    names = args.format or list(formats)
    counts = {name: Counts() for name in names}
    if args.inputs is not None:
        expected = by_number(names, args.seed, args.inputs)
    else:
        expected = by_time(
            {n: formats[n].share for n in names}, counts, args.seed, args.seconds or 60.0
        )
    findings: list[Outcome] = []

    def tell(result: Outcome) -> None:
        findings.append(result)
        print(f"({result.name}, {result.seed}): {result.what}", file=sys.stderr, flush=True)

    run(expected, counts, tell, module)
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
    columns = ("inputs", "results", "refusals", "findings", "slowest_s", "largest_MB", "seeds")
    rows = [(name, *(getattr(c, column) for column in columns)) for name, c in counts.items()]
    sums = [sum(getattr(c, column) for c in counts.values()) for column in columns[:4]]
    maximum = [max(getattr(c, column) for c in counts.values()) for column in columns[4:6]]
    rows.append(("all", *sums, *maximum, ""))
    lines = [("format", *columns), *rows]
    return "\n".join(
        "".join(f"{_cell(v):<{22 if k == 0 else 12}}" for k, v in enumerate(line)) for line in lines
    )


def _cell(value: object) -> str:
    if isinstance(value, list):
        return "-".join(map(str, value))
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _reproduce(name: str, files: Files, seed: int, module: str) -> int:
    folder = Path(f"fuzz-{name}-{seed}")
    for file, content in files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    with Worker(module) as worker:
        result = worker.attempt(name, seed)
    print(f"{folder}: written")
    print(f"{result.outcome} in {result.seconds:.2f} s, {result.megabytes:.0f} MB: {result.what}")
    return 1 if result.outcome == "finding" else 0


if __name__ == "__main__":
    sys.exit(main())
