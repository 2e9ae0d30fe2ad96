"""Epistemic samples of a campaign: corners, levels, a Latin hypercube, white or walking levels.

Draws of parameters and the levels of uncertain means belong to them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.arrays import FloatArray
from uqharness.campaign.inputs import Estimates
from uqharness.campaign.spec import ellipsoid
from uqharness.campaign.spec.campaign import CampaignSpec
from uqharness.campaign.spec.epistemic import SAMPLED, ParametersSection
from uqharness.flight import (
    COEFFICIENTS,
    LevelDriver,
    exact,
    named_stream,
    normals,
    numbered_stream,
)

INTERIOR_MARK = "lhs-"
"""How ids of points of a Latin hypercube begin."""
NOMINAL = "nominal"
"""Id of the model with all deltas zero."""


@dataclass(frozen=True)
class Epistemic:
    """One epistemic sample. ``levels``: level of each coefficient that is uncertain and stands still, 0..1 in the box of intervals.

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
    ``+``, one per uncertain mean; a draw of parameters adds ``+p`` and its number. Drawn samples are numbered: ``walk-000007``, and
    the points between corners as those of a Latin hypercube. Of an ellipsoid, ``e010011`` is the point in a corner's direction,
    ``a..1...`` the end of an axis, with ``.`` for a coefficient in the middle of its interval. ``nominal`` is the model with all
    deltas zero and uncertain means in the middle of their intervals.
    """
    means = [
        name for name, item in spec.aleatory.variables.items() if item.mean_interval is not None
    ]
    draws = _parameter_draws(spec)
    if spec.epistemic.method in SAMPLED:
        return tuple(_drawn(spec, means, draws))
    points = [*_combined(spec, means), *_interior(spec, means)]
    if spec.epistemic.flies_nominal:
        points.append(Epistemic(NOMINAL, {}, None, dict.fromkeys(means, 0.5)))
    return tuple(_with_draws(points, draws))


def _with_draws(
    points: Sequence[Epistemic], draws: Sequence[Mapping[str, float]]
) -> Iterator[Epistemic]:
    """Every point with every draw of parameters, draws fastest."""
    for point in points:
        if not draws:
            yield point
        for number, parameters in enumerate(draws):
            yield replace(
                point, epistemic_id=f"{point.epistemic_id}+p{number:06d}", parameters=parameters
            )


def _combined(spec: CampaignSpec, means: Sequence[str]) -> Iterator[Epistemic]:
    """Every combination, first coefficient slowest, uncertain means next."""
    section = spec.epistemic
    values = section.levels if section.method == "levels" else (0.0, 1.0)
    assert values is not None
    moved = () if section.method == "none" else spec.inputs.coefficients
    separator = "/" if section.method == "levels" else ""
    if section.set == "ellipsoid":
        points = list(_on_ellipsoid(spec))
    else:
        points = [
            (_marked(c, separator), c)
            for c in (dict(zip(moved, c, strict=True)) for c in _product(values, len(moved)))
        ]
    for (name, levels), combination in itertools.product(points, _product(values, len(means))):
        mean_levels = dict(zip(means, combination, strict=True))
        name = name if moved else NOMINAL
        if means:
            name += "+" + separator.join(f"{level:.17g}" for level in mean_levels.values())
        yield Epistemic(name, levels, None, mean_levels)


def _product(values: Sequence[float], repeat: int) -> Iterator[tuple[float, ...]]:
    return itertools.product(values, repeat=repeat)


def _marked(levels: Mapping[str, float], separator: str = "") -> str:
    return separator.join(
        f"{levels[name]:.17g}" if name in levels else "-" for name in COEFFICIENTS
    )


def _on_ellipsoid(spec: CampaignSpec) -> Iterator[tuple[str, dict[str, float]]]:
    """Id and levels of the ellipsoid's points in the directions of the corners, then those at the ends of its axes."""
    moved = spec.inputs.coefficients
    radius, share = _reach(spec), 1.0 / math.sqrt(len(moved))
    for corner in _product((0.0, 1.0), len(moved)):
        levels = ellipsoid.at([share * (2.0 * end - 1.0) for end in corner], radius)
        yield (
            f"e{_marked(dict(zip(moved, corner, strict=True)))}",
            dict(zip(moved, levels, strict=True)),
        )
    if len(moved) == 1:
        return  # its two directions are the axis
    for axis, end in itertools.product(moved, (0, 1)):
        marks = "".join(
            str(end) if name == axis else "." if name in moved else "-" for name in COEFFICIENTS
        )
        levels = ellipsoid.at(
            [(2.0 * end - 1.0) if name == axis else 0.0 for name in moved], radius
        )
        yield f"a{marks}", dict(zip(moved, levels, strict=True))


def _reach(spec: CampaignSpec) -> float:
    assert spec.inputs.confidence is not None
    return ellipsoid.reach(len(spec.inputs.coefficients), spec.inputs.confidence)


def _interior(spec: CampaignSpec, means: Sequence[str]) -> Iterator[Epistemic]:
    """Points of a Latin hypercube over the same set."""
    number = spec.interior_samples
    columns = {
        name: latin_column(spec.campaign.seed, name, number)
        for name in (*spec.inputs.coefficients, *means)
    }
    for k in range(number):
        yield Epistemic(
            f"{INTERIOR_MARK}{k:06d}",
            _inside(spec, columns, k),
            None,
            {name: float(columns[name][k]) for name in means},
        )


def _inside(spec: CampaignSpec, columns: Mapping[str, FloatArray], number: int) -> dict[str, float]:
    """Levels of one point of a Latin hypercube, brought into the ellipsoid where that is the set."""
    levels = [float(columns[name][number]) for name in spec.inputs.coefficients]
    if spec.epistemic.set == "ellipsoid":
        levels = list(ellipsoid.at(ellipsoid.in_ball(levels), _reach(spec)))
    return dict(zip(spec.inputs.coefficients, levels, strict=True))


def _drawn(
    spec: CampaignSpec, means: Sequence[str], draws: Sequence[Mapping[str, float]]
) -> Iterator[Epistemic]:
    section, root_seed = spec.epistemic, spec.campaign.seed
    moved = spec.inputs.coefficients
    assert section.samples is not None
    columns = {name: latin_column(root_seed, name, section.samples) for name in (*moved, *means)}
    for number in range(section.samples):
        name = f"{section.method}-{number:06d}"
        levels: dict[str, float] = {}
        driver = None
        if section.method == "lhs":
            levels = _inside(spec, columns, number)
        elif section.method == "white":
            driver = LevelDriver("white", root_seed, name, moved)
        else:
            rates = tuple(float(spec.inputs.walk_rates[item]) for item in moved)
            driver = LevelDriver("walk", root_seed, name, moved, rates)
        mean_levels = {item: float(columns[item][number]) for item in means}
        yield Epistemic(name, levels, driver, mean_levels, draws[number] if draws else {})


def latin_column(root_seed: int, name: str, samples: int) -> FloatArray:
    """One dimension of a Latin hypercube, (samples,) in 0..1: one value in each of ``samples`` equal cells, in random order.

    The stream is named after the dimension: adding another one moves none of these.
    """
    generator = np.random.Generator(np.random.PCG64(named_stream(root_seed, "levels", name)))
    column: FloatArray = (generator.permutation(samples) + generator.random(samples)) / samples
    return column


def _parameter_draws(spec: CampaignSpec) -> list[dict[str, float]]:
    section, estimates = spec.epistemic.parameters, spec.inputs.estimates
    if section is None or estimates is None:
        return []
    assert spec.epistemic.samples is not None
    rows = parameter_draws(section, estimates, spec.epistemic.samples, spec.campaign.seed)
    return [dict(zip(estimates.names, map(float, row), strict=True)) for row in rows]


def parameter_draws(
    section: ParametersSection, estimates: Estimates, samples: int, root_seed: int
) -> FloatArray:
    """Draws of the parameters, (samples, n): from N(values, covariance), or filling the simultaneous confidence box."""
    if section.distribution == "normal":
        rows = [
            normals.drawn(numbered_stream(root_seed, "parameters", n), len(estimates.names))
            for n in range(samples)
        ]
        found = np.tile(estimates.values, (samples, 1))
        # Column by column: a matrix product's order, and so its last bits, is the library's and the processor's.
        for column, weights in zip(np.vstack(rows).T, estimates.factor().T, strict=True):
            found += column[:, None] * weights
        return found
    # Bonferroni: each interval at 1 - (1 - confidence)/n, so that all n hold at once with at least ``confidence``.
    reach = exact.normal_quantile(
        1.0 - (1.0 - section.box_confidence) / (2.0 * len(estimates.names))
    )
    columns = [latin_column(root_seed, f"parameter {name}", samples) for name in estimates.names]
    unit = 2.0 * np.column_stack(columns) - 1.0
    return np.asarray(estimates.values + unit * reach * np.sqrt(np.diag(estimates.covariance)))
