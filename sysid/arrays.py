"""What every estimator asks of its input: segments, names, bounds; refusals that say what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
"""Array of double precision, of any shape."""


def as_array(value: ArrayLike, argument: str) -> FloatArray:
    """`value` as a float array; ValueError (never TypeError) when it is not numeric."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{argument} must be numeric and rectangular: {error}") from None


def is_segment_list(value: Any) -> bool:
    """Is this a list of segments (of arrays, or of nested lists two deep), not one array written as
    a list?
    """
    if not isinstance(value, list | tuple) or len(value) == 0:
        return False
    first = value[0]
    return bool(first.ndim >= 1 if hasattr(first, "ndim") else np.ndim(first) == 2)


def as_segments(value: Any, argument: str, *, dropouts: bool) -> list[FloatArray]:
    """Segments as (n, m) arrays from one array or a list of them; a 1-D array is one output.

    dropouts: NaN is allowed (a sample that was not measured). Infinite values never are.
    Raises ValueError: not numeric, no sample, unequal columns, non-finite values.
    """
    parts = [as_array(part, argument) for part in (value if is_segment_list(value) else [value])]
    parts = [part[:, None] if part.ndim == 1 else part for part in parts]
    for number, part in enumerate(parts):
        where = f"{argument}, segment {number}" if len(parts) > 1 else argument
        if part.ndim != 2 or part.shape[0] == 0 or part.shape[1] == 0:
            raise ValueError(
                f"{where} has shape {part.shape}; give (n samples, m channels) with n, m >= 1"
            )
        if part.shape[1] != parts[0].shape[1]:
            raise ValueError(
                f"{where} has {part.shape[1]} columns, segment 0 has {parts[0].shape[1]}; give all"
                " the same"
            )
        is_invalid = np.isinf(part) if dropouts else ~np.isfinite(part)
        if is_invalid.any():
            row, column = np.argwhere(is_invalid)[0]
            remedy = "mark dropouts as NaN" if dropouts else "repair or cut these samples"
            raise ValueError(
                f"{where} holds {int(is_invalid.sum())} value(s) that are not finite, first at row {row},"
                f" column {column}; {remedy}"
            )
    return parts


def as_parameters(theta0: ArrayLike, argument: str = "theta0") -> FloatArray:
    """A finite (k,) vector, k >= 1. Raises ValueError otherwise."""
    theta = np.atleast_1d(as_array(theta0, argument)).copy()
    if theta.ndim != 1 or theta.size == 0:
        raise ValueError(
            f"{argument} has shape {theta.shape}; give a vector of at least one parameter"
        )
    if not np.isfinite(theta).all():
        raise ValueError(
            f"{argument} holds values that are not finite at"
            f" {np.flatnonzero(~np.isfinite(theta)).tolist()}"
        )
    return theta


def as_names(
    names: Sequence[str] | None, count: int, prefix: str, argument: str = "names"
) -> tuple[str, ...]:
    """`count` unique names, `prefix`0.. when none are given.

    Raises ValueError: wrong length, repeated.
    """
    if names is None:
        return tuple(f"{prefix}{index}" for index in range(count))
    if isinstance(names, str):
        raise ValueError(
            f"{argument} is the single string {names!r}; give a list of {count} name(s)"
        )
    labels = tuple(str(name) for name in names)
    if len(labels) != count:
        raise ValueError(
            f"{argument} has {len(labels)} entries for {count} parameters; give one name for each"
        )
    repeated = sorted({name for name in labels if labels.count(name) > 1})
    if repeated:
        raise ValueError(f"{argument} repeats {', '.join(repeated)}; names must be unique")
    return labels


def as_bounds(
    bounds: Any, theta0: FloatArray, names: tuple[str, ...]
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper (k,) from None, k pairs (None = open end), two (k,) vectors or {name: (lo,
    hi)}.

    With k = 2 the form is read as pairs, one a parameter.
    Raises ValueError: wrong form, lower >= upper, theta0 outside.
    """
    count = theta0.size
    lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
    if bounds is not None:
        if isinstance(bounds, dict):
            unknown = sorted(str(key) for key in set(bounds) - set(names))
            if unknown:
                raise ValueError(
                    f"bounds names {', '.join(unknown)}; the parameters are {', '.join(names)}"
                )
            pairs = [bounds.get(name, (None, None)) for name in names]
        else:
            pairs = list(bounds)
            if len(pairs) == 2 and count != 2:
                pairs = list(
                    zip(
                        np.broadcast_to(pairs[0], count),
                        np.broadcast_to(pairs[1], count),
                        strict=True,
                    )
                )
        if len(pairs) != count or any(pair is not None and len(pair) != 2 for pair in pairs):
            raise ValueError(
                f"bounds has {len(pairs)} entries for {count} parameters; give one (lower, upper)"
                " for each"
            )
        for index, pair in enumerate(pairs):
            low, high = pair if pair is not None else (None, None)
            lower[index] = -np.inf if low is None else float(low)
            upper[index] = np.inf if high is None else float(high)
    for index, name in enumerate(names):
        low, high, start = lower[index], upper[index], theta0[index]
        if not low < high:
            raise ValueError(
                f"bounds of {name} are ({low}, {high}); the lower must be below the upper (use"
                " free= to fix)"
            )
        if not low <= start <= high:
            raise ValueError(
                f"theta0 of {name} is {start}, outside its bounds ({low}, {high}); move the start"
                " or the bounds"
            )
    return lower, upper


def as_free(free: Any, names: tuple[str, ...]) -> NDArray[np.bool_]:
    """(k,) mask of estimated parameters from None, names, indices or a boolean mask.

    Raises ValueError.
    """
    count = len(names)
    if free is None:
        return np.ones(count, dtype=bool)
    items = list(free)
    mask = np.zeros(count, dtype=bool)
    if items and all(isinstance(item, str) for item in items):
        unknown = sorted(set(items) - set(names))
        if unknown:
            raise ValueError(
                f"free names {', '.join(unknown)}; the parameters are {', '.join(names)}"
            )
        mask[[names.index(item) for item in items]] = True
    elif items and all(isinstance(item, bool | np.bool_) for item in items):
        if len(items) != count:
            raise ValueError(
                f"free has {len(items)} entries for {count} parameters; give one for each"
            )
        mask[:] = items
    else:
        index = as_array(items, "free").astype(int)
        if index.size and (index.min() < 0 or index.max() >= count):
            raise ValueError(f"free holds indices {index.tolist()}; allowed are 0 to {count - 1}")
        mask[index] = True
    if not mask.any():
        raise ValueError("free selects no parameter; name at least one to estimate")
    return mask
