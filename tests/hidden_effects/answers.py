"""What may be answered, and whether a refinement.json says it. Reads dictionaries; runs nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tests.hidden_effects.catalogue import ENTRIES

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


def _judging(result: Mapping[str, Any]) -> Mapping[str, Any]:
    """Rows of the test flights by which refine judged: of predictions where it made them, else of
    replays.
    """
    test = (result.get("gap") or {}).get("test") or {}
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


def at_floor(result: Mapping[str, Any]) -> bool:
    """Every channel of the test flights within FLOOR of its noise after refinement."""
    channels = _judging(result)
    return bool(channels) and all(
        _positive(c.get("rms_after"))
        and _positive(c.get("noise_rms"))
        and c["rms_after"] <= FLOOR * c["noise_rms"]
        for c in channels.values()
    )


def _positive(x: object) -> bool:
    return isinstance(x, (int, float)) and math.isfinite(x) and x > 0.0


def contract_faults(result: Mapping[str, Any], exit_code: int) -> list[str]:
    """What refinement.json's contract asks for and the file does not have."""
    out = [
        f"no {key}"
        for key in ("verdict", "disagreement", "effects", "remaining", "gap", "model")
        if key not in result
    ]
    verdict = result.get("verdict")
    if verdict not in VERDICTS:
        out.append(f"verdict {verdict!r}")
    elif VERDICTS[str(verdict)] != exit_code:
        out.append(f"exit code {exit_code} with {verdict}")
    effects = result.get("effects") or []
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
    for index in ("train", "test"):
        channels = ((result.get("gap") or {}).get(index) or {}).get("channels") or {}
        if not channels:
            out.append(f"gap.{index} without channels")
        for name, c in channels.items():
            out += [
                f"gap.{index}.{name} without {key}"
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
