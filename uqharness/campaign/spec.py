"""Validate campaign.toml and the files that it names.

Each section of the file is a strict pydantic model; `CampaignSpec` is the validated campaign with
its inputs. Error messages name file and line, what was received and what is allowed.
`uqharness.campaign.sampling` builds the epistemic samples from it.
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

from sysid.errors import LogError
from sysid.foreign.regular_files import ParseError, parse_json, read_regular, sha256_hex
from uqharness.errors import BadInputError
from uqharness.flight import (
    COEFFICIENTS,
    DEFAULT_TURBULENCE_SOURCE,
    TURBULENCE_W20_KT,
    random_numbers,
)
from uqharness.requests.campaign import MAX_SAMPLES
from uqharness.simulator import STEADY, StartSection
from uqharness.toml import Number, Section, as_toml, as_tuple, is_number, list_as_tuple

if TYPE_CHECKING:
    from sysid.model_form import ModelForm


# Names shared by the sections.

Turbulence = Literal["none", "light", "moderate", "severe"]
Coefficient = Literal["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
_Coefficients = Annotated[tuple[Coefficient, ...], BeforeValidator(list_as_tuple)]
assert set(TURBULENCE_W20_KT) == set(Turbulence.__args__)  # type: ignore[attr-defined]
assert Coefficient.__args__ == COEFFICIENTS  # type: ignore[attr-defined]


def ordered(value: tuple[str, ...]) -> tuple[str, ...]:
    """Return coefficients in the order CX, CY, CZ, Cl, Cm, Cn.

    Raises ValueError for an empty or repeated list.
    """
    if not value or len(set(value)) != len(value):
        raise ValueError("must name at least one coefficient, and none twice")
    return tuple(name for name in COEFFICIENTS if name in value)


# Section [epistemic].

SAMPLED = ("lhs", "white", "walk")
"""Methods that draw ``samples`` epistemic samples; the others list theirs."""

INTERIOR = 16
"""Default number of interior points with a model form, and their maximum with constant bounds."""

PUBLISHED_WALK_RATE_PER_SQRT_S = 0.0017 * 50.0**0.5
"""Default rate of a walk: 0.17 % of the interval per sample (Hale 2016, Fig 3.3, CZ), at 50 Hz."""


class ParametersSection(Section):
    """Section [epistemic.parameters]: uncertainty of identified parameters, from a fit.

    One draw of all parameters belongs to an epistemic sample. ``distribution`` normal draws from
    the covariance of the fit; box fills, by a Latin hypercube, the box of ``confidence`` (all
    parameters at once, Bonferroni) around the estimates. ``parameters`` selects some; default: all
    identified ones.
    """

    fit: str = Field(min_length=1)
    parameters: Annotated[tuple[str, ...] | None, BeforeValidator(list_as_tuple)] = None
    distribution: Literal["normal", "box"] = "normal"
    confidence: Annotated[float, Field(gt=0, lt=1)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> ParametersSection:
        """Refuse a confidence without a box, and empty or repeated parameters."""
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
        """Confidence of the box over all parameters at once; default 0.95."""
        return 0.95 if self.confidence is None else self.confidence


class EpistemicSection(Section):
    """Section [epistemic]: uncertainty of the model between the bounds of its deltas.

    ``bounds`` are numbers per coefficient or a model-form.json; default: those of the aircraft.
    ``set`` is the box of the intervals or the ellipsoid of their joint confidence. ``transient``
    adds the transient error of the model form; default: if it has one. ``interior`` is the number
    of points of a Latin hypercube flown with the corners. ``nominal`` adds the model with zero
    deltas; default: true.
    """

    method: Literal["none", "corners", "levels", "lhs", "white", "walk"]
    coefficients: _Coefficients = COEFFICIENTS  # type: ignore[assignment]
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
        """Sort the coefficients."""
        return ordered(value)

    @field_validator("bounds", mode="before")
    @classmethod
    def _bounds(cls, value: Any) -> Any:
        """Expand half-widths to intervals."""
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
        """Require distinct levels between 0 and 1."""
        value = list_as_tuple(value)
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
        """Expand a single walk rate to all coefficients."""
        # One number holds for all coefficients.
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
        """Check keys that depend on each other."""
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
        """Return the number of interior points flown with that number of corners."""
        if self.interior is not None:
            return self.interior
        if self.method != "corners":
            return 0
        return INTERIOR if isinstance(self.bounds, str) else min(INTERIOR, corners)

    @property
    def flies_nominal(self) -> bool:
        """Whether the model without deltas is flown with the corners."""
        return self.method == "corners" and self.nominal is not False

    def _check_bounds(self) -> None:
        """Require bounds for exactly the uncertain coefficients."""
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
        """Require the number of samples where samples are drawn."""
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
        """Require walk rates for all uncertain coefficients."""
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
        """Refuse sets and points that the method does not fly."""
        if self.set == "ellipsoid" and self.method not in ("corners", "lhs"):
            raise ValueError(
                f'set = "ellipsoid" belongs to the methods corners and lhs, not to "{self.method}"'
            )
        if self.interior and self.method != "corners":
            raise ValueError(
                f"interior = {self.interior}: interior points are flown with corners, not with"
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
    """Return a pair [lower, upper] with 0 between; ``0.008`` means ±0.008."""
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


# Section [stop].

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
    """Section [stop]: when a campaign ends.

    ``flights``: [aleatory] flights everywhere. ``hours``: that many flight hours per corner and
    condition. ``band-width``: as many flights as bring the band of a p-box within ``band_width``
    (probability) of its envelope. These three are known beforehand. ``decide``: a condition ends
    once the question "at most [metrics] acceptable_per_h excursions beyond radius_m?" is answered,
    at the latest after [aleatory] flights.
    """

    rule: Literal["flights", "hours", "band-width", "decide"] = "flights"
    hours: Annotated[Number, Field(gt=0)] | None = None
    band_width: Annotated[Number, Field(gt=0.001, le=1)] | None = None
    radius_m: Annotated[Number, Field(gt=0)] | None = None
    indifference_per_h: (
        Annotated[
            tuple[Annotated[Number, Field(gt=0)], Annotated[Number, Field(gt=0)]],
            BeforeValidator(list_as_tuple),
        ]
        | None
    ) = None
    error_rate: Annotated[Number, Field(gt=0, lt=0.5)] | None = None
    simultaneous_over: Literal["cell", "campaign"] | None = None
    answer_for: Literal["cell", "corner"] | None = None
    look_every: Annotated[int, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _of_its_rule(self) -> StopSection:
        """Refuse keys of another rule."""
        # A key of another rule would be ignored silently, so it is refused.
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
    """Fill in a number of flights where the stopping rule determines it."""
    stop, air = data.get("stop"), data.get("aleatory")
    if not isinstance(stop, dict) or not isinstance(air, dict) or "flights" in air:
        return data
    key = _SETS_FLIGHTS.get(str(stop.get("rule")))
    return {**data, "aleatory": {**air, "flights": 1}} if key is not None and key in stop else data


# Section [aleatory.variables]: what varies between flights besides air and noise, such as the
# payload.

Pair = tuple[Number, Number]


class VariableSection(Section):
    """Section [aleatory.variables."PROPERTY"]: a random property, drawn once per flight.

    normal: ``mean``, ``std``; uniform: ``low``, ``high``, or ``mean``, ``half_width``. ``mean`` may
    be an interval [low, high]: the mean is then unknown within it, an epistemic input. Units are
    those of the JSBSim property.
    """

    distribution: Literal["normal", "uniform"]
    mean: Annotated[Number | Pair | None, BeforeValidator(list_as_tuple)] = None
    std: Annotated[Number, Field(gt=0)] | None = None
    low: Number | None = None
    high: Number | None = None
    half_width: Annotated[Number, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> VariableSection:
        """Require exactly the keys of the distribution."""
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
        """Ends of an uncertain mean; None if the mean is known."""
        return self.mean if isinstance(self.mean, tuple) else None

    def value(self, unit_draw: float, mean_level: float) -> float:
        """Return the variable for a draw and a level of the mean.

        Parameters
        ----------
        unit_draw : float
            Standard normal, or uniform in -1..1.
        mean_level : float
            Place of an uncertain mean in its interval, 0..1.
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


# Input files: a model form (bounds and walk rates) and a fit (parameters with covariance).


@dataclass(frozen=True)
class Estimates:
    """Identified parameters.

    Attributes
    ----------
    names : tuple of str
        JSBSim properties (n).
    values : array
        Estimates (n,).
    covariance : array
        Their covariance (n, n), positive definite.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def factor(self) -> NDArray[np.float64]:
        """Return the lower triangle L (n, n) with L L' = covariance."""
        # Factor the correlation matrix, which is better conditioned, with arithmetic that is the
        # same everywhere.
        std = np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.outer(std, std)
        factor: NDArray[np.float64] = std[:, None] * np.array(
            random_numbers.cholesky(correlation.tolist())
        )
        return factor


@dataclass(frozen=True)
class CampaignInputs:
    """Contents of the files named by a campaign.

    Attributes
    ----------
    model_form : Path or None
        File of the model form.
    coefficients : tuple of str
        Uncertain coefficients.
    walk_rates : mapping of str to float
        Walk rates [1/sqrt(s)].
    estimates : Estimates or None
        Parameters of the fit.
    confidence : float or None
        Confidence of the intervals of the model form.
    has_parts : bool
        Whether the model form separates transient and persistent error.
    transient_rates : mapping of str to float
        Rates [1/sqrt(s)] of coefficients whose transient error is flown.
    hashes : mapping of str to str
        SHA-256 of the files by role (bounds, fit).
    """

    model_form: Path | None = None
    coefficients: tuple[str, ...] = COEFFICIENTS
    walk_rates: Mapping[str, float] = field(default_factory=dict)
    estimates: Estimates | None = None
    confidence: float | None = None
    has_parts: bool = False
    transient_rates: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)


def read_inputs(section: EpistemicSection, folder: Path) -> CampaignInputs:
    """Read the files that the section [epistemic] names.

    Parameters
    ----------
    section : EpistemicSection
        Validated section.
    folder : Path
        Folder of the campaign file; names are looked up there first.

    Raises
    ------
    BadInputError
        If a file is missing or does not hold what is needed.
    """
    hashes: dict[str, str] = {}
    model_form: Path | None = None
    coefficients: tuple[str, ...] = section.coefficients
    # Walk rates: from the file, the published one, or the model form.
    rates: dict[str, float] = {
        str(name): rate for name, rate in (section.walk_rate_per_sqrt_s or {}).items()
    }
    if section.method == "walk" and not rates and not isinstance(section.bounds, str):
        rates = dict.fromkeys(coefficients, PUBLISHED_WALK_RATE_PER_SQRT_S)
    form: ModelForm | None = None
    # Bounds from a model form, for the coefficients that it has.
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
    # Parameters from a fit.
    estimates = None
    if section.parameters is not None:
        path = _find(section.parameters.fit, folder, "fit", hashes)
        estimates = _estimates(path, section.parameters.parameters)
    inputs = CampaignInputs(model_form, coefficients, rates, estimates, hashes=hashes)
    return inputs if form is None else replace(inputs, **_form_fields(section, form, coefficients))


def _form_fields(
    section: EpistemicSection, form: ModelForm, coefficients: tuple[str, ...]
) -> dict[str, Any]:
    """Return the fields of `CampaignInputs` that come from a model form."""
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
    """Read a model form. Raises BadInputError."""
    # Imported here because most campaigns have no model form.
    from sysid.model_form import read_model_form

    try:
        return read_model_form(path)
    except LogError as error:
        raise BadInputError(
            f"{error} (uqharness bounds AIRCRAFT --flight FILE --out DIR makes one)"
        ) from None


def _find(name: str, folder: Path, role: str, hashes: dict[str, str]) -> Path:
    """Locate and hash a named file. Raises BadInputError."""
    named_path = Path(name)
    path = next((p for p in (folder / named_path, named_path) if p.is_file()), None)
    if path is None:
        raise BadInputError(
            f"{folder / named_path}: named as {role} and not there, nor is {named_path} in this"
            " folder"
        )
    try:
        hashes[role] = sha256_hex(read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    return path.resolve()


def _coefficients(section: EpistemicSection, path: Path, form: ModelForm) -> tuple[str, ...]:
    """Return the coefficients that are uncertain with this model form."""
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
    """Read the parameters of a fit. Raises BadInputError."""
    # Read the document,
    try:
        document = parse_json(read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ParseError as error:
        raise BadInputError(f"{path}: {error}") from None
    # and of it the names, the values and their covariance.
    try:
        names = [str(name) for name in document["names"]]
        # Validate shape, symmetry and definiteness before anything is drawn.
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
            f"{path}: no parameter was identified in this fit, so there is no parameter uncertainty"
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
    # Symmetrise: the file may be symmetric to rounding only.
    estimates = Estimates(tuple(names), values, 0.5 * (covariance + covariance.T))
    # Keep the rows and columns of the requested parameters.
    if requested is not None:
        unknown = [name for name in requested if name not in names]
        if unknown:
            raise BadInputError(
                f"{path}: {', '.join(unknown)} is not among the identified parameters"
                f" ({', '.join(names)})"
            )
        rows = [names.index(name) for name in requested]
        estimates = Estimates(requested, values[rows], estimates.covariance[np.ix_(rows, rows)])
    # What cannot be factorised cannot be drawn from.
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
    """Section [campaign]: aircraft, run script and root seed of all random streams.

    ``engine`` auto means batch where the batch engine understands aircraft and mission completely,
    else jsbsim; the first run decides.
    """

    aircraft: str = Field(min_length=1)
    mission: str = Field(min_length=1)
    seed: int = Field(ge=0, lt=2**63)
    engine: Literal["auto", "batch", "jsbsim"] = "auto"


class AleatorySection(Section):
    """Section [aleatory]: random variation from flight to flight.

    ``flights`` is the number per corner and condition; each scores ``duration_s`` after
    ``burn_in_s``. ``sensor_noise`` is on by default if the aircraft has a sensors system.
    """

    flights: int = Field(ge=1, le=1_000_000)
    duration_s: Number = Field(gt=0, le=86_400)
    burn_in_s: Number = Field(default=120.0, ge=0, le=86_400)
    wind_mps: Annotated[
        tuple[Annotated[Number, Field(ge=0, le=60)], ...], BeforeValidator(as_tuple)
    ] = (0.0,)
    wind_from_deg: Number = Field(default=270.0, ge=0, le=360)
    turbulence: Annotated[tuple[Turbulence, ...], BeforeValidator(as_tuple)] = ("none",)
    turbulence_source: Literal["jsbsim", "spec"] = DEFAULT_TURBULENCE_SOURCE
    sensor_noise: bool | None = None
    variables: dict[str, VariableSection] = Field(default_factory=dict)

    @field_validator("wind_mps", "turbulence")
    @classmethod
    def _distinct(cls, value: tuple[Any, ...]) -> tuple[Any, ...]:
        """Refuse an empty or repeated list."""
        if not value or len(set(value)) != len(value):
            raise ValueError("must name at least one value, and none twice")
        return value


class MetricsSection(Section):
    """Section [metrics]: excursions beyond each radius [m], re-armed ``rearm_m`` inside it.

    ``acceptable_per_h`` and ``acceptable_loss_per_h`` are acceptable rates of excursions and of
    aborted flights (default: the same). ``dispersion`` is the largest ratio of variance to mean of
    a flight's excursions that limits allow for (1: independent) where it cannot be measured at a
    smaller radius; ``dispersion_radius_m`` are further radii counted for that measurement.
    """

    excursion_radius_m: Annotated[
        tuple[Annotated[Number, Field(gt=0)], ...], BeforeValidator(as_tuple)
    ] = (15.0, 25.0)
    rearm_m: Number = Field(default=2.0, ge=0)
    acceptable_per_h: Number = Field(default=0.1, gt=0)
    acceptable_loss_per_h: Number | None = Field(default=None, gt=0)
    dispersion: Number = Field(default=2.0, ge=1, le=1000)
    dispersion_radius_m: Annotated[
        tuple[Annotated[Number, Field(gt=0)], ...] | None, BeforeValidator(as_tuple)
    ] = None

    @model_validator(mode="after")
    def _consistent(self) -> MetricsSection:
        """Check the radii."""
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
    """Content of a campaign file."""

    campaign: CampaignSection
    aleatory: AleatorySection
    epistemic: EpistemicSection
    metrics: MetricsSection = MetricsSection()
    stop: StopSection = StopSection()
    start: StartSection | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Document:
        """Require [start] with the steady mission, and only with it."""
        if (self.campaign.mission == STEADY) != (self.start is not None):
            raise ValueError(
                f'mission = "{STEADY}" and a section [start] with V_mps and altitude_m belong'
                " together: a trimmed flight needs both, a run script neither"
            )
        return self


@dataclass(frozen=True)
class CampaignSpec:
    """A validated campaign.

    Attributes
    ----------
    path : Path
        File that it came from.
    source : str
        Text of the file.
    campaign, aleatory, epistemic, metrics, stop, start
        Sections of the file.
    inputs : CampaignInputs
        Content of the files that it names.
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
        """Return every setting, defaults included, as JSON types.

        Two files with the same meaning give the same dictionary.
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
            # Keys that do not apply are absent, so that equal campaigns give equal dictionaries.
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
        """Number of combinations of bounds (or levels) and ends of uncertain means."""
        section = self.epistemic
        # Every combination of bounds (or levels) with both ends of every uncertain mean.
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
        """Return the campaign with the flights that give ``hours`` of scored flight per corner and
        condition.

        Raises BadInputError with the rule band-width.
        """
        if self.stop.rule == "band-width":
            raise BadInputError(
                f'--hours {hours:g}: [stop] rule = "band-width" determines the number of flights;'
                " omit one of them"
            )
        flights = math.ceil(hours * 3600.0 / self.aleatory.duration_s - 1e-9)
        stop = (
            self.stop.model_copy(update={"hours": float(hours)})
            if self.stop.rule == "hours"
            else self.stop
        )
        return dataclasses.replace(self.with_flights(max(1, flights)), stop=stop)

    def with_engine(self, engine: str) -> CampaignSpec:
        """Return the campaign in another engine."""
        return dataclasses.replace(
            self, campaign=self.campaign.model_copy(update={"engine": engine})
        )

    def with_sensor_noise(self, noise: bool) -> CampaignSpec:
        """Return the campaign with or without sensor noise."""
        return dataclasses.replace(
            self, aleatory=self.aleatory.model_copy(update={"sensor_noise": noise})
        )

    def with_flights(self, flights: int) -> CampaignSpec:
        """Return the campaign with another number of flights per corner and condition."""
        return dataclasses.replace(
            self, aleatory=self.aleatory.model_copy(update={"flights": flights})
        )
