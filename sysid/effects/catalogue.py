"""The catalogue of candidate effects: what a model may lack, its physics in a sentence, where it shows, where to read about it.

A coefficient effect is a term (effect_terms.py) in one of CX CY CZ Cl Cm Cn; any other belongs to a subsystem. Nothing here knows
how a simulator would carry it.
"""

from __future__ import annotations

from dataclasses import dataclass

from sysid.aerodynamics import COEFFICIENTS
from sysid.effects.effect_terms import VARIABLES, Term, parse

_NAMES = (
    "axial force",
    "side force",
    "normal force",
    "rolling moment",
    "pitching moment",
    "yawing moment",
)
"""Of COEFFICIENTS."""
_LATERAL = ("CY", "Cl", "Cn")
_WORDS = {
    "alpha": "angle of attack",
    "beta": "sideslip",
    "p_hat": "roll rate",
    "q_hat": "pitch rate",
    "r_hat": "yaw rate",
    "alphadot_hat": "rate of angle of attack",
    "betadot_hat": "rate of sideslip",
    "de": "elevator",
    "da": "aileron",
    "dr": "rudder",
    "dt": "throttle",
    "CT": "thrust coefficient",
    "V_rel": "airspeed",
    "h_over_b": "height in spans",
}
_POWERS = {1: "", 2: " squared", 3: " cubed"}
JATEGAONKAR = "Jategaonkar, Flight Vehicle System Identification (2015)"
KLEIN = "Klein and Morelli, Aircraft System Identification (2006)"
ETKIN = "Etkin and Reid, Dynamics of Flight (1996)"
HALE = "Hale (2016), section 2.7.2"


@dataclass(frozen=True)
class Effect:
    """One candidate.

    coefficient  CX..Cn, or None where ``subsystem`` (stall, actuator.<surface>, propulsion, mass, sensor.<channel>, ground) counts
    term         text of the term, or the subsystem's own word (lag, thrust_scale, Ixz ...)
    name, physics, regime, sign, reference  words for an engineer; sign: what is usual, "" where either is
    unit         of the value
    positive     whether only a positive value is physics: no sensor is early, no servo faster than its command (one with a lag
                 in the XML may be faster than that)
    odds         what the candidate must explain more than a plain one, in units of 2 ln L: 0 for what every textbook lists
    """

    coefficient: str | None
    subsystem: str | None
    term: str
    name: str
    physics: str
    regime: str = ""
    sign: str = ""
    reference: str = ""
    unit: str = "1"
    odds: float = 0.0
    positive: bool = False

    @property
    def key(self) -> str:
        """Name of the effect among the unknowns of an estimate: ``effect/Cm/p_hat^2``."""
        return f"effect/{self.coefficient or self.subsystem}/{self.term}"

    @property
    def property_name(self) -> str:
        """Property that carries its value."""
        if self.subsystem is None:
            return f"aero/{self.coefficient}_{parse(self.term).suffix}"
        part, _, what = self.subsystem.partition(".")
        return f"effect/{part}/{what + '-' if what else ''}{self.term}"

    @property
    def parsed(self) -> Term | None:
        """The term in factors; None for an effect of a subsystem, which is no coefficient term."""
        return parse(self.term) if self.coefficient is not None else None


# term -> physics, regime, reference
_TERMS: dict[str, tuple[str, str, str]] = {
    "alpha": ("force or moment proportional to angle of attack", "pitch manoeuvres", ETKIN),
    "alpha^2": (
        "curvature with angle of attack: drag polar, lift slope falling off",
        "large changes of angle of attack",
        KLEIN,
    ),
    "alpha^3": ("onset of separation before the stall", "high and low angles of attack", KLEIN),
    "beta": ("asymmetry between left and right sideslip", "yaw manoeuvres", ETKIN),
    "beta^2": (
        "symmetric change with sideslip: drag, fuselage upwash, dihedral of the tail",
        "large sideslip",
        KLEIN,
    ),
    "beta^3": ("side force or moment not linear in sideslip", "large sideslip", KLEIN),
    "abs(beta)": (
        "symmetric change with sideslip: one side of the tail in the fuselage's wake",
        "large sideslip",
        KLEIN,
    ),
    "abs(beta)*beta": (
        "crossflow on fuselage and fin grows faster than linearly with sideslip",
        "large sideslip",
        KLEIN,
    ),
    "alpha*beta": (
        "dihedral effect or directional stability changes with angle of attack",
        "sideslip at several angles of attack",
        KLEIN,
    ),
    "p_hat": ("spanwise change of angle of attack in a roll", "aileron doublets", ETKIN),
    "q_hat": (
        "change of angle of attack at the tail in pitching",
        "elevator doublets, 3-2-1-1",
        ETKIN,
    ),
    "r_hat": ("change of speed and sideslip along the span in yawing", "rudder doublets", ETKIN),
    "p_hat^2": (
        "both tail panels and wings gain angle of attack in a roll either way",
        "aileron doublets, large roll rate",
        HALE,
    ),
    "q_hat^2": ("pitch damping that is not linear in the rate", "abrupt pitch manoeuvres", KLEIN),
    "r_hat^2": ("both wings in yawing, whichever its direction", "rudder doublets", KLEIN),
    "p_hat*r_hat": ("roll and yaw together", "coordinated rolls", KLEIN),
    "p_hat*q_hat": (
        "roll and pitch together: moments of inertia taken wrong",
        "pulling in a roll",
        KLEIN,
    ),
    "q_hat*r_hat": ("pitch and yaw together: moments of inertia taken wrong", "steep turns", KLEIN),
    "abs(p_hat)*p_hat": ("roll damping that is not linear in the rate", "large roll rate", KLEIN),
    "abs(r_hat)*r_hat": ("yaw damping that is not linear in the rate", "large yaw rate", KLEIN),
    "abs(q_hat)*q_hat": ("pitch damping that is not linear in the rate", "large pitch rate", KLEIN),
    "alpha*p_hat": (
        "rolling: cross derivative that changes with angle of attack",
        "rolls at varying angle of attack",
        KLEIN,
    ),
    "alpha*q_hat": (
        "pitch damping that changes with angle of attack",
        "pitch manoeuvres at varying angle of attack",
        KLEIN,
    ),
    "alpha*r_hat": (
        "cross derivative of yawing that changes with angle of attack",
        "yaw at varying angle of attack",
        KLEIN,
    ),
    "beta*p_hat": (
        "rolling in sideslip: wing and tail see unequal angles",
        "rolls in sideslip",
        KLEIN,
    ),
    "beta*q_hat": ("pitching in sideslip", "combined manoeuvres", KLEIN),
    "beta*r_hat": ("yawing in sideslip", "yaw manoeuvres", KLEIN),
    "alpha*de": (
        "elevator power that changes with angle of attack (downwash, wing wake)",
        "pitch manoeuvres",
        KLEIN,
    ),
    "alpha*da": (
        "adverse yaw and aileron power that change with angle of attack",
        "rolls at varying angle of attack",
        KLEIN,
    ),
    "alpha*dr": (
        "rudder power that changes with angle of attack",
        "yaw at varying angle of attack",
        KLEIN,
    ),
    "beta*de": (
        "v-tail: elevator makes a lateral moment in sideslip",
        "sideslip with elevator",
        KLEIN,
    ),
    "beta*da": ("aileron in sideslip", "combined manoeuvres", KLEIN),
    "beta*dr": ("v-tail: rudder and sideslip load the panels unequally", "rudder doublets", KLEIN),
    "de": (
        "elevator; on a v-tail unequal panels",
        "elevator doublets, 3-2-1-1",
        "eqs 3.25-3.30 of Hale (2016)",
    ),
    "da": ("aileron: differential drag and lift", "aileron doublets", ETKIN),
    "dr": ("rudder; on a v-tail unequal panels", "rudder doublets", "eqs 3.25-3.30 of Hale (2016)"),
    "de^2": ("drag or unequal power up and down of the elevator", "large elevator", KLEIN),
    "da^2": ("drag of the ailerons, whichever the direction", "large aileron", KLEIN),
    "dr^2": ("drag of the rudder, whichever the direction", "large rudder", KLEIN),
    "de^3": ("elevator power lost at large deflections", "large elevator", KLEIN),
    "da^3": ("aileron power lost at large deflections", "large aileron", KLEIN),
    "dr^3": ("rudder power lost at large deflections", "large rudder", KLEIN),
    "abs(da)": ("drag of the ailerons, whichever the direction", "large aileron", KLEIN),
    "abs(dr)": ("drag of the rudder, whichever the direction", "large rudder", KLEIN),
    "alphadot_hat": (
        "downwash reaches the tail late; lift builds up late",
        "elevator doublets, gusts",
        ETKIN,
    ),
    "betadot_hat": ("sidewash reaches the fin late", "rudder doublets", ETKIN),
    "CT": ("slipstream and thrust line: what power does at once", "throttle doublets", JATEGAONKAR),
    "alpha*CT": (
        "propeller's normal force, slipstream over the wing",
        "throttle changes at several angles of attack",
        JATEGAONKAR,
    ),
    "beta*CT": (
        "propeller's side force; slipstream over the fin",
        "throttle changes in sideslip",
        JATEGAONKAR,
    ),
    "q_hat*CT": (
        "pitch damping by the tail in the slipstream",
        "pitch manoeuvres at different power",
        JATEGAONKAR,
    ),
    "r_hat*CT": (
        "yaw damping by the fin in the slipstream",
        "yaw manoeuvres at different power",
        JATEGAONKAR,
    ),
    "de*CT": (
        "slipstream over the elevator: its power grows with thrust",
        "elevator at different power",
        JATEGAONKAR,
    ),
    "da*CT": ("slipstream over the ailerons", "aileron at different power", JATEGAONKAR),
    "dr*CT": (
        "slipstream over the rudder: its power grows with thrust",
        "rudder at different power",
        JATEGAONKAR,
    ),
    "V_rel": (
        "coefficient that changes with airspeed: Reynolds number, elastic deformation",
        "different airspeeds",
        KLEIN,
    ),
    "alpha*V_rel": (
        "lift slope that changes with airspeed: elastic deformation",
        "different airspeeds",
        KLEIN,
    ),
    "de*V_rel": (
        "elevator power that changes with airspeed: elastic tail",
        "different airspeeds",
        KLEIN,
    ),
    "da*V_rel": (
        "aileron power that changes with airspeed: elastic wing",
        "different airspeeds",
        KLEIN,
    ),
    "dr*V_rel": (
        "rudder power that changes with airspeed: elastic fin",
        "different airspeeds",
        KLEIN,
    ),
    "1/h_over_b": ("ground effect", "low height", ETKIN),
}


_P2, _R2, _IXZ = "effect/Cm/p_hat^2", "effect/Cm/r_hat^2", "effect/mass/Ixz"
_COUPLED = (_R2, "effect/Cl/p_hat*q_hat", "effect/Cn/q_hat*r_hat")
TWINS: dict[tuple[str, str], tuple[str, ...]] = {(_P2, _IXZ): _COUPLED, (_IXZ, _P2): _COUPLED}
"""(effect, alternative) -> terms by which alone the two differ. A wrong Ixz is a pitching moment Ixz (r^2 - p^2), and moments with
p q and q r; its linear part the rate derivatives take up (rigid body, e.g. Etkin and Reid eq 4.7,2)."""


def words(term: str) -> str:
    """A term in words: ``roll rate squared``."""
    out = []
    for f in parse(term).factors:
        word = f"magnitude of {_WORDS[f.variable]}" if f.absolute else _WORDS[f.variable]
        out.append(
            f"inverse of {word}"
            if f.power == -1
            else f"{word}{_POWERS.get(f.power, f' to the power {f.power}')}"
        )
    return " times ".join(out)


def coefficient_effect(coefficient: str, term: str) -> Effect:
    """The effect of a term in a coefficient; term in any order of factors. Raises ValueError for what is neither."""
    if coefficient not in COEFFICIENTS:
        raise ValueError(f"coefficient '{coefficient}': allowed are {', '.join(COEFFICIENTS)}")
    parsed = parse(term)
    physics, regime, reference = _TERMS.get(parsed.text, ("a term of your own", "", ""))
    mirrored = parsed.odd_lateral != (coefficient in _LATERAL)
    surfaces = ("de", "da", "dr")
    degree, deflections = (
        sum(abs(f.power) for f in parsed.factors if f.variable in some)
        for some in (VARIABLES, surfaces)
    )
    return Effect(
        coefficient,
        None,
        parsed.text,
        f"{_NAMES[COEFFICIENTS.index(coefficient)]} due to {words(parsed.text)}",
        physics,
        regime,
        "",
        reference,
        "1" if not deflections else "1/deg" if deflections == 1 else f"1/deg^{deflections}",
        0.5 * (degree - 1) + (2.0 if mirrored and parsed.text not in surfaces else 0.0),
    )


def catalogue() -> list[Effect]:
    """Every coefficient term of the catalogue in every coefficient."""
    return [
        coefficient_effect(c, term)
        for c in COEFFICIENTS
        for term in _TERMS
        if term != "1/h_over_b" or c in ("CX", "Cm")
    ]
