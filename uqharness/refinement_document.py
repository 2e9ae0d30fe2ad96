"""What refinement.json must hold for a page to be written from it; see result_documents."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from uqharness.result_documents import Ends, FolderName, Number, Numbers, Part


class Evidence(Part):
    """What speaks for an effect, or for an alternative in its place."""

    interval_95: Ends | None = None
    t: Number = None
    twice_log_likelihood: Number = None
    confirmed_on_held_out_manoeuvres: Number = None
    held_out_estimate_differs_by_std: Number = None


class Alternative(Part):
    """What an effect may be taken for."""

    name: str
    term: str = ""
    coefficient: str | None = None
    subsystem: str | None = None
    evidence: Evidence = Evidence()
    separable: bool
    would_separate: str = ""

    @model_validator(mode="after")
    def _told(self) -> Alternative:
        if not self.separable and "would_separate" not in self.model_fields_set:
            raise ValueError("an alternative that is not separable needs would_separate")
        return self


class Trial(Part):
    """What the test flights say of an effect."""

    gap: str
    change_of_twice_log_likelihood: float
    std: float
    rms_over_that_of_train: float = 0.0
    share_of_estimate: float | None = None
    share_std: float | None = None

    @model_validator(mode="after")
    def _told(self) -> Trial:
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
    test: Trial | None = None


class Withdrawn(Effect):
    """An effect that the test flights spoke against."""

    test: Trial


class Region(Part):
    """Where model and flights disagreed."""

    coefficient: str
    manoeuvre: str
    region: dict[str, Ends] = Field(default_factory=dict)
    share_outside_95: Number
    size: Number


class State(Part):
    """A state that a residual depends on."""

    state: str


class Left(Part):
    """A place where something is left: in words, as a candidate that is asked for, or as a coefficient and what it depends on."""

    words: str = ""
    t: float = 0.0
    term: str = ""
    coefficient: str = ""
    subsystem: str = ""
    rms_over_noise: float = 0.0
    depends_on: list[State] = Field(default_factory=list)

    @model_validator(mode="after")
    def _told(self) -> Left:
        told = ({"words"}, {"term", "t"}, {"coefficient", "rms_over_noise", "depends_on"})
        if not any(self.model_fields_set >= keys for keys in told):
            raise ValueError(
                "needs words, or term and t, or coefficient, rms_over_noise and depends_on"
            )
        return self


class GoesWith(Part):
    """The state with which what is left goes."""

    state: str
    low: float
    high: float
    share: float
    of: str


class Near(Part):
    """A candidate near to what is left, and what it leaves of the channel: rms over noise."""

    name: str
    term: str
    coefficient: str = ""
    subsystem: str = ""
    t: float
    leaves: float


class Place(Part):
    """Where the strongest of what is left sits; null fields have a reason."""

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
    state: GoesWith | None
    channel_on_train: Number
    candidates: list[Near]
    would_tell: str | None
    reason: str | None

    @model_validator(mode="after")
    def _told(self) -> Place:
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
    """A root mean square before and after."""

    rms_before: Number = None
    rms_after: Number = None
    noise_rms: Number


class Interval(Part):
    """A coefficient's intervals before and after."""

    width_before: Number
    width_after: Number
    coverage_before: Number
    coverage_after: Number
    coverage_std_before: Number
    coverage_std_after: Number


class Reasoned(Part):
    """What is whole, or has the reason why it is not there."""

    reason: str | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        lacking = sorted({*type(self).model_fields} - {*self.model_fields_set, "reason"})
        if self.reason is None and lacking:
            raise ValueError(f"needs {', '.join(lacking)}, or a reason")
        return self


class Intervals(Reasoned):
    """Intervals on the test flights."""

    reason: str | None
    confidence: float = 0.0
    coefficients: dict[str, Interval] = Field(default_factory=dict)


class Failed(Part):
    """Flights of a mission that failed."""

    failed: int


class Mission(Reasoned):
    """A mission flown with both models."""

    folders: Annotated[list[FolderName], Field(max_length=2)] = Field(default_factory=list)
    mission: str = ""
    corners: int = 0
    flights_per_corner: int = 0
    duration_s: float = 0.0
    before: Failed = Failed(failed=0)
    after: Failed = Failed(failed=0)


class GapShown(Part):
    """The gap on the test flights; predictions: errors one sample ahead, where those judged."""

    channels: dict[str, BeforeAfter]
    predictions: dict[str, BeforeAfter] = Field(default_factory=dict)
    coefficients: dict[str, BeforeAfter]
    theil: Numbers = Field(default_factory=dict)
    intervals: Intervals | None = None
    pbox: Mission | None = None


class Gaps(Part):
    """Gaps by the use of the flights."""

    test: GapShown


class Curve(Part):
    """A smooth term by its state: value, ends of its 95 % band, and how many samples of the train flights lie near."""

    at: list[float]
    value: list[float]
    low: list[float]
    high: list[float]
    samples: list[int]

    @model_validator(mode="after")
    def _whole(self) -> Curve:
        if (
            len({len(v) for v in (self.at, self.value, self.low, self.high, self.samples)}) != 1
            or len(self.at) < 2
        ):
            raise ValueError(
                "a curve needs at, value, low, high and samples of one length, two at the least"
            )
        return self


class Shape(Part):
    """A form that physics has a name for: its correlation with the curve, and what it would leave of the channel."""

    form: str
    correlation: float
    leaves: float


class Smooth(Part):
    """A smooth term that is offered for naming."""

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
    shapes: list[Shape]
    test: Trial
    gap: dict[str, GapShown]


class Remaining(Part):
    """What a refinement left."""

    unexplained: bool
    where: list[Left]
    channels_above_noise: dict[str, float]
    coloured_channels: list[str]
    place: Place | None = None
    smooth: Smooth | None = None
    smooth_reason: str | None = None


class Identified(Part):
    """A parameter of refinement.json."""

    value: Number
    std: Number


class Switch(Part):
    """A property that takes an effect out."""

    property: str
    off: float


class Score(Part):
    """A candidate."""

    effect: str
    t: Number = None


class Refused(Score):
    """The best candidate that was refused."""

    why: str


class Candidates(Part):
    """Candidates, the likeliest first."""

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
    best_refused: Refused | None = None
    candidates: Candidates = Candidates()
    notes: list[str] = Field(default_factory=list)
    train: list[str] = Field(default_factory=list)
    test: list[str] = Field(default_factory=list)
    command: str | None = None
    seconds: Number = None
