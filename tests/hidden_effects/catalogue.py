"""Which effects are hidden, in which kind of flight, and what may be answered.

Sizes stand in sizes.csv.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from tests.hidden_effects.effects import Effect

SIZES = Path(__file__).with_name("sizes.csv")


@dataclass(frozen=True)
class Entry:
    """One hidden effect.

    guess    its size before calibration, with its sign          flown    kind of flight: mixed |
    slow | ground
    same     keys that are the same thing on the data: any of them, or a set with one of them, is
    the right name proxies  off form only: keys that may stand in its place if they bring the gap
    down
    form     regressor of an effect that no vocabulary knows
    """

    subject: str
    term: str
    guess: float
    flown: str = "mixed"
    same: tuple[str, ...] = ()
    proxies: tuple[str, ...] = ()
    form: str = ""

    @property
    def key(self) -> str:
        return f"{self.subject}:{self.term}"

    @property
    def off_form(self) -> bool:
        return bool(self.form) or self.term in ("backlash", "late")

    def effect(self, t: float, air: str = "calm") -> Effect:
        """The effect at a size that gives about |t| = t in three 90 s flights of Table 2.1's noise
        in that air.
        """
        unit = Effect(self.subject, self.term, sizes(air).get(self.key, self.guess), self.form)
        # Commands are late by whole samples.
        return (
            unit.scaled(t / 10.0)
            if self.term != "late"
            else replace(unit, size=1.0 if t < 60.0 else 2.0)
        )


@lru_cache(maxsize=2)
def sizes(air: str) -> Mapping[str, float]:
    """Key -> size at |t| = 10 in calm air or light turbulence."""
    if not SIZES.is_file():
        return {}
    with SIZES.open(encoding="utf-8") as handle:
        return {row["key"]: float(row[air]) for row in csv.DictReader(handle) if row[air]}


IN_FORM = (
    Entry("Cm", "p_hat^2", 0.12, same=("mass:Ixz",)),
    Entry("Cm", "alpha^2", 0.16),
    Entry("Cm", "beta^2", 0.03),
    Entry("Cm", "de^3", -3e-6),
    Entry("Cm", "dr", 5e-5),
    Entry("Cm", "CT", 0.02, same=("propulsion:slipstream",)),
    Entry("Cm", "de*CT", -0.004, same=("propulsion:slipstream",)),
    Entry("Cm", "alpha*q_hat", -30.0),
    Entry("Cm", "alphadot_hat", -4.0),
    Entry("CZ", "q_hat", -1.0),
    Entry("CZ", "alpha^2", 2.0),
    Entry("CZ", "alpha^3", 10.0),
    Entry("CX", "q_hat", 0.35),
    Entry("CX", "beta^2", -0.05),
    Entry("CX", "de", 2e-4),
    Entry("CY", "abs(beta)*beta", -0.1),
    Entry("CY", "alpha*beta", -0.3),
    Entry("CY", "da", 1e-4),
    Entry("Cl", "de", 6e-6),
    Entry("Cl", "alpha*beta", -0.03),
    Entry("Cl", "alpha*p_hat", 0.2),
    Entry("Cl", "da^3", -1e-6),
    Entry("Cl", "CT", 0.001, same=("propulsion:torque",)),
    Entry("Cn", "alpha*beta", 0.03),
    Entry("Cn", "alpha*p_hat", -0.2),
    Entry("Cn", "abs(beta)*beta", 0.01),
    Entry("Cn", "alpha*da", -1e-3),
    Entry("Cn", "de", 5e-6),
    Entry("actuator.elevator", "lag", 23.0),
    Entry("actuator.aileron", "lag", 23.0),
    Entry("actuator.rudder", "lag", 22.0),
    Entry("actuator.elevator", "deadband", 0.05),
    Entry("actuator.aileron", "deadband", 0.04),
    Entry("actuator.rudder", "deadband", 0.1),
    Entry("actuator.aileron", "rate_limit", 90.0),
    Entry("propulsion", "thrust_scale", 0.04, same=("CX:CT",)),
    Entry("mass", "Ixz", 0.05, same=("Cm:p_hat^2",)),
    Entry("sensor.alpha_rad", "scale", 0.05),
    Entry("sensor.beta_rad", "scale", 0.03),
    Entry("sensor.alpha_rad", "delay", 0.01),
    Entry("sensor.beta_rad", "delay", 0.01),
    Entry("sensor.V_mps", "scale", 0.05),
    Entry("sensor.ax_mps2", "bias", 0.1),
    Entry("sensor.theta_rad", "bias", 0.02),
    Entry("stall", "separation", 0.2, flown="slow"),
    Entry("stall", "dynamic", 0.2, flown="slow"),
    Entry("ground", "lift", 0.05, flown="ground"),
)

OFF_FORM = (
    Entry(
        "Cm",
        "table(alpha)",
        -0.08,
        form="maximum(alpha-0.05,0)",
        proxies=("Cm:alpha^2", "Cm:alpha^3", "Cm:abs(alpha)*alpha"),
    ),
    Entry(
        "Cn",
        "step(beta)",
        0.001,
        form="tanh(beta/0.05)",
        proxies=("Cn:beta^3", "Cn:abs(beta)*beta"),
    ),
    Entry(
        "actuator.elevator",
        "backlash",
        0.1,
        proxies=("actuator.elevator:deadband", "actuator.elevator:lag"),
    ),
    Entry(
        "Cl",
        "step(alpha)*p_hat",
        0.02,
        form="(1+tanh(30*(alpha-0.07)))*p_hat",
        proxies=("Cl:alpha*p_hat", "Cl:alpha^2*p_hat"),
    ),
    Entry(
        "CX",
        "spoiler(da)",
        -0.001,
        form="maximum(abs(da)-3,0)",
        proxies=("CX:da^2", "CX:abs(da)", "CX:abs(da)*da"),
    ),
    Entry("Cm", "wave(t)", 5e-4, form="sin(2.5*t_s)"),
    Entry("Cl", "break(t)", 3e-5, form="where(t_s>45,1,0)"),
    Entry("CZ", "ripple(alpha)", 0.01, form="sin(80*alpha)", proxies=("CZ:alpha^2", "CZ:alpha^3")),
    Entry("actuator.aileron", "late", 1.0, proxies=("actuator.aileron:lag",)),
    Entry(
        "Cm",
        "q_hat above alpha",
        -60.0,
        form="q_hat*maximum(alpha-0.04,0)",
        proxies=("Cm:alpha*q_hat", "Cm:alpha^2*q_hat"),
    ),
)

# Hidden in draws alone, where the size is found for the case's own flights: the
# guess only has to be small.
OTHERS = (
    *(Entry("CX", term, 0.01) for term in ("alpha^3", "alpha*q_hat", "dr^2", "da^2")),
    *(
        Entry("CY", term, 0.01)
        for term in ("alpha*p_hat", "alpha*r_hat", "beta^3", "CT", "abs(p_hat)*p_hat")
    ),
    *(
        Entry("CZ", term, 0.01)
        for term in ("beta^2", "alphadot_hat", "alpha*q_hat", "V_rel", "p_hat^2")
    ),
    *(
        Entry("Cl", term, 0.001)
        for term in ("alpha*r_hat", "abs(beta)*beta", "beta*CT", "abs(p_hat)*p_hat", "betadot_hat")
    ),
    *(
        Entry("Cm", term, 0.001)
        for term in ("alpha^3", "abs(beta)", "q_hat*CT", "abs(q_hat)*q_hat", "V_rel", "beta*p_hat")
    ),
    *(
        Entry("Cn", term, 0.001)
        for term in ("beta^3", "CT", "alpha*r_hat", "betadot_hat", "abs(p_hat)*p_hat", "q_hat")
    ),
    *(Entry("Cn", term, 1e-5) for term in ("dr*CT", "alpha*dr")),
    Entry("propulsion", "inflow", 0.02),
    Entry("actuator.elevator", "rate_limit", 90.0),
    Entry("actuator.rudder", "rate_limit", 90.0),
    Entry("sensor.p_radps", "scale", 0.01),
    Entry("sensor.q_radps", "scale", 0.01),
    Entry("sensor.r_radps", "scale", 0.01),
    Entry("sensor.p_radps", "delay", 0.005),
)

ON_ORDER = (Entry("mass", "cg_in_airframe", 0.03, same=("mass:cg_x",)),)
ENTRIES: Mapping[str, Entry] = {e.key: e for e in (*IN_FORM, *OFF_FORM, *OTHERS, *ON_ORDER)}
