"""campaign.toml: what a campaign flies, strictly validated.

Errors name file, line, what was received and what is allowed.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from uqharness.campaign.inputs import CampaignInputs
from uqharness.campaign.spec.epistemic import EpistemicSection
from uqharness.campaign.spec.names import Turbulence
from uqharness.campaign.spec.stop import StopSection
from uqharness.campaign.spec.variables import VariableSection
from uqharness.errors import BadInputError
from uqharness.flight import DEFAULT_TURBULENCE_SOURCE
from uqharness.settings import Number, Section, listed
from uqharness.simulator import STEADY, StartSection


class CampaignSection(Section):
    """What flies: an aircraft (name under aircraft/, or folder), a run script, and the root seed of all streams.

    ``engine`` auto is batch where the batch engine understands aircraft and mission as a whole, else jsbsim; settled at the first
    run.
    """

    aircraft: str = Field(min_length=1)
    mission: str = Field(min_length=1)
    seed: int = Field(ge=0, lt=2**63)
    engine: Literal["auto", "batch", "jsbsim"] = "auto"


class AleatorySection(Section):
    """Chance: flights per corner and condition, each ``duration_s`` scored after ``burn_in_s`` that is not.

    ``sensor_noise`` absent: on where the aircraft has a sensors system, which is settled before the campaign is flown.
    """

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
    """What is counted: excursions beyond each radius [m], re-armed ``rearm_m`` inside it, and how many of them are acceptable.

    ``acceptable_loss_per_h`` is that of aborted flights (default: as many as excursions).
    ``dispersion`` is the largest ratio of variance to mean of the excursions of a flight that limits allow for (1: independent)
    where the same air does not show one at a smaller radius; ``dispersion_radius_m`` are further radii counted for that alone.
    """

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
        asked, further = self.excursion_radius_m, self.dispersion_radius_m or ()
        radii = (*asked, *further)
        if not asked or len(set(asked)) != len(asked):
            raise ValueError("excursion_radius_m must name at least one radius, and none twice")
        if len(set(radii)) != len(radii) or max(further, default=0.0) > max(asked):
            raise ValueError(
                "dispersion_radius_m must name radii below the largest of excursion_radius_m, none twice and none of those again"
            )
        if self.rearm_m >= min(radii):
            raise ValueError(
                f"rearm_m = {self.rearm_m:g} must be less than the smallest radius, {min(radii):g} m"
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
                f'mission = "{STEADY}" and a section [start] with V_mps and altitude_m belong together: '
                "a trimmed flight needs both, a run script neither"
            )
        return self


@dataclass(frozen=True)
class CampaignSpec:
    """A validated campaign. ``path`` is the file it came from; ``source`` its text; ``inputs`` what the files it names hold."""

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
        """Every setting, defaults included, as plain JSON types: two files that mean the same give the same."""
        sections = {name: getattr(self, name) for name in Document.model_fields}
        found = {
            name: section.model_dump(mode="json", exclude_none=True)
            for name, section in sections.items()
            if section is not None
        }
        found["aleatory"].setdefault("sensor_noise", True)
        epistemic = found["epistemic"]
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
        return found

    @property
    def corner_count(self) -> int:
        """Number of combinations that ``method`` lists: of bounds (or levels) and of the ends of uncertain means."""
        section = self.epistemic
        means = sum(item.mean_interval is not None for item in self.aleatory.variables.values())
        moved = 0 if section.method == "none" else len(self.inputs.coefficients)
        values = len(section.levels) if section.method == "levels" and section.levels else 2
        points: int = values**moved
        if section.set == "ellipsoid" and moved > 1:
            points += 2 * moved
        return int(points * values**means)

    @property
    def interior_samples(self) -> int:
        """Number of interior points flown with the corners."""
        return self.epistemic.interior_samples(self.corner_count)

    def with_hours(self, hours: float) -> CampaignSpec:
        """The same campaign with as many flights as give ``hours`` of scored flight per corner and condition."""
        if not (math.isfinite(hours) and hours > 0):
            raise BadInputError(
                f"--hours {hours:g}: must be a number of flight hours greater than 0"
            )
        if self.stop.rule == "band-width":
            raise BadInputError(
                f'--hours {hours:g}: [stop] rule = "band-width" says how much is flown; leave out one of them'
            )
        flights = math.ceil(hours * 3600.0 / self.aleatory.duration_s - 1e-9)
        given = (
            self.stop.model_copy(update={"hours": float(hours)})
            if self.stop.rule == "hours"
            else self.stop
        )
        return dataclasses.replace(self.with_flights(max(1, flights)), stop=given)

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
