"""Arithmetic as JSBSim XML: a small expression tree, polynomials in Horner's form, and lines of text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

from uqharness.xml.document import comment

Powers = tuple[int, ...]
_WIDTH = 110


@dataclass(frozen=True)
class Expression:
    """``tag`` is a JSBSim operation, ``property`` or ``value``; a leaf has ``text``, an operation arguments.

    ``tight``: without blanks between its tags and its arguments.
    """

    tag: str
    text: str = ""
    arguments: tuple[Expression, ...] = ()
    tight: bool = False

    def line(self) -> str:
        """All of it on one line."""
        if not self.arguments:
            return f"<{self.tag}>{escape(self.text)}</{self.tag}>"
        gap = "" if self.tight else " "
        return f"<{self.tag}>{gap}{' '.join(a.line() for a in self.arguments)}{gap}</{self.tag}>"

    def lines(self) -> list[str]:
        """On one line where that is short, else arguments on lines of their own, two spaces deeper."""
        line = self.line()
        if len(line) <= _WIDTH or not self.arguments:
            return [line]
        inner = [f"  {line}" for argument in self.arguments for line in argument.lines()]
        return [f"<{self.tag}>", *inner, f"</{self.tag}>"]


def value(number: float, form: str = "") -> Expression:
    """A constant in a format such as ".8g"; without one, in the shortest digits that give the same double again."""
    return Expression("value", format(number, form) if form else repr(float(number)))


def prop(name: str) -> Expression:
    """The value of a JSBSim property."""
    return Expression("property", name)


def call(tag: str, *arguments: Expression) -> Expression:
    """An operation; a sum or product of one argument is that argument (JSBSim would warn and drop the operation itself)."""
    if tag in ("sum", "product", "min", "max") and len(arguments) == 1:
        return arguments[0]
    return Expression(tag, "", arguments)


def function_lines(
    name: str, tag: str, lines: Sequence[str], at_cg: bool = False, remark: str = ""
) -> list[str]:
    """A ``<function>`` of one operation, whose arguments are given as lines."""
    attributes = ' apply_at_cg="true"' if at_cg else ""
    return [
        f"<function name={quoteattr(name)}{attributes}>",
        *([f"  {comment(remark)}"] if remark else []),
        f"  <{tag}>",
        *(f"    {line}" for line in lines),
        f"  </{tag}>",
        "</function>",
    ]


def horner(coefficients: Mapping[Powers, float], names: Sequence[str]) -> Expression:
    """The polynomial sum of c * prod(names[k] ** powers[k]) in a multivariate Horner form.

    The variable that occurs in most monomials is taken out first (Ceberio and Kreinovich, "Greedy algorithms for optimizing
    multivariate Horner schemes", 2004).
    """
    return _horner({p: c for p, c in coefficients.items() if c != 0.0}, names)


def _horner(terms: dict[Powers, float], names: Sequence[str]) -> Expression:
    summands: list[Expression] = []
    while terms:
        use = Counter(k for powers in terms for k, n in enumerate(powers) if n)
        if not use:
            summands.append(value(next(iter(terms.values()))))
            break
        k = min(use, key=lambda index: (-use[index], index))
        inside = {_less(powers, k): c for powers, c in terms.items() if powers[k]}
        terms = {powers: c for powers, c in terms.items() if not powers[k]}
        factor = _horner(inside, names)
        factors = factor.arguments if factor.tag == "product" else (factor,)
        one = len(inside) == 1 and factor == value(1.0)
        summands.append(prop(names[k]) if one else call("product", prop(names[k]), *factors))
    return call("sum", *summands) if summands else value(0.0)


def _less(powers: Powers, k: int) -> Powers:
    return (*powers[:k], powers[k] - 1, *powers[k + 1 :])
