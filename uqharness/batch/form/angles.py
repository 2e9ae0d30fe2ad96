"""Angles that are made from their own sine and cosine: who asks for these again is given them, without the angle.

What publishes an angle in a slot may keep its sine and cosine beside it, in slots ``SINE`` and ``COSINE`` with its name.
"""

from __future__ import annotations

from dataclasses import replace

from uqharness.batch.form.ir import Builder, Node, Value, rebuilt
from uqharness.batch.form.program import Program

SINE, COSINE = "#sine/", "#cosine/"
"""Begins of the names of slots that have the sine and cosine of the angle in the slot named behind them."""

_PREFIXES = {"sin": SINE, "cos": COSINE}


def without_angles(program: Program) -> Program:
    """The program with sines and cosines of such slots, and of their negatives, read in the place of computed.

    A slot counts if each section that stores it stores its sine and cosine too and no stream feeds it. Before the first section
    that stores it its sine and cosine are what their slots begin with.
    """
    fed = {name for stream in program.streams for name in stream.columns}
    angles = {name.removeprefix(SINE) for name in program.slots if name.startswith(SINE)} - fed
    for section in program.sections:
        stored = section.function.stores
        angles -= {
            name
            for name in angles
            if name in stored and not (SINE + name in stored and COSINE + name in stored)
        }

    def rule(builder: Builder, node: Node, arguments: list[Value]) -> Value:
        prefix = _PREFIXES[node.operation]
        of = builder.nodes[arguments[0].index]
        negative = of.operation == "neg"
        if negative:
            of = builder.nodes[of.arguments[0]]
        if of.operation != "load" or of.name not in angles:
            return builder.op(node.operation, *arguments)
        found = builder.load(prefix + of.name)
        return -found if negative and prefix == SINE else found

    if not angles:
        return program
    return replace(
        program,
        sections=tuple(
            replace(s, function=rebuilt(s.function, _PREFIXES, rule)) for s in program.sections
        ),
    )
