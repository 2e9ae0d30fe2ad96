"""The effects of a refinement as a section of its page: value and error bar, change of the XML, what else it may be, evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from uqharness.report.pages.refine_candidates import LEGEND, candidate_figure
from uqharness.report.pages.refine_words import carried_by, test_says
from uqharness.report.parts import (
    Block,
    Bullets,
    Code,
    Figure,
    Figures,
    Section,
    Table,
    Words,
    shown,
)
from uqharness.report.svg import Scale, rows_chart


def headline(e: Mapping[str, Any]) -> str:
    """Name, value and standard error of an effect."""
    return f"{capital(e['name'])}: {shown(e['value'], '.5g')} ± {shown(e['std'], '.2g')}{_unit(e)}"


def _unit(e: Mapping[str, Any]) -> str:
    return "" if e.get("unit") in (None, "", "1") else f" {e['unit']}"


def capital(text: str) -> str:
    """The text with a capital first letter; the rest as it is."""
    return text[:1].upper() + text[1:]


def effect_section(done: Mapping[str, Any], diff: str = "", prefix: str = "") -> Section:
    """The effects: value with its error bar, what changed in the XML, alternatives, evidence; and who else was asked.

    diff: the text of model.diff
    """
    off = {s["property"]: s["off"] for s in done.get("switch", ())}
    parts = [
        Section(
            headline(e),
            (*_value(e, off, f"{prefix}effect{k}"), *_change(e, diff), *_others(e), *_evidence(e)),
        )
        for k, e in enumerate(done["effects"])
    ]
    first: list[Block] = [] if parts else [Words("None.")]
    refused = done.get("best_refused")
    if refused:
        t = shown(_abs(refused.get("t")), ".1f")
        first.append(
            Words(
                f"Best candidate that was refused: {refused['effect']} (|t| {t}): {refused['why']}."
            )
        )
    figure = candidate_figure(done, prefix)
    if figure:
        first.append(Figures((figure,), LEGEND, file="candidates"))
    return Section("Effects", tuple(first), tuple(parts))


def _value(e: Mapping[str, Any], off: Mapping[str, float], name: str) -> list[Block]:
    """What the hold-out flights say, and the 95 % interval beside the value without the effect."""
    out: list[Block] = [Words(f"{capital(test_says(e))}.")] if e.get("test") else []
    low, high = e.get("evidence", {}).get("interval_95") or (None, None)
    if low is None or high is None or e["value"] is None:
        return out
    without = float(off.get(e.get("property") or "", 0.0))
    ends = [float(v) for v in (low, high, without)]
    margin = 0.08 * (max(ends) - min(ends)) or 1.0
    label = f"{capital(e['name'])}: 95 % interval {shown(low, '.5g')} to {shown(high, '.5g')}{_unit(e)}, without it {without:g}."
    unit = e.get("unit") or "-"
    axis = f"value [{'-' if unit == '1' else unit}]"
    chart = rows_chart(
        name, label, Scale(axis, min(ends) - margin, max(ends) + margin), [e["term"]], 24
    )
    chart.upright(without, "zero", "without the effect")
    chart.across(low, high, 0.0, "first")
    chart.marker(e["value"], 0.0, "first", "disc")
    return [
        *out,
        Figures(
            (
                Figure(
                    chart.name,
                    chart.svg(),
                    "Value with its 95 % interval; the line is the model without it.",
                ),
            )
        ),
    ]


def _change(e: Mapping[str, Any], diff: str) -> list[Block]:
    """The lines of model.diff that name the effect or its property, with what stands around them."""
    text = lines_naming(diff, [w for w in (e.get("property"), e["name"]) if w])
    return [Code(f"Change of the XML for {e['name']}", text)] if text else []


def lines_naming(diff: str, words: Sequence[str], around: int = 2) -> str:
    """Changed lines of a unified difference in which one of the words stands, with ``around`` lines on either side."""
    lines = [line for line in diff.splitlines() if not line.startswith(("--- ", "+++ ", "@@"))]
    own = [k for k, line in enumerate(lines) if line[:1] in "+-" and any(w in line for w in words)]
    near = sorted(
        {k for c in own for k in range(max(c - around, 0), min(c + around + 1, len(lines)))}
    )
    out: list[str] = []
    for last, k in zip([-1, *near], near, strict=False):
        out += ["..."] * (last >= 0 and k > last + 1) + [lines[k]]
    return "\n".join(out)


def _others(e: Mapping[str, Any]) -> list[Block]:
    """What the effect is confounded with, and which alternatives the flights exclude."""
    told = [
        f"Distinguished from {a['name']}."
        if a["separable"]
        else f"Confounded with {a['name']}. Would separate them: {a['would_separate']}."
        for a in e.get("alternatives", ())
    ]
    return [Bullets(tuple(told))] if told else []


def _evidence(e: Mapping[str, Any]) -> list[Block]:
    evidence = e.get("evidence", {})
    low, high = evidence.get("interval_95") or (None, None)
    rows = [
        ("Value", f"{shown(e['value'], '.5g')}{_unit(e)}"),
        ("Standard error", shown(e["std"], ".2g")),
        ("95 % interval", f"{shown(low, '.5g')} to {shown(high, '.5g')}"),
        ("|t|", shown(_abs(evidence.get("t")), ".1f")),
        ("Twice the log-likelihood gained", shown(evidence.get("twice_log_likelihood"), ".4g")),
        (
            "Gained on held-out manoeuvres",
            shown(evidence.get("confirmed_on_held_out_manoeuvres"), ".4g"),
        ),
        (
            "Held-out estimate differs by",
            f"{shown(evidence.get('held_out_estimate_differs_by_std'), '.2f')} standard errors",
        ),
        ("Property", carried_by(e)),
    ]
    why = Words(f"{capital(e['why']).rstrip('.')}.")
    return [why, Table(f"Evidence for {e['name']}.", ("Evidence", "Value"), tuple(rows))]


def _abs(value: float | None) -> float | None:
    return None if value is None else abs(value)
