"""The intermediate form: a graph of typed values, built without repetition, with constants folded
and without control flow.

A ``Builder`` makes values; a value that was made before is not made again, and an operation on
constants is a constant. ``finish`` keeps what outputs and stores need and gives a ``Function``,
which passes rewrite, ``machine`` compiles and ``evaluate`` computes in numpy. State is read once at
the begin of a frame and written once at its end: ``load`` after ``store`` gives the stored value.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

# What each operation of the intermediate form means: kinds of arguments and result, and its
# value computed by numpy.
#
# Every operation but the transcendental ones is exact or correctly rounded by IEEE 754, so
# numpy, constants folded at build time and the compiled code have the same bits. The one
# exception is the sign and payload of a NaN, which processors choose differently: NaN is
# compared as NaN. There is no fused multiply-add.

F64, I64, I1, TABLE = "f64", "i64", "i1", "table"
"""Kinds of values: a double, its 64 bits as an integer, a truth value; and a row of constant
doubles, the same in all lanes.
"""


@dataclass(frozen=True)
class Operation:
    """``kinds`` of the arguments, ``result`` kind, ``compute`` over numpy arrays (None: expanded
    before it is computed).
    """

    kinds: tuple[str, ...]
    result: str
    compute: Callable[..., Any] | None


def _shift(function: Callable[..., Any]) -> Callable[..., Any]:
    """A shift of the bits as unsigned numbers; the second argument is below 64."""
    return lambda a, n: function(np.asarray(a).view(np.uint64), np.asarray(n).view(np.uint64)).view(
        np.int64
    )


def _bits(a: Any) -> Any:
    return np.asarray(a, dtype=np.float64).view(np.int64)


def _double(a: Any) -> Any:
    return np.asarray(a, dtype=np.int64).view(np.float64)


def _looked_up(table: Any, index: Any) -> Any:
    inside = np.where(index > 0.0, index, 0.0)
    return table[np.where(inside < len(table) - 1.0, inside, len(table) - 1.0).astype(np.int64)]


_BINARY: Mapping[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "min": lambda a, b: np.where(a < b, a, b),
    "max": lambda a, b: np.where(a > b, a, b),
}
_UNARY: Mapping[str, Callable[..., Any]] = {
    "neg": np.negative,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "floor": np.floor,
}
_COMPARE: Mapping[str, Callable[..., Any]] = {
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
}
_INTEGER: Mapping[str, Callable[..., Any]] = {
    "iadd": np.add,
    "isub": np.subtract,
    "iand": np.bitwise_and,
    "ior": np.bitwise_or,
    "ixor": np.bitwise_xor,
    "ishl": _shift(np.left_shift),
    "ishr": _shift(np.right_shift),
}
_LOGIC: Mapping[str, Callable[..., Any]] = {"and": np.logical_and, "or": np.logical_or}

TRANSCENDENTAL: Mapping[str, int] = {
    **dict.fromkeys(
        ("sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "log2", "log10"), 1
    ),
    **dict.fromkeys(("atan2", "pow", "fmod"), 2),
}
"""Names and numbers of arguments; ``form.maths.lower`` writes them out in the other operations."""

OPERATIONS: Mapping[str, Operation] = {
    **{name: Operation((F64, F64), F64, f) for name, f in _BINARY.items()},
    **{name: Operation((F64,), F64, f) for name, f in _UNARY.items()},
    **{name: Operation((F64, F64), I1, f) for name, f in _COMPARE.items()},
    **{name: Operation((I64, I64), I64, f) for name, f in _INTEGER.items()},
    **{name: Operation((I1, I1), I1, f) for name, f in _LOGIC.items()},
    **{name: Operation((F64,) * count, F64, None) for name, count in TRANSCENDENTAL.items()},
    "not": Operation((I1,), I1, np.logical_not),
    "bits": Operation((F64,), I64, _bits),
    "double": Operation((I64,), F64, _double),
    "select": Operation((I1, F64, F64), F64, np.where),
    "lookup": Operation((TABLE, F64), F64, _looked_up),
}
"""``min(a, b)`` is ``a if a < b else b`` and ``max(a, b)`` is ``a if a > b else b``: with a NaN, or
two zeros, the second. ``ne`` is true for a NaN, the other comparisons are false. ``bits`` and
``double`` view the 64 bits as an integer and back; ``ishr`` fills with zeros. ``lookup`` gives the
number of a table at an index, cut to a whole one and held at the ends; at 0 for a NaN."""


def numpy_of(operation: str) -> Callable[..., Any]:
    """What computes the operation over numpy arrays or scalars.

    Raises ValueError for a transcendental one.
    """
    compute = OPERATIONS[operation].compute
    if compute is None:
        raise ValueError(f"{operation} is computed only after form.maths.lower has written it out")
    return compute


def computed(operation: str, arguments: Sequence[Any]) -> Any:
    """The operation over numpy arrays or scalars, without warnings of numpy.

    Raises ValueError for a transcendental one.
    """
    compute = numpy_of(operation)
    with np.errstate(all="ignore"):
        return compute(*arguments)


Constant = float | int | bool
Known = Constant | tuple[float, ...]
"""What a constant node holds."""


class Node(NamedTuple):
    """An operation on earlier nodes.

    ``const`` has its ``value``; ``input`` and ``load`` have the ``name`` of what they read.
    """

    operation: str
    kind: str
    arguments: tuple[int, ...] = ()
    value: Known | None = None
    name: str = ""


@dataclass(frozen=True)
class Function:
    """What is computed in a frame: ``nodes`` in an order in which each stands behind its arguments.

    inputs   names of what is given from outside
    slots    names of the state, read or written
    outputs  name to the node that has the value;  ``stores`` the same for slots that change
    """

    nodes: tuple[Node, ...]
    inputs: tuple[str, ...]
    slots: tuple[str, ...]
    outputs: Mapping[str, int]
    stores: Mapping[str, int]

    def counts(self) -> dict[str, int]:
        """How often each operation occurs."""
        found: dict[str, int] = {}
        for node in self.nodes:
            found[node.operation] = found.get(node.operation, 0) + 1
        return found


@dataclass(slots=True, eq=False)
class Value:
    """A value of a builder, never changed. Arithmetic operators work on doubles and numbers;
    comparisons are methods, so that ``==`` stays Python's."""

    builder: Builder
    index: int

    @property
    def kind(self) -> str:
        """f64, i64 or i1."""
        return self.builder.nodes[self.index].kind

    @property
    def constant(self) -> Constant | None:
        """The number it is known to be, or None."""
        value = self.builder.nodes[self.index].value
        return None if isinstance(value, tuple) else value

    def __add__(self, other: Value | float) -> Value:
        return self.builder.op("add", self, other)

    def __radd__(self, other: float) -> Value:
        return self.builder.op("add", other, self)

    def __sub__(self, other: Value | float) -> Value:
        return self.builder.op("sub", self, other)

    def __rsub__(self, other: float) -> Value:
        return self.builder.op("sub", other, self)

    def __mul__(self, other: Value | float) -> Value:
        return self.builder.op("mul", self, other)

    def __rmul__(self, other: float) -> Value:
        return self.builder.op("mul", other, self)

    def __truediv__(self, other: Value | float) -> Value:
        return self.builder.op("div", self, other)

    def __rtruediv__(self, other: float) -> Value:
        return self.builder.op("div", other, self)

    def __neg__(self) -> Value:
        return self.builder.op("neg", self)

    def lt(self, other: Value | float) -> Value:
        """Whether it is less; false with a NaN, as ``le``, ``gt``, ``ge`` and ``eq``."""
        return self.builder.op("lt", self, other)

    def le(self, other: Value | float) -> Value:
        """Less or equal."""
        return self.builder.op("le", self, other)

    def gt(self, other: Value | float) -> Value:
        """Greater."""
        return self.builder.op("gt", self, other)

    def ge(self, other: Value | float) -> Value:
        """Greater or equal."""
        return self.builder.op("ge", self, other)

    def eq(self, other: Value | float) -> Value:
        """Equal; zeros of both signs are."""
        return self.builder.op("eq", self, other)

    def ne(self, other: Value | float) -> Value:
        """Not equal; true with a NaN."""
        return self.builder.op("ne", self, other)

    def choose(self, yes: Value | float, no: Value | float) -> Value:
        """``yes`` where this truth value is true, else ``no``; both are computed."""
        return self.builder.op("select", self, yes, no)


class Builder:
    """Makes values, each once."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.state: dict[str, Value] = {}
        self._known: dict[tuple[Any, ...], int] = {}

    def constant(self, value: Constant, kind: str = F64) -> Value:
        """A number: doubles are distinguished by their bits, so 0.0 is not -0.0."""
        if kind == F64:
            value = float(value)
            key: Any = value or struct.pack("<d", value) if value == value else "nan"
        else:
            value = bool(value) if kind == I1 else (int(value) + 2**63) % 2**64 - 2**63
            key = value
        return self._leaf(("const", kind, key), "const", kind, value)

    def integer(self, value: int) -> Value:
        """A constant of kind i64."""
        return self.constant(value, I64)

    def truth(self, value: bool) -> Value:
        """A constant of kind i1."""
        return self.constant(value, I1)

    def table(self, values: Sequence[float]) -> Value:
        """Constant doubles that ``lookup`` picks from, at least one."""
        if not values:
            raise ValueError("a table has a number at least")
        numbers = tuple(float(x) for x in values)
        return self._leaf(("const", TABLE, np.array(numbers).tobytes()), "const", TABLE, numbers)

    def input(self, name: str) -> Value:
        """A double that is given from outside, for each lane its own."""
        return self._leaf(("input", name), "input", F64, None, name)

    def load(self, slot: str) -> Value:
        """The double in a slot of the state: what was stored in this frame, else what the last
        frame left.
        """
        if slot in self.state:
            return self.state[slot]
        return self._leaf(("load", slot), "load", F64, None, slot)

    def store(self, slot: str, value: Value | float) -> None:
        """Put a double into a slot of the state."""
        self.state[slot] = self.value(value)

    def value(self, value: Value | Constant) -> Value:
        """A number as a constant; a value as it is. A value of another builder is refused."""
        if not isinstance(value, Value):
            return self.constant(value)
        if value.builder is not self:
            raise ValueError("a value of another builder")
        return value

    def op(self, operation: str, *arguments: Value | float) -> Value:
        """The operation on the arguments, folded where they are constants.

        Raises ValueError for wrong kinds.
        """
        return Value(self, self._place(operation, tuple([self.value(a).index for a in arguments])))

    def again(self, node: Node, values: Sequence[Value]) -> Value:
        """A node of another builder in this one, made of this one's values for its arguments."""
        if node.operation == "const":
            assert node.value is not None
            return (
                self.table(node.value)
                if isinstance(node.value, tuple)
                else self.constant(node.value, node.kind)
            )
        if node.operation == "input":
            return self.input(node.name)
        if node.operation == "load":
            return self.load(node.name)
        return Value(self, self._place(node.operation, tuple([v.index for v in values])))

    def _place(self, operation: str, arguments: tuple[int, ...]) -> int:
        """The node of an operation on nodes."""
        key = (operation, *arguments)
        found = self._known.get(key)
        if found is not None:
            return found
        nodes = [self.nodes[i] for i in arguments]
        meaning = OPERATIONS[operation]
        if tuple([node.kind for node in nodes]) != meaning.kinds:
            raise ValueError(
                f"{operation} takes {', '.join(meaning.kinds)}; received"
                f" {', '.join(n.kind for n in nodes)}"
            )
        if meaning.compute is not None and None not in [node.value for node in nodes]:
            made = self.constant(
                computed(operation, [known(node) for node in nodes]).item(), meaning.result
            ).index
        else:
            simpler = self._simpler(operation, arguments, nodes)
            made = len(self.nodes) if simpler is None else simpler
            if simpler is None:
                self.nodes.append(Node(operation, meaning.result, arguments))
        self._known[key] = made
        return made

    def finish(
        self, outputs: Mapping[str, Value], stores: Mapping[str, Value] | None = None
    ) -> Function:
        """The function that computes ``outputs`` and the stored slots; what they do not need is
        left out.
        """
        stores = self.state if stores is None else stores
        return _compact(
            self.nodes,
            {name: v.index for name, v in outputs.items()},
            {name: v.index for name, v in stores.items()},
        )

    def _leaf(
        self, key: tuple[Any, ...], operation: str, kind: str, value: Known | None, name: str = ""
    ) -> Value:
        index = self._known.get(key)
        if index is None:
            index = self._known[key] = len(self.nodes)
            self.nodes.append(Node(operation, kind, (), value, name))
        return Value(self, index)

    def _simpler(
        self, operation: str, arguments: tuple[int, ...], nodes: Sequence[Node]
    ) -> int | None:
        """The node of the same value by less work, bit for bit; None if there is none."""
        first, last = arguments[0], arguments[-1]
        begins, ends = nodes[0].value, nodes[-1].value
        if operation == "select":
            if begins is not None:
                return arguments[1] if begins else arguments[2]
            return arguments[1] if arguments[1] == arguments[2] else None
        if operation in ("and", "or") and (begins is not None or ends is not None):
            value, known_one, other = (
                (begins, first, last) if begins is not None else (ends, last, first)
            )
            return other if bool(value) == (operation == "and") else known_one
        if operation in ("neg", "not") and nodes[0].operation == operation:
            return nodes[0].arguments[0]
        if nodes[-1].kind != F64 or ends is None:
            if operation == "mul" and begins in (1.0, -1.0):
                return last if begins == 1.0 else self._place("neg", (last,))
            return None
        assert isinstance(ends, float)
        if (operation in ("mul", "div") and ends == 1.0) or (
            operation == "sub" and _same(ends, 0.0)
        ):
            return first
        if operation == "mul" and ends == -1.0:
            return self._place("neg", (first,))
        if operation == "add" and _same(ends, -0.0):
            return first
        if operation == "div" and _exact_reciprocal(ends):
            return self._place("mul", (first, self.constant(1.0 / ends).index))
        return None


def rebuilt(
    function: Function,
    operations: Collection[str],
    rule: Callable[[Builder, Node, list[Value]], Value],
) -> Function:
    """The function with each of these ``operations`` made by ``rule`` in a new builder; all else
    stays.
    """
    if not any(node.operation in operations for node in function.nodes):
        return function
    builder = Builder()
    values: list[Value] = []
    for node in function.nodes:
        arguments = [values[i] for i in node.arguments]
        values.append(
            rule(builder, node, arguments)
            if node.operation in operations
            else builder.again(node, arguments)
        )
    outputs = {name: values[i] for name, i in function.outputs.items()}
    return builder.finish(outputs, {name: values[i] for name, i in function.stores.items()})


def storing(function: Function, slots: Collection[str]) -> Function:
    """The function with the stores of these slots alone."""
    return _compact(
        function.nodes,
        function.outputs,
        {name: i for name, i in function.stores.items() if name in slots},
    )


def _compact(
    nodes: Sequence[Node], outputs: Mapping[str, int], stores: Mapping[str, int]
) -> Function:
    """Those of the nodes that outputs and stores need, in the same order."""
    needed = bytearray(len(nodes))
    open_nodes = [*outputs.values(), *stores.values()]
    while open_nodes:
        index = open_nodes.pop()
        if not needed[index]:
            needed[index] = 1
            open_nodes += nodes[index].arguments
    kept = [index for index, used in enumerate(needed) if used]
    if len(kept) < len(nodes):
        place = dict(zip(kept, range(len(kept)), strict=True))
        nodes = [_moved(nodes[old], place) for old in kept]
        outputs, stores = ({name: place[i] for name, i in of.items()} for of in (outputs, stores))
    loads = [node.name for node in nodes if node.operation == "load"]
    inputs = tuple(node.name for node in nodes if node.operation == "input")
    return Function(
        tuple(nodes), inputs, tuple(dict.fromkeys([*loads, *stores])), dict(outputs), dict(stores)
    )


def slots_read(function: Function) -> dict[str, frozenset[str]]:
    """For each store the slots that its value is made of."""
    of: list[frozenset[str]] = []
    for node in function.nodes:
        if node.operation == "load":
            of.append(frozenset((node.name,)))
        else:
            parts = [of[i] for i in node.arguments]
            of.append(parts[0] if len(parts) == 1 else frozenset().union(*parts))
    return {slot: of[index] for slot, index in function.stores.items()}


def evaluate(
    function: Function,
    inputs: Mapping[str, np.ndarray],
    state: Mapping[str, np.ndarray] | None = None,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Outputs and the state after the frame, computed by numpy over lanes; the reference for the
    compiled code.
    """
    lanes = max([np.size(a) for a in (*inputs.values(), *(state or {}).values())], default=1)
    last = _last_uses(function)
    values: list[Any] = [None] * len(function.nodes)
    with np.errstate(all="ignore"):
        for index, node in enumerate(function.nodes):
            if node.operation == "const":
                values[index] = known(node)
            elif node.operation in ("input", "load"):
                source = inputs if node.operation == "input" else (state or {})
                values[index] = np.asarray(source[node.name], dtype=np.float64)
            else:
                values[index] = numpy_of(node.operation)(*[values[i] for i in node.arguments])
            for i in node.arguments:
                if last[i] == index:
                    values[i] = None
    outputs = {
        name: np.broadcast_to(values[i], lanes).copy() for name, i in function.outputs.items()
    }
    after = {
        slot: np.array(state[slot], dtype=np.float64)
        for slot in function.slots
        if state and slot in state
    }
    after.update(
        {name: np.broadcast_to(values[i], lanes).copy() for name, i in function.stores.items()}
    )
    return outputs, after


def _last_uses(function: Function) -> list[int]:
    """For each node the last node that reads it; outputs and stores are never done with."""
    last = [-1] * len(function.nodes)
    for index, node in enumerate(function.nodes):
        for i in node.arguments:
            last[i] = index
    for i in (*function.outputs.values(), *function.stores.values()):
        last[i] = len(last)
    return last


def _moved(node: Node, place: Mapping[int, int]) -> Node:
    if not node.arguments:
        return node
    return Node(
        node.operation, node.kind, tuple([place[i] for i in node.arguments]), node.value, node.name
    )


_MAKE: Mapping[str, Callable[..., Any]] = {
    F64: np.float64,
    I64: np.int64,
    I1: np.bool_,
    TABLE: np.array,
}


def known(node: Node) -> Any:
    """A constant as numpy has it."""
    assert node.value is not None
    return _MAKE[node.kind](node.value)


def _same(a: Constant, b: float) -> bool:
    return struct.pack("<d", float(a)) == struct.pack("<d", b)


def _exact_reciprocal(x: float) -> bool:
    """Whether 1/x is a normal double without rounding: x is a power of two."""
    mantissa, exponent = math.frexp(x)
    return abs(mantissa) == 0.5 and -1000 < exponent < 1000
