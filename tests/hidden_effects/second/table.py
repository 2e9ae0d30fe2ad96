"""The table of what was met: a line a case and meeting, with the commit of the code; first-met
lines apart from later ones.
"""

from __future__ import annotations

import csv
import hashlib
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.hidden_effects.airframes import ROOT
from tests.hidden_effects.second.drawn import Question
from tests.hidden_effects.second.verdict import Verdict
from tests.hidden_effects.second.wrongs import names

COLUMNS = (
    "draw",
    "number",
    "met",
    "commit",
    "generator",
    "case",
    "kind",
    "air",
    "aircraft",
    "truth",
    "size",
    "t",
    "named",
    "wrong",
    "card",
    "verdict",
    "answer",
    "effects",
    "spurious",
    "z",
    "inside",
    "parameters",
    "left_out",
    "placed",
    "fair",
    "apart",
    "gap",
    "cpu_s",
    "peak_MB",
    "exit",
    "faults",
)
PATH = Path(__file__).with_name("met.csv")
"""Lines of the three draws; those of the development draw stand in the folder of its run."""
FIRST, LATER = "first", "later"
_CODE = ("sysid", "uqharness", "aircraft", "scripts")
_MAKES = (
    "airframes",
    "answers",
    "cases",
    "catalogue",
    "effects",
    "equations",
    "expressions",
    "flights",
    "gusts",
    "manoeuvres",
    "motion",
    "strength",
)
_OWN = ("drawn", "folders", "verdict", "weighing", "wrongs")
_GENERATOR = ("tests/hidden_effects", "tests/helpers/sixdof.py")


def code_of(project: Path = ROOT) -> tuple[str, bool]:
    """Commit of the examined code, and whether its folders or the generator differ from it."""
    head = _git(project, "rev-parse", "--short=12", "HEAD").strip()
    changed = _git(
        project, "status", "--porcelain", "--untracked-files=normal", "--", *_CODE, *_GENERATOR
    )
    lines = [line for line in changed.splitlines() if not line.endswith(PATH.name)]
    return head, bool(lines)


def _git(project: Path, *words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=project, capture_output=True, text=True, check=True
    ).stdout


def generator_digest() -> str:
    """Ten digits of the SHA-256 of everything that makes flights and judges answers, marks and
    table apart.
    """
    own = Path(__file__).parent
    files = [own.parent / f"{name}.py" for name in _MAKES] + [own / f"{name}.py" for name in _OWN]
    files += [own.parent / "sizes.csv", ROOT / "tests/helpers/sixdof.py"]
    return hashlib.sha256(b"".join(p.name.encode() + p.read_bytes() for p in files)).hexdigest()[
        :10
    ]


def line_of(
    asked: Question, verdict: Verdict, cost: Mapping[str, Any], code: str, met: str
) -> dict[str, Any]:
    """One line of the table; the truth stands in it. cost: cpu_s, peak_MB, exit, error, apart."""
    spaced = lambda values, form: " ".join(format(v, form) for v in values)  # noqa: E731
    return {
        "draw": asked.draw,
        "number": asked.number,
        "met": met,
        "commit": code,
        "generator": generator_digest(),
        "case": asked.id,
        "kind": asked.kind,
        "air": asked.air,
        "aircraft": asked.aircraft,
        "truth": " + ".join(e.key for e in asked.effects),
        "size": spaced((e.size for e in asked.effects), ".4g"),
        "t": spaced(asked.t, ".1f"),
        "named": spaced(map(int, verdict.named), "d"),
        "wrong": "" if asked.wrong is None else names([asked.wrong]),
        "card": "" if verdict.card is None else int(verdict.card),
        "verdict": verdict.verdict,
        "answer": "; ".join(verdict.answer),
        "effects": verdict.effects,
        "spurious": verdict.spurious,
        "z": spaced(verdict.z, ".2f"),
        "inside": spaced(map(int, verdict.inside), "d"),
        "parameters": spaced(verdict.parameters, ".2f"),
        "left_out": verdict.left_out,
        "placed": "" if verdict.placed is None else int(verdict.placed),
        "fair": "" if verdict.fair is None else int(verdict.fair),
        "apart": "" if cost["apart"] is None else format(cost["apart"], ".4f"),
        "gap": format(verdict.gap, ".4f"),
        "cpu_s": format(cost["cpu_s"], ".1f"),
        "peak_MB": format(cost["peak_MB"], ".0f"),
        "exit": cost["exit"],
        "faults": "; ".join([*verdict.faults, *([cost["error"]] if cost["error"] else [])]),
    }


def read(path: Path) -> list[dict[str, str]]:
    """The table's lines; none where there is no file."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as handle:
        return list(csv.DictReader(handle))


def add(path: Path, line: Mapping[str, Any]) -> None:
    """Append a line; the file is begun with its header."""
    begun = path.is_file()
    with path.open("a", encoding="utf-8", newline="") as handle:
        out = csv.DictWriter(handle, COLUMNS, lineterminator="\n")
        if not begun:
            out.writeheader()
        out.writerow(line)


def of_draw(lines: Sequence[Mapping[str, str]], draw: int, met: str) -> list[Mapping[str, str]]:
    """A draw's lines: those first met, or of each case the last of the later ones."""
    own = [r for r in lines if int(r["draw"]) == draw and r["met"] == met]
    return list({r["number"]: r for r in own}.values())
