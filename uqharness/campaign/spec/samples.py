"""Epistemic samples of a campaign: corners, levels, a Latin hypercube, white or walking levels.

Draws of parameters and the levels of uncertain means belong to them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uqharness.campaign.inputs import Estimates
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.campaign.spec.epistemic import SAMPLED, ParametersSection
from uqharness.flight import COEFFICIENTS, LevelDriver, exact, named_stream, normals, numbered_stream

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Epistemic:
    """One epistemic sample. ``levels``: level, 0..1, of each coefficient that is uncertain and stands still.

    ``driver``: those that move; ``means``: level, 0..1, of each uncertain mean; ``parameters``: values of the drawn parameters.
    """

    epistemic_id: str
    levels: Mapping[str, float]
    driver: LevelDriver | None = None
    means: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)


def epistemic_samples(spec: CampaignSpec) -> tuple[Epistemic, ...]:
    """The epistemic samples in their one order. Depends on the campaign alone.

    A corner's id has one digit per coefficient in the order CX CY CZ Cl Cm Cn (``-`` for one that is not uncertain), then, after a
    ``+``, one per uncertain mean; a draw of parameters adds ``+p`` and its number. Drawn samples are numbered: ``walk-000007``.
    """
    means = [name for name, item in spec.aleatory.variables.items() if item.mean_interval is not None]
    draws = _parameter_draws(spec)
    if spec.epistemic.method in SAMPLED:
        return tuple(_drawn(spec, means, draws))
    return tuple(_combined(spec, means, draws))


def _combined(spec: CampaignSpec, means: Sequence[str], draws: Sequence[Mapping[str, float]]) -> Iterator[Epistemic]:
    """Every combination, first coefficient slowest, uncertain means next, draws of parameters fastest."""
    section = spec.epistemic
    values = section.levels if section.method == "levels" else (0.0, 1.0)
    assert values is not None
    moved = () if section.method == "none" else spec.inputs.coefficients
    separator = "/" if section.method == "levels" else ""
    for combination in itertools.product(values, repeat=len(moved) + len(means)):
        levels: dict[str, float] = dict(zip(moved, combination, strict=False))
        mean_levels = dict(zip(means, combination[len(moved) :], strict=True))
        marks = [f"{levels[name]:.17g}" if name in levels else "-" for name in COEFFICIENTS]
        name = separator.join(marks) if moved else "nominal"
        if means:
            name += "+" + separator.join(f"{level:.17g}" for level in mean_levels.values())
        if not draws:
            yield Epistemic(name, levels, None, mean_levels)
        for number, parameters in enumerate(draws):
            yield Epistemic(f"{name}+p{number:06d}", levels, None, mean_levels, parameters)


def _drawn(spec: CampaignSpec, means: Sequence[str], draws: Sequence[Mapping[str, float]]) -> Iterator[Epistemic]:
    section, root_seed = spec.epistemic, spec.campaign.seed
    moved = spec.inputs.coefficients
    assert section.samples is not None
    columns = {name: latin_column(root_seed, name, section.samples) for name in (*moved, *means)}
    for number in range(section.samples):
        name = f"{section.method}-{number:06d}"
        levels: dict[str, float] = {}
        driver = None
        if section.method == "lhs":
            levels = {item: float(columns[item][number]) for item in moved}
        elif section.method == "white":
            driver = LevelDriver("white", root_seed, name, moved)
        else:
            rates = tuple(float(spec.inputs.walk_rates[item]) for item in moved)
            driver = LevelDriver("walk", root_seed, name, moved, rates)
        mean_levels = {item: float(columns[item][number]) for item in means}
        yield Epistemic(name, levels, driver, mean_levels, draws[number] if draws else {})


def latin_column(root_seed: int, name: str, samples: int) -> Array:
    """One dimension of a Latin hypercube, (samples,) in 0..1: one value in each of ``samples`` equal cells, in random order.

    The stream is named after the dimension: adding another one moves none of these.
    """
    generator = np.random.Generator(np.random.PCG64(named_stream(root_seed, "levels", name)))
    column: Array = (generator.permutation(samples) + generator.random(samples)) / samples
    return column


def _parameter_draws(spec: CampaignSpec) -> list[dict[str, float]]:
    section, estimates = spec.epistemic.parameters, spec.inputs.estimates
    if section is None or estimates is None:
        return []
    assert spec.epistemic.samples is not None
    rows = parameter_draws(section, estimates, spec.epistemic.samples, spec.campaign.seed)
    return [dict(zip(estimates.names, map(float, row), strict=True)) for row in rows]


def parameter_draws(section: ParametersSection, estimates: Estimates, samples: int, root_seed: int) -> Array:
    """Draws of the parameters, (samples, n): from N(values, covariance), or filling the simultaneous confidence box."""
    if section.distribution == "normal":
        rows = [normals.drawn(numbered_stream(root_seed, "parameters", n), len(estimates.names)) for n in range(samples)]
        found = np.tile(estimates.values, (samples, 1))
        # Column by column: a matrix product's order, and so its last bits, is the library's and the processor's.
        for column, weights in zip(np.vstack(rows).T, estimates.factor().T, strict=True):
            found += column[:, None] * weights
        return found
    # Bonferroni: each interval at 1 - (1 - confidence)/n, so that all n hold at once with at least ``confidence``.
    reach = exact.normal_quantile(1.0 - (1.0 - section.box_confidence) / (2.0 * len(estimates.names)))
    columns = [latin_column(root_seed, f"parameter {name}", samples) for name in estimates.names]
    unit = 2.0 * np.column_stack(columns) - 1.0
    return np.asarray(estimates.values + unit * reach * np.sqrt(np.diag(estimates.covariance)))
