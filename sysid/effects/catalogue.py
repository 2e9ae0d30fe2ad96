"""Catalogue of candidate effects: what a model may lack, with physics, regime and reference.

A coefficient effect is a `Term` in one of CX, CY, CZ, Cl, Cm, Cn; other effects belong to a
subsystem such as a servo or a sensor. catalogue.csv lists them. How a simulator represents them is
defined elsewhere.
"""

from __future__ import annotations

import csv
import importlib.resources
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from sysid.aerodynamics import COEFFICIENTS
from sysid.arrays import FloatArray
from sysid.effects import tuned
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
_REFERENCES = {
    "Etkin": "Etkin and Reid, Dynamics of Flight (1996)",
    "Hale": "Hale (2016), section 2.7.2",
    "Jategaonkar": "Jategaonkar, Flight Vehicle System Identification (2015)",
    "Klein": "Klein and Morelli, Aircraft System Identification (2006)",
}
"""Books by the word that catalogue.csv has for them."""
_POSITIVE = ("delay", "lag", "deadband", "rate_limit", "separation", "dynamic")
_WIND = ("V_mps", "alpha_rad", "beta_rad")


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


@cache
def _table() -> dict[str, list[dict[str, str]]]:
    """Return the rows of catalogue.csv by what they are effects of, in the order of the file.

    A brace stands for the servo or sensor; the penalty is in units of `SUBSYSTEM_PENALTY`.
    """
    text = (importlib.resources.files("sysid.effects") / "catalogue.csv").read_text("utf-8")
    table: dict[str, list[dict[str, str]]] = {}
    for row in csv.DictReader(text.splitlines()):
        row["reference"] = _REFERENCES.get(row["reference"], row["reference"])
        table.setdefault(row["of"], []).append(row)
    return table


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
    row = next(
        (r for r in _table()["coefficient"] if r["term"] == parsed.text),
        {"physics": "a term of your own", "regime": "", "reference": ""},
    )
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
        row["physics"],
        row["regime"],
        "",
        row["reference"],
        "1" if not deflections else "1/deg" if deflections == 1 else f"1/deg^{deflections}",
        0.5 * (degree - 1) + (2.0 if mirrored and parsed.text not in surfaces else 0.0),
    )


def catalogue() -> list[Effect]:
    """Return every coefficient effect of the catalogue."""
    return [
        coefficient_effect(c, row["term"])
        for c in COEFFICIENTS
        for row in _table()["coefficient"]
        if row["term"] != "1/h_over_b" or c in ("CX", "Cm")
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
    places = [("aircraft", "")]
    places += [("servo", s) for s in surfaces]
    # Biases of the gyros are always estimated.
    places += [
        ("wind sensor" if c in _WIND else "gyro" if c[:2] in ("p_", "q_", "r_") else "sensor", c)
        for c in channels
    ]
    # Sensor positions appear in fast rotation only.
    if {"ax_mps2", "ay_mps2", "az_mps2"} & {*channels}:
        places.append(("accelerometers", ""))
    if {"V_mps", "q_radps", "r_radps"} <= {*channels} and {"alpha_rad", "beta_rad"} & {*channels}:
        places.append(("vanes", ""))
    # Delays of single channels are rarer than those of a sensor.
    places += [("late sensor", c) for c in delays]
    places += [("late channel", c) for c in parts]
    return [_subsystem_effect(row, name) for kind, name in places for row in _table()[kind]]


def _subsystem_effect(row: Mapping[str, str], name: str) -> Effect:
    """Return the effect of a row of the table, of the servo or sensor ``name``."""
    short, _, unit = name.partition("_")
    return Effect(
        None,
        row["subsystem"].format(name),
        row["term"],
        row["name"].format(short),
        row["physics"],
        row["regime"].format(short),
        "",
        row["reference"],
        row["unit"] or unit,
        float(row["penalty"]) * tuned.SUBSYSTEM_PENALTY,
        row["term"] in _POSITIVE,
    )
