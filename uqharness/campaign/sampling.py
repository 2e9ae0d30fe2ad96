"""Build the epistemic samples of a campaign.

Samples are corners or levels of the coefficients' intervals, points of a Latin hypercube, or levels
that vary in flight (white, walk). Draws of identified parameters and levels of uncertain means
belong to them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from sysid.arrays import FloatArray
from uqharness.campaign.spec import SAMPLED, CampaignSpec, Estimates, ParametersSection
from uqharness.flight import (
    COEFFICIENTS,
    LevelDriver,
    named_stream,
    numbered_stream,
    random_numbers,
)

# Joint confidence set: an ellipsoid in place of the box of intervals. Coefficients are taken as
# independent, their errors as normal, and each half-width as a quantile. The joint set is then a
# ball in half-widths; its radius is the quantile of the chi distribution over that of the normal
# one. Its ends may lie outside 0..1.

_MAX_SIGMA = 40.0
_TERMS = 2000


def joint_radius(dof: int, confidence: float) -> float:
    """Return the radius within which ``dof`` independent standard normals lie together.

    It is the square root of the chi-square quantile: 3.548 for six at 0.95. The value is
    bit-identical on every processor.

    Parameters
    ----------
    dof : int
        Number of normals, at least 1.
    confidence : float
        Probability, above 0 and at most 1 - 1e-9.

    Raises
    ------
    ValueError
        Outside these ranges.

    Examples
    --------
    >>> round(joint_radius(6, 0.95), 3)
    3.548
    """
    if dof < 1 or not 0.0 < confidence <= 1.0 - 1e-9:
        raise ValueError(
            f"dof = {dof}, confidence = {confidence}: at least 1, and a number above 0 and below 1"
            " are needed"
        )
    # Bisection to the last bit: no library function with other rounding is involved.
    low, high = 0.0, _MAX_SIGMA
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        low, high = (middle, high) if _chi_distribution(middle, dof) < confidence else (low, middle)


def marginal_radius(confidence: float) -> float:
    """Return the half-width of one interval in standard deviations: 1.960 at 0.95."""
    return random_numbers.normal_quantile(0.5 + 0.5 * confidence)


@lru_cache(maxsize=16)
def joint_reach(dof: int, confidence: float) -> float:
    """Return the radius of the joint set in half-widths of the intervals; 1 for one coefficient."""
    return 1.0 if dof == 1 else joint_radius(dof, confidence) / marginal_radius(confidence)


def levels_at(direction: Sequence[float], radius: float) -> tuple[float, ...]:
    """Return the levels ``radius`` half-widths from the middles of the intervals along
    ``direction``.
    """
    return tuple(0.5 + 0.5 * component * radius for component in direction)


def box_to_ball(levels: Sequence[float]) -> tuple[float, ...]:
    """Map a point of the box of levels 0..1 into the unit ball; shells map to shells, directions
    stay.
    """
    cube = [2.0 * level - 1.0 for level in levels]
    length = math.sqrt(math.fsum(c * c for c in cube))
    return tuple(c * max(map(abs, cube)) / length if length > 0.0 else 0.0 for c in cube)


def _chi_distribution(r: float, dof: int) -> float:
    """Return the probability that the length of ``dof`` standard normals is at most ``r``.

    The series of the incomplete gamma function is summed with arithmetic that is the same
    everywhere.
    """
    factor = random_numbers.exp(-0.5 * r * r) * (math.sqrt(2.0 / math.pi) if dof % 2 else 1.0)
    # Leading term r^dof exp(-r^2/2) over the double factorial, then the series.
    for n in range(dof, 0, -2):
        factor *= r * r / n if n > 1 else r
    term = total = 1.0
    for n in range(1, _TERMS):
        term *= r * r / (dof + 2 * n)
        total += term
        if term < 1e-18 * total:
            break
    return factor * total


INTERIOR_MARK = "lhs-"
"""Beginning of the ids of points of a Latin hypercube."""
NOMINAL = "nominal"
"""Id of the model with zero deltas."""


@dataclass(frozen=True)
class Epistemic:
    """One epistemic sample.

    Attributes
    ----------
    epistemic_id : str
        Id, see `epistemic_samples`.
    levels : mapping of str to float
        Constant level of each uncertain coefficient; 0..1 within the box of intervals.
    driver : LevelDriver or None
        Levels that vary in flight.
    means : mapping of str to float
        Level 0..1 of each uncertain mean.
    parameters : mapping of str to float
        Values of drawn parameters.
    """

    epistemic_id: str
    levels: Mapping[str, float]
    driver: LevelDriver | None = None
    means: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)


def epistemic_samples(spec: CampaignSpec) -> tuple[Epistemic, ...]:
    """Return the epistemic samples in their one order, which depends on the campaign alone.

    A corner's id has one digit per coefficient in the order CX CY CZ Cl Cm Cn (``-`` for one that
    is not uncertain), then, after a ``+``, one per uncertain mean; a draw of parameters adds ``+p``
    and its number. Drawn samples are numbered (``walk-000007``), interior points as those of a
    Latin hypercube. For an ellipsoid, ``e010011`` is the point in the direction of a corner and
    ``a..1...`` the end of an axis, with ``.`` for a coefficient in the middle of its interval.
    ``nominal`` has zero deltas and uncertain means in the middle of their intervals.
    """
    # Uncertain means are a further dimension of every combination.
    means = [
        name for name, item in spec.aleatory.variables.items() if item.mean_interval is not None
    ]
    draws = _parameter_draws(spec)
    if spec.epistemic.method in SAMPLED:
        return tuple(_drawn_samples(spec, means, draws))
    # Corners, interior points, and last the nominal model.
    points = [*_combined(spec, means), *_interior(spec, means)]
    if spec.epistemic.flies_nominal:
        points.append(Epistemic(NOMINAL, {}, None, dict.fromkeys(means, 0.5)))
    return tuple(_with_draws(points, draws))


def _with_draws(
    points: Sequence[Epistemic], draws: Sequence[Mapping[str, float]]
) -> Iterator[Epistemic]:
    """Combine every point with every draw of parameters, draws fastest."""
    for point in points:
        if not draws:
            yield point
        for number, parameters in enumerate(draws):
            yield replace(
                point, epistemic_id=f"{point.epistemic_id}+p{number:06d}", parameters=parameters
            )


def _combined(spec: CampaignSpec, means: Sequence[str]) -> Iterator[Epistemic]:
    """Yield every combination, first coefficient slowest, uncertain means fastest."""
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
    """Return the Cartesian power of a set of values."""
    return itertools.product(values, repeat=repeat)


def _marked(levels: Mapping[str, float], separator: str = "") -> str:
    """Return the digits of a corner's id."""
    return separator.join(
        f"{levels[name]:.17g}" if name in levels else "-" for name in COEFFICIENTS
    )


def _on_ellipsoid(spec: CampaignSpec) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield id and levels of the points in the directions of the corners, then of the ends of the
    axes.
    """
    moved = spec.inputs.coefficients
    radius, share = _reach(spec), 1.0 / math.sqrt(len(moved))
    for corner in _product((0.0, 1.0), len(moved)):
        levels = levels_at([share * (2.0 * end - 1.0) for end in corner], radius)
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
        levels = levels_at([(2.0 * end - 1.0) if name == axis else 0.0 for name in moved], radius)
        yield f"a{marks}", dict(zip(moved, levels, strict=True))


def _reach(spec: CampaignSpec) -> float:
    """Return the radius of the campaign's ellipsoid in half-widths."""
    assert spec.inputs.confidence is not None
    return joint_reach(len(spec.inputs.coefficients), spec.inputs.confidence)


def _interior(spec: CampaignSpec, means: Sequence[str]) -> Iterator[Epistemic]:
    """Yield the points of a Latin hypercube over the uncertainty set."""
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
    """Return the levels of one point of a Latin hypercube, mapped into the ellipsoid if that is the
    set.
    """
    # A point of the unit box; for an ellipsoid it is mapped into the ball.
    levels = [float(columns[name][number]) for name in spec.inputs.coefficients]
    if spec.epistemic.set == "ellipsoid":
        levels = list(levels_at(box_to_ball(levels), _reach(spec)))
    return dict(zip(spec.inputs.coefficients, levels, strict=True))


def _drawn_samples(
    spec: CampaignSpec, means: Sequence[str], draws: Sequence[Mapping[str, float]]
) -> Iterator[Epistemic]:
    """Yield the samples of the methods lhs, white and walk."""
    section, root_seed = spec.epistemic, spec.campaign.seed
    moved = spec.inputs.coefficients
    assert section.samples is not None
    # One column per coefficient and per uncertain mean.
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
    """Return one dimension of a Latin hypercube (samples,), with one value in each of equal cells
    of 0..1.

    The random stream has the name of the dimension, so adding a dimension leaves the others
    unchanged.
    """
    generator = np.random.Generator(np.random.PCG64(named_stream(root_seed, "levels", name)))
    column: FloatArray = (generator.permutation(samples) + generator.random(samples)) / samples
    return column


def _parameter_draws(spec: CampaignSpec) -> list[dict[str, float]]:
    """Return the draws of the identified parameters by name; empty without them."""
    section, estimates = spec.epistemic.parameters, spec.inputs.estimates
    if section is None or estimates is None:
        return []
    assert spec.epistemic.samples is not None
    rows = parameter_draws(section, estimates, spec.epistemic.samples, spec.campaign.seed)
    return [dict(zip(estimates.names, map(float, row), strict=True)) for row in rows]


def parameter_draws(
    section: ParametersSection, estimates: Estimates, samples: int, root_seed: int
) -> FloatArray:
    """Return draws of the parameters (samples, n).

    They come from N(values, covariance), or fill the simultaneous confidence box.
    """
    if section.distribution == "normal":
        rows = [
            random_numbers.draw_normals(
                numbered_stream(root_seed, "parameters", n), len(estimates.names)
            )
            for n in range(samples)
        ]
        draws = np.tile(estimates.values, (samples, 1))
        # Column by column: order of summation, and so the last bits, of a matrix product depend on
        # the library and the processor.
        for column, weights in zip(np.vstack(rows).T, estimates.factor().T, strict=True):
            draws += column[:, None] * weights
        return draws
    # Bonferroni: each interval at 1 - (1 - confidence)/n, so that all n hold at once with at least
    # ``confidence``.
    reach = random_numbers.normal_quantile(
        1.0 - (1.0 - section.box_confidence) / (2.0 * len(estimates.names))
    )
    columns = [latin_column(root_seed, f"parameter {name}", samples) for name in estimates.names]
    unit = 2.0 * np.column_stack(columns) - 1.0
    return np.asarray(estimates.values + unit * reach * np.sqrt(np.diag(estimates.covariance)))
