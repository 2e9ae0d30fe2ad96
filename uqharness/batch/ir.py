"""Intermediate representation: a graph of typed values in static single assignment form.

A `Builder` creates values. It numbers values (an operation on the same arguments is created once),
folds constants, and has no control flow. `Builder.finish` removes dead nodes and returns a
`Function`, which passes rewrite, `uqharness.batch.llvm` compiles and `evaluate` computes with
numpy. State is read once at the start of a frame and written once at its end: ``load`` after
``store`` returns the stored value.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

# Operations: kinds of arguments and result, and the value computed by numpy. All operations
# except transcendental ones are exact or correctly rounded (IEEE 754), so numpy, constant folding
# and compiled code agree bit for bit. Only sign and payload of a NaN differ between processors.
# There is no fused multiply-add.

F64, I64, I1, TABLE = "f64", "i64", "i1", "table"
"""Kinds of values: a double, its 64 bits as an integer, a truth value; and a table of constant
doubles, the same in all lanes.
"""


@dataclass(frozen=True)
class Operation:
    """Signature and meaning of an operation.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of the arguments.
    result : str
        Kind of the result.
    compute : callable or None
        Computes it over numpy arrays; None for operations that `maths.lower` expands first.
    """

    kinds: tuple[str, ...]
    result: str
    compute: Callable[..., Any] | None


def _shift(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a shift of the bits as unsigned numbers; the second argument is below 64."""
    return lambda a, n: function(np.asarray(a).view(np.uint64), np.asarray(n).view(np.uint64)).view(
        np.int64
    )


def _to_bits(a: Any) -> Any:
    """View doubles as 64-bit integers."""
    return np.asarray(a, dtype=np.float64).view(np.int64)


def _from_bits(a: Any) -> Any:
    """View 64-bit integers as doubles."""
    return np.asarray(a, dtype=np.int64).view(np.float64)


def _lookup(table: Any, index: Any) -> Any:
    """Look up table entries at an index that is clipped to the table; NaN becomes 0."""
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
"""Name -> number of arguments; ``form.maths.lower`` expands them into the other operations."""

OPERATIONS: Mapping[str, Operation] = {
    **{name: Operation((F64, F64), F64, f) for name, f in _BINARY.items()},
    **{name: Operation((F64,), F64, f) for name, f in _UNARY.items()},
    **{name: Operation((F64, F64), I1, f) for name, f in _COMPARE.items()},
    **{name: Operation((I64, I64), I64, f) for name, f in _INTEGER.items()},
    **{name: Operation((I1, I1), I1, f) for name, f in _LOGIC.items()},
    **{name: Operation((F64,) * count, F64, None) for name, count in TRANSCENDENTAL.items()},
    "not": Operation((I1,), I1, np.logical_not),
    "bits": Operation((F64,), I64, _to_bits),
    "double": Operation((I64,), F64, _from_bits),
    "select": Operation((I1, F64, F64), F64, np.where),
    "lookup": Operation((TABLE, F64), F64, _lookup),
}
"""Name -> operation. ``min(a, b)`` is ``a if a < b else b`` and ``max(a, b)`` is ``a if a > b
else b``: the second argument for a NaN or two zeros. ``ne`` is true for a NaN, the other
comparisons are false. ``bits`` and ``double`` view the 64 bits as an integer and back; ``ishr``
fills with zeros. ``lookup`` returns a table's entry at a truncated index, clipped to the table;
a NaN index counts as 0.
"""


def numpy_function(operation: str) -> Callable[..., Any]:
    """Return the function that computes an operation over numpy arrays or scalars.

    Raises ValueError for a transcendental operation.
    """
    compute = OPERATIONS[operation].compute
    if compute is None:
        raise ValueError(f"{operation} is computed only after form.maths.lower has written it out")
    return compute


def apply_operation(operation: str, arguments: Sequence[Any]) -> Any:
    """Compute an operation over numpy arrays or scalars without floating-point warnings.

    Raises ValueError for a transcendental operation.
    """
    compute = numpy_function(operation)
    with np.errstate(all="ignore"):
        return compute(*arguments)


Constant = float | int | bool
ConstantValue = Constant | tuple[float, ...]
"""Value of a constant node."""


class Node(NamedTuple):
    """An operation on earlier nodes.

    ``arguments`` are indices of nodes. ``const`` nodes have a ``value``; ``input`` and ``load``
    nodes have the ``name`` of the input or slot.
    """

    operation: str
    kind: str
    arguments: tuple[int, ...] = ()
    value: ConstantValue | None = None
    name: str = ""


@dataclass(frozen=True)
class Function:
    """Computation of one frame.

    Attributes
    ----------
    nodes : tuple of Node
        In topological order.
    inputs : tuple of str
        Names of external inputs.
    slots : tuple of str
        Names of the state that is read or written.
    outputs, stores : mapping
        Name of an output, or of a slot that changes -> index of the node with its value.
    """

    nodes: tuple[Node, ...]
    inputs: tuple[str, ...]
    slots: tuple[str, ...]
    outputs: Mapping[str, int]
    stores: Mapping[str, int]

    def counts(self) -> dict[str, int]:
        """Count the nodes of each operation."""
        counts: dict[str, int] = {}
        for node in self.nodes:
            counts[node.operation] = counts.get(node.operation, 0) + 1
        return counts


@dataclass(slots=True, eq=False)
class Value:
    """An immutable value of a builder.

    Arithmetic operators work on doubles and numbers. Comparisons are methods, so that ``==`` keeps
    Python's meaning.
    """

    builder: Builder
    index: int

    @property
    def kind(self) -> str:
        """Kind of the value: f64, i64 or i1."""
        return self.builder.nodes[self.index].kind

    @property
    def constant(self) -> Constant | None:
        """The number if the value is constant, else None."""
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
        """Return whether self < other. Like ``le``, ``gt``, ``ge`` and ``eq`` it is false for
        NaN.
        """
        return self.builder.op("lt", self, other)

    def le(self, other: Value | float) -> Value:
        """Return whether self <= other."""
        return self.builder.op("le", self, other)

    def gt(self, other: Value | float) -> Value:
        """Return whether self > other."""
        return self.builder.op("gt", self, other)

    def ge(self, other: Value | float) -> Value:
        """Return whether self >= other."""
        return self.builder.op("ge", self, other)

    def eq(self, other: Value | float) -> Value:
        """Return whether self == other; 0.0 equals -0.0."""
        return self.builder.op("eq", self, other)

    def ne(self, other: Value | float) -> Value:
        """Return whether self != other; true for NaN."""
        return self.builder.op("ne", self, other)

    def choose(self, yes: Value | float, no: Value | float) -> Value:
        """Return ``yes`` in lanes where this truth value is true, else ``no``; both are
        computed.
        """
        return self.builder.op("select", self, yes, no)


class Builder:
    """Create values with value numbering and constant folding.

    Examples
    --------
    >>> b = Builder()
    >>> x = b.input("x")
    >>> (x + 1.0).index == (x + 1.0).index
    True
    >>> (b.constant(2.0) * 3.0).constant
    6.0
    >>> outputs, _ = evaluate(b.finish({"y": x * x + 1.0}), {"x": np.array([3.0])})
    >>> float(outputs["y"][0])
    10.0
    """

    def __init__(self) -> None:
        """Start without values."""
        self.nodes: list[Node] = []
        self.state: dict[str, Value] = {}
        self._interned: dict[tuple[Any, ...], int] = {}

    def constant(self, value: Constant, kind: str = F64) -> Value:
        """Return a constant; doubles are distinguished by their bits, so 0.0 is not -0.0."""
        if kind == F64:
            value = float(value)
            key: Any = value or struct.pack("<d", value) if value == value else "nan"
        else:
            value = bool(value) if kind == I1 else (int(value) + 2**63) % 2**64 - 2**63
            key = value
        return self._leaf(("const", kind, key), "const", kind, value)

    def integer(self, value: int) -> Value:
        """Return a constant of kind i64."""
        return self.constant(value, I64)

    def truth(self, value: bool) -> Value:
        """Return a constant of kind i1."""
        return self.constant(value, I1)

    def table(self, values: Sequence[float]) -> Value:
        """Return a table of constant doubles for ``lookup``; ValueError if it is empty."""
        if not values:
            raise ValueError("a table has a number at least")
        numbers = tuple(float(x) for x in values)
        return self._leaf(("const", TABLE, np.array(numbers).tobytes()), "const", TABLE, numbers)

    def input(self, name: str) -> Value:
        """Return an external input, one double per lane."""
        return self._leaf(("input", name), "input", F64, None, name)

    def load(self, slot: str) -> Value:
        """Return the double in a slot of the state: the value stored in this frame, else that of
        the last frame.
        """
        if slot in self.state:
            return self.state[slot]
        return self._leaf(("load", slot), "load", F64, None, slot)

    def store(self, slot: str, value: Value | float) -> None:
        """Store a double into a slot of the state."""
        self.state[slot] = self.value(value)

    def value(self, value: Value | Constant) -> Value:
        """Return a number as a constant, a value unchanged; ValueError for a value of another
        builder.
        """
        if not isinstance(value, Value):
            return self.constant(value)
        if value.builder is not self:
            raise ValueError("a value of another builder")
        return value

    def op(self, operation: str, *arguments: Value | float) -> Value:
        """Return an operation on arguments, folded if they are constants.

        Raises ValueError for arguments of the wrong kinds.
        """
        indices = [
            a.index if isinstance(a, Value) and a.builder is self else self.value(a).index
            for a in arguments
        ]
        return Value(self, self._intern(operation, tuple(indices)))

    def copy_node(self, node: Node, values: Sequence[Value]) -> Value:
        """Copy a node of another builder, with this builder's ``values`` as its arguments."""
        if node.arguments:
            return Value(self, self._intern(node.operation, tuple([v.index for v in values])))
        if node.operation == "const":
            assert node.value is not None
            return (
                self.table(node.value)
                if isinstance(node.value, tuple)
                else self.constant(node.value, node.kind)
            )
        if node.operation == "input":
            return self.input(node.name)
        return self.load(node.name)

    def _intern(self, operation: str, arguments: tuple[int, ...]) -> int:
        """Return the index of an operation's node, created at its first use."""
        key = (operation, *arguments)
        existing = self._interned.get(key)
        if existing is not None:
            return existing
        nodes, kinds, all_constant = [], [], True
        for i in arguments:
            node = self.nodes[i]
            nodes.append(node)
            kinds.append(node.kind)
            all_constant = all_constant and node.value is not None
        meaning = OPERATIONS[operation]
        # Kinds are checked once, when the node is created.
        if tuple(kinds) != meaning.kinds:
            raise ValueError(
                f"{operation} takes {', '.join(meaning.kinds)}; received {', '.join(kinds)}"
            )
        # All arguments are constant: fold.
        if all_constant and meaning.compute is not None:
            index = self.constant(
                apply_operation(operation, [numpy_constant(node) for node in nodes]).item(),
                meaning.result,
            ).index
        else:
            simpler = self._simpler(operation, arguments, nodes)
            index = len(self.nodes) if simpler is None else simpler
            if simpler is None:
                self.nodes.append(Node(operation, meaning.result, arguments))
        self._interned[key] = index
        return index

    def finish(
        self, outputs: Mapping[str, Value], stores: Mapping[str, Value] | None = None
    ) -> Function:
        """Return the function that computes ``outputs`` and the stores, without dead nodes.

        ``stores`` defaults to everything that was stored.
        """
        stores = self.state if stores is None else stores
        return _compact(
            self.nodes,
            {name: v.index for name, v in outputs.items()},
            {name: v.index for name, v in stores.items()},
        )

    def _leaf(
        self,
        key: tuple[Any, ...],
        operation: str,
        kind: str,
        value: ConstantValue | None,
        name: str = "",
    ) -> Value:
        """Return a node without arguments, created at its first use."""
        index = self._interned.get(key)
        if index is None:
            index = self._interned[key] = len(self.nodes)
            self.nodes.append(Node(operation, kind, (), value, name))
        return Value(self, index)

    def _simpler(
        self, operation: str, arguments: tuple[int, ...], nodes: Sequence[Node]
    ) -> int | None:
        """Return an existing or cheaper node with exactly the same bits; None if there is none."""
        first, last = arguments[0], arguments[-1]
        first_value, last_value = nodes[0].value, nodes[-1].value
        if operation == "select":
            if first_value is not None:
                return arguments[1] if first_value else arguments[2]
            return arguments[1] if arguments[1] == arguments[2] else None
        # Logic with one constant is the other argument or the constant.
        if operation in ("and", "or") and (first_value is not None or last_value is not None):
            value, constant_one, other = (
                (first_value, first, last) if first_value is not None else (last_value, last, first)
            )
            return other if bool(value) == (operation == "and") else constant_one
        if operation in ("neg", "not") and nodes[0].operation == operation:
            return nodes[0].arguments[0]
        # Only x * 1 and x * -1 can be simplified with a constant first factor.
        if nodes[-1].kind != F64 or last_value is None:
            if operation == "mul" and first_value in (1.0, -1.0):
                return last if first_value == 1.0 else self._intern("neg", (last,))
            return None
        assert isinstance(last_value, float)
        if (operation in ("mul", "div") and last_value == 1.0) or (
            operation == "sub" and same_bits(last_value, 0.0)
        ):
            return first
        if operation == "mul" and last_value == -1.0:
            return self._intern("neg", (first,))
        # x + 0.0 is not x if x is -0.0; x + -0.0 is.
        if operation == "add" and same_bits(last_value, -0.0):
            return first
        # Division by a power of two is an exact multiplication, which is cheaper.
        if operation == "div" and _exact_reciprocal(last_value):
            return self._intern("mul", (first, self.constant(1.0 / last_value).index))
        return None


def rewrite(
    function: Function,
    operations: Collection[str],
    rule: Callable[[Builder, Node, list[Value]], Value],
) -> Function:
    """Rebuild a function; nodes of ``operations`` are made by ``rule(builder, node, arguments)``,
    all others are copied.
    """
    if not any(node.operation in operations for node in function.nodes):
        return function
    # A new builder folds and merges what the rule makes constant or equal.
    builder = Builder()
    values: list[Value] = []
    for node in function.nodes:
        arguments = [values[i] for i in node.arguments]
        values.append(
            rule(builder, node, arguments)
            if node.operation in operations
            else builder.copy_node(node, arguments)
        )
    outputs = {name: values[i] for name, i in function.outputs.items()}
    return builder.finish(outputs, {name: values[i] for name, i in function.stores.items()})


def restrict_stores(function: Function, slots: Collection[str]) -> Function:
    """Return the function with the stores of these slots only."""
    return _compact(
        function.nodes,
        function.outputs,
        {name: i for name, i in function.stores.items() if name in slots},
    )


def _compact(
    nodes: Sequence[Node], outputs: Mapping[str, int], stores: Mapping[str, int]
) -> Function:
    """Keep the nodes that outputs and stores need, in the same order."""
    # Mark backwards from outputs and stores, then renumber.
    needed = bytearray(len(nodes))
    open_nodes = [*outputs.values(), *stores.values()]
    while open_nodes:
        index = open_nodes.pop()
        if not needed[index]:
            needed[index] = 1
            open_nodes += nodes[index].arguments
    retained = [index for index, used in enumerate(needed) if used]
    if len(retained) < len(nodes):
        place = dict(zip(retained, range(len(retained)), strict=True))
        nodes = [_renumber(nodes[old], place) for old in retained]
        outputs, stores = ({name: place[i] for name, i in of.items()} for of in (outputs, stores))
    loads = [node.name for node in nodes if node.operation == "load"]
    inputs = tuple(node.name for node in nodes if node.operation == "input")
    return Function(
        tuple(nodes), inputs, tuple(dict.fromkeys([*loads, *stores])), dict(outputs), dict(stores)
    )


def slots_read(function: Function) -> dict[str, frozenset[str]]:
    """Return, for each store, the slots that its value depends on."""
    # Sets of slots are bits of an integer, which are united faster.
    loaded: list[str] = []
    masks: list[int] = []
    for node in function.nodes:
        mask = 0
        if node.operation == "load":
            mask = 1 << len(loaded)
            loaded.append(node.name)
        for i in node.arguments:
            mask |= masks[i]
        masks.append(mask)
    return {
        slot: frozenset([name for k, name in enumerate(loaded) if masks[index] >> k & 1])
        for slot, index in function.stores.items()
    }


def evaluate(
    function: Function,
    inputs: Mapping[str, np.ndarray],
    state: Mapping[str, np.ndarray] | None = None,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Compute a function with numpy; the reference for the compiled code.

    Parameters
    ----------
    function : Function
        Without transcendental operations.
    inputs : mapping
        Name -> values (n,), one per lane.
    state : mapping, optional
        Slot -> values (n,) at the start of the frame.

    Returns
    -------
    outputs, state : dict
        Values (n,) after the frame.
    """
    lanes = max([np.size(a) for a in (*inputs.values(), *(state or {}).values())], default=1)
    last = _last_uses(function)
    values: list[Any] = [None] * len(function.nodes)
    with np.errstate(all="ignore"):
        for index, node in enumerate(function.nodes):
            if node.operation == "const":
                values[index] = numpy_constant(node)
            elif node.operation in ("input", "load"):
                source = inputs if node.operation == "input" else (state or {})
                values[index] = np.asarray(source[node.name], dtype=np.float64)
            else:
                # Free arrays after their last use.
                values[index] = numpy_function(node.operation)(*[values[i] for i in node.arguments])
            for i in node.arguments:
                if last[i] == index:
                    values[i] = None
    outputs = {
        name: np.broadcast_to(values[i], lanes).copy() for name, i in function.outputs.items()
    }
    # Slots that are only read keep their value.
    updated = {
        slot: np.array(state[slot], dtype=np.float64)
        for slot in function.slots
        if state and slot in state
    }
    updated.update(
        {name: np.broadcast_to(values[i], lanes).copy() for name, i in function.stores.items()}
    )
    return outputs, updated


def _last_uses(function: Function) -> list[int]:
    """Return for each node the last node that reads it; outputs and stores are read last of all."""
    last = [-1] * len(function.nodes)
    for index, node in enumerate(function.nodes):
        for i in node.arguments:
            last[i] = index
    for i in (*function.outputs.values(), *function.stores.values()):
        last[i] = len(last)
    return last


def _renumber(node: Node, place: Mapping[int, int]) -> Node:
    """Return a node with new indices of its arguments."""
    if not node.arguments:
        return node
    operation, kind, arguments, value, name = node
    return Node(operation, kind, tuple([place[i] for i in arguments]), value, name)


NUMPY_TYPES: Mapping[str, Callable[..., Any]] = {
    F64: np.float64,
    I64: np.int64,
    I1: np.bool_,
    TABLE: np.array,
}


def numpy_constant(node: Node) -> Any:
    """Return the value of a constant node as numpy's type of its kind."""
    assert node.value is not None
    return NUMPY_TYPES[node.kind](node.value)


def same_bits(a: Constant, b: float) -> bool:
    """Return whether two doubles have the same bits."""
    return struct.pack("<d", float(a)) == struct.pack("<d", b)


def _exact_reciprocal(x: float) -> bool:
    """Return whether 1/x is a normal double without rounding, that is, x is a power of two."""
    mantissa, exponent = math.frexp(x)
    return abs(mantissa) == 0.5 and -1000 < exponent < 1000
