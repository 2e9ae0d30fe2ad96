"""campaign.toml: what a campaign flies, strictly validated.

Errors name file, line, what was received and what is allowed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, field_validator, model_validator

from sysid.digests import sha256_hex
from sysid.errors import LogError
from sysid.foreign.regular_files import ParseError, parse_json, read_regular
from uqharness.errors import BadInputError
from uqharness.flight import (
    COEFFICIENTS,
    DEFAULT_TURBULENCE_SOURCE,
    TURBULENCE_W20_KT,
    random_numbers,
)
from uqharness.simulator import STEADY, StartSection
from uqharness.toml import Number, Section, as_toml, is_number, listed, tupled

if TYPE_CHECKING:
    from sysid.model_form import ModelForm


# Names that sections of campaign.toml share: turbulence, coefficients.

Turbulence = Literal["none", "light", "moderate", "severe"]
Coefficient = Literal["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
assert set(TURBULENCE_W20_KT) == set(Turbulence.__args__)  # type: ignore[attr-defined]
assert Coefficient.__args__ == COEFFICIENTS  # type: ignore[attr-defined]


def ordered(value: tuple[str, ...]) -> tuple[str, ...]:
    """Coefficients in the order in which they are always listed.

    ValueError for none or one twice.
    """
    if not value or len(set(value)) != len(value):
        raise ValueError("must name at least one coefficient, and none twice")
    return tuple(name for name in COEFFICIENTS if name in value)


# [epistemic] of campaign.toml: uncertainty of the model, and how it is sampled.

SAMPLED = ("lhs", "white", "walk")
"""Methods that draw ``samples`` epistemic samples; the others list theirs."""

MAX_SAMPLES = 1_000_000

INTERIOR = 16
"""Most interior points by default: so many with a model form, at most one per corner with constant
bounds.
"""

PUBLISHED_WALK_RATE_PER_SQRT_S = 0.0017 * 50.0**0.5
"""0.17 % of the interval a sample (Hale 2016, Fig 3.3, CZ), the record taken as 50 Hz: what a walk
moves at unless told.
"""


class ParametersSection(Section):
    """Uncertainty of the identified parameters, from a fit: one draw of all of them belongs to an
    epistemic sample.

    ``distribution`` normal draws from the fit's covariance; box fills, by a Latin hypercube, the
    box of ``confidence`` (all parameters at once, Bonferroni) about the estimates. ``parameters``
    picks some of the fit's; absent = all identified ones."""

    fit: str = Field(min_length=1)
    parameters: Annotated[tuple[str, ...] | None, BeforeValidator(tupled)] = None
    distribution: Literal["normal", "box"] = "normal"
    confidence: Annotated[float, Field(gt=0, lt=1)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> ParametersSection:
        if self.confidence is not None and self.distribution != "box":
            raise ValueError(
                'confidence belongs to distribution = "box"; a normal distribution has no edge'
            )
        names = self.parameters
        if names is not None and (not names or len(set(names)) != len(names)):
            raise ValueError("parameters must name at least one property, and none twice")
        return self

    @property
    def box_confidence(self) -> float:
        """Confidence of the box over all parameters at once, 0.95 where none is given."""
        return 0.95 if self.confidence is None else self.confidence


class EpistemicSection(Section):
    """Ignorance: how the deltas move between their bounds.

    ``bounds`` per coefficient, or the name of a model-form.json; absent = the aircraft's own.
    ``set``: the intervals' box, or the ellipsoid of their joint confidence. ``transient``: the
    model form's transient error flies as well; absent = where there is such a part. ``interior``:
    points of a Latin hypercube flown with the corners. ``nominal``: the model with all deltas zero
    is flown with the corners as well (absent = true)."""

    method: Literal["none", "corners", "levels", "lhs", "white", "walk"]
    coefficients: Annotated[tuple[Coefficient, ...], BeforeValidator(tupled)] = COEFFICIENTS  # type: ignore[assignment]
    bounds: dict[Coefficient, tuple[Number, Number]] | str | None = None
    levels: tuple[Number, ...] | None = None
    samples: int | None = Field(default=None, ge=1, le=MAX_SAMPLES)
    walk_rate_per_sqrt_s: dict[Coefficient, Number] | None = None
    transient: bool | None = None
    set: Literal["box", "ellipsoid"] = "box"
    interior: int | None = Field(default=None, ge=0, le=MAX_SAMPLES)
    nominal: bool | None = None
    parameters: ParametersSection | None = None

    @field_validator("coefficients")
    @classmethod
    def _in_order(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        return ordered(value)

    @field_validator("bounds", mode="before")
    @classmethod
    def _bounds(cls, value: Any) -> Any:
        if isinstance(value, str) and not value.endswith(".json"):
            raise ValueError(
                "must be numbers, as { CX = 0.008, ... }, or the file of a model form, as"
                ' "model-form.json"'
            )
        return (
            {n: _interval(str(n), item) for n, item in value.items()}
            if isinstance(value, dict)
            else value
        )

    @field_validator("levels", mode="before")
    @classmethod
    def _levels(cls, value: Any) -> Any:
        value = tupled(value)
        if isinstance(value, tuple) and not all(
            is_number(item) and 0 <= item <= 1 for item in value
        ):
            raise ValueError("every level must be a number from 0 (lower bound) to 1 (upper bound)")
        if isinstance(value, tuple) and (not value or len(set(value)) != len(value)):
            raise ValueError("must name at least one level, and none twice")
        return value

    @field_validator("walk_rate_per_sqrt_s", mode="before")
    @classmethod
    def _rates(cls, value: Any) -> Any:
        rates = value if isinstance(value, dict) else dict.fromkeys(COEFFICIENTS, value)
        for name, rate in rates.items():
            if not is_number(rate) or not rate > 0:
                raise ValueError(
                    f"{name} = {as_toml(rate)}: a rate is a number above 0, the walk's standard"
                    " deviation after one second as a share of the interval's width (0.012 for the"
                    " published CZ)"
                )
        return {name: float(rate) for name, rate in rates.items()}

    @model_validator(mode="after")
    def _consistent(self) -> EpistemicSection:
        if (self.method == "levels") != (self.levels is not None):
            raise ValueError(
                'levels belongs to method = "levels", which needs it: levels = [0, 0.5, 1]'
            )
        self._check_bounds()
        self._check_samples()
        self._check_rates()
        self._check_set()
        return self

    def interior_samples(self, corners: int) -> int:
        """Return the number of interior points flown with so many corners."""
        if self.interior is not None:
            return self.interior
        if self.method != "corners":
            return 0
        return INTERIOR if isinstance(self.bounds, str) else min(INTERIOR, corners)

    @property
    def flies_nominal(self) -> bool:
        """Whether the model without deltas flies with the corners."""
        return self.method == "corners" and self.nominal is not False

    def _check_bounds(self) -> None:
        if not isinstance(self.bounds, dict):
            return
        for name in self.bounds:
            if name not in self.coefficients:
                raise ValueError(f"bounds are given for {name}, which is not among coefficients")
        missing = [name for name in self.coefficients if name not in self.bounds]
        if missing:
            raise ValueError(
                f"bounds lack {', '.join(missing)}: give them, or leave them out of coefficients"
            )

    def _check_samples(self) -> None:
        draws_samples = self.method in SAMPLED or self.parameters is not None
        if draws_samples and self.samples is None:
            key = (
                f'method = "{self.method}"' if self.method in SAMPLED else "[epistemic.parameters]"
            )
            raise ValueError(f"{key} needs samples, the number of draws: samples = 2000")
        if not draws_samples and self.samples is not None:
            raise ValueError(
                f"samples belongs to the methods {', '.join(SAMPLED)} and to"
                f' [epistemic.parameters]; method = "{self.method}" flies every combination'
                " there is"
            )

    def _check_rates(self) -> None:
        if self.walk_rate_per_sqrt_s is None:
            return
        if self.method != "walk":
            raise ValueError(
                f'walk_rate_per_sqrt_s belongs to method = "walk", not to "{self.method}"'
            )
        missing = [name for name in self.coefficients if name not in self.walk_rate_per_sqrt_s]
        if missing and not isinstance(self.bounds, str):
            raise ValueError(
                f"walk_rate_per_sqrt_s lacks {', '.join(missing)}: give them, or leave them out of"
                " coefficients"
            )

    def _check_set(self) -> None:
        if self.set == "ellipsoid" and self.method not in ("corners", "lhs"):
            raise ValueError(
                f'set = "ellipsoid" belongs to the methods corners and lhs, not to "{self.method}"'
            )
        if self.interior and self.method != "corners":
            raise ValueError(
                f"interior = {self.interior}: interior points are flown beside corners, not with"
                f' method = "{self.method}"'
            )
        if self.nominal and self.method != "corners":
            raise ValueError(
                "nominal = true: the nominal model is flown with corners, not with method ="
                f' "{self.method}"; method = "none" flies it alone'
            )
        if self.transient and self.method == "none":
            raise ValueError('transient = true: method = "none" flies no model error')


def _interval(name: str, item: Any) -> Any:
    """``0.008`` means ±0.008; a pair means [lower, upper] with 0 between."""
    if is_number(item):
        if item < 0:
            raise ValueError(
                f"{name} = {item:g}: a single bound is a half-width and cannot be negative"
            )
        return (-float(item), float(item))
    if not (isinstance(item, list) and len(item) == 2 and all(map(is_number, item))):
        raise ValueError(f"{name} = {as_toml(item)}: must be a number (±) or a pair [lower, upper]")
    if not item[0] <= 0 <= item[1]:
        raise ValueError(
            f"{name} = {as_toml(item)}: must have lower <= 0 <= upper, so that the model itself"
            " lies inside"
        )
    return (float(item[0]), float(item[1]))


# [stop] of campaign.toml: when the flying ends.

_KEYS_OF_RULE: Mapping[str, tuple[str, ...]] = {
    "flights": (),
    "hours": ("hours",),
    "band-width": ("band_width",),
    "decide": (
        "radius_m",
        "indifference_per_h",
        "error_rate",
        "simultaneous_over",
        "answer_for",
        "look_every",
    ),
}
_SETS_FLIGHTS = {"hours": "hours", "band-width": "band_width"}


class StopSection(Section):
    """When it ends.

    ``flights``: [aleatory] flights everywhere. ``hours``: that many flight hours per corner and
    condition. ``band-width``: as many flights as bring the p-box's band within ``band_width``
    (probability) of its envelope. All three are known beforehand. ``decide``: a cell ends once "at
    most [metrics] acceptable_per_h excursions beyond radius_m?" is answered, [aleatory] flights at
    the latest."""

    rule: Literal["flights", "hours", "band-width", "decide"] = "flights"
    hours: Annotated[Number, Field(gt=0)] | None = None
    band_width: Annotated[Number, Field(gt=0.001, le=1)] | None = None
    radius_m: Annotated[Number, Field(gt=0)] | None = None
    indifference_per_h: (
        Annotated[
            tuple[Annotated[Number, Field(gt=0)], Annotated[Number, Field(gt=0)]],
            BeforeValidator(tupled),
        ]
        | None
    ) = None
    error_rate: Annotated[Number, Field(gt=0, lt=0.5)] | None = None
    simultaneous_over: Literal["cell", "campaign"] | None = None
    answer_for: Literal["cell", "corner"] | None = None
    look_every: Annotated[int, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _of_its_rule(self) -> StopSection:
        for rule, keys in _KEYS_OF_RULE.items():
            strange = [key for key in keys if getattr(self, key) is not None and rule != self.rule]
            if strange:
                raise ValueError(f'{strange[0]} belongs to rule = "{rule}", not to "{self.rule}"')
        if self.rule == "band-width" and self.band_width is None:
            raise ValueError('rule = "band-width" needs band_width, a probability such as 0.1')
        if (
            self.indifference_per_h is not None
            and self.indifference_per_h[0] > self.indifference_per_h[1]
        ):
            raise ValueError("indifference_per_h must be [lower, upper]")
        return self


def without_flights(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The content of a file whose rule says how many flights there are, with a place for the
    number; any other as it is.
    """
    stop, air = data.get("stop"), data.get("aleatory")
    if not isinstance(stop, dict) or not isinstance(air, dict) or "flights" in air:
        return data
    key = _SETS_FLIGHTS.get(str(stop.get("rule")))
    return {**data, "aleatory": {**air, "flights": 1}} if key is not None and key in stop else data


# [aleatory.variables."PROPERTY"] of campaign.toml: what differs from flight to flight besides
# air and noise, such as the load.

Pair = tuple[Number, Number]


class VariableSection(Section):
    """One random property, drawn once a flight. normal: ``mean``, ``std``; uniform: ``low``,
    ``high``, or ``mean``, ``half_width``.

    ``mean`` may be an interval [low, high]: then where the mean lies is not known, which is an
    epistemic input of its own. Units are those of the JSBSim property (its name says them)."""

    distribution: Literal["normal", "uniform"]
    mean: Annotated[Number | Pair | None, BeforeValidator(tupled)] = None
    std: Annotated[Number, Field(gt=0)] | None = None
    low: Number | None = None
    high: Number | None = None
    half_width: Annotated[Number, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> VariableSection:
        present = {
            name
            for name in ("mean", "std", "low", "high", "half_width")
            if getattr(self, name) is not None
        }
        allowed = (
            [{"mean", "std"}]
            if self.distribution == "normal"
            else [{"low", "high"}, {"mean", "half_width"}]
        )
        if present not in allowed:
            needs = " or ".join(" and ".join(sorted(names, key=_ORDER.index)) for names in allowed)
            got = ", ".join(sorted(present, key=_ORDER.index)) or "none"
            raise ValueError(
                f'distribution = "{self.distribution}" needs {needs}, and no more; received {got}'
            )
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"low = {self.low:g} must be less than high = {self.high:g}")
        if isinstance(self.mean, tuple) and not self.mean[0] < self.mean[1]:
            raise ValueError(
                f"mean = [{self.mean[0]:g}, {self.mean[1]:g}]: an interval is [low, high] with low"
                " < high"
            )
        return self

    @property
    def mean_interval(self) -> Pair | None:
        """Ends of an uncertain mean; None where the mean is known."""
        return self.mean if isinstance(self.mean, tuple) else None

    def value(self, unit_draw: float, mean_level: float) -> float:
        """The variable for a draw in its unit (standard normal, or uniform in -1..1) and a level
        0..1 of an uncertain mean.
        """
        if self.mean is None:
            assert self.low is not None
            assert self.high is not None
            return 0.5 * (self.low + self.high) + 0.5 * (self.high - self.low) * unit_draw
        mean = self.mean
        centre = mean[0] + mean_level * (mean[1] - mean[0]) if isinstance(mean, tuple) else mean
        scale = self.std if self.std is not None else self.half_width
        assert scale is not None
        return centre + scale * unit_draw


_ORDER = ("mean", "std", "low", "high", "half_width")


# Files that a campaign.toml names as inputs: a model form (bounds and walk rates) and a fit
# (parameters with covariance).


@dataclass(frozen=True)
class Estimates:
    """Identified parameters: ``names`` (JSBSim properties), ``values`` (n,) and ``covariance`` (n,
    n), positive definite.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def factor(self) -> NDArray[np.float64]:
        """Lower triangle L (n, n) with L L' = covariance."""
        std = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(std, std)
        factor: NDArray[np.float64] = std[:, None] * np.array(
            random_numbers.cholesky(correlation.tolist())
        )
        return factor


@dataclass(frozen=True)
class CampaignInputs:
    """What the named files hold: the path of the model form, the coefficients it bounds, walk rates
    in 1/sqrt(s), the fit.

    ``confidence`` is that of the model form's intervals; ``has_parts``: it separates transient from
    persistent model error; ``transient_rates``, in 1/sqrt(s), are of the coefficients whose
    transient part is flown. ``hashes`` are SHA-256 of the files by what they are named as: bounds,
    fit."""

    model_form: Path | None = None
    coefficients: tuple[str, ...] = COEFFICIENTS
    walk_rates: Mapping[str, float] = field(default_factory=dict)
    estimates: Estimates | None = None
    confidence: float | None = None
    has_parts: bool = False
    transient_rates: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)


def read_inputs(section: EpistemicSection, folder: Path) -> CampaignInputs:
    """Read the files that ``section`` names, relative to the folder ``folder`` first.

    Raises BadInputError.
    """
    hashes: dict[str, str] = {}
    model_form: Path | None = None
    coefficients: tuple[str, ...] = section.coefficients
    rates: dict[str, float] = {
        str(name): rate for name, rate in (section.walk_rate_per_sqrt_s or {}).items()
    }
    if section.method == "walk" and not rates and not isinstance(section.bounds, str):
        rates = dict.fromkeys(coefficients, PUBLISHED_WALK_RATE_PER_SQRT_S)
    form: ModelForm | None = None
    if isinstance(section.bounds, str):
        model_form = _find(section.bounds, folder, "bounds", hashes)
        form = read_bounds(model_form)
        coefficients = _coefficients(section, model_form, form)
        if section.method == "walk":
            rates = {
                name: rates.get(name, form.coefficients[name].walk_rate) for name in coefficients
            }
            lacking = [name for name in coefficients if not rates[name] > 0]
            if lacking:
                raise BadInputError(
                    f"{model_form}: no walk_rate for {', '.join(lacking)}; give"
                    " walk_rate_per_sqrt_s in [epistemic], or take the bounds from a longer flight"
                )
    estimates = None
    if section.parameters is not None:
        path = _find(section.parameters.fit, folder, "fit", hashes)
        estimates = _estimates(path, section.parameters.parameters)
    inputs = CampaignInputs(model_form, coefficients, rates, estimates, hashes=hashes)
    return inputs if form is None else replace(inputs, **_form_fields(section, form, coefficients))


def _form_fields(
    section: EpistemicSection, form: ModelForm, coefficients: tuple[str, ...]
) -> dict[str, Any]:
    """What a model form says beside its bounds."""
    parts = {name: form.coefficients[name].parts for name in coefficients}
    has_transient = section.transient is not False and section.method != "none"
    rates = {
        name: part.transient_rate_per_sqrt_s
        for name, part in parts.items()
        if has_transient and part is not None and part.transient_half_width > 0.0
    }
    return {
        "confidence": form.confidence,
        "has_parts": any(part is not None for part in parts.values()),
        "transient_rates": rates,
    }


def read_bounds(path: Path) -> ModelForm:
    """A model form from its file. Raises BadInputError."""
    # Imported here: most campaigns do without.
    from sysid.model_form import read_model_form

    try:
        return read_model_form(path)
    except LogError as error:
        raise BadInputError(
            f"{error} (uqharness bounds AIRCRAFT --flight FILE --out DIR makes one)"
        ) from None


def _find(name: str, folder: Path, role: str, hashes: dict[str, str]) -> Path:
    named_path = Path(name)
    path = next((p for p in (folder / named_path, named_path) if p.is_file()), None)
    if path is None:
        raise BadInputError(
            f"{folder / named_path}: named as {role} and not there, nor is {named_path} in this folder"
        )
    try:
        hashes[role] = sha256_hex(read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    return path.resolve()


def _coefficients(section: EpistemicSection, path: Path, form: ModelForm) -> tuple[str, ...]:
    requested = section.coefficients
    if "coefficients" not in section.model_fields_set:
        return tuple(name for name in requested if name in form.coefficients)
    missing = [name for name in requested if name not in form.coefficients]
    if missing:
        raise BadInputError(
            f"{path}: has no bounds for {', '.join(missing)}, which [epistemic] coefficients names"
        )
    return requested


def _estimates(path: Path, requested: tuple[str, ...] | None) -> Estimates:
    try:
        document = parse_json(read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ParseError as error:
        raise BadInputError(f"{path}: {error}") from None
    try:
        names = [str(name) for name in document["names"]]
        covariance = np.array(document["cov"], dtype=np.float64)
        values = np.array(
            [document["parameters"][name]["value"] for name in names], dtype=np.float64
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInputError(
            f"{path}: not a fit with parameters, names and cov ({error}); make one with: uqharness"
            " identify"
        ) from None
    if not names:
        raise BadInputError(
            f"{path}: nothing was identified in this fit, so there is no parameter uncertainty to"
            " draw from"
        )
    if covariance.shape != (len(names), len(names)) or not (
        np.isfinite(covariance).all() and np.isfinite(values).all()
    ):
        raise BadInputError(
            f"{path}: cov must be a finite {len(names)} x {len(names)} matrix, as many as there are"
            " names"
        )
    if not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0):
        raise BadInputError(f"{path}: cov is not symmetric")
    estimates = Estimates(tuple(names), values, 0.5 * (covariance + covariance.T))
    if requested is not None:
        unknown = [name for name in requested if name not in names]
        if unknown:
            raise BadInputError(
                f"{path}: {', '.join(unknown)} is not among the identified parameters"
                f" ({', '.join(names)})"
            )
        rows = [names.index(name) for name in requested]
        estimates = Estimates(requested, values[rows], estimates.covariance[np.ix_(rows, rows)])
    try:
        if not (np.diag(estimates.covariance) > 0).all():
            raise ValueError("a variance is not positive")
        estimates.factor()
    except ValueError:
        raise BadInputError(
            f"{path}: cov is not positive definite, so nothing can be drawn from it"
        ) from None
    return estimates


class CampaignSection(Section):
    """What flies: an aircraft (name under aircraft/, or folder), a run script, and the root seed of
    all streams.

    ``engine`` auto is batch where the batch engine understands aircraft and mission as a whole,
    else jsbsim; settled at the first run."""

    aircraft: str = Field(min_length=1)
    mission: str = Field(min_length=1)
    seed: int = Field(ge=0, lt=2**63)
    engine: Literal["auto", "batch", "jsbsim"] = "auto"


class AleatorySection(Section):
    """Chance: flights per corner and condition, each ``duration_s`` scored after ``burn_in_s`` that
    is not.

    ``sensor_noise`` absent: on where the aircraft has a sensors system, which is settled before the
    campaign is flown."""

    flights: int = Field(ge=1, le=1_000_000)
    duration_s: Number = Field(gt=0, le=86_400)
    burn_in_s: Number = Field(default=120.0, ge=0, le=86_400)
    wind_mps: Annotated[
        tuple[Annotated[Number, Field(ge=0, le=60)], ...], BeforeValidator(listed)
    ] = (0.0,)
    wind_from_deg: Number = Field(default=270.0, ge=0, le=360)
    turbulence: Annotated[tuple[Turbulence, ...], BeforeValidator(listed)] = ("none",)
    turbulence_source: Literal["jsbsim", "spec"] = DEFAULT_TURBULENCE_SOURCE
    sensor_noise: bool | None = None
    variables: dict[str, VariableSection] = Field(default_factory=dict)

    @field_validator("wind_mps", "turbulence")
    @classmethod
    def _distinct(cls, value: tuple[Any, ...]) -> tuple[Any, ...]:
        if not value or len(set(value)) != len(value):
            raise ValueError("must name at least one value, and none twice")
        return value


class MetricsSection(Section):
    """What is counted: excursions beyond each radius [m], re-armed ``rearm_m`` inside it, and how
    many of them are acceptable.

    ``acceptable_loss_per_h`` is that of aborted flights (default: as many as excursions).
    ``dispersion`` is the largest ratio of variance to mean of the excursions of a flight that
    limits allow for (1: independent) where the same air does not show one at a smaller radius;
    ``dispersion_radius_m`` are further radii counted for that alone."""

    excursion_radius_m: Annotated[
        tuple[Annotated[Number, Field(gt=0)], ...], BeforeValidator(listed)
    ] = (15.0, 25.0)
    rearm_m: Number = Field(default=2.0, ge=0)
    acceptable_per_h: Number = Field(default=0.1, gt=0)
    acceptable_loss_per_h: Number | None = Field(default=None, gt=0)
    dispersion: Number = Field(default=2.0, ge=1, le=1000)
    dispersion_radius_m: Annotated[
        tuple[Annotated[Number, Field(gt=0)], ...] | None, BeforeValidator(listed)
    ] = None

    @model_validator(mode="after")
    def _consistent(self) -> MetricsSection:
        excursion_radii, dispersion_radii = self.excursion_radius_m, self.dispersion_radius_m or ()
        radii = (*excursion_radii, *dispersion_radii)
        if not excursion_radii or len(set(excursion_radii)) != len(excursion_radii):
            raise ValueError("excursion_radius_m must name at least one radius, and none twice")
        if len(set(radii)) != len(radii) or max(dispersion_radii, default=0.0) > max(
            excursion_radii
        ):
            raise ValueError(
                "dispersion_radius_m must name radii below the largest of excursion_radius_m, none"
                " twice and none of those again"
            )
        if self.rearm_m >= min(radii):
            raise ValueError(
                f"rearm_m = {self.rearm_m:g} must be less than the smallest radius,"
                f" {min(radii):g} m"
            )
        return self


class Document(Section):
    """A campaign file's content."""

    campaign: CampaignSection
    aleatory: AleatorySection
    epistemic: EpistemicSection
    metrics: MetricsSection = MetricsSection()
    stop: StopSection = StopSection()
    start: StartSection | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Document:
        if (self.campaign.mission == STEADY) != (self.start is not None):
            raise ValueError(
                f'mission = "{STEADY}" and a section [start] with V_mps and altitude_m belong'
                " together: a trimmed flight needs both, a run script neither"
            )
        return self


@dataclass(frozen=True)
class CampaignSpec:
    """A validated campaign. ``path`` is the file it came from; ``source`` its text; ``inputs`` what
    the files it names hold.
    """

    path: Path
    source: str
    campaign: CampaignSection
    aleatory: AleatorySection
    epistemic: EpistemicSection
    metrics: MetricsSection
    stop: StopSection
    start: StartSection | None = None
    inputs: CampaignInputs = field(default_factory=CampaignInputs)

    def as_dict(self) -> dict[str, Any]:
        """Every setting, defaults included, as plain JSON types: two files that mean the same give
        the same.
        """
        sections = {name: getattr(self, name) for name in Document.model_fields}
        settings = {
            name: section.model_dump(mode="json", exclude_none=True)
            for name, section in sections.items()
            if section is not None
        }
        settings["aleatory"].setdefault("sensor_noise", True)
        epistemic = settings["epistemic"]
        epistemic["coefficients"] = list(self.inputs.coefficients)
        for name in ("interior", "nominal", "transient"):
            epistemic.pop(name, None)
        if self.epistemic.method == "corners":
            epistemic["interior"] = self.interior_samples
            epistemic["nominal"] = self.epistemic.flies_nominal
        if self.inputs.has_parts and self.epistemic.method != "none":
            epistemic["transient"] = bool(self.inputs.transient_rates)
        if self.epistemic.method == "walk":
            epistemic["walk_rate_per_sqrt_s"] = {
                name: self.inputs.walk_rates[name] for name in self.inputs.coefficients
            }
        return settings

    @property
    def corner_count(self) -> int:
        """Number of combinations that ``method`` lists: of bounds (or levels) and of the ends of
        uncertain means.
        """
        section = self.epistemic
        means = sum(item.mean_interval is not None for item in self.aleatory.variables.values())
        coefficients = 0 if section.method == "none" else len(self.inputs.coefficients)
        values = len(section.levels) if section.method == "levels" and section.levels else 2
        points: int = values**coefficients
        if section.set == "ellipsoid" and coefficients > 1:
            points += 2 * coefficients
        return int(points * values**means)

    @property
    def interior_samples(self) -> int:
        """Number of interior points flown with the corners."""
        return self.epistemic.interior_samples(self.corner_count)

    def with_hours(self, hours: float) -> CampaignSpec:
        """The same campaign with as many flights as give ``hours`` of scored flight per corner and
        condition.
        """
        if not (math.isfinite(hours) and hours > 0):
            raise BadInputError(
                f"--hours {hours:g}: must be a number of flight hours greater than 0"
            )
        if self.stop.rule == "band-width":
            raise BadInputError(
                f'--hours {hours:g}: [stop] rule = "band-width" says how much is flown; leave out'
                " one of them"
            )
        flights = math.ceil(hours * 3600.0 / self.aleatory.duration_s - 1e-9)
        stop = (
            self.stop.model_copy(update={"hours": float(hours)})
            if self.stop.rule == "hours"
            else self.stop
        )
        return dataclasses.replace(self.with_flights(max(1, flights)), stop=stop)

    def with_engine(self, engine: str) -> CampaignSpec:
        """The same campaign flown in the engine of that name."""
        return dataclasses.replace(
            self, campaign=self.campaign.model_copy(update={"engine": engine})
        )

    def with_sensor_noise(self, noise: bool) -> CampaignSpec:
        """The same campaign flown with sensor noise or without."""
        return dataclasses.replace(
            self, aleatory=self.aleatory.model_copy(update={"sensor_noise": noise})
        )

    def with_flights(self, flights: int) -> CampaignSpec:
        """The same campaign with another number of flights per corner and condition."""
        return dataclasses.replace(
            self, aleatory=self.aleatory.model_copy(update={"flights": flights})
        )
