"""Passes over programs. None changes a bit of what is recorded, or of the slots that are to be
kept.

``optimised`` puts them together. Slots that only sections know may stand at other values behind it,
or be missing."""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Iterable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uqharness.batch.form.ir import (
    F64,
    I1,
    I64,
    TABLE,
    Builder,
    Function,
    Value,
    computed,
    slots_read,
    storing,
)
from uqharness.batch.form.maths import lower
from uqharness.batch.form.program import Program, Section, When

# Values that are stored more often than anyone looks are computed in the frames in which
# someone does.
#
# Code sinking (Muchnick 1997, section 18) over frames: what only sections of every n-th frame
# load, or records alone, moves into a section of every n-th frame behind the one that stored
# it.

PASSED = "#passed/"
"""The begin of the names of slots that hand values on to what has been moved."""

_STORE = 2
"""What a slot more costs, in operations."""


def sunk(program: Program, keep: Collection[str] = (), stride: int = 1) -> Program:
    """The program with such values moved; no bit changes of what is recorded in frames that
    ``stride`` divides, nor of ``keep``.

    Behind a call that ends in another frame a moved slot is as old as the last frame in which it
    was computed."""
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
    """Whether a part that has been moved loads the slot in frames that ``every`` does not
    divide.
    """
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
    """All nodes that the goals are made of; what stands behind the nodes of ``edge`` is
    left out.
    """
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


ONCE = "#once/"
"""The begin of the names of slots whose values are computed before the first frame of a call."""

_EFFORT = {"div": 5, "sqrt": 8, "load": 1, "const": 0, "bits": 0, "double": 0, "lookup": 6}
"""What operations cost, roughly, in simple ones (1)."""

_MANY = 1000
"""Efforts are not counted beyond it: parts that are shared count again and again."""

_WORTH = 2
"""A value is computed beforehand if it costs at least so much: then to load it is cheaper."""


def lowered(program: Program) -> Program:
    """The program with every transcendental operation written out (``form.maths.lower``)."""
    sections = tuple(
        replace(section, function=lower(section.function)) for section in program.sections
    )
    return replace(
        program,
        sections=sections,
        prelude=None if program.prelude is None else lower(program.prelude),
    )


def optimised(program: Program, keep: Collection[str] = (), stride: int = 1) -> Program:
    """The program written out, with less work: sections joined, what nobody needs left out, what
    never changes done before, what is seldom looked at done when it is.

    ``keep`` are slots that are read from the state behind a call; records are kept anyway, in
    frames that ``stride`` divides. Slots that are no longer used are gone."""
    program = alive(joined(alive(lowered(program), keep)), keep)
    return trimmed(hoisted(joined(sunk(program, keep, stride))), keep)


def for_what_follows(
    first: Program, second: Program, program: Program, keep: Collection[str]
) -> tuple[Program, Program]:
    """Two programs that each run one frame before ``program``, without what neither it nor ``keep``
    needs; written out.
    """
    wanted = {*program.slots, *keep}
    later = lowered(alive(joined(second), wanted))
    loaded = {name for section in later.sections for name in section.function.slots}
    masks = {section.when.mask for section in later.sections if section.when.mask is not None}
    return lowered(alive(joined(first), wanted | loaded | masks)), later


def joined(program: Program) -> Program:
    """Neighbours that run at the same times and in the same lanes made one section, so that values
    pass without memory and what both compute is computed once. Sections that store nothing go."""
    groups: list[list[Section]] = []
    for section in (s for s in program.sections if s.function.stores):
        group = groups[-1] if groups else None
        mask = section.when.mask
        if (
            group is None
            or group[0].when != section.when
            or any(mask in other.function.stores for other in group)
        ):
            groups.append([section])
        else:
            group.append(section)
    return replace(
        program, sections=tuple(group[0] if len(group) == 1 else _one(group) for group in groups)
    )


def _one(sections: Sequence[Section]) -> Section:
    builder = Builder()
    for section in sections:
        values: list[Value] = []
        for node in section.function.nodes:
            values.append(builder.again(node, [values[i] for i in node.arguments]))
        for slot, index in section.function.stores.items():
            builder.store(slot, values[index])
    return Section(
        ", ".join(section.name for section in sections), builder.finish({}), sections[0].when
    )


def alive(program: Program, keep: Collection[str] = ()) -> Program:
    """Without stores that nothing needs: no section of this or a later frame that has an effect, no
    mask, no counter, no record.
    """
    while True:
        needed = _needed(program, frozenset(keep) | frozenset(program.records))
        sections = []
        for section, live in zip(program.sections, needed, strict=True):
            nodes = section.function.nodes
            stores = {
                slot: index
                for slot, index in section.function.stores.items()
                if slot in live and (nodes[index].operation, nodes[index].name) != ("load", slot)
            }
            if len(stores) == len(section.function.stores):
                sections.append(section)
            elif stores:
                sections.append(replace(section, function=storing(section.function, stores)))
        if tuple(sections) == program.sections:
            return program
        program = replace(program, sections=tuple(sections))


def _needed(program: Program, behind: frozenset[str]) -> list[frozenset[str]]:
    """For each section the slots whose values behind it somebody needs: the least solution around
    the frames' circle.
    """
    reads = [slots_read(section.function) for section in program.sections]
    end = behind
    while True:
        live, found = end, []
        for section, read in zip(reversed(program.sections), reversed(reads), strict=True):
            found.append(live)
            wanted = {slot for goal, slots in read.items() if goal in live for slot in slots}
            if wanted or any(goal in live for goal in read):
                wanted |= {section.when.mask} if section.when.mask else set()
            live = (live - frozenset(read) if section.when == When() else live) | wanted
        for stream in program.streams:
            if stream.every == 1:
                live -= frozenset(stream.columns)
        live |= {stream.counter for stream in program.streams if stream.counter}
        if live <= end:
            return found[::-1]
        end |= live


def hoisted(program: Program) -> Program:
    """What depends on constants and slots that no frame changes is computed before the first frame
    of a call, in ``prelude``.

    Of such values those are kept, in slots '#once/<k>', that something else uses and that cost more
    than a load. Raises ValueError for a program that has a prelude."""
    if program.prelude is not None:
        raise ValueError("the program has a prelude")
    changing = {slot for section in program.sections for slot in section.function.stores}
    changing |= {slot for stream in program.streams for slot in stream.columns}
    before = Builder()
    places: dict[int, str] = {}
    sections = tuple(
        replace(s, function=_hoisted(s.function, changing, before, places))
        for s in program.sections
    )
    if not places:
        return program
    prelude = before.finish({}, {name: Value(before, index) for index, name in places.items()})
    slots = {**program.slots, **dict.fromkeys(places.values(), 0.0)}
    return replace(program, sections=sections, slots=slots, prelude=prelude)


def _hoisted(
    function: Function, changing: set[str], before: Builder, places: dict[int, str]
) -> Function:
    """The function with loads in the place of what is computed in ``before``; ``places`` are values
    of it and their slots.
    """
    fixed, effort = _fixed(function, changing)
    builder = Builder()
    early: list[Value | None] = []
    late: list[Value | None] = []

    def value(index: int) -> Value:
        """A node's value in the frame: loaded if it is made beforehand and worth it, else
        computed.
        """
        known = late[index]
        if known is not None:
            return known
        node, first = function.nodes[index], early[index]
        if first is not None and first.constant is not None:
            made = builder.constant(first.constant, first.kind)
        elif first is not None and node.kind == F64 and effort[index] >= _WORTH:
            made = builder.load(places.setdefault(first.index, f"{ONCE}{len(places)}"))
        elif first is not None and node.kind == I1 and effort[index] > _WORTH:
            number = first.choose(1.0, 0.0)
            made = builder.load(places.setdefault(number.index, f"{ONCE}{len(places)}")).ne(0.0)
        else:
            made = builder.op(node.operation, *[value(i) for i in node.arguments])
        late[index] = made
        return made

    for index, node in enumerate(function.nodes):
        late.append(None if node.arguments else builder.again(node, ()))
        early.append(None)
        if fixed[index]:
            arguments = [early[i] for i in node.arguments]
            early[index] = before.again(node, [a for a in arguments if a is not None])
        elif node.arguments:
            value(index)
    return builder.finish({}, {slot: value(index) for slot, index in function.stores.items()})


def _fixed(function: Function, changing: set[str]) -> tuple[list[bool], list[int]]:
    """Of each node whether it stays the same in all frames, and roughly what it costs with all it
    is made of.
    """
    fixed: list[bool] = []
    effort: list[int] = []
    for node in function.nodes:
        if node.operation == "load":
            fixed.append(node.name not in changing)
        else:
            fixed.append(all(fixed[i] for i in node.arguments))
        inside = sum(effort[i] for i in node.arguments if function.nodes[i].operation != "load")
        effort.append(min(_EFFORT.get(node.operation, 1) + inside, _MANY))
    return fixed, effort


def trimmed(program: Program, keep: Collection[str] = ()) -> Program:
    """Without slots that nothing uses, and the others in the order in which a frame uses them."""
    used: dict[str, None] = {}
    for stream in program.streams:
        used |= dict.fromkeys((*stream.columns, *((stream.counter,) if stream.counter else ())))
    for section in program.sections:
        used |= dict.fromkeys(
            ((section.when.mask,) if section.when.mask else ()) + section.function.slots
        )
    used |= dict.fromkeys((*program.records, *keep))
    if program.prelude is not None:
        used |= dict.fromkeys(program.prelude.slots)
    return replace(program, slots={name: program.slots[name] for name in used})


# What never changes in a flight although something writes it: found over all frames at once,
# and folded.
#
# Constant propagation through the frames (Wegman and Zadeck 1991): every slot is taken for
# constant until a store says otherwise. A section that no lane ever runs is left out, one that
# all lanes always run loses its mask.

Known = MutableMapping[str, float | None]
"""Slots to their only value, None where they have several."""


def settled(
    before: Sequence[Program],
    program: Program,
    varying: Collection[str],
    between: Sequence[Program] = (),
) -> Program:
    """``program`` with what is constant folded, when programs ``before`` have each run one frame.

    varying: slots that differ between lanes before the first of them. between: programs that run
    any number of frames before it."""
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
    """Take one section into account; whether it taught anything.

    ``once``: it runs now, and not again.
    """
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
