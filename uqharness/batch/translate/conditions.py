"""Tests of switches, distributors and events: lines of a property, a comparison and a value, joined by AND or OR."""

from __future__ import annotations

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.scope import Scope
from uqharness.xml import Node

COMPARISONS = {
    word: word.lower()
    for word in ("EQ", "NE", "GT", "GE", "LT", "LE", "eq", "ne", "gt", "ge", "lt", "le")
}
COMPARISONS |= {"==": "eq", "!=": "ne", ">": "gt", ">=": "ge", "<": "lt", "<=": "le"}
"""Words and signs of comparisons."""


def condition(scope: Scope, node: Node) -> Value:
    """Whether a ``<test>`` or ``<condition>`` holds: its lines and the elements of the same name in it, all of them or, with
    ``logic="OR"``, one. All are looked at. The caller deals with the attributes of ``node``, but for ``logic``.

    Raises BadInputError with file and line for what JSBSim leaves out or is not understood.
    """
    b = scope.builder
    logic = node.attributes.get("logic", "AND") or "AND"
    if logic not in ("AND", "OR"):
        scope.refuse(node, f"logic='{logic}' of <{node.tag}>: allowed are AND and OR")
    parts = [_comparison(scope, node, line) for line in node.text.split("\n") if line.strip()]
    for child in node.children:
        if child.tag != node.tag:
            scope.refuse(
                child,
                f"<{child.tag}> in <{node.tag}> is not understood; allowed are lines and <{node.tag}>",
            )
        scope.only(child, ("logic",))
        parts.append(condition(scope, child))
    if not parts:
        scope.refuse(
            node,
            f"<{node.tag}> has no comparison; a line is a property, a comparison, and a property or number",
        )
    result = parts[0]
    for part in parts[1:]:
        result = b.op("and" if logic == "AND" else "or", result, part)
    return result


def _comparison(scope: Scope, node: Node, line: str) -> Value:
    """JSBSim divides at blanks alone: a tab does not."""
    words = [word.strip() for word in line.strip().split(" ") if word.strip()]
    if (
        len(words) != 3
        or words[1] not in COMPARISONS
        or any(len(word.split()) != 1 for word in words)
    ):
        known = ", ".join(COMPARISONS)
        scope.refuse(
            node,
            f"a comparison is 'property sign value', blanks between, sign one of {known}; received {line.strip()!r}",
        )
    return scope.builder.op(
        COMPARISONS[words[1]], scope.named_property(node, words[0]), scope.parameter(node, words[2])
    )
