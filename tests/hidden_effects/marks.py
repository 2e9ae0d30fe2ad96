"""The table of the battery and the marks it has to reach."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tests.hidden_effects.cases import Case

COLUMNS = (
    "case",
    "kind",
    "air",
    "truth",
    "t",
    "size",
    "right",
    "together",
    "verdict",
    "answer",
    "spurious",
    "z",
    "gap",
    "oracle",
    "seconds",
    "exit",
    "faults",
)
NOT_FLOWN = "not flown"
CLEAR_T, MARGINAL_T = 10.0, 3.0
Row = Mapping[str, Any]


def row(case: Case, answer: Mapping[str, Any], t: Mapping[str, float]) -> dict[str, Any]:
    """One line of the table; the truth stands in it."""
    score = answer["score"]
    return {
        "case": case.id,
        "kind": case.kind,
        "air": case.air,
        "truth": " + ".join(case.entries) or case.truth,
        "t": min(t.values()) if t else math.nan,
        "size": " + ".join(f"{e.size:.4g}" for e in case.effects),
        "right": int(score["right"]),
        "together": "" if score["together"] is None else int(score["together"]),
        "verdict": score["verdict"],
        "answer": "; ".join(score["answer"]),
        "spurious": score["spurious"],
        "z": " ".join(f"{z:.2f}" for z in score["z"]),
        "gap": round(score["gap"], 4),
        "oracle": round(answer.get("oracle", math.nan), 4),
        "seconds": round(answer["seconds"], 1),
        "exit": answer["exit"],
        "faults": "; ".join(
            [*score["faults"], answer["error"]] if answer["error"] else score["faults"]
        ),
    }


def strength_of(r: Row) -> str:
    """clear | marginal | weak, by |t|; by what was aimed at where |t| is not known."""
    if r["kind"] not in ("clear", "marginal") or not math.isfinite(r["t"]):
        return str(r["kind"])
    return "clear" if r["t"] > CLEAR_T else "marginal" if r["t"] >= MARGINAL_T else "weak"


def _share(rows: Sequence[Row], good: Callable[[Row], bool]) -> tuple[int, int]:
    return sum(good(r) for r in rows), len(rows)


def marks(rows: Sequence[Row]) -> tuple[bool, str]:
    """Whether every mark is reached that the rows let one judge, and the marks in words."""
    lines, reached = [], True

    def mark(name: str, part: tuple[int, int], wanted: float, most: bool = False) -> None:
        nonlocal reached
        good, n = part
        if not n:
            return
        share = good / n
        ok = share <= wanted if most else share >= wanted
        reached &= ok
        asked = f"{'at most' if most else 'at least'} {100 * wanted:.0f} %"
        lines.append(
            f"{'reached' if ok else 'MISSED '}  {name}: {good} of {n} = {100 * share:.0f} %"
            f" ({asked})"
        )

    lost = [r for r in rows if r["verdict"] == NOT_FLOWN]
    rows = [r for r in rows if r["verdict"] != NOT_FLOWN]
    single = [r for r in rows if r["kind"] in ("clear", "marginal")]

    def pick(strength: str, air: str) -> list[Row]:
        return [r for r in single if strength_of(r) == strength and r["air"] == air]

    right = lambda r: bool(r["right"])  # noqa: E731
    mark("clear, calm: right name first", _share(pick("clear", "calm"), right), 0.95)
    mark("marginal, calm: right name first", _share(pick("marginal", "calm"), right), 0.50)
    mark("clear, light turbulence: right name first", _share(pick("clear", "light"), right), 0.85)
    mark("pairs: both effects", _share([r for r in rows if r["kind"] == "pair"], right), 0.80)
    mark(
        "off form: unexplained or a fair proxy",
        _share([r for r in rows if r["kind"] == "off-form"], right),
        0.80,
    )
    hidden = [r for r in rows if r["kind"] != "null"]
    mark(
        "cases with a spurious effect", _share(hidden, lambda r: r["spurious"] > 0), 0.05, most=True
    )
    nulls = [r for r in rows if r["kind"] == "null"]
    mark("nulls that get an effect", _share(nulls, lambda r: r["spurious"] > 0), 0.05, most=True)
    mark("nulls called so", _share(nulls, right), 0.95)
    errors = [float(z) for r in rows if r["air"] == "calm" for z in str(r["z"]).split()]
    mark(
        "coefficient within two of its standard deviations, calm",
        (sum(abs(z) <= 2.0 for z in errors), len(errors)),
        0.90,
    )
    judged = [
        r
        for r in hidden
        if math.isfinite(r["oracle"]) and math.isfinite(r["gap"]) and strength_of(r) == "clear"
    ]
    mark(
        "held-out gap within 10 % of the oracle's",
        _share(judged, lambda r: r["gap"] <= 1.1 * r["oracle"]),
        0.90,
    )
    mark(
        "same causes stand together",
        _share(
            [r for r in rows if r["together"] != "" and r["right"]], lambda r: bool(r["together"])
        ),
        0.95,
    )
    mark("files that keep their contract", _share(rows, lambda r: not r["faults"]), 1.0)
    if lost:
        lines.append(
            f"not asked, since their flights come to grief: {len(lost)}"
            f" ({', '.join(r['case'] for r in lost)})"
        )
    slow = sorted(r["seconds"] for r in rows)
    if slow:
        lines.append(f"seconds a case: median {slow[len(slow) // 2]:.0f}, largest {slow[-1]:.0f}")
    return reached, "\n".join(lines)
