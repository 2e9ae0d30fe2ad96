"""What may be answered, and whether a refinement.json says it. Reads dictionaries; runs nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tests.helpers.sixdof import isa_density
from tests.hidden_effects.cases import Case
from tests.hidden_effects.catalogue import ENTRIES
from tests.hidden_effects.effects import COEFFICIENTS

# rms over noise up to which a channel is at the noise floor, as `uqharness compare` has it
FLOOR = 1.15
LARGEST_SET = 3
VERDICTS = {"effects-found": 0, "no-missing-effect": 0, "unexplained": 1}
_CHANNELS = (
    "V_mps",
    "alpha_rad",
    "beta_rad",
    "phi_rad",
    "theta_rad",
    "psi_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "ax_mps2",
    "ay_mps2",
    "az_mps2",
    "h_m",
)


@dataclass(frozen=True)
class Score:
    """One case judged.

    right     the case's own criterion: right name (or inseparable set with it) first; both of a
    pair; nothing for a null;
              off form: unexplained, or proxies alone that bring the test gap to the floor
    together  of a cause that is one and the same with another on the data: both stand in the answer
    (None: no such cause, or
              the other belongs to no body)
    spurious  effects that stand for nothing hidden
    z         (value - truth) / std of each coefficient term that was named as hidden
    gap       test gap after over the noise, root mean square over channels
    faults    where the file breaks its contract
    """

    right: bool
    verdict: str
    answer: tuple[str, ...]
    spurious: int
    together: bool | None = None
    z: tuple[float, ...] = ()
    gap: float = math.nan
    faults: tuple[str, ...] = field(default=())


def canonical(effect: Mapping[str, Any]) -> str:
    """ "subject:term" of an effect or alternative; a sensor's channel may be named without its
    unit.
    """
    subject = str(effect.get("coefficient") or effect.get("subsystem") or "?")
    if subject.startswith("sensor."):
        channel = subject.removeprefix("sensor.")
        full = [c for c in _CHANNELS if c == channel or c.split("_")[0] == channel]
        subject = f"sensor.{full[0]}" if full else subject
    return f"{subject}:{effect.get('term', '?')}"


def accepted(key: str) -> set[str]:
    """Keys any of which is the right name of a hidden effect: itself and what is the same on the
    data.
    """
    entry = ENTRIES[key]
    return {key, *entry.same}


def stands_for(effect: Mapping[str, Any]) -> set[str]:
    """The named effect and what the answer calls inseparable from it."""
    return {
        canonical(effect),
        *(canonical(a) for a in effect.get("alternatives", ()) if a.get("separable") is False),
    }


def judge(case: Case, found: Mapping[str, Any], exit_code: int) -> Score:
    """Score of a refinement.json against the case's truth."""
    faults = tuple(contract_faults(found, exit_code))
    effects: Sequence[Mapping[str, Any]] = found.get("effects") or []
    sets = [stands_for(e) for e in effects]
    verdict = str(found.get("verdict"))
    hidden = [ENTRIES[k] for k in case.entries]
    allowed = set().union(*(accepted(e.key) | set(e.proxies) for e in hidden)) if hidden else set()
    spurious = sum(1 for s in sets if not s & allowed)
    gap = test_gap(found)
    if case.kind == "null":
        right = verdict == "no-missing-effect" and not effects
    elif any(e.off_form for e in hidden):
        right = spurious == 0 and (verdict == "unexplained" or (bool(effects) and at_floor(found)))
    elif case.kind == "pair":
        right = all(any(s & accepted(e.key) for s in sets) for e in hidden)
    else:
        right = (
            bool(sets) and bool(sets[0] & accepted(hidden[0].key)) and len(sets[0]) <= LARGEST_SET
        )
    with_twin = [e for e in hidden if e.same and ENTRIES.get(e.same[0]) and _any_body(case, e.key)]
    together = None
    if with_twin:
        together = all(any({e.key, *e.same} <= s for s in sets) for e in with_twin)
    return Score(
        right,
        verdict,
        tuple(" | ".join(sorted(s)) for s in sets),
        spurious,
        together,
        _errors(case, effects),
        gap,
        faults,
    )


def _any_body(case: Case, key: str) -> bool:
    """Whether a body could have the product of inertia that does what pitching moment from roll
    rate squared does.

    Ixz p^2 = qbar S c Cm_p2 (p b / 2V)^2, so Ixz = rho S c b^2 Cm_p2 / 8; no body's squared is
    above Ixx Izz."""
    a = case.airframe
    hidden = [e.size for e in case.effects if e.key == key == "Cm:p_hat^2"]
    return all(
        abs(isa_density(0.0) * a.S * a.c * a.b**2 * size / 8.0) < math.sqrt(a.Ixx * a.Izz)
        for size in hidden
    )


def _errors(case: Case, effects: Sequence[Mapping[str, Any]]) -> tuple[float, ...]:
    """(value - truth) / std where a hidden coefficient term was named by its own name."""
    out = []
    for truth in case.effects:
        if truth.subject not in COEFFICIENTS or truth.form:
            continue
        for e in effects:
            if canonical(e) == truth.key:
                value, std = e.get("value"), e.get("std")
                good = (
                    isinstance(value, (int, float)) and isinstance(std, (int, float)) and std > 0.0
                )
                out.append((value - truth.size) / std if good else math.inf)
    return tuple(out)


def _judging(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """Rows of the test flights by which refine judged: of predictions where it made them, else of
    replays.
    """
    test = (found.get("gap") or {}).get("test") or {}
    return test.get("predictions") or test.get("channels") or {}


def test_gap(found: Mapping[str, Any]) -> float:
    """Root mean square over channels of rms_after / noise_rms on the test flights; NaN where the
    file does not say.
    """
    channels = _judging(found)
    ratios = [
        c["rms_after"] / c["noise_rms"]
        for c in channels.values()
        if _positive(c.get("rms_after")) and _positive(c.get("noise_rms"))
    ]
    return math.sqrt(sum(r * r for r in ratios) / len(ratios)) if ratios else math.nan


def at_floor(found: Mapping[str, Any]) -> bool:
    """Every channel of the test flights within FLOOR of its noise after refinement."""
    channels = _judging(found)
    return bool(channels) and all(
        _positive(c.get("rms_after"))
        and _positive(c.get("noise_rms"))
        and c["rms_after"] <= FLOOR * c["noise_rms"]
        for c in channels.values()
    )


def _positive(x: object) -> bool:
    return isinstance(x, (int, float)) and math.isfinite(x) and x > 0.0


def contract_faults(found: Mapping[str, Any], exit_code: int) -> list[str]:
    """What refinement.json's contract asks for and the file does not have."""
    out = [
        f"no {key}"
        for key in ("verdict", "disagreement", "effects", "remaining", "gap", "model")
        if key not in found
    ]
    verdict = found.get("verdict")
    if verdict not in VERDICTS:
        out.append(f"verdict {verdict!r}")
    elif VERDICTS[str(verdict)] != exit_code:
        out.append(f"exit code {exit_code} with {verdict}")
    effects = found.get("effects") or []
    if verdict == "effects-found" and not effects:
        out.append("effects-found without an effect")
    if verdict == "no-missing-effect" and effects:
        out.append("no-missing-effect with effects")
    for e in effects:
        out += [
            f"effect without {key}"
            for key in ("term", "name", "why", "value", "std", "evidence", "alternatives")
            if key not in e
        ]
        if ("coefficient" in e) == ("subsystem" in e):
            out.append("effect with both or neither of coefficient and subsystem")
        if len(stands_for(e)) > LARGEST_SET:
            out.append(f"{len(stands_for(e))} inseparable effects")
        if "coefficient" in e and e.get("property") != property_name(
            str(e["coefficient"]), str(e.get("term"))
        ):
            out.append(f"property {e.get('property')!r} for {canonical(e)}")
    for which in ("train", "test"):
        channels = ((found.get("gap") or {}).get(which) or {}).get("channels") or {}
        if not channels:
            out.append(f"gap.{which} without channels")
        for name, c in channels.items():
            out += [
                f"gap.{which}.{name} without {key}"
                for key in ("rms_before", "rms_after", "noise_rms")
                if key not in c
            ]
    return out


def property_name(coefficient: str, term: str) -> str:
    """The JSBSim property of a term: _hat dropped, ^n to n, * to _, abs(x) to absx."""
    text = (
        term.replace("_hat", "")
        .replace("^", "")
        .replace("*", "_")
        .replace("abs(", "abs")
        .replace(")", "")
    )
    return f"aero/{coefficient}_{text}"
