"""Results of identify, compare, bounds and validate-bounds."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from uqharness.results.base import Number, Numbers, Part, Texts

_IDENTIFIED = "identified"


class RmsWithNoise(Part):
    """A root mean square and the part that noise explains."""

    rms: Number = None
    noise: Number = None


class Parameter(Part):
    """A parameter of fit.json."""

    value: Number
    std: Number = None
    std_crb: Number = None
    status: str
    reason: str | None = None
    initial: Number = None

    @model_validator(mode="after")
    def _check_consistent(self) -> Parameter:
        """Require standard errors of an identified parameter."""
        if self.status == _IDENTIFIED and (
            self.value is None or not {"std", "std_crb"} <= self.model_fields_set
        ):
            raise ValueError("an identified parameter needs value, std and std_crb")
        return self


class FitChannel(RmsWithNoise):
    """A channel of fit.json."""

    whiteness_p: Number = None
    predictable_share: Number = None


class Fit(Part):
    """fit.json of `uqharness identify`."""

    aircraft: str
    flights: list[str]
    parameters: dict[str, Parameter]
    fit: dict[str, FitChannel]
    method: str = ""
    converged: bool = False
    flights_sha256: list[str] | None = None
    warnings: list[str] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)
    command: str | None = None
    simulations: Number = None
    seconds: Number = None


class Channel(Part):
    """A channel of compare.json."""

    rms: Number
    noise: Number
    ratio: Number
    judged: bool = True
    delay_s: Number = None
    delay_std_s: Number = None
    theil_u: Number = None


class Gap(RmsWithNoise):
    """A coefficient of compare.json."""

    mean: Number = None


class Manoeuvre(Part):
    """A manoeuvre of compare.json: rms over noise."""

    channels: Numbers
    coefficients: Numbers


class Moment(Part):
    """An instant of large error in compare.json."""

    time_s: float
    channel: str
    manoeuvre: str
    noises: Number


class Compare(Part):
    """compare.json of `uqharness compare`."""

    aircraft: str
    flight: str
    channels: dict[str, Channel]
    coefficients: dict[str, Gap]
    reached_noise_floor: bool
    above: list[str] = Field(default_factory=list)
    manoeuvres: dict[str, Manoeuvre] = Field(default_factory=dict)
    moments: list[Moment] = Field(default_factory=list)
    verdict: str | None = None
    notes: list[str] = Field(default_factory=list)
    command: str | None = None
    rule: str = ""

    @model_validator(mode="after")
    def _check_consistent(self) -> Compare:
        """Require that channels above the limit exist and have a ratio."""
        for name in self.above:
            if name not in self.channels or self.channels[name].ratio is None:
                raise ValueError(f"above names {name!r}, which is no channel with a ratio")
        return self


class Share(Part):
    """Coverage of one coefficient in coverage.json."""

    share_95: float = Field(alias="0.95")
    share_68: float = Field(alias="0.68")
    n_effective: Number = None
    mean_width: Number = None


class StateBin(Part):
    """A range of a state in coverage.json, and the coverage in it by coefficient."""

    state: str
    low: Number = Field(alias="from")
    high: Number = Field(alias="to")
    samples: int = 0
    share: Numbers = Field(default_factory=dict)


class Coverage(Part):
    """coverage.json of `uqharness validate-bounds`."""

    coverage: Annotated[dict[str, Share], Field(min_length=1)]
    # Optional keys below: older files lack them.
    errors: dict[str, Numbers] = Field(default_factory=dict)
    outside_data: Numbers = Field(default_factory=dict)
    manoeuvres: dict[str, dict[str, Numbers]] = Field(default_factory=dict)
    by_speed: list[StateBin] = Field(default_factory=list)
    by_incidence: list[StateBin] = Field(default_factory=list)
    conformal: dict[str, Numbers] = Field(default_factory=dict)
    verdicts: dict[str, Literal["holds", "fails", "inconclusive"]] = Field(default_factory=dict)
    flight_variance: Numbers = Field(default_factory=dict)
    failed: list[str] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)
    command: str | None = None

    @model_validator(mode="after")
    def _check_consistent(self) -> Coverage:
        """Require that failed coefficients have a coverage."""
        for name in self.failed:
            if name not in self.coverage:
                raise ValueError(f"failed names {name!r}, of which there is no coverage")
        return self


class BoundsOfCoefficient(Part):
    """Bounds of one dimensionless coefficient in bounds.json."""

    states: Texts = Field(default=[], description="flight states of the polynomial")
    terms: Texts = Field(default=[], description="terms of the polynomial")
    n: int | None = Field(default=None, description="samples")
    n_effective: Number = Field(default=None, description="effective number of independent samples")
    s: Number = Field(default=None, description="standard deviation of the residuals")
    mean_width: Number = Field(default=None, description="mean width of the bounds over the data")
    noise_width: Number = Field(
        default=None, description="width that sensor noise alone would force"
    )
    left_out_share: Number = Field(
        default=None, description="share of a manoeuvre inside the bounds of the others"
    )
    walk_rate: Number = Field(default=None, description="rate of variation of the level, 1/sqrt(s)")
    walk_sigma: Number = Field(
        default=None, description="standard deviation of the level's variation"
    )
    noise_std: Number = Field(default=None, description="standard deviation of the sensors' noise")
    persistent: Number = Field(default=None, description="persistent part of the model error, std")
    transient: Number = Field(default=None, description="transient part of the model error, std")
    transient_half_width: Number = Field(
        default=None, description="half-width of the transient part"
    )
    transient_time_s: Number = Field(
        default=None, description="correlation time of the transient part, s"
    )
    flight: Number = Field(default=None, description="part that differs between flights, std")
    noise_scale: Number = Field(default=None, description="estimated over stated sensor noise")
    not_above: Number = Field(
        default=None, description="upper confidence limit of the model error, std"
    )
    found: bool | None = Field(default=None, description="whether a model error is significant")


class Filters(Part):
    """Alternative low-pass filters in bounds.json, and the mean widths that they give."""

    cutoff_hz: Number = Field(description="differentiator and smoother, Hz")
    airspeed_cutoff_hz: Number = Field(default=None, description="low-pass of the airspeed, Hz")
    mean_width: Numbers = Field(description="mean width by coefficient")
    left_out_share: Numbers = Field(default={}, description="share inside by coefficient")


class Bounds(Part):
    """bounds.json of `uqharness bounds`: the bounds of each coefficient and their evidence."""

    aircraft: str = Field(default="", description="aircraft that the bounds belong to")
    flights: Texts = Field(default=[], description="flights that they were made from")
    confidence: Number = Field(default=None, description="confidence of the intervals")
    outside: Literal["grow", "clamp"] = Field(
        default="grow", description="what the bounds do outside the data"
    )
    coefficients: dict[str, BoundsOfCoefficient] = Field(description="bounds by coefficient")
    left_out: dict[str, Numbers] = Field(
        default={},
        description="manoeuvre to coefficient to the share inside the bounds of the others",
    )
    cutoffs: list[Filters] = Field(default=[], description="mean widths with other filters")
    warnings: Texts = Field(default=[], description="sentences for the user")
    notes: Texts = Field(default=[], description="sentences for the user")
    command: str | None = Field(default=None, description="command that made the file")
    version: str = Field(default="", description="version that made the file")
