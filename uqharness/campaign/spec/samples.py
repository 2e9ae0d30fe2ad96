"""Epistemic samples of a campaign: corners, levels, a Latin hypercube, white or walking levels.

Draws of parameters and the levels of uncertain means belong to them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from sysid.arrays import FloatArray
from uqharness.campaign.spec.campaign import (
    MAX_SAMPLES,
    SAMPLED,
    AleatorySection,
    CampaignSpec,
    Document,
    Estimates,
    ParametersSection,
    read_inputs,
    without_flights,
)
from uqharness.errors import BadInputError
from uqharness.flight import (
    BELOW_CEILING,
    COEFFICIENTS,
    TURBULENCE_CEILING_M,
    LevelDriver,
    named_stream,
    numbered_stream,
    random_numbers,
)
from uqharness.toml import as_toml, explain, line_of, read_toml

# Levels of a joint confidence set: an ellipsoid in place of the box of intervals that each hold
# for one coefficient.
#
# Coefficients are taken as independent, their errors as normal, each interval's half-width as
# its quantile: the joint set is then a ball in the intervals' half-widths, of the chi
# distribution's quantile over the normal one. Its ends may lie outside 0..1.

_MAX_SIGMA = 40.0
_TERMS = 2000


def joint_radius(dof: int, confidence: float) -> float:
    """Radius [standard deviations] within which ``dof`` independent normals lie together: the root
    of chi-square's quantile.

    3.548 for six at 0.95. The same bits on every processor. ValueError for no dof, or a confidence
    not between 0 and 1 - 1e-9."""
    if dof < 1 or not 0.0 < confidence <= 1.0 - 1e-9:
        raise ValueError(
            f"dof = {dof}, confidence = {confidence}: at least 1, and a number above 0 and below 1"
            " are needed"
        )
    low, high = 0.0, _MAX_SIGMA
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        low, high = (middle, high) if _chi_distribution(middle, dof) < confidence else (low, middle)


def marginal_radius(confidence: float) -> float:
    """Half-width of one interval, in standard deviations: 1.960 at 0.95."""
    return random_numbers.normal_quantile(0.5 + 0.5 * confidence)


@lru_cache(maxsize=16)
def joint_reach(dof: int, confidence: float) -> float:
    """Radius of the ball in half-widths of the intervals; 1 for one coefficient."""
    return 1.0 if dof == 1 else joint_radius(dof, confidence) / marginal_radius(confidence)


def levels_at(direction: Sequence[float], radius: float) -> tuple[float, ...]:
    """Levels ``radius`` half-widths from the intervals' middles, component by component of
    ``direction``.
    """
    return tuple(0.5 + 0.5 * component * radius for component in direction)


def box_to_ball(levels: Sequence[float]) -> tuple[float, ...]:
    """A point of the box of levels 0..1 as a point of the unit ball: the box's shells become the
    ball's, directions stay.
    """
    cube = [2.0 * level - 1.0 for level in levels]
    length = math.sqrt(math.fsum(c * c for c in cube))
    return tuple(c * max(map(abs, cube)) / length if length > 0.0 else 0.0 for c in cube)


def _chi_distribution(r: float, dof: int) -> float:
    """Probability that the length of ``dof`` standard normals is at most r, by the series of the
    incomplete gamma function.
    """
    factor = random_numbers.exp(-0.5 * r * r) * (math.sqrt(2.0 / math.pi) if dof % 2 else 1.0)
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
"""How ids of points of a Latin hypercube begin."""
NOMINAL = "nominal"
"""Id of the model with all deltas zero."""


@dataclass(frozen=True)
class Epistemic:
    """One epistemic sample. ``levels``: level of each coefficient that is uncertain and stands
    still, 0..1 in the box of intervals.

    ``driver``: those that move; ``means``: level, 0..1, of each uncertain mean; ``parameters``:
    values of the drawn parameters."""

    epistemic_id: str
    levels: Mapping[str, float]
    driver: LevelDriver | None = None
    means: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)


def epistemic_samples(spec: CampaignSpec) -> tuple[Epistemic, ...]:
    """The epistemic samples in their one order. Depends on the campaign alone.

    A corner's id has one digit per coefficient in the order CX CY CZ Cl Cm Cn (``-`` for one that
    is not uncertain), then, after a ``+``, one per uncertain mean; a draw of parameters adds ``+p``
    and its number. Drawn samples are numbered: ``walk-000007``, and the points between corners as
    those of a Latin hypercube. Of an ellipsoid, ``e010011`` is the point in a corner's direction,
    ``a..1...`` the end of an axis, with ``.`` for a coefficient in the middle of its interval.
    ``nominal`` is the model with all deltas zero and uncertain means in the middle of their
    intervals."""
    means = [
        name for name, item in spec.aleatory.variables.items() if item.mean_interval is not None
    ]
    draws = _parameter_draws(spec)
    if spec.epistemic.method in SAMPLED:
        return tuple(_drawn_samples(spec, means, draws))
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
    """Id and levels of the ellipsoid's points in the directions of the corners, then those at the
    ends of its axes.
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
    assert spec.inputs.confidence is not None
    return joint_reach(len(spec.inputs.coefficients), spec.inputs.confidence)


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
    """Levels of one point of a Latin hypercube, brought into the ellipsoid where that is
    the set.
    """
    levels = [float(columns[name][number]) for name in spec.inputs.coefficients]
    if spec.epistemic.set == "ellipsoid":
        levels = list(levels_at(box_to_ball(levels), _reach(spec)))
    return dict(zip(spec.inputs.coefficients, levels, strict=True))


def _drawn_samples(
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
    """One dimension of a Latin hypercube, (samples,) in 0..1: one value in each of ``samples``
    equal cells, in random order.

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
    """Draws of the parameters, (samples, n): from N(values, covariance), or filling the
    simultaneous confidence box.
    """
    if section.distribution == "normal":
        rows = [
            random_numbers.drawn(numbered_stream(root_seed, "parameters", n), len(estimates.names))
            for n in range(samples)
        ]
        draws = np.tile(estimates.values, (samples, 1))
        # Column by column: a matrix product's order, and so its last bits, is the library's and the
        # processor's.
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


# campaign.toml read: every mistake named with its line, and the number of flights that its rule
# asks for.


def read_campaign(path: str | Path) -> CampaignSpec:
    """Read and validate a campaign file.

    Raises BadInputError that lists every mistake as ``file:line: ...``.
    """
    path = Path(path)
    data, text = read_toml(path)
    return campaign_from(data, path, text)


def checked_settings(data: dict[str, Any]) -> dict[str, Any]:
    """Settings of a campaign as a manifest holds them, defaults filled in.

    Looks at no file; raises pydantic's ValidationError.
    """
    document = Document.model_validate(without_flights(data))
    return document.model_dump(mode="json", exclude_none=True)


def campaign_from(data: dict[str, Any], path: Path, text: str = "") -> CampaignSpec:
    """Validate the content of a campaign file, as TOML or a manifest holds it.

    ``path`` is where files it names are looked for.
    """
    try:
        document = Document.model_validate(without_flights(data))
    except ValidationError as error:
        problems = [explain(Document, text, data, dict(item)) for item in error.errors()]
        lines = [f"{path}:{line}: {message}" for line, message in sorted(problems)]
        raise BadInputError(*dict.fromkeys(lines)) from None
    sections = {name: getattr(document, name) for name in Document.model_fields}
    inputs = read_inputs(document.epistemic, path.resolve().parent)
    spec = CampaignSpec(path, text, **sections, inputs=inputs)
    return with_planned_flights(spec, has_flights="flights" in data["aleatory"])


def with_planned_flights(spec: CampaignSpec, has_flights: bool) -> CampaignSpec:
    """The campaign with the number of flights its rule asks for; ``has_flights``: the file gives a
    number as well.

    Raises BadInputError, with the line, where the two differ, where [stop] and [metrics] do not
    belong together, and where [epistemic] asks for what its bounds do not hold."""
    _check_turbulence_model(spec)
    _check_metrics(spec)
    _check_model_form(spec)
    planned_spec, reason = _plan_flights(spec)
    if has_flights and planned_spec.aleatory.flights != spec.aleatory.flights:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('aleatory', 'flights'))}: [aleatory] flights ="
            f" {spec.aleatory.flights}, but [stop] {reason} asks for {planned_spec.aleatory.flights}; leave"
            " [aleatory] flights out"
        )
    return planned_spec


def replan_flights(spec: CampaignSpec) -> CampaignSpec:
    """The campaign with the number of flights its rule asks for, after something that bears on it
    has been changed.
    """
    return _plan_flights(spec)[0]


def _check_metrics(spec: CampaignSpec) -> None:
    stop, metrics = spec.stop, spec.metrics
    if stop.radius_m is not None and stop.radius_m not in metrics.excursion_radius_m:
        radii = ", ".join(f"{radius:g}" for radius in metrics.excursion_radius_m)
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('stop', 'radius_m'))}: [stop] radius_m ="
            f" {stop.radius_m:g}: must be among [metrics] excursion_radius_m ({radii})"
        )
    zone = stop.indifference_per_h
    if zone is not None and not zone[0] <= metrics.acceptable_per_h <= zone[1]:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('stop', 'indifference_per_h'))}: [stop]"
            f" indifference_per_h = [{zone[0]:g}, {zone[1]:g}]: must hold [metrics]"
            f" acceptable_per_h = {metrics.acceptable_per_h:g}"
        )


def _check_turbulence_model(spec: CampaignSpec) -> None:
    """Refuse a [start] above the turbulence model; the height of a script's start is found out by
    flying it.
    """
    air, start = spec.aleatory, spec.start
    turbulent = [name for name in air.turbulence if name != "none"]
    if start is None or not turbulent or air.turbulence_source != "spec":
        return
    if start.altitude_m > TURBULENCE_CEILING_M:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('start', 'altitude_m'))}: [start] altitude_m ="
            f" {start.altitude_m:g}: [aleatory] turbulence = {as_toml(turbulent)} is the"
            f" low-altitude model of MIL-F-8785C, which reaches to {TURBULENCE_CEILING_M:g} m (1000"
            f" ft); {BELOW_CEILING}"
        )


@contextlib.contextmanager
def naming_keys(spec: CampaignSpec) -> Iterator[None]:
    """Put file, line and section before a flight's refusal that begins with the name of a key of
    [aleatory].
    """
    try:
        yield
    except BadInputError as error:
        key = str(error).partition(" = ")[0]
        if type(error) is not BadInputError or key not in AleatorySection.model_fields:
            raise
        # A campaign from a Python dictionary has no lines.
        place = f"{spec.path}:{line_of(spec.source, ('aleatory', key))}: " if spec.source else ""
        raise BadInputError(f"{place}[aleatory] {error}") from None


def _check_model_form(spec: CampaignSpec) -> None:
    section, form = spec.epistemic, spec.inputs.model_form
    if section.transient and not spec.inputs.has_parts:
        lacks = "bounds are no model-form.json" if form is None else f"{form} has no transient part"
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('epistemic', 'transient'))}: [epistemic] transient"
            f" = true: {lacks}; make a model-form.json with `uqharness bounds`, or leave"
            " transient out"
        )
    if section.set == "ellipsoid" and form is None:
        raise BadInputError(
            f"{spec.path}:{line_of(spec.source, ('epistemic', 'set'))}: [epistemic] set ="
            ' "ellipsoid": it needs intervals whose confidence is known, bounds ='
            ' "model-form.json"; bounds given as numbers, or an aircraft\'s own, are a box'
        )


def _plan_flights(spec: CampaignSpec) -> tuple[CampaignSpec, str]:
    """The campaign with the flights its rule asks for, and what asks for them."""
    stop = spec.stop
    if stop.rule == "hours" and stop.hours is not None:
        reason = f"hours = {stop.hours:g} of flights of {spec.aleatory.duration_s:g} s"
        return spec.with_hours(stop.hours), reason
    if stop.rule == "band-width":
        # Imported here: pandas and scipy are for this rule alone.
        from uqharness.campaign.conditions import CONFIDENCE
        from uqharness.statistics import flights_for_band

        assert stop.band_width is not None
        samples = len(epistemic_samples(spec))
        flights = flights_for_band(stop.band_width, samples, CONFIDENCE)
        reason = f"band_width = {stop.band_width:g} over {samples} epistemic samples"
        return spec.with_flights(flights), reason
    return spec, ""


def with_samples(spec: CampaignSpec, samples: int) -> CampaignSpec:
    """The same campaign with another number of drawn epistemic samples.

    Raises BadInputError where none are drawn.
    """
    if spec.epistemic.samples is None:
        raise BadInputError(
            f"--samples {samples}: {spec.path} draws no epistemic samples (method ="
            f' "{spec.epistemic.method}"), so their number cannot be changed'
        )
    if not 1 <= samples <= MAX_SAMPLES:
        raise BadInputError(f"--samples {samples}: must be from 1 to {MAX_SAMPLES}")
    return replan_flights(
        dataclasses.replace(spec, epistemic=spec.epistemic.model_copy(update={"samples": samples}))
    )
