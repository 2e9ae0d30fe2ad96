"""Results of identify, compare, bounds and validate-bounds."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from uqharness.results.base import Number, Numbers, Part, Texts

_IDENTIFIED = "identified"


class RmsWithNoise(Part):
    """A root mean square and the part that noise explains."""

    rms: Number = Field(default=None, description="rms of measured minus modelled")
    noise: Number = Field(default=None, description="rms that noise alone gives")

    @property
    def ratio_to_noise(self) -> float | None:
        """Return rms over noise; None where one of them is unknown or the noise is 0."""
        return self.rms / self.noise if self.rms is not None and self.noise else None


class Parameter(Part):
    """A parameter of fit.json, in the unit that the XML declares."""

    value: Number = Field(description="estimate")
    std: Number = Field(
        default=None,
        description="standard error, corrected for coloured residuals; null where not identified",
    )
    std_crb: Number = Field(default=None, description="Cramér-Rao bound of the standard error")
    status: str = Field(description="identified or not-identified")
    reason: str | None = Field(default=None, description="why it is not identified")
    initial: Number = Field(default=None, description="start value")
    basis: str = Field(
        default="",
        description="data, prior and data, prior only, start value and data, or start value;"
        " ordinary flights and priors",
    )

    @property
    def is_identified(self) -> bool:
        """Return whether the flights determine the parameter."""
        return self.status == _IDENTIFIED

    @model_validator(mode="after")
    def _check_consistent(self) -> Parameter:
        """Require standard errors of an identified parameter."""
        if self.is_identified and (
            self.value is None or not {"std", "std_crb"} <= self.model_fields_set
        ):
            raise ValueError("an identified parameter needs value, std and std_crb")
        return self


class FitChannel(RmsWithNoise):
    """A channel of fit.json, in the channel's unit."""

    whiteness_p: Number = Field(default=None, description="p-value of the test for white residuals")
    predictable_share: Number = Field(
        default=None, description="share of the residual predictable from its past"
    )


class Nuisance(Part):
    """A bias, delay or start state that was estimated with the parameters."""

    value: Number = Field(default=None, description="estimate, SI units")
    std: Number = Field(default=None, description="standard error")


class FlightPiece(Part):
    """A segment of a flight that was replayed."""

    flight: str = Field(default="", description="flight")
    label: str = Field(default="", description="manoeuvre")
    start_s: Number = Field(default=None, description="first row, s")
    end_s: Number = Field(default=None, description="last row, s")


class ReplaySpeed(Part):
    """How fast the machine replayed."""

    simulations_per_s: Number = Field(default=None, description="replays of all segments, 1/s")
    flight_s_per_s: Number = Field(default=None, description="seconds of flight per second")
    processes: int | None = Field(default=None, description="processes")
    bare_flight_s_per_s: Number = Field(
        default=None, description="seconds of flight per second of JSBSim's bare loop"
    )


class SplitInTime(Part):
    """Parts of one ordinary flight, of which the result was made from one."""

    used_s: list[list[float]] = Field(
        description="first and last time of each stretch that was used, s"
    )
    held_out_s: list[list[float]] = Field(
        default=[], description="stretches left for the next command, s"
    )
    block_s: float = Field(default=0.0, description="length of the blocks, s; 0: not split")
    difference: float = Field(
        default=0.0, description="largest Kolmogorov-Smirnov distance between the parts"
    )
    differs: str = Field(default="", description="channel in which they differ most")


class Fit(Part):
    """fit.json of `uqharness identify`: parameters, their covariance, the fit to the flights."""

    aircraft: str = Field(description="aircraft whose parameters were estimated")
    method: str = Field(default="", description="output error or filter error")
    converged: bool = Field(default=False, description="whether the estimate stands")
    parameters: dict[str, Parameter] = Field(description="parameters by JSBSim property")
    names: Texts = Field(
        default=[], description="identified parameters, in the order of the covariance"
    )
    cov: list[list[Number]] = Field(default=[], description="covariance of the identified ones")
    warnings: Texts = Field(default=[], description="sentences with their evidence")
    fit: dict[str, FitChannel] = Field(description="residuals by channel")
    nuisance: dict[str, Nuisance] = Field(
        default={}, description="biases, delays and start states by name"
    )
    segments: list[FlightPiece] = Field(default=[], description="segments that were replayed")
    flights: Texts = Field(description="files of the flights")
    flights_sha256: Texts | None = Field(default=None, description="SHA-256 of the flights")
    split: SplitInTime | None = Field(
        default=None, description="which rows of one ordinary flight were used"
    )
    servos: Literal["card", "ideal"] | None = Field(
        default=None, description="how commands reach the surfaces"
    )
    notes: Texts = Field(default=[], description="what was done to the records")
    command: str | None = Field(default=None, description="command that made the file")
    simulations: int | None = Field(default=None, description="replays of all segments")
    seconds: Number = Field(default=None, description="time it took, s")
    speed: ReplaySpeed | None = Field(default=None, description="speed of the replays")


class Channel(RmsWithNoise):
    """A channel of compare.json, in the channel's unit."""

    rms: Number = Field(description="rms of measured minus modelled, after the estimated delay")
    noise: Number = Field(description="noise of the sensor, standard deviation")
    ratio: Number = Field(description="rms over noise; 1 is the noise floor")
    judged: bool = Field(default=True, description="whether the channel decides the verdict")
    delay_s: Number = Field(default=None, description="delay of the measured channel, s")
    delay_std_s: Number = Field(default=None, description="standard error of the delay, s")
    theil_u: Number = Field(default=None, description="Theil's inequality coefficient")
    theil_bias: Number = Field(default=None, description="its share of bias")
    theil_variance: Number = Field(default=None, description="its share of variance")
    theil_covariance: Number = Field(default=None, description="its share of covariance")
    slip: str = Field(default="", description="a sign or scale that is certainly wrong")
    delay_undefined: str = Field(
        default="", description="why the delay is null; empty where it is a number"
    )


class Gap(RmsWithNoise):
    """A coefficient of compare.json."""

    mean: Number = Field(default=None, description="mean of flight minus model")


class Manoeuvre(Part):
    """A manoeuvre of compare.json: rms over noise."""

    channels: Numbers = Field(description="rms over noise by channel")
    coefficients: Numbers = Field(description="rms over noise by coefficient")


class Moment(Part):
    """An instant of large error in compare.json."""

    time_s: float = Field(description="time, s")
    channel: str = Field(description="channel")
    manoeuvre: str = Field(description="manoeuvre")
    gap: Number = Field(default=None, description="measured minus modelled, the channel's unit")
    noises: Number = Field(description="the gap in standard deviations of the noise")


class Compare(Part):
    """compare.json of `uqharness compare`: the gap between a model and a flight."""

    aircraft: str = Field(description="aircraft that was compared")
    flight: str = Field(description="flight that it was compared with")
    reached_noise_floor: bool = Field(description="the answer")
    rule: str = Field(default="", description="what the answer rests on")
    verdict: str | None = Field(default=None, description="the answer in a sentence")
    controls_late_s: Number = Field(default=None, description="delay of the controls, s")
    aligned: bool | None = Field(
        default=None, description="whether that is less than the record allows"
    )
    above: Texts = Field(default=[], description="channels above the noise floor")
    channels: dict[str, Channel] = Field(description="gaps by channel")
    coefficients: dict[str, Gap] = Field(description="gaps by dimensionless coefficient")
    manoeuvres: dict[str, Manoeuvre] = Field(default={}, description="gaps by manoeuvre")
    moments: list[Moment] = Field(default=[], description="the largest gaps")
    biases: Numbers = Field(default={}, description="estimated biases of the sensors")
    notes: Texts = Field(default=[], description="what was done to the record")
    command: str | None = Field(default=None, description="command that made the file")

    @model_validator(mode="after")
    def _check_consistent(self) -> Compare:
        """Require that channels above the limit exist and have a ratio."""
        for name in self.above:
            if name not in self.channels or self.channels[name].ratio is None:
                raise ValueError(f"above names {name!r}, which is no channel with a ratio")
        return self


class ModelScore(Part):
    """Scores of two models at one horizon in compare.json."""

    horizon_s: float = Field(description="time from the start of a prediction, s")
    difference: Number = Field(description="mean relative difference of CRPS, + where A is better")
    low: Number = Field(default=None, description="lower end of its 95 % interval")
    high: Number = Field(default=None, description="upper end")
    rms_a: Numbers = Field(default={}, description="rms error of A by channel")
    rms_b: Numbers = Field(default={}, description="rms error of B by channel")


class ScoreDifference(Part):
    """Mean relative difference of the scores of two models."""

    difference: Number = Field(description="(CRPS of B - CRPS of A) / mean of both, + for A")
    low: Number = Field(default=None, description="lower end of its 95 % interval")
    high: Number = Field(default=None, description="upper end")


class BetterModel(Part):
    """compare.json of `uqharness compare A B`: which model predicts a flight better."""

    better: Literal["A", "B", "no difference"] = Field(description="the answer")
    a: str = Field(description="first aircraft")
    b: str = Field(description="second aircraft")
    flight: str = Field(description="flight that both predicted")
    horizon_s: Number = Field(
        default=None, description="shortest horizon at which they differ, s; null: none"
    )
    score: ScoreDifference = Field(description="over all horizons and channels")
    horizons: list[ModelScore] = Field(description="by horizon")
    channels: Texts = Field(description="compared channels")
    starts: int = Field(description="predictions of each model")
    blocks: int = Field(description="independent blocks of time")
    controls_late_s: list[float] = Field(
        description="delay of the controls with which A and B predict best, s"
    )
    notes: Texts = Field(default=[], description="what was done to the record")
    command: str | None = Field(default=None, description="command that made the file")


class Share(Part):
    """Coverage of one coefficient in coverage.json."""

    share_95: float = Field(alias="0.95", description="share inside the 95 % bounds")
    share_68: float = Field(alias="0.68", description="share inside the 68 % bounds")
    n_effective: Number = Field(default=None, description="effective number of independent samples")
    mean_width: Number = Field(default=None, description="mean width of the bounds over the flight")


class StateBin(Part):
    """A range of a state in coverage.json, and the coverage in it by coefficient."""

    state: str = Field(description="state")
    low: Number = Field(alias="from", description="lower end, SI units")
    high: Number = Field(alias="to", description="upper end, SI units")
    samples: int = Field(default=0, description="samples in the range")
    share: Numbers = Field(default={}, description="share inside the 95 % bounds by coefficient")


class Conformal(Part):
    """A factor by which bounds hold for a further manoeuvre, whatever the distributions are."""

    factor: Number = Field(default=None, description="factor of the bounds' width")
    level: Number = Field(default=None, description="level at which they hold")
    manoeuvres: int | None = Field(default=None, description="manoeuvres that it comes from")


Verdict = Literal["holds", "fails", "inconclusive"]


class Coverage(Part):
    """coverage.json of `uqharness validate-bounds`: how much of a flight lies inside bounds."""

    coverage: Annotated[dict[str, Share], Field(min_length=1)] = Field(
        description="share of the flight inside the bounds by coefficient"
    )
    # Optional keys below: older files lack them.
    errors: dict[str, Numbers] = Field(
        default={}, description="standard errors of the shares by coefficient"
    )
    outside_data: Numbers = Field(
        default={}, description="share of samples outside the data of the bounds"
    )
    manoeuvres: dict[str, dict[str, Numbers]] = Field(
        default={}, description="manoeuvre to coefficient to the shares"
    )
    by_speed: list[StateBin] = Field(default=[], description="shares in thirds of the airspeed")
    by_incidence: list[StateBin] = Field(
        default=[], description="shares in thirds of the angle of attack"
    )
    conformal: dict[str, Conformal] = Field(
        default={}, description="factors by which bounds must be widened, by what manoeuvres show"
    )
    verdicts: dict[str, Verdict] = Field(default={}, description="answer by coefficient")
    flight_variance: Numbers = Field(
        default={}, description="standard deviation from flight to flight; null: not estimable"
    )
    failed: Texts = Field(default=[], description="coefficients whose bounds do not hold")
    warnings: Texts = Field(default=[], description="sentences with their evidence")
    notes: Texts = Field(default=[], description="what was done to the records")
    command: str | None = Field(default=None, description="command that made the file")
    version: str = Field(default="", description="version that made the file")

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
    split: SplitInTime | None = Field(
        default=None, description="which rows of one ordinary flight were used"
    )
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
