"""Catalogue of candidate effects: what a model may lack, with physics, regime and reference.

A coefficient effect is a `Term` in one of CX, CY, CZ, Cl, Cm, Cn; other effects belong to a
subsystem such as a servo or a sensor. How a simulator represents them is defined elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects.tuned import SUBSYSTEM_PENALTY
from sysid.errors import LogError
from sysid.foreign.regular_files import ParseError, parse_toml, read_regular_text

# The language of coefficient terms: ``alpha*beta``, ``abs(beta)*beta``, ``p_hat^2``,
# ``1/h_over_b``; values and property names.
#
# A term is a product of factors; a factor is a variable, ``abs(variable)``, ``variable^n`` (n =
# -3 ... 9) or ``1/variable``. It is brought to one form: factors in the order of VARIABLES,
# ``abs()`` before the variable itself, equal factors gathered in a power.

VARIABLES: Mapping[str, str] = {
    "alpha": "rad",
    "beta": "rad",
    "p_hat": "pb/2V",
    "q_hat": "qc/2V",
    "r_hat": "rb/2V",
    "alphadot_hat": "alphadot c/2V",
    "betadot_hat": "betadot b/2V",
    "de": "deg",
    "da": "deg",
    "dr": "deg",
    "dt": "throttle/100",
    "CT": "T/(qbar S)",
    "V_rel": "V/22.2",
    "h_over_b": "h/b",
}
"""Variables of terms and their units, in the order of a term's factors."""
V_REFERENCE_MPS = 22.2
_FACTOR = re.compile(
    r"(?P<inverse>1/)?(?:abs\((?P<absolute>\w+)\)|(?P<plain>\w+?))(?:\^(?P<power>-?\d))?"
)


@dataclass(frozen=True)
class Factor:
    """variable^power, or |variable|^power."""

    variable: str
    absolute: bool = False
    power: int = 1

    @property
    def text(self) -> str:
        """The factor as text: ``p_hat^2``, ``abs(beta)``, ``1/V_rel``."""
        if self.power == -1 and not self.absolute:
            return f"1/{self.variable}"
        name = f"abs({self.variable})" if self.absolute else self.variable
        return name if self.power == 1 else f"{name}^{self.power}"


@dataclass(frozen=True)
class Term:
    """A product of factors in the order of VARIABLES."""

    factors: tuple[Factor, ...]

    @property
    def text(self) -> str:
        """The term as text: factors joined by ``*``."""
        return "*".join(f.text for f in self.factors)

    @property
    def suffix(self) -> str:
        """Suffix of a property such as ``aero/Cm_``: letters, digits and underscores."""
        out = []
        for f in self.factors:
            before, power = (
                ("over" if f.power < 0 else "") + ("abs" if f.absolute else ""),
                abs(f.power),
            )
            out.append(f"{before}{f.variable.removesuffix('_hat')}{power if power > 1 else ''}")
        return "_".join(out)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables, each once, in order of appearance."""
        return tuple(dict.fromkeys(f.variable for f in self.factors))

    @property
    def odd_lateral(self) -> bool:
        """Whether the term changes sign when left and right are exchanged."""
        lateral = {"beta", "p_hat", "r_hat", "betadot_hat", "da", "dr"}
        return (
            sum(f.power for f in self.factors if f.variable in lateral and not f.absolute) % 2 == 1
        )

    def values(self, variables: Mapping[str, FloatArray]) -> FloatArray:
        """Return the term's values (n,) from those of the variables, (n,) each.

        Raises KeyError for a missing variable.
        """
        each = [
            (np.abs(variables[f.variable]) if f.absolute else variables[f.variable])
            ** float(f.power)
            for f in self.factors
        ]
        return np.asarray(np.prod(each, axis=0), dtype=np.float64)


def parse(text: str) -> Term:
    """Parse a term such as ``alpha*beta``; raises ValueError for anything else."""
    gathered: dict[tuple[str, bool], int] = {}
    for part in text.replace(" ", "").split("*"):
        match = _FACTOR.fullmatch(part)
        name = (match["absolute"] or match["plain"]) if match else ""
        if match is None or name not in VARIABLES:
            raise ValueError(
                f"term '{text}': '{part}' is no factor; allowed are variable, abs(variable),"
                f" variable^n and 1/variable with variable one of {', '.join(VARIABLES)}, joined"
                " by *"
            )
        key = (name, match["absolute"] is not None)
        gathered[key] = gathered.get(key, 0) + int(match["power"] or 1) * (
            -1 if match["inverse"] else 1
        )
    factors = [
        Factor(name, absolute, power) for (name, absolute), power in gathered.items() if power
    ]
    if not factors:
        raise ValueError(
            f"term '{text}': the factors cancel; a constant is the coefficient's own _0"
        )
    return Term(
        tuple(sorted(factors, key=lambda f: ([*VARIABLES].index(f.variable), not f.absolute)))
    )


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
    """A candidate effect.

    Attributes
    ----------
    coefficient : str or None
        CX to Cn, or None for an effect of a ``subsystem``.
    subsystem : str or None
        stall, actuator.<surface>, propulsion, mass, sensor.<channel> or ground.
    term : str
        The term as text, or the subsystem's quantity (lag, thrust_scale, Ixz, ...).
    name, physics, regime, sign, reference : str
        Descriptions for an engineer; ``sign`` is the usual sign, empty if both are usual.
    unit : str
        Unit of the value.
    penalty : float
        Additional gain in 2 ln L required of the candidate; 0 for textbook effects.
    positive : bool
        Whether only positive values are possible: no sensor is early, and no servo precedes its
        command.
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
    penalty: float = 0.0
    positive: bool = False

    @property
    def key(self) -> str:
        """Name of the effect among estimated quantities: ``effect/Cm/p_hat^2``."""
        return f"effect/{self.coefficient or self.subsystem}/{self.term}"

    @property
    def property_name(self) -> str:
        """Property that holds its value."""
        if self.subsystem is None:
            return f"aero/{self.coefficient}_{parse(self.term).suffix}"
        part, _, detail = self.subsystem.partition(".")
        return f"effect/{part}/{detail + '-' if detail else ''}{self.term}"

    @property
    def parsed(self) -> Term | None:
        """The parsed term; None for an effect of a subsystem."""
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
"""Pairs of effects that only further terms distinguish, and these terms.

A wrong Ixz causes a pitching moment Ixz (r^2 - p^2) and moments with p q and q r; the rate
derivatives absorb its linear part (Etkin and Reid, eq 4.7,2).
"""


def words(term: str) -> str:
    """Return a term in words: ``roll rate squared``."""
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
    """Return the effect of a term in a coefficient; the factors may have any order.

    Raises ValueError for an unknown coefficient or term.
    """
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
    """Return every coefficient effect of the catalogue."""
    return [
        coefficient_effect(c, term)
        for c in COEFFICIENTS
        for term in _TERMS
        if term != "1/h_over_b" or c in ("CX", "Cm")
    ]


# A user's own effects from a TOML file:
#
# [[effect]] coefficient = "Cm" term = "p_hat^2*CT" physics = "slipstream on the tail in a roll"
# # optional, as are name, regime, sign, reference

_KEYS = {"coefficient", "term", "name", "physics", "regime", "sign", "reference"}
_MAX_CHARACTERS = 2000
"""Longest text of an effect, some paragraphs."""


def read_effects(path: Path) -> list[Effect]:
    """Read a user's effects from a file; raises LogError with file and entry."""
    try:
        data = parse_toml(read_regular_text(path))
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror or error}", path) from None
    except ParseError as error:
        raise LogError(str(error), path) from None
    except UnicodeDecodeError:
        raise LogError("not a text file in UTF-8", path) from None
    rows = data.get("effect")
    if set(data) - {"effect"} or not isinstance(rows, list) or not rows:
        raise LogError(
            f"holds {sorted(data) or 'nothing'}; it needs tables [[effect]] with coefficient and"
            " term",
            path,
        )
    out: list[Effect] = []
    numbers: dict[str, int] = {}
    for number, row in enumerate(rows, 1):
        where = f"[[effect]] {number}"
        if not isinstance(row, dict) or {"coefficient", "term"} - set(row):
            raise LogError("needs coefficient and term", path, where)
        if unknown := sorted(set(row) - _KEYS):
            raise LogError(
                f"unknown key '{unknown[0]}'; allowed are {', '.join(sorted(_KEYS))}", path, where
            )
        if not_text := [k for k, v in row.items() if not isinstance(v, str)]:
            raise LogError(
                f"{not_text[0]} must be text; received {row[not_text[0]]!r}", path, where
            )
        # The texts go into pages and into comments of the refined XML, which has no place for
        # control characters.
        for key, text in row.items():
            if len(text) > _MAX_CHARACTERS:
                raise LogError(
                    f"{key} has {len(text)} characters; allowed are {_MAX_CHARACTERS}", path, where
                )
            if control := [c for c in text if ord(c) < 32 and c not in "\n\r\t"]:
                raise LogError(
                    f"{key} has the control character {control[0]!r}; give plain text", path, where
                )
        try:
            effect = coefficient_effect(row["coefficient"], row["term"])
        except ValueError as error:
            raise LogError(str(error), path, where) from None
        if effect.key in numbers:
            raise LogError(
                f"{effect.coefficient}, {row['term']} is [[effect]] {numbers[effect.key]} too; give"
                " each effect once",
                path,
                where,
            )
        numbers[effect.key] = number
        texts = {k: text for k, text in row.items() if text and k not in ("coefficient", "term")}
        out.append(replace(effect, penalty=0.0, **texts))
    return out


# Candidate effects that are no coefficient term: stall, ground, propulsion, mass, actuators,
# sensors.

_POSITIVE = ("delay", "lag", "deadband", "rate_limit", "separation", "dynamic")
_WIND = ("V_mps", "alpha_rad", "beta_rad")
# subsystem, term, name, physics, regime, unit
_AIRCRAFT = (
    (
        "stall",
        "separation",
        "lift lost by separation",
        "flow separates from the trailing edge at high angle of attack",
        "high angle of attack",
        "1",
    ),
    (
        "stall",
        "dynamic",
        "lift lost by separation that lags",
        "separation follows angle of attack late (eq 2.40)",
        "fast changes at high angle of attack",
        "1",
    ),
    (
        "ground",
        "lift",
        "lift gained near the ground",
        (
            "the ground holds up the wing's downwash: normal force grows by a share that falls off"
            " as exp(-2 h/b)"
        ),
        "low height",
        "1",
    ),
    (
        "propulsion",
        "thrust_scale",
        "thrust off by a factor",
        "propeller or battery give more or less than the map",
        "throttle changes",
        "1",
    ),
    (
        "propulsion",
        "inflow",
        "inflow at the propeller off by a factor",
        "the propeller meets the air faster or slower than the map has it",
        "throttle and speed changes",
        "1",
    ),
    (
        "propulsion",
        "airspeed",
        "thrust off by a factor that goes with airspeed",
        "propeller and motor are matched at another speed",
        "throttle and speed changes",
        "1",
    ),
    (
        "propulsion",
        "torque",
        "propeller torque",
        "the motor's reaction rolls the aircraft against the propeller",
        "throttle changes",
        "1",
    ),
    (
        "propulsion",
        "p_factor",
        "p-factor",
        "the descending blade sees more angle of attack: yaw with alpha, pitch with beta",
        "throttle at angle of attack",
        "1",
    ),
    (
        "propulsion",
        "slipstream",
        "slipstream over the tail",
        "tail surfaces act in more dynamic pressure as thrust grows",
        "elevator and rudder at different power",
        "1",
    ),
    (
        "mass",
        "cg_x",
        "centre of gravity further forward",
        "the moments are about another point",
        "all manoeuvres",
        "m",
    ),
    (
        "mass",
        "Ixz",
        "product of inertia Ixz off",
        "roll and yaw accelerations are coupled, and pitch with roll rate squared",
        "aileron and rudder doublets",
        "kg m^2",
    ),
)


def _effect(
    subsystem: str,
    term: str,
    name: str,
    physics: str,
    regime: str,
    unit: str,
    penalty: float = SUBSYSTEM_PENALTY,
) -> Effect:
    return Effect(
        None,
        subsystem,
        term,
        name,
        physics,
        regime,
        "",
        JATEGAONKAR,
        unit,
        penalty,
        term in _POSITIVE,
    )


def subsystem_effects(
    surfaces: Sequence[str],
    channels: Sequence[str],
    delays: Sequence[str],
    parts: Sequence[str] = (),
) -> list[Effect]:
    """Return the effects that are no coefficient term.

    Parameters
    ----------
    surfaces : sequence of str
        Surfaces with a servo.
    channels : sequence of str
        Measured channels.
    delays : sequence of str
        Sensors whose delay is estimated.
    parts : sequence of str
        Channels of a sensor with several, each of which may be filtered differently.
    """
    effects = [_effect(*row) for row in _AIRCRAFT]
    # Servos.
    for s in surfaces:
        servo = f"actuator.{s}"
        effects += [
            _effect(
                servo,
                "lag",
                f"{s} servo's lag other than modelled",
                "first-order lag of the servo",
                f"{s} steps",
                "s",
            ),
            _effect(
                servo,
                "deadband",
                f"{s} servo with a deadband",
                "small commands do not move the surface",
                f"small {s} commands",
                "deg",
            ),
            _effect(
                servo,
                "rate_limit",
                f"{s} servo's rate limit other than modelled",
                "the servo's speed is limited",
                f"large {s} steps",
                "s/deg",
            ),
        ]
    any_, abrupt, double_penalty = "all manoeuvres", "abrupt manoeuvres", 2.0 * SUBSYSTEM_PENALTY
    # Sensors: scale and zero. Biases of the gyros are always estimated.
    for c in channels:
        short, unit = c.split("_")
        physics = "position error or upwash at the sensor" if c in _WIND else "calibration"
        effects.append(
            _effect(
                f"sensor.{c}",
                "scale",
                f"{short} sensor's scale off",
                physics,
                any_,
                "1",
                double_penalty,
            )
        )
        if short not in ("p", "q", "r"):
            physics = "calibration or misalignment"
            effects.append(
                _effect(
                    f"sensor.{c}",
                    "bias",
                    f"{short} sensor's zero off",
                    physics,
                    any_,
                    unit,
                    double_penalty,
                )
            )
    # Sensor positions, which appear in fast rotation only.
    if {"ax_mps2", "ay_mps2", "az_mps2"} & set(channels):
        physics = "they feel the rotation about the CG"
        effects += [
            _effect(
                "sensor.accelerometer",
                f"place_{axis}",
                f"accelerometers further {way}",
                physics,
                abrupt,
                "m",
                double_penalty,
            )
            for axis, way in (("x", "forward"), ("y", "right"), ("z", "down"))
        ]
    if {"V_mps", "q_radps", "r_radps"} <= set(channels) and {"alpha_rad", "beta_rad"} & set(
        channels
    ):
        physics = "they move with pitch and yaw rate"
        effects.append(
            _effect(
                "sensor.vane",
                "place_x",
                "wind vanes further forward",
                physics,
                abrupt,
                "m",
                double_penalty,
            )
        )
    # Delays of a sensor, and of single channels of one, which are rarer.
    late = [
        (c, "sensor late", "filtering and transport of the signal", double_penalty) for c in delays
    ]
    late += [
        (
            c,
            "alone late",
            "filtered otherwise than the other channels of its sensor",
            2.0 * double_penalty,
        )
        for c in parts
    ]
    return effects + [
        _effect(
            f"sensor.{c}",
            "delay",
            f"{c.split('_')[0]} {name}",
            physics,
            "fast manoeuvres",
            "s",
            penalty,
        )
        for c, name, physics, penalty in late
    ]
