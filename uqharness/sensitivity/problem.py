"""What is uncertain: epistemic intervals and aleatory distributions, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.arrays import FloatArray
from uqharness.errors import BadInputError


@dataclass(frozen=True)
class Problem:
    """d epistemic parameters, each an interval with a nominal value inside, and a aleatory variables, each a distribution.

    ``lower``, ``upper``, ``nominal`` (d,) in the parameters' own units. ``step`` (d,), signed, is what the local method adds to one
    parameter at a time. ``aleatory`` maps a name to anything with ``ppf`` (a frozen scipy.stats distribution).
    """

    names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    nominal: FloatArray
    step: FloatArray
    aleatory: Mapping[str, Any]

    @property
    def width(self) -> FloatArray:
        """(d,) widths of the intervals."""
        return self.upper - self.lower


def make_problem(
    epistemic: Mapping[str, tuple[float, float]],
    aleatory: Mapping[str, Any] | None = None,
    nominal: Mapping[str, float] | None = None,
    step: Mapping[str, float] | None = None,
) -> Problem:
    """Check and collect. ``nominal`` defaults to the middle of each interval, ``step`` to a hundredth of its width.

    Raises BadInputError for an interval that is not lower < upper, a nominal value outside, a step of 0, a name that is not known
    or used twice, and a distribution without ``ppf``.
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
                f"aleatory {name}: {distribution!r} has no ppf; give a frozen distribution, as scipy.stats.norm(2.0, 0.1)"
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
    try:
        low, high = (float(end) for end in interval)
    except (TypeError, ValueError):
        raise BadInputError(
            f"epistemic {name} = {interval!r}: must be a pair (lower, upper)"
        ) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise BadInputError(
            f"epistemic {name} = ({low:g}, {high:g}): must be finite with lower < upper; a known value belongs into the model"
        )


def _over(
    names: tuple[str, ...], given: Mapping[str, float] | None, default: FloatArray, what: str
) -> FloatArray:
    unknown = sorted(set(given or {}) - set(names))
    if unknown:
        raise BadInputError(
            f"{what}: {', '.join(unknown)} not among the epistemic parameters {', '.join(names)}"
        )
    values = np.array(
        [float((given or {}).get(name, other)) for name, other in zip(names, default, strict=True)]
    )
    if not np.all(np.isfinite(values)):
        raise BadInputError(f"{what}: must be finite numbers, received {values.tolist()}")
    return values


def aleatory_draws(problem: Problem, draws: int, rng: np.random.Generator) -> FloatArray:
    """(draws, a) by Latin hypercube: the same draws serve every epistemic sample, so that differences are not chance's."""
    if not problem.aleatory:
        return np.empty((1, 0))
    from scipy.stats import qmc

    uniform = qmc.LatinHypercube(len(problem.aleatory), rng=rng).random(draws)
    columns = [dist.ppf(uniform[:, k]) for k, dist in enumerate(problem.aleatory.values())]
    return np.stack([np.asarray(column, dtype=float) for column in columns], axis=1)


def aleatory_centre(problem: Problem) -> FloatArray:
    """(1, a) means, or the median of a distribution that has no mean."""
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
    """(2^d, d) corners of the box, first parameter slowest."""
    d = lower.size
    bits = (np.arange(2**d)[:, None] >> np.arange(d - 1, -1, -1)) & 1
    return np.where(bits == 1, upper, lower)
