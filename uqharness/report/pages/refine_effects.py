"""The effects of a refinement as a section of its page: what was found, on what evidence, and what it may be taken for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uqharness.refinement.showing import carried_by, test_says
from uqharness.report.parts import Block, Bullets, Figure, Figures, Section, Table, Words, shown
from uqharness.report.svg import Scale, rows_chart


def headline(e: Mapping[str, Any]) -> str:
    """Name, value and standard error of an effect."""
    return f"{capital(e['name'])}: {shown(e['value'], '.5g')} ± {shown(e['std'], '.2g')}{_unit(e)}"


def _unit(e: Mapping[str, Any]) -> str:
    return "" if e.get("unit") in (None, "", "1") else f" {e['unit']}"


def capital(text: str) -> str:
    """The text with a capital first letter; the rest as it is."""
    return text[:1].upper() + text[1:]


def effect_section(done: Mapping[str, Any], prefix: str = "") -> Section:
    """The effects: value, evidence, what else could be behind them; and who else was asked."""
    parts = []
    for e in done["effects"]:
        evidence = e.get("evidence", {})
        low, high = evidence.get("interval_95") or (None, None)
        rows = [
            ("Value", f"{shown(e['value'], '.5g')}{_unit(e)}"), ("Standard error", shown(e["std"], ".2g")),
            ("95 % interval", f"{shown(low, '.5g')} to {shown(high, '.5g')}"), ("|t|", shown(_abs(evidence.get("t")), ".1f")),
            ("Twice the log-likelihood gained", shown(evidence.get("twice_log_likelihood"), ".4g")),
            ("Gained on held-out manoeuvres", shown(evidence.get("confirmed_on_held_out_manoeuvres"), ".4g")),
            ("Held-out estimate differs by", f"{shown(evidence.get('held_out_estimate_differs_by_std'), '.2f')} standard errors"),
            ("Property", carried_by(e)),
        ]  # fmt: skip
        blocks: list[Block] = [
            Words(f"{capital(e['why']).rstrip('.')}."),
            Table(f"Evidence for {e['name']}.", ("Evidence", "Value"), tuple(rows)),
        ]
        if e.get("test"):
            said = test_says(e)
            blocks.insert(0, Words(f"{capital(said)}."))
        told = [
            f"Distinguished from {a['name']}."
            if a["separable"]
            else f"Confounded with {a['name']}. Would separate them: {a['would_separate']}."
            for a in e.get("alternatives", ())
        ]
        if told:
            blocks.append(Bullets(tuple(told)))
        parts.append(Section(headline(e), tuple(blocks)))
    first: list[Block] = [] if parts else [Words("None.")]
    refused = done.get("best_refused")
    if refused:
        t = shown(_abs(refused.get("t")), ".1f")
        first.append(Words(f"Best candidate that was refused: {refused['effect']} (|t| {t}): {refused['why']}."))
    figure = _candidates(done, prefix)
    if figure:
        first.append(Figures((figure,), file="candidates"))
    return Section("Effects", tuple(first), tuple(parts))


def _abs(value: float | None) -> float | None:
    return None if value is None else abs(value)


def _candidates(done: Mapping[str, Any], prefix: str) -> Figure | None:
    board = done.get("candidates", {})
    rows = [(r["effect"], abs(r["t"])) for r in board.get("scores", ()) if r.get("t") is not None][:14]
    if not rows:
        return None
    chosen = {f"{e.get('coefficient') or e.get('subsystem')} {e['term']}" for e in done["effects"]}
    label = "Candidate effects by |t| [-], each alone: " + ", ".join(f"{n} {t:.1f}" for n, t in rows[:5]) + "."
    limit = board.get("limit")
    x = Scale("|t| of the score test [-]", 0.0, 1.08 * max([t for _, t in rows] + [limit or 0.0]))
    chart = rows_chart(f"{prefix}candidates", label, x, [f"{name} ●" if name in chosen else name for name, _ in rows])
    for k, (name, t) in enumerate(rows):
        chart.across(0.0, t, k, "thick" if name in chosen else "wide")
    if limit is not None:
        chart.upright(limit, "limit", "reached by chance by the best of all")
    caption = "What explains the disagreement of the train flights, each alone: |t| [-]. Chosen ones are dark and carry a ●."
    return Figure(chart.name, chart.svg(), caption)
