"""The language of coefficient terms: ``alpha*beta``, ``abs(beta)*beta``, ``p_hat^2``, ``1/h_over_b``; values and property names.

A term is a product of factors; a factor is a variable, ``abs(variable)``, ``variable^n`` (n = -3 ... 9) or ``1/variable``. It is
brought to one form: factors in the order of VARIABLES, ``abs()`` before the variable itself, equal factors gathered in a power.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid.arrays import FloatArray

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
"""Variables of a term and their units, in the order in which a term's factors stand."""
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
        """The factor as a term writes it: ``p_hat^2``, ``abs(beta)``, ``1/V_rel``."""
        if self.power == -1 and not self.absolute:
            return f"1/{self.variable}"
        name = f"abs({self.variable})" if self.absolute else self.variable
        return name if self.power == 1 else f"{name}^{self.power}"


@dataclass(frozen=True)
class Term:
    """A product of factors in their standing order."""

    factors: tuple[Factor, ...]

    @property
    def text(self) -> str:
        """The term as it is written: factors joined by ``*``, in the vocabulary's order."""
        return "*".join(f.text for f in self.factors)

    @property
    def suffix(self) -> str:
        """What stands behind ``aero/Cm_`` in a property: letters, digits and underscores alone."""
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

    def values(self, found: Mapping[str, FloatArray]) -> FloatArray:
        """(n,) values from those of the variables, each (n,). Raises KeyError for a variable that is not there."""
        each = [
            (np.abs(found[f.variable]) if f.absolute else found[f.variable]) ** float(f.power)
            for f in self.factors
        ]
        return np.asarray(np.prod(each, axis=0), dtype=np.float64)


def parse(text: str) -> Term:
    """The term of a text such as ``alpha*beta``. Raises ValueError saying what was received and what is allowed."""
    gathered: dict[tuple[str, bool], int] = {}
    for part in text.replace(" ", "").split("*"):
        found = _FACTOR.fullmatch(part)
        name = (found["absolute"] or found["plain"]) if found else ""
        if found is None or name not in VARIABLES:
            raise ValueError(
                f"term '{text}': '{part}' is no factor; allowed are variable, abs(variable), variable^n and 1/variable with "
                f"variable one of {', '.join(VARIABLES)}, joined by *"
            )
        key = (name, found["absolute"] is not None)
        gathered[key] = gathered.get(key, 0) + int(found["power"] or 1) * (
            -1 if found["inverse"] else 1
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
