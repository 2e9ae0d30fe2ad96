"""Effects that a flight can hide: coefficient terms, actuators, propulsion, mass, sensors, stall,
ground; some of no vocabulary.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import CodeType
from typing import Any

import numpy as np

COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
SURFACES = ("elevator", "aileron", "rudder")
SUBSYSTEMS: Mapping[str, tuple[str, ...]] = {
    "stall": ("separation", "dynamic"),
    "propulsion": ("thrust_scale", "inflow"),
    # cg_x takes the accelerometers with it; cg_in_airframe leaves them where they are.
    "mass": ("cg_x", "cg_in_airframe", "Ixz"),
    "ground": ("lift",),
    # backlash and late (samples) are of no vocabulary: an answer can only come near them.
    **{f"actuator.{s}": ("lag", "deadband", "rate_limit", "backlash", "late") for s in SURFACES},
}
# Sensors elsewhere than the card says, and a record whose commands carry another clock's time.
PLACES: Mapping[str, tuple[str, ...]] = {
    "sensor.accelerometer": ("place_x", "place_y", "place_z"),
    "sensor.vane": ("place_x",),
    "record": ("delay",),
}
# lag of the aircraft as it is, 1/s; rate that the pilot's hand never exceeds, deg/s
NEUTRAL = {"lag": 25.0, "rate_limit": 120.0}
SENSOR_TERMS = ("bias", "scale", "delay")
_FUNCTIONS: Mapping[str, Any] = {
    "abs": np.abs,
    "tanh": np.tanh,
    "sin": np.sin,
    "sqrt": np.sqrt,
    "maximum": np.maximum,
    "where": np.where,
    "interp": np.interp,
}


@dataclass(frozen=True)
class Effect:
    """One hidden effect.

    subject  a coefficient (CX ... Cn) or a subsystem ("actuator.elevator", "sensor.alpha_rad",
    "mass", ...)
    term     what it is called in an answer ("p_hat^2", "lag")
    size     coefficient terms: the coefficient, in the term's own units. lag [1/s], rate_limit
    [deg/s], deadband and backlash
             [deg, whole width], late [samples]; thrust_scale and inflow as a fraction to add; Ixz
             [kg m2], cg_x and cg_in_airframe [m, forward] to add; sensor bias [unit of the
             channel], scale [fraction to add], delay [s]; place_x, place_y, place_z [m, forward,
             right, down] to add; record delay [s] by which commands act after their rows; stall:
             share of the separation's lift loss; ground: lift gained at zero height, as a fraction
    form     expression of the regressor where it is not the term itself (effects that no vocabulary
    knows); besides the
             vocabulary's variables it may use t_s and abs, tanh, sin, sqrt, maximum, where, interp
    """

    subject: str
    term: str
    size: float
    form: str = ""

    def __post_init__(self) -> None:
        if self.subject in COEFFICIENTS:
            compiled(self.form or self.term)
        elif self.subject in PLACES:
            if self.term not in PLACES[self.subject]:
                raise ValueError(f"{self.key}: {self.subject} has {PLACES[self.subject]}")
        elif self.subject.startswith("sensor."):
            if self.term not in SENSOR_TERMS:
                raise ValueError(f"{self.key}: a sensor has {SENSOR_TERMS}")
        elif self.term not in SUBSYSTEMS.get(self.subject, ()):
            raise ValueError(
                f"{self.key}: known are {COEFFICIENTS}, sensor.<channel> and {dict(SUBSYSTEMS)}"
            )

    @property
    def key(self) -> str:
        return f"{self.subject}:{self.term}"

    @property
    def needs_dots(self) -> bool:
        """It depends on alphadot or betadot, which the forces themselves make."""
        return "dot_hat" in (self.form or self.term) or self.key == "stall:dynamic"

    def scaled(self, factor: float) -> Effect:
        """The same effect with ``factor`` times its strength; lag and rate limit by their inverse,
        from where they do nothing.
        """
        if self.term in NEUTRAL:
            idle = 1.0 / NEUTRAL[self.term]
            return self._sized(1.0 / (idle + factor * (1.0 / self.size - idle)))
        return self._sized(self.size * factor)

    def _sized(self, size: float) -> Effect:
        return Effect(self.subject, self.term, size, self.form)


@lru_cache(maxsize=256)
def compiled(expression: str) -> CodeType:
    """Code of a term such as ``abs(beta)*beta`` or ``p_hat^2``; ValueError names a variable that is
    none.
    """
    code = compile(expression.replace("^", "**"), "<term>", "eval")
    unknown = set(code.co_names) - set(_FUNCTIONS) - VARIABLES
    if unknown:
        raise ValueError(f"{expression}: unknown {sorted(unknown)}; known are {sorted(VARIABLES)}")
    return code


VARIABLES = {
    "alpha",
    "beta",
    "p_hat",
    "q_hat",
    "r_hat",
    "alphadot_hat",
    "betadot_hat",
    "de",
    "da",
    "dr",
    "dt",
    "CT",
    "V_rel",
    "h_over_b",
    "t_s",
}


def value(expression: str, variables: Mapping[str, Any]) -> Any:
    """The expression's value at the variables (angles rad, deflections deg, as the vocabulary
    says).
    """
    return eval(compiled(expression), {"__builtins__": {}}, {**_FUNCTIONS, **variables})
