"""The chart of a refinement's candidates: every one that the page names, and the likeliest of the others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from uqharness.report.parts import Figure
from uqharness.report.svg import Scale, rows_chart

MOST_OTHERS = 8
"""Candidates in the chart that the page does not name."""
LEGEND = (("wide", "alone, beside the parameters"), ("thick", "the same of a chosen effect"))
_MARKS = {
    "chosen": "\N{BLACK CIRCLE}",
    "withdrawn": "\N{MULTIPLICATION X}",
    "alternative": "\N{ALMOST EQUAL TO}",
    "left": "?",
}


@dataclass(frozen=True)
class Named:
    """A candidate that the page names: as what (chosen, withdrawn, alternative, left), and its |t| there; None where unknown."""

    part: str
    t: float | None


def named_candidates(done: Mapping[str, Any]) -> dict[str, Named]:
    """Candidates that a refinement names, by coefficient or subsystem and term; one that is named twice as the first of `Named`.

    An alternative's |t| is that in the effect's place, the root of what it gains in twice the log likelihood.
    """
    rows: list[tuple[str, Mapping[str, Any], float | None]] = []
    for part, effects in (("chosen", done["effects"]), ("withdrawn", done.get("withdrawn", ()))):
        rows += [(part, e, e.get("evidence", {}).get("t")) for e in effects]
    for e in (*done["effects"], *done.get("withdrawn", ())):
        for a in e.get("alternatives", ()):
            gain = a.get("evidence", {}).get("twice_log_likelihood")
            rows.append(("alternative", a, None if gain is None else math.sqrt(max(gain, 0.0))))
    remaining = done["remaining"]
    rows += [("left", w, w["t"]) for w in remaining["where"] if w.get("term") and "t" in w]
    rows += [("left", c, c["t"]) for c in (remaining.get("place") or {}).get("candidates", ())]
    out: dict[str, Named] = {}
    for part, e, t in rows:
        if e.get("term"):
            out.setdefault(_short(e), Named(part, None if t is None else abs(t)))
    refused = done.get("best_refused")
    if refused:
        out.setdefault(
            _as_scored(refused["effect"]),
            Named("left", None if refused.get("t") is None else abs(refused["t"])),
        )
    return out


def _short(e: Mapping[str, Any]) -> str:
    return f"{e.get('coefficient') or e.get('subsystem') or ''} {e['term']}".strip()


def _as_scored(key: str) -> str:
    """An effect's key, as a refused candidate has it, as the scores name it."""
    return key.replace("/", " ", 1)


def candidate_figure(done: Mapping[str, Any], prefix: str = "") -> Figure | None:
    """|t| of the candidates; None where a refinement names and scores none."""
    board = done.get("candidates", {})
    alone = {r["effect"]: abs(r["t"]) for r in board.get("scores", ()) if r.get("t") is not None}
    named = named_candidates(done)
    others = [n for n in alone if n not in named][:MOST_OTHERS]
    sizes = {
        n: max(alone.get(n, 0.0), (named[n].t or 0.0) if n in named else 0.0)
        for n in (*named, *others)
    }
    if not sizes:
        return None
    order = sorted(sizes, key=lambda n: -sizes[n])
    limit = board.get("limit")
    label = "Candidate effects by |t| [-]: " + ", ".join(f"{n} {sizes[n]:.1f}" for n in order) + "."
    x = Scale("|t| of the score test [-]", 0.0, 1.08 * max(*sizes.values(), limit or 0.0, 1e-9))
    titles = [f"{n} {_MARKS[named[n].part]}" if n in named else n for n in order]
    chart = rows_chart(f"{prefix}candidates", label, x, titles)
    for k, n in enumerate(order):
        if n in alone:
            chart.across(
                0.0, alone[n], k, "thick" if n in named and named[n].part == "chosen" else "wide"
            )
        if n in named and named[n].t is not None:
            chart.marker(named[n].t or 0.0, float(k), "first", "disc")
    if limit is not None:
        chart.upright(limit, "limit", "reached by chance by the best of all")
    caption = (
        "What explains the disagreement of the train flights, |t| [-]: bars alone, discs beside the chosen effects (alternatives: "
        "in the effect's place). \N{BLACK CIRCLE} chosen, \N{ALMOST EQUAL TO} alternative, \N{MULTIPLICATION X} withdrawn, ? left."
    )
    return Figure(chart.name, chart.svg(), caption)
