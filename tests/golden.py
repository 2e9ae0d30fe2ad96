"""Results whose bytes must not change when code moves: make them with two versions of the code,
then compare.

    python -m tests.golden make DIR          a campaign, an identification, bounds, a refinement and
    a study, in some three minutes
    python -m tests.golden compare A B       exit code 1, and a line a file, where the two differ

Figures in the files depend on the processor's arithmetic, so both are made on one machine. Compared
are tables and documents; paths, versions, commands and times of day in them are left out. Pages and
pictures are not compared: their words may change."""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
KINDS = {".parquet", ".csv", ".json", ".xml", ".diff"}
# What a folder was made by and where, which its tables do not depend on.
LEFT_OUT = {"manifest.json", "study.json"}
# Of where and by what something was made, and how long it took.
ASIDE = frozenset(
    {
        "command",
        "commands",
        "version",
        "versions",
        "campaign_file",
        "path",
        "folder",
        "report",
        "figures",
        "digest",
        "tables",
        "seconds",
    }
    | {"elapsed_s", "time_s", "made_by", "hash", "key", "source", "model"}
    # An aircraft's identity, whose remarks name the command that wrote it.
    | {"sha256"}
    | {"simulations_per_s", "flight_s_per_s", "bare_flight_s_per_s"}
)
CAMPAIGN = """
[campaign]
aircraft = "espaaro"
mission = "{root}/scripts/loiter.xml"
seed = 1
[aleatory]
flights = 6
duration_s = 30
burn_in_s = 10
wind_mps = [0, 3]
turbulence = "moderate"
[epistemic]
method = "corners"
interior = 0
nominal = false
coefficients = ["CX", "CY", "Cn"]
bounds = {{ CX = 0.008, CY = 0.010, Cn = 0.0015 }}
"""
FLIGHTS = {
    "ident": ("flight-ident", 1),
    "bounds": ("flight-bounds", 2),
    "validation": ("flight-validation", 3),
}


def commands(out: Path) -> list[list[str]]:
    """What is run, in order."""
    flight = {name: str(out / f"{name}.parquet") for name in FLIGHTS}
    fly = [
        [
            "fly",
            "espaaro_truth",
            "--script",
            script,
            "--turbulence",
            "light",
            "--noise",
            "--seed",
            str(seed),
            "--out",
            flight[name],
        ]
        for name, (script, seed) in FLIGHTS.items()
    ]
    calm = [
        [*words[:4], *words[6:-1], words[-1].replace(".parquet", "-calm.parquet")] for words in fly
    ]
    ident, bounds, validation = (
        path.replace(".parquet", "-calm.parquet") for path in flight.values()
    )
    study = str(ROOT / "tests" / "golden_study.toml")
    return [
        *fly,
        *calm,
        ["campaign", "run", str(out / "campaign.toml"), "--out", str(out / "campaign")],
        ["sensitivity", str(out / "campaign")],
        ["identify", "espaaro", "--flight", ident, "--no-figures", "--out", str(out / "identify")],
        [
            "bounds",
            "espaaro",
            "--flight",
            flight["bounds"],
            "--no-figures",
            "--out",
            str(out / "bounds"),
        ],
        [
            "refine",
            "espaaro",
            "--train",
            ident,
            "--train",
            bounds,
            "--test",
            validation,
            "--out",
            str(out / "refine"),
            "--no-pbox",
        ],
        ["study", study, "--out", str(out / "study")],
    ]


def make(out: Path) -> int:
    """Run everything into ``out``, which must not exist."""
    out.mkdir(parents=True)
    (out / "campaign.toml").write_text(CAMPAIGN.format(root=ROOT))
    for words in commands(out):
        print("uqharness", *words, flush=True)
        done = subprocess.run(
            [sys.executable, "-m", "uqharness", *words],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            check=False,
        )
        if done.returncode not in (0, 1):
            print(f"ended with {done.returncode}")
            return 1
    return 0


def content(path: Path, root: Path) -> Any:
    """What of a file counts."""
    raw = path.read_bytes()
    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        return pq.read_table(path).replace_schema_metadata(None).to_pydict()
    text = (
        raw.decode("utf-8", errors="surrogateescape")
        .replace(str(root.resolve()), "DIR")
        .replace(str(root), "DIR")
    )
    if path.suffix == ".json":
        return leave_out(json.loads(text))
    # Remarks in an XML name the command and the flights.
    return (
        re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
        if path.suffix in (".xml", ".diff")
        else text
    )


def leave_out(value: Any) -> Any:
    """A document without what belongs to the place and time of its making."""
    if isinstance(value, dict):
        return {key: leave_out(item) for key, item in value.items() if key not in ASIDE}
    return [leave_out(item) for item in value] if isinstance(value, list) else value


def compared(folder: Path) -> list[str]:
    """Names of the files below a folder that are looked at."""
    result = (
        path for path in folder.rglob("*") if path.suffix in KINDS and path.name not in LEFT_OUT
    )
    return [path.relative_to(folder).as_posix() for path in result]


def compare(first: Path, second: Path) -> list[str]:
    """A line for each file that differs or is missing."""
    names = [set(compared(folder)) for folder in (first, second)]
    lines = [f"{name}: only in one" for name in sorted(names[0] ^ names[1])]
    for name in sorted(names[0] & names[1]):
        if repr(content(first / name, first)) != repr(content(second / name, second)):
            lines.append(f"{name}: differs")
    return [*lines, *([] if names[0] & names[1] else ["nothing to compare"])]


def main(argv: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("make").add_argument("out", type=Path)
    pair = verbs.add_parser("compare")
    pair.add_argument("first", type=Path)
    pair.add_argument("second", type=Path)
    chosen = parser.parse_args(argv)
    if chosen.verb == "make":
        return make(chosen.out)
    lines = compare(chosen.first, chosen.second)
    print("\n".join(lines) or "the same")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
