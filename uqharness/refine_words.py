"""Sentences about effects: why one was named, and which manoeuvre would tell two of them apart."""

from __future__ import annotations

from sysid.effect_choice import Choice
from sysid.effects import Effect

_EXCITES = {
    "alpha": "slow changes of angle of attack by speed (level flight from the slowest to the fastest)",
    "beta": "steady sideslips at several angles",
    "p_hat": "aileron doublets of two sizes and lengths",
    "q_hat": "elevator doublets of two lengths",
    "r_hat": "rudder doublets of two lengths",
    "alphadot_hat": "elevator doublets beside turns at constant angle of attack: alphadot without q and q without alphadot",
    "betadot_hat": "flat turns beside rudder doublets: r without betadot",
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
    "mass": "none in the air: a swing test on the ground measures Ixz, weighing the centre of gravity",
    "actuator": "the surface moved on the ground with its position logged",
    "sensor": "calibration of the sensor on the ground",
    "ground": "the same manoeuvre low and high",
    "record": "a tap on the aircraft logged by all sensors",
}


def why(effect: Effect, choice: Choice) -> str:
    """One sentence: physics, where it shows, how strongly the flights say so."""
    sign = "positive" if choice.value > 0 else "negative"
    where = f"; it shows in {effect.regime}" if effect.regime else ""
    source = f" ({effect.reference})" if effect.reference else ""
    return (
        f"{effect.physics}{where}{source}. "
        f"The flights want {choice.value:.4g} +/- {choice.std:.2g} ({sign}), |t| {abs(choice.t):.1f} with "
        "standard errors corrected for coloured residuals"
    )


def separating_manoeuvre(one: Effect, other: Effect) -> str:
    """What would tell two effects apart that these flights do not."""
    for effect in (one, other):
        part = (effect.subsystem or "").partition(".")[0]
        if part == "mass" and effect.term == "Ixz":
            return (
                "no manoeuvre: in flight a wrong product of inertia acts exactly as pitching moment from roll rate squared does; "
                "measure Ixz on the ground (swing test)"
            )
        if part in _SUBSYSTEM:
            return _SUBSYSTEM[part]
    a, b = one.parsed, other.parsed
    assert a is not None
    assert b is not None
    apart = [v for v in (*a.variables, *b.variables) if (v in a.variables) != (v in b.variables)]
    if not apart:
        return f"the same manoeuvres at several amplitudes: {a.text} and {b.text} differ in how they grow"
    return "; ".join(dict.fromkeys(_EXCITES[v] for v in apart[:2]))
