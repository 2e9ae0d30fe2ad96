"""The uncertain parameters of a study, checked, and the reader of its arrays.

`make_problem` checks epistemic intervals and aleatory distributions; `corners` and `aleatory_draws`
make the points. `read_arrays` reads .npz files of unknown origin safely.
"""

from __future__ import annotations

import io
import lzma
import math
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import one_line
from sysid.foreign.regular_files import in_words, read_regular
from uqharness.errors import BadInputError


@dataclass(frozen=True)
class Problem:
    """d epistemic parameters and a aleatory variables.

    Attributes
    ----------
    names : tuple of str
        Epistemic parameters.
    lower, upper, nominal : array (d,)
        Intervals and nominal values in the parameters' own units.
    step : array (d,)
        Signed steps of the local method.
    aleatory : mapping
        Name to anything with ``ppf`` (a frozen scipy.stats distribution).
    """

    names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    nominal: FloatArray
    step: FloatArray
    aleatory: Mapping[str, Any]

    @property
    def width(self) -> FloatArray:
        """Widths (d,) of the intervals."""
        return self.upper - self.lower


def make_problem(
    epistemic: Mapping[str, tuple[float, float]],
    aleatory: Mapping[str, Any] | None = None,
    nominal: Mapping[str, float] | None = None,
    step: Mapping[str, float] | None = None,
) -> Problem:
    """Check and collect the uncertain parameters.

    Parameters
    ----------
    epistemic : mapping of str to (float, float)
        Intervals.
    aleatory : mapping, optional
        Distributions with ``ppf``.
    nominal : mapping of str to float, optional
        By default the middle of each interval.
    step : mapping of str to float, optional
        By default a hundredth of the interval's width.

    Returns
    -------
    Problem
        In the order of ``epistemic``.

    Raises
    ------
    BadInputError
        For an interval that is not lower < upper, a nominal value outside, a step of 0, an unknown
        or repeated name, and a distribution without ``ppf``.
    """
    aleatory = dict(aleatory or {})
    if not epistemic:
        raise BadInputError(
            "epistemic is empty; name at least one parameter with its interval: {'k': (0.9, 1.1)}"
        )
    names = tuple(epistemic)
    for name, interval in epistemic.items():
        _check_interval(name, interval)
        if name in aleatory:
            raise BadInputError(
                f"{name} is both epistemic and aleatory; give the two uncertainties two names"
            )
    for name, distribution in aleatory.items():
        if not callable(getattr(distribution, "ppf", None)):
            raise BadInputError(
                f"aleatory {name}: {distribution!r} has no ppf; give a frozen distribution, as"
                " scipy.stats.norm(2.0, 0.1)"
            )
    lower = np.array([float(epistemic[name][0]) for name in names])
    upper = np.array([float(epistemic[name][1]) for name in names])
    centre = _over(names, nominal, 0.5 * (lower + upper), "nominal")
    for name, value, low, high in zip(names, centre, lower, upper, strict=True):
        if not low <= value <= high:
            raise BadInputError(
                f"nominal {name} = {value:g} lies outside its interval [{low:g}, {high:g}]"
            )
    steps = _over(names, step, 0.01 * (upper - lower), "step")
    for name, value in zip(names, steps, strict=True):
        if value == 0.0:
            raise BadInputError(f"step {name} = 0: the finite difference needs a step")
    return Problem(names, lower, upper, centre, steps, aleatory)


def _check_interval(name: str, interval: Any) -> None:
    """Raise BadInputError unless the interval is finite with lower < upper."""
    try:
        low, high = (float(end) for end in interval)
    except (TypeError, ValueError):
        raise BadInputError(
            f"epistemic {name} = {interval!r}: must be a pair (lower, upper)"
        ) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise BadInputError(
            f"epistemic {name} = ({low:g}, {high:g}): must be finite with lower < upper; a known"
            " value belongs into the model"
        )


def _over(
    names: tuple[str, ...], overrides: Mapping[str, float] | None, default: FloatArray, label: str
) -> FloatArray:
    """Replace elements of ``default`` by name; raises BadInputError."""
    unknown = sorted(set(overrides or {}) - set(names))
    if unknown:
        raise BadInputError(
            f"{label}: {', '.join(unknown)} not among the epistemic parameters {', '.join(names)}"
        )
    values = np.array(
        [
            float((overrides or {}).get(name, other))
            for name, other in zip(names, default, strict=True)
        ]
    )
    if not np.all(np.isfinite(values)):
        raise BadInputError(f"{label}: must be finite numbers, received {values.tolist()}")
    return values


def aleatory_draws(problem: Problem, draws: int, rng: np.random.Generator) -> FloatArray:
    """Draw the aleatory variables (draws, a) by Latin hypercube.

    The same draws serve every epistemic sample, so that differences are no sampling error.
    """
    if not problem.aleatory:
        return np.empty((1, 0))
    from scipy.stats import qmc

    uniform = qmc.LatinHypercube(len(problem.aleatory), rng=rng).random(draws)
    columns = [dist.ppf(uniform[:, k]) for k, dist in enumerate(problem.aleatory.values())]
    return np.stack([np.asarray(column, dtype=float) for column in columns], axis=1)


def aleatory_centre(problem: Problem) -> FloatArray:
    """Return the means (1, a), or the median of a distribution without a mean."""
    centre = []
    for distribution in problem.aleatory.values():
        mean = (
            float(distribution.mean())
            if callable(getattr(distribution, "mean", None))
            else math.nan
        )
        centre.append(mean if math.isfinite(mean) else float(distribution.ppf(0.5)))
    return np.array([centre]).reshape(1, -1)


def corners(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the corners (2^d, d) of the box, first parameter slowest.

    Examples
    --------
    >>> import numpy as np
    >>> corners(np.zeros(2), np.ones(2)).tolist()
    [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
    """
    d = lower.size
    bits = (np.arange(2**d)[:, None] >> np.arange(d - 1, -1, -1)) & 1
    return np.where(bits == 1, upper, lower)


# Arrays of a .npz of unknown origin: nothing is unpickled, and memory is limited.

MAX_FILE_BYTES = 500_000_000
MAX_BYTES = 1_000_000_000
"""Largest size of all arrays, unpacked.

A study of 12 parameters, 8192 samples and 100 draws has 200 MB an output.
"""
_KINDS = "fiub"
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    tokenize.TokenError,
    OSError,
    EOFError,
    RuntimeError,
    NotImplementedError,
    ValueError,
    SyntaxError,
    TypeError,
    OverflowError,
    LookupError,
    MemoryError,
)
"""Exceptions of zipfile and numpy for a damaged, encrypted or unknown file."""


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read arrays of numbers by name from a .npz file.

    Raises BadInputError for anything else, and for more than MAX_BYTES.
    """
    try:
        content = read_regular(path, MAX_FILE_BYTES)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        # Check the unpacked size before reading a member.
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > MAX_BYTES:
                raise ValueError(
                    f"its arrays would take {in_words(size)}, at most {in_words(MAX_BYTES)} are"
                    " read"
                )
            return {
                member.filename.removesuffix(".npy"): _array(archive.read(member))
                for member in members
            }
    except _DAMAGED as error:
        words = one_line(error)
        raise BadInputError(
            f"{path}: not a study written by uqharness, nor any other archive of arrays: {words};"
            " write it again"
        ) from None


def _array(content: bytes) -> NDArray[Any]:
    """Parse one array.

    Raises ValueError for other data than numbers, and for a header that does not match the length.
    """
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, fortran, dtype = read(file)
    # Numbers alone, of the length that the header says.
    if dtype.kind not in _KINDS or dtype.hasobject:
        raise ValueError(f"an array of type {dtype} among its arrays")
    if math.prod(shape) * dtype.itemsize != len(content) - file.tell():
        raise ValueError("an array is cut short, or its header does not tell its size")
    flat = np.frombuffer(content, dtype, offset=file.tell())
    return flat.reshape(shape, order="F" if fortran else "C").copy()
