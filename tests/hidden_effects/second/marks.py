"""The marks of issue and page: which rows count, and whether every mark is reached."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tests.hidden_effects.second.verdict import NORMAL_95

LEAST, MOST = 0.90, 0.98
"""Coverage asked of 95 % intervals, rounded outward to whole cases."""
SAME_TABLE = 0.02
"""Largest relative difference of rms over noise between refine's table of the test flight and
`compare` of the model it wrote.
"""
CPU_S: Mapping[str, float] = {"calm": 15.0, "light": 60.0}
MEMORY_MB = 1024.0
WITHIN = 0.95
"""Share of cases within the limits of time and memory: a busy machine makes single ones slower."""
Row = Mapping[str, Any]
Line = tuple[bool, str]


def numbers(text: Any) -> list[float]:
    """Numbers of a cell of the table."""
    return [float(w) for w in str(text).split()]


def covered(inside: int, count: int) -> bool:
    """Whether a count lies within LEAST and MOST of all, rounded outward."""
    return math.floor(LEAST * count) <= inside <= math.ceil(MOST * count)


def marks(rows: Sequence[Row], whole: bool = True) -> tuple[bool, str]:
    """Whether every mark is reached, and the marks in words. whole: a draw of every case; a part is
    judged in proportion.
    """
    lines = [*_names(rows, whole), *_intervals(rows), *_rest(rows)]
    text = "\n".join(f"{'reached' if ok else 'MISSED '}  {words}" for ok, words in lines)
    commits = Counter(str(r["commit"]) for r in rows)
    if len(commits) > 1:
        # Whoever met a case first had not seen it, whatever was mended on the cases before it.
        text += (
            f"\nmet by {len(commits)} commits:"
            f" {', '.join(f'{n} by {c}' for c, n in commits.items())}"
        )
    weak = [bool(int(n)) for r in rows if r["kind"] == "weak" for n in str(r["named"]).split()]
    return (
        all(ok for ok, _ in lines),
        text + f"\nreported only: |t| 3 to 4 named {sum(weak)} of {len(weak)}",
    )


def _at_least(name: str, good: Sequence[bool], wanted: int, of: int, whole: bool) -> list[Line]:
    """A whole draw must have every case, and as many right as asked; a part is judged in
    proportion.
    """
    if not good and not whole:
        return []
    ok = (
        (len(good) >= of and sum(good) >= wanted)
        if whole
        else sum(good) >= math.floor(wanted / of * len(good))
    )
    return [(ok, f"{name}: {sum(good)} of {len(good)} (asked: {wanted} of {of})")]


def _flags(rows: Sequence[Row], kinds: Sequence[str]) -> list[bool]:
    return [bool(int(n)) for r in rows if r["kind"] in kinds for n in str(r["named"]).split()]


def _names(rows: Sequence[Row], whole: bool) -> list[Line]:
    clean = [int(r["effects"]) == 0 for r in rows if r["kind"] == "null"]
    cards = [bool(int(r["card"])) for r in rows if r["card"] not in ("", None)]
    fair = [bool(int(r["fair"])) for r in rows if r["fair"] not in ("", None)]
    effects, false = sum(int(r["effects"]) for r in rows), sum(int(r["spurious"]) for r in rows)
    return [
        *_at_least("clear effects named", _flags(rows, ("clear", "pair", "card")), 79, 80, whole),
        *_at_least("marginal effects named", _flags(rows, ("marginal",)), 48, 60, whole),
        *_at_least("nulls without an effect", clean, 49, 50, whole),
        *_at_least("wrong cards named as such", cards, 37, 40, whole),
        *_at_least(
            "off the catalogue: unexplained, or fair proxies at the floor", fair, 11, 12, whole
        ),
        (false <= 0.02 * effects, f"false effects: {false} of {effects} named (at most 2 %)"),
    ]


def _intervals(rows: Sequence[Row]) -> list[Line]:
    out = []
    for air, words in (("calm", "calm air"), ("light", "turbulence")):
        here = [r for r in rows if r["air"] == air]
        inside = [bool(v) for r in here for v in numbers(r["inside"])]
        z = [v for r in here for v in numbers(r["z"])]
        own = [v for r in here for v in numbers(r["parameters"])]
        held = sum(abs(v) < NORMAL_95 for v in own)
        if not here:
            continue
        told = f"{sum(inside)} of {len(inside)} hold the truth; z {_spread(z)}"
        out.append(
            (
                bool(inside) and covered(sum(inside), len(inside)),
                f"intervals of effects, {words}: {told}",
            )
        )
        told = f"{held} of {len(own)} hold the truth; z {_spread(own)}"
        out.append(
            (bool(own) and covered(held, len(own)), f"intervals of parameters, {words}: {told}")
        )
    return out


def _spread(z: Sequence[float]) -> str:
    if not z:
        return "none"
    return (
        f"rms {math.sqrt(sum(v * v for v in z) / len(z)):.2f}, largest {max(abs(v) for v in z):.1f}"
    )


def _rest(rows: Sequence[Row]) -> list[Line]:
    left = sum(int(r["left_out"]) for r in rows)
    placed = [bool(int(r["placed"])) for r in rows if r["placed"] not in ("", None)]
    apart = [
        float(r["apart"])
        for r in rows
        if r["apart"] not in ("", None) and math.isfinite(float(r["apart"]))
    ]
    failed = [r["case"] for r in rows if r["faults"]]
    out = [
        (left == 0, f"causes and candidates above |t| 10 that an answer leaves out: {left}"),
        (
            all(placed),
            (
                f"unexplained with channel, interval, band and three candidates: {sum(placed)} of"
                f" {len(placed)}"
            ),
        ),
        (
            all(a <= SAME_TABLE for a in apart),
            (
                f"refine's table and compare: {sum(a <= SAME_TABLE for a in apart)} of {len(apart)}"
                f" within {SAME_TABLE:.0%}"
            ),
        ),
        (not failed, f"files that keep their contract: {len(rows) - len(failed)} of {len(rows)}"),
    ]
    for air, most in CPU_S.items():
        here = [r for r in rows if r["air"] == air]
        out += _limit(f"CPU seconds, {air}", here, lambda r: float(r["cpu_s"]), most)
    return out + _limit("peak memory, MB", rows, lambda r: float(r["peak_MB"]), MEMORY_MB)


def _limit(name: str, rows: Sequence[Row], of: Callable[[Row], float], most: float) -> list[Line]:
    values = sorted(map(of, rows))
    if not values:
        return []
    share = sum(v <= most for v in values) / len(values)
    told = f"{name}: median {values[len(values) // 2]:.0f}, largest {values[-1]:.0f}"
    return [(share >= WITHIN, f"{told}, {share:.0%} within {most:.0f} ({WITHIN:.0%} asked)")]
