"""What each operation of the intermediate form means: kinds of arguments and result, and its value computed by numpy.

Every operation but the transcendental ones is exact or correctly rounded by IEEE 754, so numpy, constants folded at build time
and the compiled code have the same bits. The one exception is the sign and payload of a NaN, which processors choose differently:
NaN is compared as NaN. There is no fused multiply-add.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

F64, I64, I1, TABLE = "f64", "i64", "i1", "table"
"""Kinds of values: a double, its 64 bits as an integer, a truth value; and a row of constant doubles, the same in all lanes."""


@dataclass(frozen=True)
class Operation:
    """``kinds`` of the arguments, ``result`` kind, ``compute`` over numpy arrays (None: expanded before it is computed)."""

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
"""``min(a, b)`` is ``a if a < b else b`` and ``max(a, b)`` is ``a if a > b else b``: with a NaN, or two zeros, the second. ``ne``
is true for a NaN, the other comparisons are false. ``bits`` and ``double`` view the 64 bits as an integer and back; ``ishr``
fills with zeros. ``lookup`` gives the number of a table at an index, cut to a whole one and held at the ends; at 0 for a NaN."""


def numpy_of(operation: str) -> Callable[..., Any]:
    """What computes the operation over numpy arrays or scalars. Raises ValueError for a transcendental one."""
    compute = OPERATIONS[operation].compute
    if compute is None:
        raise ValueError(f"{operation} is computed only after form.maths.lower has written it out")
    return compute


def computed(operation: str, arguments: Sequence[Any]) -> Any:
    """The operation over numpy arrays or scalars, without warnings of numpy. Raises ValueError for a transcendental one."""
    compute = numpy_of(operation)
    with np.errstate(all="ignore"):
        return compute(*arguments)
