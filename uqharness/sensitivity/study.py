"""A study: the model is run once at every point that any method needs, and all outputs are kept.

`run_study` runs it, `write_study` and `read_study` store it as .npz; `analysis.analyse` applies the
methods.
"""

from __future__ import annotations

import io
import json
import lzma
import math
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.arrays import FloatArray
from sysid.errors import one_line
from sysid.foreign.regular_files import in_words, parse_json, read_regular
from uqharness.arguments import flag, instance, integer
from uqharness.arguments import path as file_path
from uqharness.errors import BadInputError
from uqharness.files import write_bytes

# The uncertain parameters of a study, checked, and the reader of its arrays.
#
# `make_problem` checks epistemic intervals and aleatory distributions; `corners` and
# `aleatory_draws` make the points. `read_arrays` reads .npz files of unknown origin safely.


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
    # Epistemic parameters: intervals with unique names.
    for name, interval in epistemic.items():
        _check_interval(name, interval)
        if name in aleatory:
            raise BadInputError(
                f"{name} is both epistemic and aleatory; give the two uncertainties two names"
            )
    # Aleatory variables: anything with an inverse distribution function.
    for name, distribution in aleatory.items():
        if not callable(getattr(distribution, "ppf", None)):
            raise BadInputError(
                f"aleatory {name}: {distribution!r} has no ppf; give a frozen distribution, as"
                " scipy.stats.norm(2.0, 0.1)"
            )
    lower = np.array([float(epistemic[name][0]) for name in names])
    upper = np.array([float(epistemic[name][1]) for name in names])
    # The nominal point is the middle unless the user says otherwise.
    centre = _over(names, nominal, 0.5 * (lower + upper), "nominal")
    for name, value, low, high in zip(names, centre, lower, upper, strict=True):
        if not low <= value <= high:
            raise BadInputError(
                f"nominal {name} = {value:g} lies outside its interval [{low:g}, {high:g}]"
            )
    # Finite differences need steps that are not 0.
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


METHODS = ("local", "scatter", "anova", "pbox", "proposed")
"""Finite difference, scatter regression, total-effect Sobol, p-box pinching, corner pairs.

The five methods of chapter 4.
"""

INTERIOR_SAMPLES = 16
"""Interior samples that check the corners' envelope in a study without other interior samples."""

MAX_CORNERS = 2**16
_ROWS_AT_ONCE = 65536

Model = Callable[..., Any]


@dataclass(frozen=True)
class Evaluations:
    """Outputs of one quantity, one array a stage; None for a stage that was not run.

    Columns are the same A aleatory draws in all stages.

    Attributes
    ----------
    nominal, forward : array (1,), (d,)
        At the centre of the aleatory variables: nominal, and one parameter changed by its step.
    sampled, second : array (E, A)
        Two independent sets of epistemic samples.
    mixed : array (d, E, A)
        The first set with column i from the second.
    pinned : array (d, E, A)
        The first set with column i at its nominal value.
    corners : array (2^d, A)
        First parameter slowest.
    interior : array (n, A)
        Samples inside the box.
    """

    nominal: FloatArray | None = None
    forward: FloatArray | None = None
    sampled: FloatArray | None = None
    second: FloatArray | None = None
    mixed: FloatArray | None = None
    pinned: FloatArray | None = None
    corners: FloatArray | None = None
    interior: FloatArray | None = None

    @property
    def between(self) -> FloatArray | None:
        """Samples inside the box: ``interior``, else ``sampled``; None without any."""
        return self.interior if self.interior is not None else self.sampled


@dataclass(frozen=True)
class Study:
    """Points and outputs of a study.

    Attributes
    ----------
    names : tuple of str
        d epistemic parameters.
    lower, upper, nominal, step : array (d,)
        Intervals, nominal values and steps in the parameters' own units.
    theta : array (E, d)
        Sampled points.
    chance : bool
        Columns of the evaluations are random draws; if not, a single column is exact.
    outputs : mapping of str to Evaluations
        By output.
    """

    names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    nominal: FloatArray
    step: FloatArray
    theta: FloatArray
    chance: bool
    outputs: Mapping[str, Evaluations]

    def __repr__(self) -> str:
        return (
            f"Study({len(self.theta)} samples of {', '.join(self.names)};"
            f" {', '.join(self.outputs)})"
        )

    @property
    def width(self) -> FloatArray:
        """Width (d,) of each parameter's interval."""
        return self.upper - self.lower


def run_study(
    model: Model,
    epistemic: Mapping[str, tuple[float, float]],
    aleatory: Mapping[str, Any] | None = None,
    *,
    nominal: Mapping[str, float] | None = None,
    step: Mapping[str, float] | None = None,
    samples: int = 1024,
    draws: int = 100,
    seed: int = 0,
    methods: Sequence[str] = METHODS,
    vectorised: bool = True,
    on_progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Run a function at the points that methods of sensitivity need, and keep every output.

    Parameters
    ----------
    model : callable
        ``model(**values)`` receives every epistemic and aleatory value by name and returns the
        output, or a mapping of named outputs. A NaN output is kept and reported.
    epistemic : Mapping
        Parameter to its interval (lower, upper), in its own unit.
    aleatory : Mapping, optional
        Variable to its distribution, anything with ``ppf`` such as a frozen scipy.stats one.
    nominal : Mapping, optional
        Parameter to its nominal value; by default the middle of its interval.
    step : Mapping, optional
        Parameter to the signed step of the local method; by default a hundredth of its interval.
    samples : int
        E, epistemic samples; a power of two for ``anova``.
    draws : int
        A, draws of the aleatory variables; 1 if there are none.
    seed : int
        Of samples and draws.
    methods : sequence of str
        Among ``METHODS``.
    vectorised : bool
        Whether the model takes and returns arrays (n,); else it is called with floats, one by one.
    on_progress : callable, optional
        Called with runs done and runs to do.

    Returns
    -------
    Study
        ``theta`` (E, d), and per output the evaluations of each stage.

    Raises
    ------
    BadInputError
        For intervals, distributions, sizes and methods that are not valid, and for a model that
        returns something else than it should.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, chapter 4: the five methods and their costs
    (Table 4.1).

    Examples
    --------
    >>> from scipy import stats
    >>> import uqharness as uq
    >>> def sink_rate(CD0, k, mass):
    ...     return mass * (CD0 + k)
    >>> intervals = {"CD0": (0.02, 0.03), "k": (0.05, 0.06)}
    >>> masses = {"mass": stats.norm(21.3, 0.5)}
    >>> study = uq.sensitivity.run_study(sink_rate, intervals, masses, samples=64, draws=10)
    >>> study.theta.shape, list(study.outputs)
    ((64, 2), ['output'])
    """
    integer("samples", samples)
    integer("draws", draws)
    integer("seed", seed)
    flag("vectorised", vectorised)
    problem = make_problem(epistemic, aleatory, nominal, step)
    _check(problem, samples, draws, methods)
    rng = np.random.default_rng(seed)
    chance = aleatory_draws(problem, draws, rng)
    centre = aleatory_centre(problem)
    # Two independent sets of epistemic samples, and interior samples.
    first, second = (
        problem.lower + rng.random((samples, len(problem.names))) * problem.width for _ in range(2)
    )
    inside = problem.lower + rng.random((INTERIOR_SAMPLES, len(problem.names))) * problem.width

    # Points of each stage that the methods need.
    stages: dict[str, tuple[FloatArray, FloatArray]] = {}
    if "local" in methods:
        stages["nominal"] = problem.nominal[None], centre
        stages["forward"] = problem.nominal + np.diag(problem.step), centre
    if set(methods) & {"local", "scatter", "anova", "pbox"}:
        stages["sampled"] = first, chance
    if "anova" in methods:
        stages["second"] = second, chance
        stages["mixed"] = _columns_from(first, second).reshape(-1, first.shape[1]), chance
    if "pbox" in methods:
        stages["pinned"] = (
            _columns_from(first, np.broadcast_to(problem.nominal, first.shape)).reshape(
                -1, first.shape[1]
            ),
            chance,
        )
    if "proposed" in methods:
        stages["corners"] = corners(problem.lower, problem.upper), chance
        if "sampled" not in stages:
            stages["interior"] = inside, chance

    # Run the model stage by stage.
    total = sum(len(theta) * len(draw) for theta, draw in stages.values())
    done = 0
    stage_outputs: dict[str, dict[str, FloatArray]] = {}
    for stage, (theta, draw) in stages.items():
        values = _evaluate(model, problem, theta, draw, vectorised)
        done += len(theta) * len(draw)
        if on_progress is not None:
            on_progress(done, total)
        # One array a stage for each output.
        for output, y in values.items():
            stage_outputs.setdefault(output, {})[stage] = _shaped(stage, y, len(problem.names))
    outputs = {output: Evaluations(**stage_outputs[output]) for output in stage_outputs}
    return Study(
        problem.names,
        problem.lower,
        problem.upper,
        problem.nominal,
        problem.step,
        first,
        bool(problem.aleatory),
        outputs,
    )


def _check(problem: Problem, samples: int, draws: int, methods: Sequence[str]) -> None:
    """Raise BadInputError for sizes and methods that do not fit."""
    unknown = sorted(set(methods) - set(METHODS))
    if unknown or not methods:
        raise BadInputError(
            f"methods {', '.join(unknown) or '(none)'}: choose among {', '.join(METHODS)}"
        )
    if samples < 16 or draws < 1:
        raise BadInputError(
            f"samples = {samples}, draws = {draws}: at least 16 samples and 1 draw are needed"
        )
    if problem.aleatory and draws < 2:
        raise BadInputError(
            f"draws = {draws}: with aleatory variables at least 2 draws are needed, and 8 for"
            " intervals"
        )
    if "anova" in methods and samples & (samples - 1):
        raise BadInputError(
            f"samples = {samples}: the variance-based method needs a power of two; "
            f"use {2 ** (samples.bit_length() - 1)} or {2 ** samples.bit_length()}"
        )
    if "proposed" in methods and 2 ** len(problem.names) > MAX_CORNERS:
        raise BadInputError(
            f"{len(problem.names)} epistemic parameters have 2^{len(problem.names)} corners, more"
            f" than {MAX_CORNERS}; leave 'proposed' out of methods, or fewer parameters in"
        )


def _columns_from(first: FloatArray, other: FloatArray) -> FloatArray:
    """Return copies (d, E, d) of ``first`` with column i from ``other``."""
    d = first.shape[1]
    copies = np.repeat(first[None], d, axis=0)
    for i in range(d):
        copies[i, :, i] = other[:, i]
    return copies


def _shaped(stage: str, y: FloatArray, d: int) -> FloatArray:
    """Reshape the outputs (n, A) of a stage as in `Evaluations`."""
    if stage in ("nominal", "forward"):
        return y[:, 0]
    return y.reshape(d, -1, y.shape[1]) if stage in ("mixed", "pinned") else y


def _evaluate(
    model: Model, problem: Problem, theta: FloatArray, draws: FloatArray, vectorised: bool
) -> dict[str, FloatArray]:
    """Run the model at every row of theta (n, d) with every draw (A, a): (n, A) per output."""
    rows = max(1, _ROWS_AT_ONCE // len(draws))
    parts: dict[str, list[FloatArray]] = {}
    for start in range(0, len(theta), rows):
        block = theta[start : start + rows]
        values = {name: np.repeat(block[:, k], len(draws)) for k, name in enumerate(problem.names)}
        values |= {
            name: np.tile(draws[:, k], len(block)) for k, name in enumerate(problem.aleatory)
        }
        called = (
            _call(model, values, len(block) * len(draws))
            if vectorised
            else _call_each(model, values)
        )
        if parts and set(called) != set(parts):
            raise BadInputError(f"the model gave outputs {sorted(called)} after {sorted(parts)}")
        for output, y in called.items():
            parts.setdefault(output, []).append(y.reshape(len(block), len(draws)))
    return {output: np.concatenate(blocks) for output, blocks in parts.items()}


def _as_mapping(returned: Any) -> Mapping[str, Any]:
    """Name a single output "output"."""
    return returned if isinstance(returned, Mapping) else {"output": returned}


def _call(model: Model, values: dict[str, FloatArray], n: int) -> dict[str, FloatArray]:
    """Call the model with arrays (n,)."""
    outputs = {}
    for output, y in _as_mapping(model(**values)).items():
        y = np.asarray(y, dtype=float)
        if y.shape not in ((n,), ()):
            raise BadInputError(
                f"the model gave an array of shape {y.shape} for values of shape ({n},); return one"
                " number per value, or pass vectorised=False to have it called with floats"
            )
        # A constant model may return one number.
        outputs[str(output)] = np.broadcast_to(y, (n,)).copy()
    return outputs


def _call_each(model: Model, values: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Call the model with floats, value by value."""
    rows = zip(*(column.tolist() for column in values.values()), strict=True)
    results = [_as_mapping(model(**dict(zip(values, row, strict=True)))) for row in rows]
    if any(set(item) != set(results[0]) for item in results):
        raise BadInputError(
            "the model names different outputs at different values; give every output a value, NaN"
            " where it has none"
        )
    return {
        str(output): np.array([float(item[output]) for item in results]) for output in results[0]
    }


_ARRAYS = ("lower", "upper", "nominal", "step", "theta")


def write_study(study: Study, path: str | Path) -> None:
    """Write a study, raw outputs included, whole or not at all.

    Parameters
    ----------
    study : Study
        What `run_study` gave.
    path : str or Path
        File to write, .npz.

    Raises
    ------
    BadInputError
        For what is no study, and where it cannot be written.

    Examples
    --------
    >>> from uqharness import sensitivity
    >>> study = sensitivity.run_study(lambda a: a**2, {"a": (0, 1)}, samples=16)
    >>> sensitivity.write_study(study, "study.npz")
    """
    instance("study", study, Study, "a Study, as run_study gives it,")
    target = file_path("path", path)
    arrays: dict[str, Any] = {name: getattr(study, name) for name in _ARRAYS}
    header = {"names": list(study.names), "outputs": list(study.outputs), "chance": study.chance}
    # Names and outputs as JSON bytes, so that the file holds numbers alone.
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    for number, evaluations in enumerate(study.outputs.values()):
        for field in fields(Evaluations):
            values = getattr(evaluations, field.name)
            if values is not None:
                arrays[f"{number}/{field.name}"] = values
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(target, buffer.getvalue())


def read_study(path: str | Path) -> Study:
    """Read a study that `write_study` wrote.

    Parameters
    ----------
    path : str or Path
        The .npz file.

    Returns
    -------
    Study
        As it was written.

    Raises
    ------
    BadInputError
        For any other file.

    Examples
    --------
    >>> from uqharness import sensitivity
    >>> study = sensitivity.run_study(lambda a: a**2, {"a": (0, 1)}, samples=16)
    >>> sensitivity.write_study(study, "study.npz")
    >>> sensitivity.read_study("study.npz").names
    ('a',)
    """
    arrays = read_arrays(Path(path))
    try:
        # Every array is checked, as the file may come from anybody.
        header = parse_json(arrays["header"].tobytes())
        names, outputs = list(map(_text, header["names"])), list(map(_text, header["outputs"]))
        d, samples = len(names), len(arrays["theta"])
        by_output = {
            output: Evaluations(
                **{
                    field.name: arrays[f"{k}/{field.name}"]
                    for field in fields(Evaluations)
                    if f"{k}/{field.name}" in arrays
                }
            )
            for k, output in enumerate(outputs)
        }
        for name in _ARRAYS:
            _require(name, arrays[name], (samples, d) if name == "theta" else (d,))
        for evaluations in by_output.values():
            _check_evaluations(evaluations, d, samples)
        stored: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
        return Study(
            names=tuple(names), chance=header["chance"] is True, outputs=by_output, **stored
        )
    except (ValueError, KeyError, TypeError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        raise BadInputError(f"{path}: not a study written by uqharness: {reason}") from None


def _text(value: Any) -> str:
    """Return a text entry; raises ValueError."""
    if not isinstance(value, str):
        raise ValueError(f"a name is {value!r}")
    return value


def _require(name: str, values: FloatArray, shape: tuple[int | None, ...]) -> None:
    """Raise ValueError unless an array has the dtype and the shape required."""
    fits = values.ndim == len(shape) and all(
        n is None or n == m for n, m in zip(shape, values.shape, strict=True)
    )
    if values.dtype != np.float64 or not fits:
        expected = " x ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(
            f"{name} is {values.dtype} of shape {values.shape}; {expected} numbers are needed"
        )


def _check_evaluations(evaluations: Evaluations, d: int, samples: int) -> None:
    """Raise ValueError unless every stage has its shape and the same draws."""
    stages = {field.name: getattr(evaluations, field.name) for field in fields(Evaluations)}
    stages = {name: values for name, values in stages.items() if values is not None}
    draws = {
        values.shape[-1]
        for name, values in stages.items()
        if name not in ("nominal", "forward") and values.ndim
    }
    if len(draws) > 1:
        raise ValueError(f"stages have {sorted(draws)} draws, which must be as many everywhere")
    shapes: dict[str, tuple[int | None, ...]] = {
        "nominal": (1,),
        "forward": (d,),
        "sampled": (samples, None),
        "second": (samples, None),
        "mixed": (d, samples, None),
        "pinned": (d, samples, None),
        "corners": (2**d if d < 64 else -1, None),
        "interior": (None, None),
    }
    for name, values in stages.items():
        _require(name, values, shapes[name])
