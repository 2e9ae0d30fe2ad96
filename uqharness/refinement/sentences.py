"""Sentences about effects: the evidence for each, the evidence against it, and separating
manoeuvres.
"""

from __future__ import annotations

from collections.abc import Sequence

from sysid.effects import Effect, SelectedEffect

_EXCITES = {
    "alpha": (
        "slow changes of angle of attack by speed (level flight from the slowest to the fastest)"
    ),
    "beta": "steady sideslips at several angles",
    "p_hat": "aileron doublets of two sizes and lengths",
    "q_hat": "elevator doublets of two lengths",
    "r_hat": "rudder doublets of two lengths",
    "alphadot_hat": (
        "elevator doublets and turns at constant angle of attack: alphadot without q and q without"
        " alphadot"
    ),
    "betadot_hat": "flat turns and rudder doublets: r without betadot",
    "de": "elevator steps at constant speed, by throttle",
    "da": "short aileron pulses: deflection before there is a roll rate",
    "dr": "short rudder pulses: deflection before there is a yaw rate",
    "dt": "throttle steps",
    "CT": "throttle doublets at constant speed and angle of attack",
    "V_rel": "the same manoeuvres at widely different speeds, thrust held",
    "h_over_b": "the same manoeuvres high and low",
}
_SUBSYSTEM = {
    "stall": "a slow approach to the stall, and a fast one",
    "propulsion": "throttle doublets at two speeds; a static thrust measurement",
    "mass": (
        "none in the air: a swing test on the ground measures Ixz, weighing the centre of gravity"
    ),
    "actuator": "the surface moved on the ground with its position logged",
    "sensor": "calibration of the sensor on the ground",
    "ground": "the same manoeuvre low and high",
    "record": "a tap on the aircraft logged by all sensors",
}


def reason_for(effect: Effect, choice: SelectedEffect) -> str:
    """Return a sentence with an effect's physics, regime and evidence."""
    sign = "positive" if choice.value > 0 else "negative"
    usual = f"; usual: {effect.sign}" if effect.sign else ""
    where = f"; visible in {effect.regime}" if effect.regime else ""
    source = f" ({effect.reference})" if effect.reference else ""
    return (
        f"{effect.physics}{where}{source}. Estimate {choice.value:.4g} ± {choice.std:.2g}"
        f" ({sign}{usual}), |t| {abs(choice.t):.1f} with standard errors corrected for coloured"
        " residuals"
    )


def separating_manoeuvre(one: Effect, other: Effect) -> str:
    """Return the manoeuvre that would separate two effects that these flights do not."""
    for effect in (one, other):
        part = (effect.subsystem or "").partition(".")[0]
        if part == "mass" and effect.term == "Ixz":
            return (
                "measure Ixz on the ground (swing test); in flight a wrong Ixz acts like a pitching"
                " moment due to roll rate squared and, with opposite sign, to yaw rate squared:"
                " rudder doublets separate them only if the aircraft has no moment due to yaw rate"
                " squared"
            )
        if part in _SUBSYSTEM:
            return _SUBSYSTEM[part]
    a, b = one.parsed, other.parsed
    assert a is not None
    assert b is not None
    different = [
        v for v in (*a.variables, *b.variables) if (v in a.variables) != (v in b.variables)
    ]
    if not different:
        return (
            f"the same manoeuvres at several amplitudes, on which {a.text} and {b.text} depend"
            " differently"
        )
    return "; ".join(dict.fromkeys(_EXCITES[v] for v in different[:2]))


_OF_STATE = {
    "V_mps": "V_rel",
    "alpha_rad": "alpha",
    "beta_rad": "beta",
    "p_radps": "p_hat",
    "q_radps": "q_hat",
    "r_radps": "r_hat",
    "elevator_deg": "de",
    "aileron_deg": "da",
    "rudder_deg": "dr",
    "throttle_pct": "dt",
}


def discriminating_manoeuvre(
    state: str | None, nearest: Sequence[Effect], loudest: tuple[str, float]
) -> str:
    """Return the flight that would explain the remaining residual.

    ``state`` is the state with which the residual varies, ``nearest`` are candidates, the best
    first, ``loudest`` is the kind of manoeuvre with the channel's largest residual, and its rms
    over noise.
    """
    kind, ratio = loudest
    sentences = [
        (
            f"repeat {kind}, where the channel is at {ratio:.2f} times its noise,"
            " at other amplitudes and speeds"
        )
    ]
    if state is not None:
        sentences.insert(0, _EXCITES[_OF_STATE[state]])
    if len(nearest) > 1:
        first, second = nearest[:2]
        sentences.append(
            f"to separate {first.name} from {second.name}: {separating_manoeuvre(first, second)}"
        )
    return "; ".join(sentences)


def withdrawal_reason(effect: Effect, choice: SelectedEffect, gap: str) -> str:
    """Return why an effect that the training flights support is withdrawn.

    The hold-out flights contradict it, or do not show it beside unexplained residuals (``gap``, see
    `hold_out.Verdict`).
    """
    start = f"the training flights support {effect.name} (|t| {abs(choice.t):.1f}), but "
    if gap == "grew":
        grew = "the hold-out residuals grow with it: withdrawn"
        return f"{start}{grew}; an unknown difference between the flights is likely"
    return (
        f"{start}the hold-out flights do not confirm it, and residuals are unexplained: withdrawn"
    )


def too_weak_to_name(effect: Effect, choice: SelectedEffect) -> str:
    """Return why an effect is not named beside unexplained residuals."""
    return (
        f"{effect.name} would explain a part of it (|t| {abs(choice.t):.1f}), too little to be"
        " named while residuals are unexplained"
    )


def still_significant(effect: Effect, t: float) -> str:
    """Return the sentence on a candidate that the flights still support beside the selected
    effects.
    """
    return (
        f"{effect.name} is still significant (|t| {abs(t):.1f}); this or a similar effect is"
        " missing"
    )
