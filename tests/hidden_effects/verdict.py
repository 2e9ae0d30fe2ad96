"""What a refinement.json says of a question, against the truth.

Reads dictionaries; runs nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.hidden_effects.answers import (
    LARGEST_SET,
    accepted,
    at_floor,
    canonical,
    contract_faults,
    stands_for,
    test_gap,
)
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.questions import SAME, Question

STRONG_T = 10.0
"""|t| above which nothing may be left out of `remaining.where`."""


@dataclass(frozen=True)
class Verdict:
    """One answer judged.

    named     of each hidden effect: whether it stands in a set of at most three       card: the
    same of the wrong card (None: none)
    effects   how many effects were named       spurious: of them, those that stand for nothing
    hidden z, inside (estimate - truth) / std of what was named by its own name, and whether
    interval_95 holds the truth parameters  (estimate - truth) / std of the aircraft's own
    parameters, where the answer vouches for them left_out  hidden causes and candidates above |t|
    10 that the answer neither names nor lists
    placed    of `unexplained`: whether channel, stretch, band and three candidates are told, or the
    reason why not
    fair      off the catalogue: `unexplained`, or effects of the right coefficient that bring the
    test gap to the floor"""

    verdict: str
    answer: tuple[str, ...]
    named: tuple[bool, ...]
    card: bool | None
    effects: int
    spurious: int
    z: tuple[float, ...]
    inside: tuple[bool, ...]
    parameters: tuple[float, ...]
    left_out: int
    placed: bool | None
    fair: bool | None
    gap: float
    faults: tuple[str, ...]


def judge(request: Question, result: Mapping[str, Any], exit_code: int) -> Verdict:
    """The verdict on an answer that ended with an exit code."""
    effects: Sequence[Mapping[str, Any]] = result.get("effects") or []
    late_s = (result.get("timing") or {}).get("controls_late_s") or 0.0
    sets = [stands_for(e) for e in effects]
    verdict = str(result.get("verdict"))
    off = request.kind == "off-form"
    ways = [_ways(key) for key in request.entries] if not off else []
    card = request.wrong.accepted if request.wrong else set()
    allowed = set().union(card, *ways)
    if off:
        spurious = sum(
            not any(k.startswith(f"{request.effects[0].subject}:") for k in s) for s in sets
        )
    else:
        spurious = sum(not s & allowed for s in sets)
    moved = request.wrong is not None and request.wrong.key == "record:delay"
    spurious += bool(late_s) and not moved
    listed = tuple(_names_of(sets, way) for way in ways)
    has_card = (
        None
        if request.wrong is None
        else _names_of(sets, card) or (moved and late_s * (request.wrong.value or 0.0) > 0.0)
    )
    pairs = [] if off else _estimates(request, effects)
    vouched = verdict in ("effects-found", "no-missing-effect") and not off
    return Verdict(
        verdict,
        tuple(" | ".join(sorted(s)) for s in sets) + (("record:delay",) if late_s else ()),
        listed,
        has_card,
        len(sets) + bool(late_s),
        spurious,
        tuple(z for z, _ in pairs),
        tuple(constant for _, constant in pairs if constant is not None),
        _parameters(request, result) if vouched else (),
        left_out(request, result, listed, has_card),
        _placed(result) if verdict == "unexplained" else None,
        (spurious == 0 and (verdict == "unexplained" or (bool(effects) and at_floor(result))))
        if off
        else None,
        test_gap(result),
        tuple(contract_faults(result, exit_code)),
    )


def _ways(key: str) -> set[str]:
    return accepted(key) if key in ENTRIES else {key}


def _names_of(sets: Sequence[set[str]], way: set[str]) -> bool:
    return any(s & way and len(s) <= LARGEST_SET for s in sets)


def _estimates(
    request: Question, effects: Sequence[Mapping[str, Any]]
) -> list[tuple[float, bool | None]]:
    """(z, inside) of what was named by its own name, or one whose number is the same, and has a
    number as truth.
    """
    truths = {e.key: e.size for e in request.effects if not e.form}
    if request.wrong is not None and request.wrong.value is not None:
        truths[request.wrong.key] = request.wrong.value
    truths |= {SAME[k][0]: SAME[k][1] * v for k, v in truths.items() if k in SAME}
    out: list[tuple[float, bool | None]] = []
    for e in effects:
        truth = truths.get(canonical(e))
        if truth is None:
            continue
        value, std = e.get("value"), e.get("std")
        valid = isinstance(value, (int, float)) and isinstance(std, (int, float)) and std > 0.0
        low, high = (e.get("evidence") or {}).get("interval_95") or (math.nan, math.nan)
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        out.append(((value - truth) / std if valid else math.inf, bool(low <= truth <= high)))
    return out


def _parameters(request: Question, result: Mapping[str, Any]) -> tuple[float, ...]:
    coefficients = request.airframe.coefficients
    out = []
    for name, row in (result.get("parameters") or {}).items():
        truth = coefficients.get(name.removeprefix("aero/"))
        value, std = row.get("value"), row.get("std")
        if truth is None or not isinstance(std, (int, float)) or not std > 0.0:
            continue
        out.append((value - truth) / std)
    return tuple(out)


def left_out(
    request: Question, result: Mapping[str, Any], selected: Sequence[bool], card: bool | None
) -> int:
    """Hidden causes above |t| 10 of which an answer says nothing, and candidates above it that its
    file shows but does not list.
    """
    remaining = result.get("remaining") or {}
    where = remaining.get("where") or []
    listed = {canonical(w) for w in where} | {
        k for e in result.get("effects") or [] for k in stands_for(e)
    }
    listed |= {
        canonical(a) for e in result.get("effects") or [] for a in e.get("alternatives") or []
    }
    missed = [not n for n in selected] + ([not card] if card is not None else [])
    hidden = (
        sum(m and s > STRONG_T for m, s in zip(missed, request.t, strict=False)) if not where else 0
    )
    visible = [
        (canonical(c), c.get("t")) for c in (remaining.get("place") or {}).get("candidates") or []
    ]
    visible += [
        (canonical(c), (c.get("evidence") or {}).get("t")) for c in result.get("withdrawn") or []
    ]
    refused = result.get("best_refused") or {}
    if refused:
        visible.append((str(refused.get("effect", "?")).replace("/", ":", 1), refused.get("t")))
    return hidden + len(
        {k for k, size in visible if size is not None and abs(size) > STRONG_T and k not in listed}
    )


def _placed(result: Mapping[str, Any]) -> bool:
    """Whether `remaining.place` has channel, interval, band and three candidates with what each
    leaves; or channel and a reason.
    """
    place = (result.get("remaining") or {}).get("place") or {}
    candidates = place.get("candidates") or []
    reports = len(candidates) == 3 and all(c.get("leaves") is not None for c in candidates)
    interval = all(place.get(k) is not None for k in ("from_s", "to_s", "from_Hz", "to_Hz"))
    return bool(place.get("channel")) and reports and (interval or bool(place.get("reason")))
