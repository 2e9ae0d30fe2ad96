"""Results of refine: refinement.json."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from uqharness.results.base import Ends, FolderName, Number, Numbers, Part


class Evidence(Part):
    """Statistical evidence for an effect or an alternative."""

    interval_95: Ends | None = None
    t: Number = None
    twice_log_likelihood: Number = None
    confirmed_on_held_out_manoeuvres: Number = None
    held_out_estimate_differs_by_std: Number = None


class Alternative(Part):
    """Another effect that explains the same data."""

    name: str
    term: str = ""
    coefficient: str | None = None
    subsystem: str | None = None
    evidence: Evidence = Evidence()
    separable: bool
    would_separate: str = ""

    @model_validator(mode="after")
    def _check_complete(self) -> Alternative:
        """Require advice for an alternative that cannot be distinguished."""
        if not self.separable and "would_separate" not in self.model_fields_set:
            raise ValueError("an alternative that is not separable needs would_separate")
        return self


class HoldOutTest(Part):
    """Test of an effect on the hold-out flights."""

    gap: str
    change_of_twice_log_likelihood: float
    std: float
    rms_over_that_of_train: float = 0.0
    share_of_estimate: float | None = None
    share_std: float | None = None

    @model_validator(mode="after")
    def _check_complete(self) -> HoldOutTest:
        """Require the rms ratio of a gap that is too large for the test."""
        if self.gap == "too far" and "rms_over_that_of_train" not in self.model_fields_set:
            raise ValueError("a gap that is too far needs rms_over_that_of_train")
        return self


class Effect(Part):
    """An effect of refinement.json."""

    name: str
    term: str
    why: str
    value: Number
    std: Number
    coefficient: str | None = None
    subsystem: str | None = None
    property: str | None = None
    unit: str | None = None
    evidence: Evidence = Evidence()
    alternatives: list[Alternative] = Field(default_factory=list)
    test: HoldOutTest | None = None


class Withdrawn(Effect):
    """An effect that the hold-out flights contradict."""

    test: HoldOutTest


class Region(Part):
    """A region of states where model and flights disagree."""

    coefficient: str
    manoeuvre: str
    region: dict[str, Ends] = Field(default_factory=dict)
    share_outside_95: Number
    size: Number


class State(Part):
    """A state that a residual depends on."""

    state: str


class RemainingPart(Part):
    """Something unexplained: a text, a candidate effect, or a coefficient with its states."""

    words: str = ""
    t: float = 0.0
    term: str = ""
    coefficient: str = ""
    subsystem: str = ""
    rms_over_noise: float = 0.0
    depends_on: list[State] = Field(default_factory=list)

    @model_validator(mode="after")
    def _check_complete(self) -> RemainingPart:
        """Require one of the three forms."""
        alternatives = ({"words"}, {"term", "t"}, {"coefficient", "rms_over_noise", "depends_on"})
        if not any(self.model_fields_set >= keys for keys in alternatives):
            raise ValueError(
                "needs words, or term and t, or coefficient, rms_over_noise and depends_on"
            )
        return self


class StateDependence(Part):
    """The state with which the remaining residual varies."""

    state: str
    low: float
    high: float
    share: float
    of: str


class NearbyCandidate(Part):
    """A candidate that would explain part of the residual, and the rms over noise that remains."""

    name: str
    term: str
    coefficient: str = ""
    subsystem: str = ""
    t: float
    leaves: float


class ResidualLocation(Part):
    """Where the largest remaining residual occurs; null fields have a reason."""

    flights: str | None
    flight: str | None
    manoeuvre: str | None
    channel: str | None
    from_s: Number
    to_s: Number
    from_Hz: Number
    to_Hz: Number
    rms_over_noise: Number
    share_of_excess: Number
    state: StateDependence | None
    channel_on_train: Number
    candidates: list[NearbyCandidate]
    would_tell: str | None
    reason: str | None

    @model_validator(mode="after")
    def _check_complete(self) -> ResidualLocation:
        """Require the fields that belong together."""
        timed = (self.flight, self.manoeuvre, self.from_s, self.to_s, self.from_Hz, self.to_Hz)
        if self.reason is None and (self.channel is None or None in timed):
            raise ValueError(
                "a place without flight, manoeuvre, channel, stretch and band needs a reason"
            )
        if self.channel is not None and None in (
            self.flights,
            self.rms_over_noise,
            self.channel_on_train,
            self.would_tell,
        ):
            raise ValueError(
                "a channel needs flights, rms_over_noise, channel_on_train and would_tell"
            )
        return self


class BeforeAfter(Part):
    """A root mean square before and after refinement."""

    rms_before: Number = None
    rms_after: Number = None
    noise_rms: Number


class Interval(Part):
    """Error bounds of a coefficient before and after refinement."""

    width_before: Number
    width_after: Number
    coverage_before: Number
    coverage_after: Number
    coverage_std_before: Number
    coverage_std_after: Number


class CompleteOrReason(Part):
    """An object that is complete, or has a reason for being incomplete."""

    reason: str | None = None

    @model_validator(mode="after")
    def _check_complete(self) -> Self:
        """Require all fields unless there is a reason."""
        lacking = sorted({*type(self).model_fields} - {*self.model_fields_set, "reason"})
        if self.reason is None and lacking:
            raise ValueError(f"needs {', '.join(lacking)}, or a reason")
        return self


class Intervals(CompleteOrReason):
    """Error bounds evaluated on the hold-out flights."""

    reason: str | None
    confidence: float = 0.0
    coefficients: dict[str, Interval] = Field(default_factory=dict)


class Failed(Part):
    """Flights of a mission that failed."""

    failed: int


class Mission(CompleteOrReason):
    """A mission flown with the models before and after refinement."""

    folders: Annotated[list[FolderName], Field(max_length=2)] = Field(default_factory=list)
    mission: str = ""
    corners: int = 0
    flights_per_corner: int = 0
    duration_s: float = 0.0
    before: Failed = Failed(failed=0)
    after: Failed = Failed(failed=0)


class ResidualTables(Part):
    """Residuals on one set of flights; `predictions` are one-step prediction errors, if these
    counted.
    """

    channels: dict[str, BeforeAfter]
    predictions: dict[str, BeforeAfter] = Field(default_factory=dict)
    coefficients: dict[str, BeforeAfter]
    theil: Numbers = Field(default_factory=dict)
    intervals: Intervals | None = None
    pbox: Mission | None = None


class Gaps(Part):
    """Residuals by the use of the flights."""

    test: ResidualTables


class Curve(Part):
    """A smooth term over its state: value, 95 % band, and number of train samples nearby."""

    at: list[float]
    value: list[float]
    low: list[float]
    high: list[float]
    samples: list[int]

    @model_validator(mode="after")
    def _check_complete(self) -> Curve:
        """Require lists of equal length, at least two points."""
        if (
            len({len(v) for v in (self.at, self.value, self.low, self.high, self.samples)}) != 1
            or len(self.at) < 2
        ):
            raise ValueError(
                "a curve needs at, value, low, high and samples of one length, two at the least"
            )
        return self


class FunctionalForm(Part):
    """A functional form of physics compared with a smooth term."""

    form: str
    correlation: float
    leaves: float


class SmoothTerm(Part):
    """A smooth term proposed as a new effect."""

    coefficient: str
    state: str
    times: str | None = None
    name: str
    property: str
    unit: str
    model: str
    effective_degrees_of_freedom: float
    in_place_of: list[str] = Field(default_factory=list)
    curve: Curve
    channel: str
    channel_on_train: float
    leaves: float
    shapes: list[FunctionalForm]
    test: HoldOutTest
    gap: dict[str, ResidualTables]


class Remaining(Part):
    """Residual that the refined model does not explain."""

    unexplained: bool
    where: list[RemainingPart]
    channels_above_noise: dict[str, float]
    coloured_channels: list[str]
    place: ResidualLocation | None = None
    smooth: SmoothTerm | None = None
    smooth_reason: str | None = None


class Identified(Part):
    """A parameter of refinement.json."""

    value: Number
    std: Number


class Switch(Part):
    """A property that removes an effect from the model."""

    property: str
    off: float


class Score(Part):
    """A candidate effect and its t statistic."""

    effect: str
    t: Number = None


class RefusedCandidate(Score):
    """The best candidate that was not accepted."""

    why: str


class Candidates(Part):
    """Candidate effects, the most likely first."""

    limit: Number = None
    scores: list[Score] = Field(default_factory=list)


class Refinement(Part):
    """refinement.json of `uqharness refine`."""

    verdict: str
    effects: list[Effect]
    withdrawn: list[Withdrawn] = Field(default_factory=list)
    disagreement: list[Region]
    gap: Gaps
    remaining: Remaining
    parameters: dict[str, Identified] = Field(default_factory=dict)
    switch: list[Switch] = Field(default_factory=list)
    best_refused: RefusedCandidate | None = None
    candidates: Candidates = Candidates()
    notes: list[str] = Field(default_factory=list)
    train: list[str] = Field(default_factory=list)
    test: list[str] = Field(default_factory=list)
    command: str | None = None
    seconds: Number = None
