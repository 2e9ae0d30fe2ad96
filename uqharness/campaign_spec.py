"""campaign.toml: what a campaign flies, strictly validated.

Errors name file, line, what was received and what is allowed.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator, model_validator

from uqharness.errors import BadInputError
from uqharness.flight_spec import COEFFICIENTS, DEFAULT_TURBULENCE_SOURCE, TURBULENCE_W20_KT
from uqharness.toml_errors import as_toml, explain, line_of

_NOT_YET = {
    ("epistemic", "method"): ("lhs", "white", "walk"),
    ("stop", "rule"): ("hours", "band-width", "decide"),
}


def _listed(value: Any) -> Any:
    """A single value stands for a list of one; TOML's lists become tuples, which strict validation wants."""
    return tuple(value) if isinstance(value, list) else (value,)


def _tupled(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Number = Annotated[float, Field(allow_inf_nan=False)]
Turbulence = Literal["none", "light", "moderate", "severe"]
Coefficient = Literal["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
assert set(TURBULENCE_W20_KT) == set(Turbulence.__args__)  # type: ignore[attr-defined]
assert Coefficient.__args__ == COEFFICIENTS  # type: ignore[attr-defined]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class CampaignSection(_Section):
    """What flies: an aircraft (name under aircraft/, or folder), a run script, and the root seed of all streams."""

    aircraft: str = Field(min_length=1)
    mission: str = Field(min_length=1)
    seed: int = Field(ge=0, lt=2**63)


class AleatorySection(_Section):
    """Chance: flights per corner and condition, each ``duration_s`` scored after ``burn_in_s`` that is not."""

    flights: int = Field(ge=1, le=1_000_000)
    duration_s: Number = Field(gt=0, le=86_400)
    burn_in_s: Number = Field(default=120.0, ge=0, le=86_400)
    wind_mps: Annotated[tuple[Annotated[Number, Field(ge=0, le=60)], ...], BeforeValidator(_listed)] = (0.0,)
    wind_from_deg: Number = Field(default=270.0, ge=0, le=360)
    turbulence: Annotated[tuple[Turbulence, ...], BeforeValidator(_listed)] = ("none",)
    turbulence_source: Literal["jsbsim", "spec"] = DEFAULT_TURBULENCE_SOURCE
    sensor_noise: bool = True

    @field_validator("wind_mps", "turbulence")
    @classmethod
    def _distinct(cls, value: tuple[Any, ...]) -> tuple[Any, ...]:
        if not value or len(set(value)) != len(value):
            raise ValueError("must name at least one value, and none twice")
        return value


class EpistemicSection(_Section):
    """Ignorance: how the deltas move between their bounds. ``bounds`` per coefficient; absent = the aircraft's own."""

    method: Literal["none", "corners", "levels"]
    coefficients: Annotated[tuple[Coefficient, ...], BeforeValidator(_tupled)] = COEFFICIENTS  # type: ignore[assignment]
    bounds: dict[Coefficient, tuple[Number, Number]] | None = None
    levels: tuple[Number, ...] | None = None

    @field_validator("coefficients")
    @classmethod
    def _in_order(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if not value or len(set(value)) != len(value):
            raise ValueError("must name at least one coefficient, and none twice")
        return tuple(name for name in COEFFICIENTS if name in value)

    @field_validator("bounds", mode="before")
    @classmethod
    def _bounds(cls, value: Any) -> Any:
        if isinstance(value, str):
            raise ValueError(
                "bounds from a file are not available yet; write numbers, as { CX = 0.008, ... }, "
                "or leave the key out to use the bounds in the aircraft itself"
            )
        if not isinstance(value, dict):
            return value
        return {name: _interval(str(name), item) for name, item in value.items()}

    @field_validator("levels", mode="before")
    @classmethod
    def _levels(cls, value: Any) -> Any:
        value = _tupled(value)
        if isinstance(value, tuple) and not all(_is_number(item) and 0 <= item <= 1 for item in value):
            raise ValueError("every level must be a number from 0 (lower bound) to 1 (upper bound)")
        if isinstance(value, tuple) and (not value or len(set(value)) != len(value)):
            raise ValueError("must name at least one level, and none twice")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> EpistemicSection:
        if (self.method == "levels") != (self.levels is not None):
            raise ValueError('levels belongs to method = "levels", which needs it: levels = [0, 0.5, 1]')
        for name in self.bounds or {}:
            if name not in self.coefficients:
                raise ValueError(f"bounds are given for {name}, which is not among coefficients")
        missing = [name for name in self.coefficients if self.bounds is not None and name not in self.bounds]
        if missing:
            raise ValueError(f"bounds lack {', '.join(missing)}: give them, or leave them out of coefficients")
        return self


class MetricsSection(_Section):
    """What is counted: excursions beyond each radius [m], re-armed ``rearm_m`` inside it."""

    excursion_radius_m: Annotated[tuple[Annotated[Number, Field(gt=0)], ...], BeforeValidator(_listed)] = (15.0, 25.0)
    rearm_m: Number = Field(default=2.0, ge=0)

    @model_validator(mode="after")
    def _consistent(self) -> MetricsSection:
        radii = self.excursion_radius_m
        if not radii or len(set(radii)) != len(radii):
            raise ValueError("excursion_radius_m must name at least one radius, and none twice")
        if self.rearm_m >= min(radii):
            raise ValueError(f"rearm_m = {self.rearm_m:g} must be less than the smallest radius, {min(radii):g} m")
        return self


class StopSection(_Section):
    """When it ends: ``flights`` flies [aleatory] flights everywhere."""

    rule: Literal["flights"] = "flights"


class _Document(_Section):
    campaign: CampaignSection
    aleatory: AleatorySection
    epistemic: EpistemicSection
    metrics: MetricsSection = MetricsSection()
    stop: StopSection = StopSection()


@dataclass(frozen=True)
class CampaignSpec:
    """A validated campaign. ``path`` is the file it came from; ``source`` its text, kept for the record."""

    path: Path
    source: str
    campaign: CampaignSection
    aleatory: AleatorySection
    epistemic: EpistemicSection
    metrics: MetricsSection
    stop: StopSection

    def as_dict(self) -> dict[str, Any]:
        """Every setting, defaults included, as plain JSON types: two files that mean the same give the same."""
        names = ("campaign", "aleatory", "epistemic", "metrics", "stop")
        return {name: getattr(self, name).model_dump(mode="json") for name in names}

    def with_hours(self, hours: float) -> CampaignSpec:
        """The same campaign with as many flights as give ``hours`` of scored flight per corner and condition."""
        if not (math.isfinite(hours) and hours > 0):
            raise BadInputError(f"--hours {hours:g}: must be a number of flight hours greater than 0")
        flights = math.ceil(hours * 3600.0 / self.aleatory.duration_s - 1e-9)
        return dataclasses.replace(self, aleatory=self.aleatory.model_copy(update={"flights": max(1, flights)}))


def read_campaign(path: str | Path) -> CampaignSpec:
    """Read and validate a campaign file. Raises BadInputError that lists every mistake as ``file:line: ...``."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise BadInputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        where = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        line = where.group(1) if where else str(text.count("\n") + 1)
        raise BadInputError(f"{path}:{line}: not valid TOML: {error}") from None
    problems = _not_yet(text, data)
    if not problems:
        try:
            document = _Document.model_validate(data)
        except ValidationError as error:
            problems = [explain(_Document, text, data, dict(item)) for item in error.errors()]
        else:
            return CampaignSpec(path, text, *(getattr(document, name) for name in _Document.model_fields))
    lines = [f"{path}:{line}: {message}" for line, message in sorted(problems)]
    raise BadInputError("\n".join(dict.fromkeys(lines)))


def _not_yet(text: str, data: dict[str, Any]) -> list[tuple[int, str]]:
    """Settings that are planned: naming them beats calling them unknown."""
    problems = []
    for (section, key), values in _NOT_YET.items():
        table = data.get(section)
        if isinstance(table, dict) and table.get(key) in values:
            allowed = ", ".join(f'"{item}"' for item in _allowed(section, key))
            message = f'[{section}] {key} = "{table[key]}" is not available yet; use {allowed}'
            problems.append((line_of(text, (section, key)), message))
    for section, key in (("aleatory", "variables"), ("epistemic", "parameters"), ("epistemic", "samples")):
        table = data.get(section)
        if isinstance(table, dict) and key in table:
            problems.append((line_of(text, (section, key)), f"[{section}] {key} is not available yet; remove it"))
    return problems


def _allowed(section: str, key: str) -> tuple[str, ...]:
    annotation = _Document.model_fields[section].annotation.model_fields[key].annotation  # type: ignore[union-attr]
    return tuple(annotation.__args__)


def _interval(name: str, item: Any) -> Any:
    """``0.008`` means ±0.008; a pair means [lower, upper] with 0 between."""
    if _is_number(item):
        if item < 0:
            raise ValueError(f"{name} = {item:g}: a single bound is a half-width and cannot be negative")
        return (-float(item), float(item))
    if not (isinstance(item, list) and len(item) == 2 and all(map(_is_number, item))):
        raise ValueError(f"{name} = {as_toml(item)}: must be a number (±) or a pair [lower, upper]")
    if not item[0] <= 0 <= item[1]:
        raise ValueError(
            f"{name} = {as_toml(item)}: must have lower <= 0 <= upper, so that the model itself lies inside"
        )
    return (float(item[0]), float(item[1]))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
