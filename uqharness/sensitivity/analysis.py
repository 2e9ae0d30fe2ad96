"""Apply the five methods of sensitivity to a stored study, and average repeats.

`analyse` is the public entry; `Sensitivity` holds an index [-] per output, method and parameter and
prints it as a table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.distributions import student_quantile
from uqharness.arguments import flag, instance, integer
from uqharness.errors import BadInputError
from uqharness.sensitivity.measures import (
    CONFIDENCE,
    Index,
    MethodResult,
    PairRange,
    anova,
    corner_pairs,
    local,
    pinching,
    scatter,
)
from uqharness.sensitivity.study import METHODS, Evaluations, Study
from uqharness.text_tables import TabularResult

if TYPE_CHECKING:
    import pandas as pd

_FUNCTIONS: Mapping[str, Callable[[Study, Evaluations, int, bool], MethodResult]] = {
    "local": local,
    "scatter": scatter,
    "anova": anova,
    "pbox": pinching,
    "proposed": corner_pairs,
}
assert tuple(_FUNCTIONS) == METHODS


@dataclass(frozen=True)
class Sensitivity(TabularResult):
    """Results by output, then by method.

    Attributes
    ----------
    results : mapping
        Output to method to `MethodResult`.
    """

    results: Mapping[str, Mapping[str, MethodResult]]

    def __repr__(self) -> str:
        return f"Sensitivity({', '.join(self.results)}; text() is the table)"

    def __getitem__(self, output: str) -> Mapping[str, MethodResult]:
        return self.results[output]

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON types; null with a reason where an index is undefined."""
        return {
            output: {method: result.as_dict() for method, result in methods.items()}
            for output, methods in self.results.items()
        }

    def to_dataframe(self) -> pd.DataFrame:
        """One row per output, parameter and method.

        Columns: the index [-], from ``smallest`` to ``largest`` (equal unless the method gives a
        range over pairs of corners), the ends ``low`` and ``high`` of its 95 % interval, and the
        ``reason`` where it is undefined (NaN).
        """
        import pandas as pd

        rows = [
            {
                "output": output,
                "parameter": name,
                "method": method,
                "smallest": ends[0].value,
                "largest": ends[1].value,
                "low": ends[0].low,
                "high": ends[1].high,
                "reason": index.reason,
            }
            for output, methods in self.results.items()
            for method, result in methods.items()
            for name, index in result.indices.items()
            for ends in [
                (index.minimum, index.maximum) if isinstance(index, PairRange) else (index, index)
            ]
        ]
        return pd.DataFrame(rows).set_index(["output", "parameter", "method"]).sort_index()

    def text(self) -> str:
        """Return tables: one per output, each index with its interval, then cost and assumption of
        methods.
        """
        return "\n\n".join(_table(output, methods) for output, methods in self.results.items())


def analyse(
    study: Study, methods: Sequence[str] = METHODS, seed: int = 0, intervals: bool = True
) -> Sensitivity:
    """Apply methods of sensitivity to every output of a study; no run is made.

    Parameters
    ----------
    study : Study
        From `run_study`.
    methods : sequence of str
        Among ``METHODS``; one that the study was not run for is undefined.
    seed : int
        Of the resampling.
    intervals : bool
        Whether indices have intervals by resampling.

    Returns
    -------
    Sensitivity
        Output, method and parameter to an `Index` [-] with its 95 % interval, NaN with a reason
        where it is undefined; ``text()`` is the table.

    Raises
    ------
    BadInputError
        For what is no study, and an unknown method.

    References
    ----------
    L. E. Hale, dissertation, Virginia Tech, 2016, chapter 4.

    Examples
    --------
    >>> from uqharness import sensitivity
    >>> study = sensitivity.run_study(
    ...     lambda a, b: 3 * a + b, {"a": (0, 1), "b": (0, 1)}, samples=16
    ... )
    >>> local = sensitivity.analyse(study, methods=["local"])["output"]["local"]
    >>> bool(local.indices["a"].value > local.indices["b"].value)
    True
    """
    instance("study", study, Study, "a Study, as run_study gives it,")
    integer("seed", seed)
    flag("intervals", intervals)
    unknown = sorted(set(methods) - set(METHODS))
    if unknown:
        raise BadInputError(f"methods {', '.join(unknown)}: choose among {', '.join(METHODS)}")
    return Sensitivity(
        {
            output: {method: _FUNCTIONS[method](study, runs, seed, intervals) for method in methods}
            for output, runs in study.outputs.items()
        }
    )


def _table(output: str, methods: Mapping[str, MethodResult]) -> str:
    """Format the table of one output."""
    names = list(next(iter(methods.values())).indices)
    width = max(9, *(len(name) for name in names))
    head = f"  {'':<{width}}" + "".join(f"{method:>27}" for method in methods)
    lines = [output, head]
    for name in names:
        lines.append(
            f"  {name:<{width}}"
            + "".join(f"{cell(result.indices[name]):>27}" for result in methods.values())
        )
    lines += [
        f"  {method}: {result.runs} runs; {result.statement}" for method, result in methods.items()
    ]
    return "\n".join(lines)


def cell(index: Index | PairRange) -> str:
    """Format an index or a range, with its interval if it has one."""
    if isinstance(index, PairRange):
        text, low, high = (
            f"{index.minimum.value:.3f}..{index.maximum.value:.3f}",
            index.minimum.low,
            index.maximum.high,
        )
        undefined = math.isnan(index.minimum.value)
    else:
        text, low, high = f"{index.value:.3f}", index.low, index.high
        undefined = math.isnan(index.value)
    if undefined:
        return "undefined"
    return text if math.isnan(low) else f"{text} [{low:.3f}, {high:.3f}]"


# Independent repeats of one study: the mean, and the variation of a single run.
#
# This is the simplest sampling error, for models that are cheap.


def average(repeats: Sequence[Sensitivity]) -> Sensitivity:
    """Average repeats that differ in their seed alone; each interval is that of the mean (Student's
    t).

    Parameters
    ----------
    repeats : sequence of Sensitivity
        At least two, of the same outputs and methods.

    Returns
    -------
    Sensitivity
        ``details["std_of_one_run"]`` (d,) [-] of each method is the standard deviation of a single
        repeat (of the larger end for the proposed method). An index that is undefined in one repeat
        is undefined.

    Raises
    ------
    BadInputError
        For fewer than two.

    Examples
    --------
    >>> from uqharness import sensitivity
    >>> def once(seed):
    ...     study = sensitivity.run_study(
    ...         lambda a, b: 3 * a + b, {"a": (0, 1), "b": (0, 1)}, samples=16, seed=seed
    ...     )
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
    """Average one method's results."""
    first = results[0]
    indices: dict[str, Index | PairRange] = {}
    stds = []
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
        stds.append(std)
    details = dict(first.details) | {"repeats": len(results), "std_of_one_run": np.array(stds)}
    runs = sum(result.runs for result in results)
    return replace(first, runs=runs, indices=indices, details=details)


def _mean(same: Sequence[Index]) -> tuple[Index, float]:
    """Return the mean index with its interval, and the standard deviation of a single run."""
    values = np.array([item.value for item in same])
    if np.isnan(values).any():
        return next(item for item in same if np.isnan(item.value)), float("nan")
    std = float(values.std(ddof=1))
    reach = (
        float(student_quantile(0.5 + 0.5 * CONFIDENCE, values.size - 1)) * std / values.size**0.5
    )
    mean = float(values.mean())
    return Index(mean, mean - reach, mean + reach), std
