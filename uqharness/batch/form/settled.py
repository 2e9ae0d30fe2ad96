"""What never changes in a flight although something writes it: found over all frames at once, and folded.

Constant propagation through the frames (Wegman and Zadeck 1991): every slot is taken for constant until a store says otherwise. A
section that no lane ever runs is left out, one that all lanes always run loses its mask.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping, MutableMapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uqharness.batch.form.ir import Builder, Function, Value
from uqharness.batch.form.passes import lowered
from uqharness.batch.form.program import Program, Section
from uqharness.batch.form.semantics import F64, I1, I64, TABLE, computed

Known = MutableMapping[str, float | None]
"""Slots to their only value, None where they have several."""


def settled(
    before: Sequence[Program],
    program: Program,
    varying: Collection[str],
    between: Sequence[Program] = (),
) -> Program:
    """``program`` with what is constant folded, when programs ``before`` have each run one frame.

    varying: slots that differ between lanes before the first of them. between: programs that run any number of frames before it.
    """
    known: Known = {}
    for one in before:
        one = lowered(one)
        _begin(known, one, varying)
        for section in one.sections:
            _step(known, section, once=True)
    sections = [section for one in between for section in lowered(one).sections]
    for one in between:
        _begin(known, one, varying)
    while sum(_step(known, section, once=False) for section in sections):
        pass
    written = lowered(program)
    _begin(known, written, varying)
    for stream in written.streams:
        known.update(dict.fromkeys(stream.columns))
    while sum(_step(known, section, once=False) for section in written.sections):
        pass
    # Folded before it is written out: a transcendental function of a constant is then one constant.
    folded = [_folded(section, known) for section in program.sections]
    return replace(program, sections=tuple(s for s in folded if s is not None))


def _begin(known: Known, program: Program, varying: Collection[str]) -> None:
    for name, value in program.slots.items():
        known.setdefault(name, None if name in varying else value)


def _step(known: Known, section: Section, once: bool) -> bool:
    """Take one section into account; whether it taught anything. ``once``: it runs now, and not again."""
    mask = None if section.when.mask is None else known.get(section.when.mask)
    if section.when.mask is not None and mask == 0.0:
        return False
    sure = once and (section.when.mask is None or mask is not None)
    stores = _values(section.function, known)
    changed = False
    for name, value in stores.items():
        old = known.get(name)
        if sure:
            known[name] = value
        elif old is not None and not _same(old, value):
            known[name], changed = None, True
    return changed


def _same(a: float, b: float | None) -> bool:
    return b is not None and struct.pack("<d", a) == struct.pack("<d", b)


def _values(function: Function, known: Mapping[str, float | None]) -> dict[str, float | None]:
    """What a function stores, None where that is not one number."""
    values: list[Any] = []
    for node in function.nodes:
        if node.operation == "const":
            values.append(node.value)
        elif node.operation == "load":
            values.append(known.get(node.name))
        elif node.operation == "select" and values[node.arguments[0]] is not None:
            values.append(values[node.arguments[1 if values[node.arguments[0]] else 2]])
        elif node.operation in ("and", "or"):
            values.append(_junction(node.operation, [values[i] for i in node.arguments]))
        elif node.operation == "input" or any(values[i] is None for i in node.arguments):
            values.append(None)
        else:
            arguments = [_MAKE[function.nodes[i].kind](values[i]) for i in node.arguments]
            values.append(computed(node.operation, arguments).item())
    return {name: values[i] for name, i in function.stores.items()}


def _junction(operation: str, values: Sequence[bool | None]) -> bool | None:
    deciding = operation == "or"
    if any(v is not None and bool(v) == deciding for v in values):
        return deciding
    return None if any(v is None for v in values) else not deciding


_MAKE: Mapping[str, Any] = {F64: np.float64, I64: np.int64, I1: np.bool_, TABLE: np.array}


def _folded(section: Section, known: Mapping[str, float | None]) -> Section | None:
    when = section.when
    if when.mask is not None and (mask := known.get(when.mask)) is not None:
        if mask == 0.0:
            return None
        when = replace(when, mask=None)
    builder = Builder()
    values: list[Value] = []
    for node in section.function.nodes:
        constant = known.get(node.name) if node.operation == "load" else None
        arguments = [values[i] for i in node.arguments]
        values.append(
            builder.again(node, arguments) if constant is None else builder.constant(constant)
        )
    stores = {
        name: values[i] for name, i in section.function.stores.items() if known.get(name) is None
    }
    return replace(section, function=builder.finish({}, stores), when=when)
