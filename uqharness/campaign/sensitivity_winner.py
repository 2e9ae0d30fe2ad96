"""Which coefficient's model-form uncertainty drives a metric of a corner campaign, over all its conditions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from uqharness.campaign.sensitivity import analyse_campaign, metrics_of, read_corner_campaign
from uqharness.errors import BadInputError
from uqharness.flight import COEFFICIENTS
from uqharness.sensitivity import PairRange

DEFAULT_METRIC = "cross_track_median_m"


@dataclass(frozen=True)
class Winner:
    """``coefficient`` with its share of the metric's p-box [smallest, largest] in the condition whose p-box is the widest.

    ``certain``: first in every condition, whatever the others are and for the sampling error. ``words``: of `sensitivity`.
    """

    coefficient: str
    metric: str
    share: tuple[float, float]
    condition: str
    certain: bool
    words: tuple[str, ...]


def find_winner(
    folder: Path,
    metric: str | None = None,
    coefficient: str | None = None,
    seed: int = 0,
    on_progress: Callable[[int, int], None] | None = None,
) -> Winner:
    """The coefficient with the largest part of the p-boxes' widths, summed over conditions; or ``coefficient``, with its part.

    Raises BadInputError: no corner campaign, an unknown metric, nothing that could be compared, or no coefficient that wins.
    """
    flown = read_corner_campaign(folder)
    there = metrics_of(flown)
    chosen = metric or (DEFAULT_METRIC if DEFAULT_METRIC in there else (there or ("",))[0])
    if chosen not in there:
        raise BadInputError(
            f"--metric {chosen}: {folder} has {', '.join(there) or 'no metric that any flight got'}"
        )
    found = [
        f
        for f in analyse_campaign(flown, metrics=[chosen], seed=seed, on_progress=on_progress)
        if f.ranking.first
    ]
    if not found:
        raise BadInputError(
            f"{folder}: no sensitivity of {chosen} (uqharness sensitivity {folder} says why); fly more of the campaign, choose "
            "another --metric, or name a --coefficient"
        )
    parts: dict[str, float] = {}
    for item in found:
        for name, index in item.result.indices.items():
            assert isinstance(index, PairRange)
            middle = 0.5 * (index.minimum.value + index.maximum.value)
            parts[name] = parts.get(name, 0.0) + middle * float(item.result.details["area"])
    first = max(parts, key=lambda name: parts[name])
    name = coefficient or first
    if name not in parts:
        raise BadInputError(
            f"--coefficient {name}: not uncertain in {folder}; there are {', '.join(parts)}"
        )
    if name not in COEFFICIENTS:
        raise BadInputError(
            f"{folder}: {name} drives {chosen}; it is a quantity of its own and no model form: measure it. For the aerodynamic "
            "coefficient that matters most name it: --coefficient C"
        )
    best = max(found, key=lambda f: float(f.result.details["area"]))
    index = best.result.indices[name]
    assert isinstance(index, PairRange)
    return Winner(
        name,
        chosen,
        (index.minimum.value, index.maximum.value),
        best.condition.label,
        all(f.ranking.first == name and f.ranking.certain for f in found),
        tuple(f"{f.condition.words}: {f.words}" for f in found),
    )
