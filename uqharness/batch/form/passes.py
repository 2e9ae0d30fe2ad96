"""Passes over programs. None changes a bit of what is recorded, or of the slots that are to be kept.

``optimised`` puts them together. Slots that only sections know may stand at other values behind it, or be missing.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from uqharness.batch.form.ir import Builder, Function, Value, slots_read, storing
from uqharness.batch.form.maths import lower
from uqharness.batch.form.program import Program, Section, When
from uqharness.batch.form.semantics import F64, I1
from uqharness.batch.form.sinking import sunk

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
    """The program written out, with less work: sections joined, what nobody needs left out, what never changes done before, what is
    seldom looked at done when it is.

    ``keep`` are slots that are read from the state behind a call; records are kept anyway, in frames that ``stride`` divides. Slots
    that are no longer used are gone.
    """
    program = alive(joined(alive(lowered(program), keep)), keep)
    return trimmed(hoisted(joined(sunk(program, keep, stride))), keep)


def for_what_follows(
    first: Program, second: Program, program: Program, keep: Collection[str]
) -> tuple[Program, Program]:
    """Two programs that each run one frame before ``program``, without what neither it nor ``keep`` needs; written out."""
    wanted = {*program.slots, *keep}
    later = lowered(alive(joined(second), wanted))
    loaded = {name for section in later.sections for name in section.function.slots}
    masks = {section.when.mask for section in later.sections if section.when.mask is not None}
    return lowered(alive(joined(first), wanted | loaded | masks)), later


def joined(program: Program) -> Program:
    """Neighbours that run at the same times and in the same lanes made one section, so that values pass without memory and what
    both compute is computed once. Sections that store nothing go."""
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
    """Without stores that nothing needs: no section of this or a later frame that has an effect, no mask, no counter, no record."""
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
    """For each section the slots whose values behind it somebody needs: the least solution around the frames' circle."""
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
    """What depends on constants and slots that no frame changes is computed before the first frame of a call, in ``prelude``.

    Of such values those are kept, in slots '#once/<k>', that something else uses and that cost more than a load. Raises ValueError
    for a program that has a prelude.
    """
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
    """The function with loads in the place of what is computed in ``before``; ``places`` are values of it and their slots."""
    fixed, effort = _fixed(function, changing)
    builder = Builder()
    early: list[Value | None] = []
    late: list[Value | None] = []

    def value(index: int) -> Value:
        """A node's value in the frame: loaded if it is made beforehand and worth it, else computed."""
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
    """Of each node whether it stays the same in all frames, and roughly what it costs with all it is made of."""
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
