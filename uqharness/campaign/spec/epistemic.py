"""[epistemic] of campaign.toml: uncertainty of the model, and how it is sampled."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from uqharness.campaign.spec.names import Coefficient, ordered
from uqharness.flight import COEFFICIENTS
from uqharness.settings import Number, Section, is_number, tupled
from uqharness.toml import as_toml

SAMPLED = ("lhs", "white", "walk")
"""Methods that draw ``samples`` epistemic samples; the others list theirs."""

MOST_SAMPLES = 1_000_000

INTERIOR = 16
"""Most interior points by default: so many with a model form, at most one per corner with constant bounds."""

PUBLISHED_WALK_RATE_PER_SQRT_S = 0.0017 * 50.0**0.5
"""0.17 % of the interval a sample (Hale 2016, Fig 3.3, CZ), the record taken as 50 Hz: what a walk moves at unless told."""


class ParametersSection(Section):
    """Uncertainty of the identified parameters, from a fit: one draw of all of them belongs to an epistemic sample.

    ``distribution`` normal draws from the fit's covariance; box fills, by a Latin hypercube, the box of ``confidence`` (all
    parameters at once, Bonferroni) about the estimates. ``parameters`` picks some of the fit's; absent = all identified ones.
    """

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

    ``bounds`` per coefficient, or the name of a model-form.json; absent = the aircraft's own. ``set``: the intervals' box, or the
    ellipsoid of their joint confidence. ``transient``: the model form's transient error flies as well; absent = where there
    is such a part. ``interior``: points of a Latin hypercube flown with the corners. ``nominal``: the model with all deltas zero is
    flown with the corners as well (absent = true).
    """

    method: Literal["none", "corners", "levels", "lhs", "white", "walk"]
    coefficients: Annotated[tuple[Coefficient, ...], BeforeValidator(tupled)] = COEFFICIENTS  # type: ignore[assignment]
    bounds: dict[Coefficient, tuple[Number, Number]] | str | None = None
    levels: tuple[Number, ...] | None = None
    samples: int | None = Field(default=None, ge=1, le=MOST_SAMPLES)
    walk_rate_per_sqrt_s: dict[Coefficient, Number] | None = None
    transient: bool | None = None
    set: Literal["box", "ellipsoid"] = "box"
    interior: int | None = Field(default=None, ge=0, le=MOST_SAMPLES)
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
                'must be numbers, as { CX = 0.008, ... }, or the file of a model form, as "model-form.json"'
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
                    f"{name} = {as_toml(rate)}: a rate is a number above 0, the walk's standard deviation after one second as "
                    "a share of the interval's width (0.012 for the published CZ)"
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
        wanted = self.method in SAMPLED or self.parameters is not None
        if wanted and self.samples is None:
            what = (
                f'method = "{self.method}"' if self.method in SAMPLED else "[epistemic.parameters]"
            )
            raise ValueError(f"{what} needs samples, the number of draws: samples = 2000")
        if not wanted and self.samples is not None:
            raise ValueError(
                f'samples belongs to the methods {", ".join(SAMPLED)} and to [epistemic.parameters]; method = "{self.method}" '
                "flies every combination there is"
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
                f"walk_rate_per_sqrt_s lacks {', '.join(missing)}: give them, or leave them out of coefficients"
            )

    def _check_set(self) -> None:
        if self.set == "ellipsoid" and self.method not in ("corners", "lhs"):
            raise ValueError(
                f'set = "ellipsoid" belongs to the methods corners and lhs, not to "{self.method}"'
            )
        if self.interior and self.method != "corners":
            raise ValueError(
                f'interior = {self.interior}: interior points are flown beside corners, not with method = "{self.method}"'
            )
        if self.nominal and self.method != "corners":
            raise ValueError(
                f'nominal = true: the nominal model is flown with corners, not with method = "{self.method}"; method = "none" '
                "flies it alone"
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
            f"{name} = {as_toml(item)}: must have lower <= 0 <= upper, so that the model itself lies inside"
        )
    return (float(item[0]), float(item[1]))
