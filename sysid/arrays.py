"""Check and normalise the arguments of the estimators.

Every estimator accepts one array or a list of segments, a start vector, parameter names, bounds
and a choice of free parameters. These functions turn each of them into one canonical form (float
arrays of two dimensions, tuples of names, boolean masks) and raise ValueError with the received
value, the allowed values and the remedy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
"""Array of double precision, of any shape."""


def as_array(value: ArrayLike, argument: str) -> FloatArray:
    """Convert to a float array.

    Parameters
    ----------
    value : array_like
        Numbers of any shape.
    argument : str
        Name of the argument, for the message.

    Raises
    ------
    ValueError
        If `value` is not numeric or not rectangular (numpy may raise TypeError for this).

    Examples
    --------
    >>> as_array([1, 2], "y")
    array([1., 2.])
    """
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{argument} must be numeric and rectangular: {error}") from None


def runs(labels: NDArray[Any]) -> list[slice]:
    """Return the slices of equal consecutive entries, in order; none for an empty array.

    Examples
    --------
    >>> runs(np.array(["", "climb", "climb", ""]))
    [slice(0, 1, None), slice(1, 3, None), slice(3, 4, None)]
    """
    labels = np.asarray(labels)
    starts = np.flatnonzero(np.append(True, labels[1:] != labels[:-1])[: len(labels)]).tolist()
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(labels)], strict=True)]


def is_segment_list(value: Any) -> bool:
    """Return whether `value` is a list of segments rather than one array written as nested lists.

    A list of arrays is a list of segments; so is a list of lists of lists.
    """
    if not isinstance(value, list | tuple) or len(value) == 0:
        return False
    first = value[0]
    return bool(first.ndim >= 1 if hasattr(first, "ndim") else np.ndim(first) == 2)


def as_segments(value: Any, argument: str, *, dropouts: bool) -> list[FloatArray]:
    """Convert one array or a list of arrays to segments of equal width.

    Parameters
    ----------
    value : array_like or list of array_like
        One segment, or several. A segment of shape (n,) is one channel and becomes (n, 1).
    argument : str
        Name of the argument, for the message.
    dropouts : bool
        Allow NaN, which marks a sample that was not measured. Infinite values are never allowed.

    Returns
    -------
    list of ndarray
        Segments of shape (n, m), with m equal for all.

    Raises
    ------
    ValueError
        If a value is not numeric, a segment has no sample, the number of columns differs between
        segments, or a value is not finite.
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
        # Report the first offending sample: that is what the caller has to look at.
        is_invalid = np.isinf(part) if dropouts else ~np.isfinite(part)
        if is_invalid.any():
            row, column = np.argwhere(is_invalid)[0]
            remedy = "mark dropouts as NaN" if dropouts else "repair or cut these samples"
            raise ValueError(
                f"{where} holds {int(is_invalid.sum())} value(s) that are not finite, first at"
                f" row {row}, column {column}; {remedy}"
            )
    return parts


def as_parameters(theta0: ArrayLike, argument: str = "theta0") -> FloatArray:
    """Convert a start vector to a finite array of shape (k,) with k >= 1, as a copy.

    Raises ValueError for any other shape and for values that are not finite.
    """
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
    """Return `count` unique names; ``prefix0``, ``prefix1``, ... when `names` is None.

    Parameters
    ----------
    names : sequence of str or None
        Names chosen by the caller.
    count : int
        Number of parameters.
    prefix : str
        Beginning of the default names.
    argument : str
        Name of the argument, for the message.

    Raises
    ------
    ValueError
        If `names` is a single string, has another length, or repeats a name.

    Examples
    --------
    >>> as_names(None, 2, "theta")
    ('theta0', 'theta1')
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
    """Convert bounds in any accepted form to a lower and an upper vector.

    Parameters
    ----------
    bounds : None, sequence or dict
        None (no bounds); k pairs ``(lower, upper)`` in which None is an open end; two vectors of
        shape (k,); or a dictionary from name to pair. With k = 2 a sequence is read as pairs.
    theta0 : ndarray of shape (k,)
        Start values, which must lie inside the bounds.
    names : tuple of str
        The k parameter names.

    Returns
    -------
    lower, upper : ndarray of shape (k,)
        Open ends are -inf and inf.

    Raises
    ------
    ValueError
        If the form is wrong, a lower bound is not below its upper bound, or a start value lies
        outside.

    Examples
    --------
    >>> lower, upper = as_bounds({"b": (0.0, None)}, np.array([1.0, 2.0]), ("a", "b"))
    >>> lower.tolist(), upper.tolist()
    ([-inf, 0.0], [inf, inf])
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
            # Two vectors of lower and upper bounds; a scalar in place of a vector counts for all.
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
    """Return the mask of estimated parameters.

    Parameters
    ----------
    free : None, sequence of str, of int or of bool
        Names, indices or a mask of the parameters to estimate; None selects all.
    names : tuple of str
        The k parameter names.

    Returns
    -------
    ndarray of bool, shape (k,)
        True for a parameter that is estimated.

    Raises
    ------
    ValueError
        If a name or an index does not exist, a mask has another length, or nothing is selected.

    Examples
    --------
    >>> as_free(["b"], ("a", "b")).tolist()
    [False, True]
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
