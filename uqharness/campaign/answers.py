"""How far a campaign's question is answered, cell by cell, from what its folder holds: while it flies, and after."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sysid.units import counted, percent
from uqharness.campaign.folder.tables import is_sealed, read_checked, read_decisions
from uqharness.campaign.rounds import ALL_CORNERS
from uqharness.campaign.statements import STATEMENTS
from uqharness.text_tables import csv_rows

_ORDER = ("yes", "no", "open", "flying")
_WORDS = {"open": "inconclusive"}


@dataclass(frozen=True)
class Answer:
    """Answer of one condition to "at most ``acceptable_per_h`` excursions beyond ``radius_m`` at every corner?"."""

    condition: str
    radius_m: float
    acceptable_per_h: float
    answer: str
    reason: str
    hours: float
    flight_share_upper: float | None = None
    """Upper limit of the share of flights with an excursion at the worst corner, where the number of flights was fixed."""


def read_answers(folder: Path, manifest: Mapping[str, Any]) -> list[Answer]:
    """From decisions.csv, which a run that decides keeps up to date; else from the statements of a complete campaign; else none.

    Raises BadInputError where the table is not as it was written.
    """
    rows = [row for row in read_decisions(folder, manifest) if row["epistemic_id"] == ALL_CORNERS]
    if not rows and (
        (folder / STATEMENTS).exists() or (is_sealed(manifest) and "shard" not in manifest)
    ):
        content = read_checked(folder, manifest, STATEMENTS)
        texts = ("condition", "distance", "answer")
        every = csv_rows(
            content, folder / STATEMENTS, ("radius_m", "acceptable_per_h", "hours"), texts
        )
        smallest = min((float(row["radius_m"]) for row in every), default=0.0)
        rows = [
            row
            for row in every
            if row["distance"] == "horizontal" and float(row["radius_m"]) == smallest
        ]
    return [_answer(row) for row in rows]


def _answer(row: dict[str, str]) -> Answer:
    return Answer(
        row["condition"],
        float(row["radius_m"]),
        float(row["acceptable_per_h"]),
        row["answer"],
        row.get("reason", ""),
        float(row["hours"]),
        float(row["flight_share_upper"]) if row.get("flight_share_upper") else None,
    )


def as_json(answers: Sequence[Answer]) -> list[dict[str, object]]:
    """The same as plain types."""
    return [asdict(answer) for answer in answers]


def lines(answers: Sequence[Answer]) -> list[str]:
    """A summary, then one line per condition."""
    if not answers:
        return []
    first, count = answers[0], Counter(answer.answer for answer in answers)
    summary = ", ".join(f"{count[word]} {_WORDS.get(word, word)}" for word in _ORDER if count[word])
    found = [
        f"at most {counted(first.acceptable_per_h, 'excursion')} per hour beyond {first.radius_m:g} m? {summary}"
    ]
    for answer in answers:
        reason = f" ({answer.reason})" if answer.reason else ""
        share = answer.flight_share_upper
        said = (
            ""
            if share is None
            else f", at most {percent(share)} of flights with an excursion at the worst corner (95 % limit)"
        )
        word = _WORDS.get(answer.answer, answer.answer)
        found.append(f"  {answer.condition}: {word}{reason}, {answer.hours:.4g} flight h{said}")
    return found
