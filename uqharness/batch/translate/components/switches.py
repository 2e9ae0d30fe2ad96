"""Switches, which choose a value, and distributors, which set properties."""

from __future__ import annotations

from uqharness.batch.form.ir import Value
from uqharness.batch.translate.components.component import Component
from uqharness.batch.translate.conditions import condition
from uqharness.batch.translate.scope import Scope, property_of
from uqharness.xml import Node


def switch(c: Component) -> None:
    """The value of the first test that holds, else the default, else 0; then delay and clipping."""
    value = c.builder.constant(0.0)
    for node in c.node.all("default"):
        c.scope.only(node, ("value",))
        value = _value(c.scope, node)
    for node in reversed(c.node.all("test")):
        c.scope.only(node, ("value", "logic"))
        value = condition(c.scope, node).choose(_value(c.scope, node), value)
    c.put(c.clipped(c.delayed(value)))


def distributor(c: Component) -> None:
    """Each case whose test holds (``exclusive``: the first of them), and each without a test, sets its properties, in order."""
    kind = c.node.attributes.get("type", "")
    if kind not in ("inclusive", "exclusive"):
        c.scope.refuse(
            c.node, f"type='{kind}' of <distributor>: allowed are inclusive and exclusive"
        )
    done = c.builder.truth(False)
    for case in c.node.all("case"):
        c.scope.only(case)
        for child in case.children:
            if child.tag not in ("test", "property", "description"):
                c.scope.refuse(
                    child,
                    f"<{child.tag}> in <case> is not understood; allowed are test and property",
                )
        tests = case.all("test")
        if len(tests) > 1:
            c.scope.refuse(tests[1], "a <case> has one <test>: JSBSim takes the first")
        chosen = c.builder.truth(True)
        for test in tests:
            c.scope.only(test, ("logic",))
            chosen = condition(c.scope, test)
            if kind == "exclusive":
                chosen = c.builder.op("and", chosen, c.builder.op("not", done))
            done = c.builder.op("or", done, chosen)
        for node in case.all("property"):
            c.scope.only(node, ("value",))
            name = property_of(c.scope, node, node.text)
            if c.frame.written is None and name not in c.frame.values:
                c.scope.refuse(node, f"property {name} does not exist")
            before = c.frame.get(name)
            c.write(node, name, chosen.choose(_value(c.scope, node), before))


def _value(scope: Scope, node: Node) -> Value:
    text = node.attributes.get("value", "")
    if not text.strip():
        scope.refuse(node, f"<{node.tag}> has attribute value; JSBSim leaves it out without")
    return scope.parameter(node, text)
