"""Independent repeats of one study: the mean, and how much one run alone varies.

The plainest sampling error, where a model is cheap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.distributions import student_quantile
from uqharness.errors import BadInputError
from uqharness.sensitivity.analysis import Sensitivity
from uqharness.sensitivity.result import CONFIDENCE, Index, MethodResult, PairRange


def average(repeats: Sequence[Sensitivity]) -> Sensitivity:
    """Mean over repeats that differ in their seed alone; each interval is that of the mean (Student's t).

    Parameters
    ----------
    repeats : sequence of Sensitivity
        At least two, of the same outputs and methods.

    Returns
    -------
    Sensitivity
        ``details["std_of_one_run"]`` (d,) [-] of each method is the standard deviation of a single repeat (of the larger end for
        the proposed method). An index that is undefined in one repeat is undefined.

    Raises
    ------
    BadInputError
        For fewer than two.

    Examples
    --------
    >>> from uqharness import sensitivity
    >>> def once(seed):
    ...     study = sensitivity.run_study(lambda a, b: 3 * a + b, {"a": (0, 1), "b": (0, 1)}, samples=16, seed=seed)
    ...     return sensitivity.analyse(study, intervals=False)
    >>> mean = sensitivity.average([once(1), once(2), once(3)])
    >>> mean["output"]["anova"].details["std_of_one_run"].shape
    (2,)
    """
    if len(repeats) < 2:
        raise BadInputError(
            f"{len(repeats)} repeats: at least two are needed to see how they differ"
        )
    first = repeats[0]
    return Sensitivity(
        {
            output: {
                method: _average([item[output][method] for item in repeats]) for method in methods
            }
            for output, methods in first.results.items()
        }
    )


def _average(results: Sequence[MethodResult]) -> MethodResult:
    first = results[0]
    indices: dict[str, Index | PairRange] = {}
    spread = []
    for name in first.indices:
        same = [result.indices[name] for result in results]
        pairs = [item for item in same if isinstance(item, PairRange)]
        single = [item for item in same if isinstance(item, Index)]
        if pairs:
            low, _ = _mean([item.minimum for item in pairs])
            high, std = _mean([item.maximum for item in pairs])
            indices[name] = PairRange(low, high)
        else:
            indices[name], std = _mean(single)
        spread.append(std)
    details = dict(first.details) | {"repeats": len(results), "std_of_one_run": np.array(spread)}
    runs = sum(result.runs for result in results)
    return replace(first, runs=runs, indices=indices, details=details)


def _mean(same: Sequence[Index]) -> tuple[Index, float]:
    values = np.array([item.value for item in same])
    if np.isnan(values).any():
        return next(item for item in same if np.isnan(item.value)), float("nan")
    std = float(values.std(ddof=1))
    reach = (
        float(student_quantile(0.5 + 0.5 * CONFIDENCE, values.size - 1)) * std / values.size**0.5
    )
    mean = float(values.mean())
    return Index(mean, mean - reach, mean + reach), std
