"""Optimise programs: textbook compiler passes, applied over frames.

No pass changes a bit of the records or of the slots that are kept. `optimise` applies dead-store
elimination, fusion of sections, code sinking, hoisting of invariants and pruning of slots;
`propagate_constants` and `specialise_startup` are used where a flight starts. Slots that only
sections use may have other values afterwards, or be removed.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from uqharness.batch.ir import (
    F64,
    I1,
    NUMPY_TYPES,
    TRANSCENDENTAL,
    Builder,
    Function,
    Value,
    apply_operation,
    restrict_stores,
    same_bits,
    slots_read,
)
from uqharness.batch.maths import fold, lower
from uqharness.batch.program import Program, Section, When

# Code sinking (Muchnick 1997, section 18) over frames: values that only sections of every n-th
# frame load, or that only records use, move into a section of every n-th frame that follows the
# one that stored them.

PASSED = "#passed/"
"""Prefix of slots that pass values from a section to its moved part."""

_STORE = 2
"""Cost of a further slot, in operations."""


def sink(program: Program, keep: Collection[str] = (), stride: int = 1) -> Program:
    """Move stores into sections that run only as often as the stores are used.

    Parameters
    ----------
    program : Program
        The program.
    keep : collection of str
        Slots that must be up to date after every call.
    stride : int
        Records are exact in frames that it divides.

    Returns
    -------
    Program
        After a call that ends in another frame, a moved slot has the value of the last frame in
        which it was computed.
    """
    intervals = _sinking_intervals(program, frozenset(keep), stride)
    sections: list[Section] = []
    slots = dict(program.slots)
    for section in program.sections:
        by_interval: dict[int, list[str]] = {}
        for name in section.function.stores:
            every = intervals.get(name, 0)
            # Only multiples of the section's own interval can be split off.
            if every > section.when.every and every % section.when.every == 0:
                by_interval.setdefault(every, []).append(name)
        # Start with the longest interval; what remains can be split again.
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
                section = replace(section, function=parts.remaining)
                moved.insert(
                    0,
                    Section(f"{section.name}: in every {every}th", parts.moved, When(every=every)),
                )
                slots |= dict.fromkeys(parts.passed, 0.0)
        sections += [section, *moved]
    return replace(program, sections=tuple(sections), slots=slots)


def _sinking_intervals(program: Program, keep: frozenset[str], stride: int) -> dict[str, int]:
    """Return the slots that may be moved, and the interval of frames in which they are used."""
    writers: dict[str, list[int]] = {}
    readers: dict[str, list[int]] = {}
    for place, section in enumerate(program.sections):
        for name in section.function.stores:
            writers.setdefault(name, []).append(place)
        for node in section.function.nodes:
            if node.operation == "load":
                readers.setdefault(node.name, []).append(place)
    # Masks, counters and slots of streams are used in every frame.
    fixed = set(keep) | {section.when.mask for section in program.sections}
    fixed |= {name for stream in program.streams for name in (*stream.columns, stream.counter)}
    out = {}
    for name, (place, *further_writers) in writers.items():
        when = program.sections[place].when
        read = readers.get(name, [])
        if (
            name in fixed
            or further_writers
            or when != When(every=when.every)
            or any(r <= place for r in read)
        ):
            continue
        reader_times = [program.sections[r].when for r in read]
        # One interval covers all readers: the greatest common divisor of theirs.
        if all(reader.at is None for reader in reader_times):
            out[name] = math.gcd(
                *(reader.every for reader in reader_times),
                *((stride,) if name in program.records else ()),
            )
    return out


def _needed_more_often(name: str, every: int, moved: Sequence[Section]) -> bool:
    """Return whether a part that has been moved loads the slot in frames that ``every`` does not
    divide.
    """
    return any(part.when.every % every and name in part.function.slots for part in moved)


@dataclass(frozen=True)
class _Parts:
    """A function in two parts: the remaining one, the moved one, and the new slots between them."""

    remaining: Function
    moved: Function
    passed: tuple[str, ...]


def _split(function: Function, names: Collection[str], turns: int, number: int) -> _Parts | None:
    """Split the stores ``names`` off, to run once in ``turns``; None if that saves nothing."""
    staying = {name: index for name, index in function.stores.items() if name not in names}
    moving = {name: function.stores[name] for name in names}
    retained = _cone(function, staying.values(), ())
    stored = {index: name for name, index in staying.items()}
    passed: dict[int, str] = {}

    def crosses(index: int) -> bool:
        """Return whether the moved part takes this value from a slot."""
        node = function.nodes[index]
        if node.operation == "const" or (node.kind == I1 and index not in stored):
            return False
        if node.operation == "load":
            return node.name in function.stores
        return index in retained and node.kind == F64

    # Values on the edge are computed by the remaining part and passed through slots.
    edge = [index for index in range(len(function.nodes)) if crosses(index)]
    cone = _cone(function, moving.values(), edge)
    for index in sorted(cone & set(edge)):
        if index not in stored:
            passed[index] = f"{PASSED}{number + len(passed)}"
    exclusive = sum(1 for index in cone - retained if function.nodes[index].arguments)
    duplicated = sum(
        1 for index in cone & retained if function.nodes[index].arguments and index not in edge
    )
    # Saved work against work done twice and the cost of further slots.
    if exclusive * (turns - 1) <= duplicated + _STORE * len(passed) * turns:
        return None
    builder, values = _copy_nodes(function, retained | set(passed), {})
    remaining_stores = {name: values[index] for name, index in staying.items()}
    remaining_stores |= {name: values[index] for index, name in passed.items()}
    moved, moved_values = _copy_nodes(function, cone, {**stored, **passed})
    return _Parts(
        builder.finish({}, remaining_stores),
        moved.finish({}, {name: moved_values[index] for name, index in moving.items()}),
        tuple(passed.values()),
    )


def _cone(function: Function, goals: Iterable[int], edge: Collection[int]) -> set[int]:
    """Return all nodes that the goals depend on, up to the nodes of ``edge``."""
    nodes: set[int] = set()
    todo, stop = list(goals), set(edge)
    while todo:
        index = todo.pop()
        if index not in nodes:
            nodes.add(index)
            todo += () if index in stop else function.nodes[index].arguments
    return nodes


def _copy_nodes(
    function: Function, nodes: Collection[int], slots: Mapping[int, str]
) -> tuple[Builder, dict[int, Value]]:
    """Copy nodes into a new builder, some of them as loads from slots."""
    builder = Builder()
    values: dict[int, Value] = {}
    for index in sorted(nodes):
        node = function.nodes[index]
        if index in slots:
            values[index] = builder.load(slots[index])
        else:
            values[index] = builder.copy_node(node, [values[i] for i in node.arguments])
    return builder, values


ONCE = "#once/"
"""Prefix of slots that the prelude computes."""

_EFFORTS = {"div": 5, "sqrt": 8, "load": 1, "const": 0, "bits": 0, "double": 0, "lookup": 6}
"""Rough cost of operations, in simple ones (1)."""

_MAX_EFFORT = 1000
"""Costs saturate here, because shared nodes are counted more than once."""

_MIN_EFFORT = 2
"""Cost from which loading a hoisted value is cheaper than computing it."""


def lower_program(program: Program) -> Program:
    """Expand every transcendental operation (`maths.lower`)."""
    sections = tuple(
        replace(section, function=lower(section.function)) for section in program.sections
    )
    return replace(
        program,
        sections=sections,
        prelude=None if program.prelude is None else lower(program.prelude),
    )


def optimise(program: Program, keep: Collection[str] = (), stride: int = 1) -> Program:
    """Apply all passes.

    Parameters
    ----------
    program : Program
        Before or after `maths.lower`.
    keep : collection of str
        Slots that are read from the state after a call.
    stride : int
        Records are exact in frames that it divides.

    Returns
    -------
    Program
        Without slots that are no longer used.
    """
    # Dead stores first, so that fusion sees fewer sections; again after it, because fused sections
    # share loads.
    program = eliminate_dead_stores(
        fuse_sections(eliminate_dead_stores(lower_program(program), keep)), keep
    )
    return prune_slots(hoist_invariants(fuse_sections(sink(program, keep, stride))), keep)


def specialise_startup(
    first: Program, second: Program, program: Program, keep: Collection[str]
) -> tuple[Program, Program]:
    """Prepare two programs that each run one frame before ``program``: expand them and remove what
    neither ``program`` nor ``keep`` needs.
    """
    needed = {*program.slots, *keep}
    second_lowered = lower_program(eliminate_dead_stores(fuse_sections(second), needed))
    loaded = {name for section in second_lowered.sections for name in section.function.slots}
    masks = {
        section.when.mask for section in second_lowered.sections if section.when.mask is not None
    }
    return lower_program(
        eliminate_dead_stores(fuse_sections(first), needed | loaded | masks)
    ), second_lowered


def fuse_sections(program: Program) -> Program:
    """Fuse adjacent sections that run at the same times and in the same lanes.

    Values then pass without memory, and common subexpressions are computed once. Sections without
    stores are removed.
    """
    groups: list[list[Section]] = []
    for section in (s for s in program.sections if s.function.stores):
        group = groups[-1] if groups else None
        mask = section.when.mask
        if (
            group is None
            or group[0].when != section.when
            # A section whose mask is stored by the group must see the new mask.
            or any(mask in other.function.stores for other in group)
        ):
            groups.append([section])
        else:
            group.append(section)
    return replace(
        program,
        sections=tuple(group[0] if len(group) == 1 else _merge_group(group) for group in groups),
    )


def _merge_group(sections: Sequence[Section]) -> Section:
    """Merge sections into one."""
    builder = Builder()
    for section in sections:
        values: list[Value] = []
        for node in section.function.nodes:
            values.append(builder.copy_node(node, [values[i] for i in node.arguments]))
        for slot, index in section.function.stores.items():
            builder.store(slot, values[index])
    return Section(
        ", ".join(section.name for section in sections), builder.finish({}), sections[0].when
    )


def eliminate_dead_stores(program: Program, keep: Collection[str] = ()) -> Program:
    """Remove stores that no section of this or a later frame, mask, counter or record uses."""
    while True:
        # Removing a store may make further stores dead, so iterate.
        needed = _live_slots(program, frozenset(keep) | frozenset(program.records))
        sections = []
        for section, live in zip(program.sections, needed, strict=True):
            nodes = section.function.nodes
            stores = {
                slot: index
                for slot, index in section.function.stores.items()
                # A store of the value just loaded changes nothing.
                if slot in live and (nodes[index].operation, nodes[index].name) != ("load", slot)
            }
            if len(stores) == len(section.function.stores):
                sections.append(section)
            elif stores:
                sections.append(
                    replace(section, function=restrict_stores(section.function, stores))
                )
        if tuple(sections) == program.sections:
            return program
        program = replace(program, sections=tuple(sections))


def _live_slots(program: Program, end_slots: frozenset[str]) -> list[frozenset[str]]:
    """Return for each section the slots that are live after it: the least fixed point of liveness
    around the loop of frames.
    """
    reads = [slots_read(section.function) for section in program.sections]
    end = end_slots
    while True:
        live, by_section = end, []
        for section, read in zip(reversed(program.sections), reversed(reads), strict=True):
            by_section.append(live)
            read_slots = {slot for goal, slots in read.items() if goal in live for slot in slots}
            if read_slots or any(goal in live for goal in read):
                read_slots |= {section.when.mask} if section.when.mask else set()
            # Only a section that runs in every frame and lane kills a slot.
            live = (live - frozenset(read) if section.when == When() else live) | read_slots
        for stream in program.streams:
            if stream.every == 1:
                live -= frozenset(stream.columns)
        live |= {stream.counter for stream in program.streams if stream.counter}
        if live <= end:
            return by_section[::-1]
        end |= live


def hoist_invariants(program: Program) -> Program:
    """Compute values that no frame changes in the prelude.

    Values that other nodes use and that cost more than a load are kept in slots '#once/<k>'. Raises
    ValueError if the program has a prelude.
    """
    if program.prelude is not None:
        raise ValueError("the program has a prelude")
    # A slot that some section stores or some stream feeds is not invariant.
    changing = {slot for section in program.sections for slot in section.function.stores}
    changing |= {slot for stream in program.streams for slot in stream.columns}
    prelude_builder = Builder()
    places: dict[int, str] = {}
    sections = tuple(
        replace(s, function=_hoist_section(s.function, changing, prelude_builder, places))
        for s in program.sections
    )
    if not places:
        return program
    prelude = prelude_builder.finish(
        {}, {name: Value(prelude_builder, index) for index, name in places.items()}
    )
    slots = {**program.slots, **dict.fromkeys(places.values(), 0.0)}
    return replace(program, sections=sections, slots=slots, prelude=prelude)


def _hoist_section(
    function: Function, changing: set[str], prelude: Builder, places: dict[int, str]
) -> Function:
    """Return a section with loads in place of hoisted values.

    ``prelude`` collects these values; ``places`` maps its nodes to slots.
    """
    # Invariant nodes are built in the prelude, the others in the new section.
    fixed, effort = _invariant_nodes(function, changing)
    builder = Builder()
    early: list[Value | None] = []
    late: list[Value | None] = []

    def value(index: int) -> Value:
        """Return a node's value in the frame: loaded if it is hoisted and worth a load, else
        computed.
        """
        # Built already.
        cached = late[index]
        if cached is not None:
            return cached
        # Constants need no slot, cheap values are cheaper computed than loaded.
        node, first = function.nodes[index], early[index]
        if first is not None and first.constant is not None:
            result = builder.constant(first.constant, first.kind)
        elif first is not None and node.kind == F64 and effort[index] >= _MIN_EFFORT:
            result = builder.load(places.setdefault(first.index, f"{ONCE}{len(places)}"))
        # Slots hold doubles, so a truth value is stored as 1 or 0.
        elif first is not None and node.kind == I1 and effort[index] > _MIN_EFFORT:
            number = first.choose(1.0, 0.0)
            result = builder.load(places.setdefault(number.index, f"{ONCE}{len(places)}")).ne(0.0)
        else:
            result = builder.op(node.operation, *[value(i) for i in node.arguments])
        late[index] = result
        return result

    # Inputs, loads and constants are in both; what is fixed is computed in the prelude.
    for index, node in enumerate(function.nodes):
        late.append(None if node.arguments else builder.copy_node(node, ()))
        early.append(None)
        if fixed[index]:
            arguments = [early[i] for i in node.arguments]
            early[index] = prelude.copy_node(node, [a for a in arguments if a is not None])
        elif node.arguments:
            value(index)
    return builder.finish({}, {slot: value(index) for slot, index in function.stores.items()})


def _invariant_nodes(function: Function, changing: set[str]) -> tuple[list[bool], list[int]]:
    """Return for each node whether it is the same in all frames, and roughly what it costs with its
    arguments.
    """
    fixed: list[bool] = []
    effort: list[int] = []
    for node in function.nodes:
        if node.operation == "load":
            fixed.append(node.name not in changing)
        else:
            fixed.append(all(fixed[i] for i in node.arguments))
        inside = sum(effort[i] for i in node.arguments if function.nodes[i].operation != "load")
        effort.append(min(_EFFORTS.get(node.operation, 1) + inside, _MAX_EFFORT))
    return fixed, effort


def prune_slots(program: Program, keep: Collection[str] = ()) -> Program:
    """Remove unused slots; order the others by their first use in a frame."""
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


# Conditional constant propagation through frames (Wegman and Zadeck 1991): every slot counts as
# constant until a store contradicts. A section that no lane ever runs is removed; one that all
# lanes always run loses its mask.

SlotConstants = MutableMapping[str, float | None]
"""Slot -> its only value, None if it has several."""


def propagate_constants(
    startup: Sequence[Program],
    program: Program,
    varying: Collection[str],
    intermediate: Sequence[Program] = (),
) -> Program:
    """Fold slots that never change although something stores them.

    Parameters
    ----------
    startup : sequence of Program
        Programs that each run one frame first.
    program : Program
        Program to simplify.
    varying : collection of str
        Slots that differ between lanes at the start.
    intermediate : sequence of Program
        Programs that run any number of frames before ``program``.
    """
    constants: SlotConstants = {}
    for stage in startup:
        _add_initial_values(constants, stage, varying)
        for section in stage.sections:
            _visit_section(constants, section, is_single_run=True)
    # Iterate to a fixed point, because any number of frames may run.
    sections = [section for one in intermediate for section in one.sections]
    for stage in intermediate:
        _add_initial_values(constants, stage, varying)
    while sum(_visit_section(constants, section, is_single_run=False) for section in sections):
        pass
    _add_initial_values(constants, program, varying)
    for stream in program.streams:
        constants.update(dict.fromkeys(stream.columns))
    while sum(
        _visit_section(constants, section, is_single_run=False) for section in program.sections
    ):
        pass
    # Fold before expansion: a transcendental function of a constant becomes one constant.
    folded = [_fold_section(section, constants) for section in program.sections]
    return replace(program, sections=tuple(s for s in folded if s is not None))


def _add_initial_values(
    constants: SlotConstants, program: Program, varying: Collection[str]
) -> None:
    """Add the initial values of slots that do not vary between lanes."""
    for name, value in program.slots.items():
        constants.setdefault(name, None if name in varying else value)


def _visit_section(constants: SlotConstants, section: Section, is_single_run: bool) -> bool:
    """Merge a section's stores into the constants; return whether a slot stopped being constant.

    ``is_single_run``: it runs now and never again, so its stores replace the values.
    """
    mask = None if section.when.mask is None else constants.get(section.when.mask)
    # A section whose mask is known to be 0 cannot contradict a constant.
    if section.when.mask is not None and mask == 0.0:
        return False
    overwrites = is_single_run and (section.when.mask is None or mask is not None)
    stores = _constant_stores(section.function, constants)
    changed = False
    for name, value in stores.items():
        old = constants.get(name)
        if overwrites:
            constants[name] = value
        elif old is not None and (value is None or not same_bits(old, value)):
            constants[name], changed = None, True
    return changed


def _constant_stores(
    function: Function, constants: Mapping[str, float | None]
) -> dict[str, float | None]:
    """Return the constant that each store has, None if it may vary."""
    values: list[Any] = []
    for node in function.nodes:
        if node.operation == "const":
            values.append(node.value)
        elif node.operation == "load":
            values.append(constants.get(node.name))
        # A known condition decides, even if the other branch varies.
        elif node.operation == "select" and values[node.arguments[0]] is not None:
            values.append(values[node.arguments[1 if values[node.arguments[0]] else 2]])
        elif node.operation in ("and", "or"):
            values.append(_fold_logic(node.operation, [values[i] for i in node.arguments]))
        elif node.operation in TRANSCENDENTAL:
            values.append(fold(node.operation, [values[i] for i in node.arguments]))
        elif node.operation == "input" or any(values[i] is None for i in node.arguments):
            values.append(None)
        else:
            arguments = [NUMPY_TYPES[function.nodes[i].kind](values[i]) for i in node.arguments]
            values.append(apply_operation(node.operation, arguments).item())
    return {name: values[i] for name, i in function.stores.items()}


def _fold_logic(operation: str, values: Sequence[bool | None]) -> bool | None:
    """Evaluate ``and`` or ``or`` with unknown arguments."""
    deciding = operation == "or"
    if any(v is not None and bool(v) == deciding for v in values):
        return deciding
    return None if any(v is None for v in values) else not deciding


def _fold_section(section: Section, constants: Mapping[str, float | None]) -> Section | None:
    """Replace loads of constant slots and drop their stores; None if the section never runs."""
    when = section.when
    # A constant mask decides for all lanes and frames.
    if when.mask is not None and (mask := constants.get(when.mask)) is not None:
        if mask == 0.0:
            return None
        when = replace(when, mask=None)
    builder = Builder()
    values: list[Value] = []
    for node in section.function.nodes:
        # Every load of a constant slot becomes a constant, which the builder folds on.
        constant = constants.get(node.name) if node.operation == "load" else None
        arguments = [values[i] for i in node.arguments]
        values.append(
            builder.copy_node(node, arguments) if constant is None else builder.constant(constant)
        )
    stores = {
        name: values[i]
        for name, i in section.function.stores.items()
        if constants.get(name) is None
    }
    return replace(section, function=builder.finish({}, stores), when=when)
