"""A study: the model is run once at every point that any method needs, and all outputs are kept.

`run_study` runs it, `write_study` and `read_study` store it as .npz; `analysis.analyse` applies the
methods.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from sysid.foreign.regular_files import parse_json
from uqharness.arguments import flag, instance, integer
from uqharness.arguments import path as file_path
from uqharness.errors import BadInputError
from uqharness.files import write_bytes
from uqharness.sensitivity.problem import (
    Problem,
    aleatory_centre,
    aleatory_draws,
    corners,
    make_problem,
    read_arrays,
)

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
