"""Values that are stored more often than anyone looks are computed in the frames in which someone does.

Code sinking (Muchnick 1997, section 18) over frames: what only sections of every n-th frame load, or records alone, moves into a
section of every n-th frame behind the one that stored it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from uqharness.batch.form.ir import Builder, Function, Value
from uqharness.batch.form.program import Program, Section, When
from uqharness.batch.form.semantics import F64, I1

PASSED = "#passed/"
"""The begin of the names of slots that hand values on to what has been moved."""

_STORE = 2
"""What a slot more costs, in operations."""


def sunk(program: Program, keep: Collection[str] = (), stride: int = 1) -> Program:
    """The program with such values moved; no bit changes of what is recorded in frames that ``stride`` divides, nor of ``keep``.

    Behind a call that ends in another frame a moved slot is as old as the last frame in which it was computed.
    """
    intervals = _intervals(program, frozenset(keep), stride)
    sections: list[Section] = []
    slots = dict(program.slots)
    for section in program.sections:
        by_interval: dict[int, list[str]] = {}
        for name in section.function.stores:
            every = intervals.get(name, 0)
            if every > section.when.every and every % section.when.every == 0:
                by_interval.setdefault(every, []).append(name)
        # The rarest first: what is left is then split again.
        moved: list[Section] = []
        for every in sorted(by_interval, reverse=True):
            free = [
                name for name in by_interval[every] if not _needed_more_often(name, every, moved)
            ]
            parts = (
                _split(section.function, free, every // section.when.every, len(slots))
                if free
                else None
            )
            if parts is not None:
                section = replace(section, function=parts.left)
                moved.insert(
                    0,
                    Section(f"{section.name}: in every {every}th", parts.moved, When(every=every)),
                )
                slots |= dict.fromkeys(parts.passed, 0.0)
        sections += [section, *moved]
    return replace(program, sections=tuple(sections), slots=slots)


def _intervals(program: Program, keep: frozenset[str], stride: int) -> dict[str, int]:
    """Slots that may be moved to the interval of frames in which they are looked at."""
    writers: dict[str, list[int]] = {}
    readers: dict[str, list[int]] = {}
    for place, section in enumerate(program.sections):
        for name in section.function.stores:
            writers.setdefault(name, []).append(place)
        for node in section.function.nodes:
            if node.operation == "load":
                readers.setdefault(node.name, []).append(place)
    fixed = set(keep) | {section.when.mask for section in program.sections}
    fixed |= {name for stream in program.streams for name in (*stream.columns, stream.counter)}
    out = {}
    for name, (place, *others) in writers.items():
        when = program.sections[place].when
        read = readers.get(name, [])
        if (
            name in fixed
            or others
            or when != When(every=when.every)
            or any(r <= place for r in read)
        ):
            continue
        looks = [program.sections[r].when for r in read]
        if all(look.at is None for look in looks):
            out[name] = math.gcd(
                *(look.every for look in looks), *((stride,) if name in program.records else ())
            )
    return out


def _needed_more_often(name: str, every: int, moved: Sequence[Section]) -> bool:
    """Whether a part that has been moved loads the slot in frames that ``every`` does not divide."""
    return any(part.when.every % every and name in part.function.slots for part in moved)


@dataclass(frozen=True)
class _Parts:
    """A function in two: what stays, what goes, and the slots between them that are new."""

    left: Function
    moved: Function
    passed: tuple[str, ...]


def _split(function: Function, names: Collection[str], turns: int, number: int) -> _Parts | None:
    """The stores ``names`` apart, which run once in ``turns``; None if that saves nothing."""
    stays = {name: index for name, index in function.stores.items() if name not in names}
    goes = {name: function.stores[name] for name in names}
    kept = _cone(function, stays.values(), ())
    stored = {index: name for name, index in stays.items()}
    passed: dict[int, str] = {}

    def crosses(index: int) -> bool:
        """Whether what goes takes this value from a slot."""
        node = function.nodes[index]
        if node.operation == "const" or (node.kind == I1 and index not in stored):
            return False
        if node.operation == "load":
            return node.name in function.stores
        return index in kept and node.kind == F64

    edge = [index for index in range(len(function.nodes)) if crosses(index)]
    cone = _cone(function, goes.values(), edge)
    for index in sorted(cone & set(edge)):
        if index not in stored:
            passed[index] = f"{PASSED}{number + len(passed)}"
    own = sum(1 for index in cone - kept if function.nodes[index].arguments)
    again = sum(1 for index in cone & kept if function.nodes[index].arguments and index not in edge)
    if own * (turns - 1) <= again + _STORE * len(passed) * turns:
        return None
    left, values = _rebuilt(function, kept | set(passed), {})
    left_stores = {name: values[index] for name, index in stays.items()}
    left_stores |= {name: values[index] for index, name in passed.items()}
    moved, there = _rebuilt(function, cone, {**stored, **passed})
    first = left.finish({}, left_stores)
    return _Parts(
        first,
        moved.finish({}, {name: there[index] for name, index in goes.items()}),
        tuple(passed.values()),
    )


def _cone(function: Function, goals: Iterable[int], edge: Collection[int]) -> set[int]:
    """All nodes that the goals are made of; what stands behind the nodes of ``edge`` is left out."""
    found: set[int] = set()
    todo, stop = list(goals), set(edge)
    while todo:
        index = todo.pop()
        if index not in found:
            found.add(index)
            todo += () if index in stop else function.nodes[index].arguments
    return found


def _rebuilt(
    function: Function, wanted: Collection[int], slots: Mapping[int, str]
) -> tuple[Builder, dict[int, Value]]:
    """Those nodes in a new builder, some of them loaded from slots."""
    builder = Builder()
    values: dict[int, Value] = {}
    for index in sorted(wanted):
        node = function.nodes[index]
        if index in slots:
            values[index] = builder.load(slots[index])
        else:
            values[index] = builder.again(node, [values[i] for i in node.arguments])
    return builder, values
