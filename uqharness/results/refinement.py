"""Result of refine: refinement.json."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from uqharness.results.base import Ends, FolderName, Number, Numbers, Part, Texts


class AlternativeEvidence(Part):
    """Statistical evidence for an alternative."""

    twice_log_likelihood: Number = Field(
        default=None, description="gain in twice the log likelihood in place of the effect"
    )
    t_of_the_effect_beside_it: Number = Field(
        default=None, description="t of the effect beside the alternative"
    )
    likeness: Number = Field(default=None, description="correlation of both on these flights")
    companions: Texts = Field(
        default=[], description="effects that the alternative needs besides, to explain as much"
    )


class Alternative(Part):
    """Another effect that explains the same data."""

    coefficient: str | None = Field(default=None, description="coefficient that it acts on")
    subsystem: str | None = Field(default=None, description="subsystem, where it is no coefficient")
    term: str = Field(default="", description="product of states, or kind of subsystem effect")
    name: str = Field(description="name in words")
    evidence: AlternativeEvidence = Field(
        default=AlternativeEvidence(), description="statistical evidence"
    )
    separable: bool = Field(description="whether the flights distinguish it from the effect")
    would_separate: str = Field(
        default="", description="manoeuvre that would distinguish both, where these flights do not"
    )

    @model_validator(mode="after")
    def _check_complete(self) -> Alternative:
        """Require advice for an alternative that cannot be distinguished."""
        if not self.separable and "would_separate" not in self.model_fields_set:
            raise ValueError("an alternative that is not separable needs would_separate")
        return self


class Evidence(Part):
    """Statistical evidence for an effect."""

    t: Number = Field(default=None, description="estimate over its standard error")
    twice_log_likelihood: Number = Field(
        default=None, description="gain in twice the log likelihood of the training flights"
    )
    confirmed_on_held_out_manoeuvres: Number = Field(
        default=None, description="the same gain on manoeuvres that were held out"
    )
    held_out_estimate_differs_by_std: Number = Field(
        default=None, description="difference of the held-out estimate, in standard errors"
    )
    interval_95: Ends | None = Field(
        default=None, description="95 % interval of the value, given that the effect was chosen"
    )


HoldOutVerdict = Literal["shrank", "grew", "cannot tell", "too far"]


class HoldOutTest(Part):
    """Test of an effect on the hold-out flights."""

    change_of_twice_log_likelihood: Number = Field(
        description="change of twice the log likelihood of the hold-out flights"
    )
    std: Number = Field(description="standard error of the change")
    gap: HoldOutVerdict = Field(description="whether the residual of the hold-out flights shrank")
    rms_over_that_of_train: Number = Field(
        default=0.0, description="rms of the hold-out residual over that of the training flights"
    )
    share_of_estimate: Number = Field(
        default=None, description="share of the estimate that fits the hold-out flights best"
    )
    share_std: Number = Field(default=None, description="standard error of the share")

    @model_validator(mode="after")
    def _check_complete(self) -> Self:
        """Require the rms ratio of a gap that is too large for the test."""
        if self.gap == "too far" and "rms_over_that_of_train" not in self.model_fields_set:
            raise ValueError("a gap that is too far needs rms_over_that_of_train")
        return self


class Effect(Part):
    """An effect of refinement.json."""

    coefficient: str | None = Field(default=None, description="coefficient that it acts on")
    subsystem: str | None = Field(default=None, description="subsystem, where it is no coefficient")
    term: str = Field(description="product of states, or kind of subsystem effect")
    name: str = Field(description="name in words")
    why: str = Field(description="physics, where it shows, and the estimate")
    value: Number = Field(description="number in the XML, in `unit`")
    std: Number = Field(description="standard error of the value")
    unit: str | None = Field(default=None, description="unit of the value")
    property: str | None = Field(default=None, description="property that switches the effect")
    evidence: Evidence = Field(default=Evidence(), description="evidence of the training flights")
    withdrawn: bool = Field(default=False, description="whether the hold-out flights contradict it")
    test: HoldOutTest | None = Field(default=None, description="test on the hold-out flights")
    alternatives: list[Alternative] = Field(
        default=[], description="effects that explain the same data"
    )


class Withdrawn(Effect):
    """An effect that the hold-out flights contradict."""

    test: HoldOutTest = Field(description="test on the hold-out flights")


class Region(Part):
    """A region of states where model and flights disagree."""

    coefficient: str = Field(description="dimensionless coefficient")
    manoeuvre: str = Field(description="kind of manoeuvre")
    region: dict[str, Ends] = Field(default={}, description="state to its range")
    share_outside_95: Number = Field(description="share of the samples outside the 95 % interval")
    size: Number = Field(description="rms there over what noise and parameters allow")
    words: str = Field(default="", description="the same as a sentence")


class State(Part):
    """A state that a residual depends on."""

    state: str = Field(description="name of the state")
    share: Number = Field(default=None, description="share of the variance that it explains")


class RemainingPart(Part):
    """Something unexplained: a text, a candidate effect, or a coefficient with its states."""

    coefficient: str = Field(default="", description="coefficient that it concerns")
    subsystem: str = Field(default="", description="subsystem that it concerns")
    term: str = Field(default="", description="term of a candidate effect")
    manoeuvre: str = Field(default="", description="kind of manoeuvre")
    region: dict[str, Ends] = Field(default={}, description="state to its range")
    share_outside_95: Number = Field(
        default=None, description="share of the samples outside the 95 % interval"
    )
    size: Number = Field(default=None, description="rms there over what is allowed")
    rms_over_noise: Number = Field(default=None, description="rms of the coefficient over noise")
    depends_on: list[State] = Field(default=[], description="states with which it varies")
    twice_log_likelihood: Number = Field(
        default=None, description="gain in twice the log likelihood of allowing for it"
    )
    p: Number = Field(default=None, description="chance that noise gives as much")
    t: Number = Field(default=None, description="t of the candidate effect")
    words: str = Field(default="", description="sentence")

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

    state: str = Field(description="state or control")
    low: float = Field(description="lower end of the range with most of it, in the state's unit")
    high: float = Field(description="upper end of that range")
    share: float = Field(description="share of the variance that the state explains")
    of: str = Field(description="mean or size of the residual")
    p: Number = Field(default=None, description="chance that noise gives as much")


class NearbyCandidate(Part):
    """A candidate that would explain part of the residual."""

    coefficient: str = Field(default="", description="coefficient that it acts on")
    subsystem: str = Field(default="", description="subsystem, where it is no coefficient")
    term: str = Field(description="product of states, or kind of subsystem effect")
    name: str = Field(description="name in words")
    t: float = Field(description="t beside the chosen effects")
    leaves: float = Field(description="rms over noise that it leaves of the channel")


class ResidualLocation(Part):
    """Where the largest remaining residual occurs; null fields have a reason."""

    flights: Literal["train", "test"] | None = Field(description="train or hold-out flights")
    flight: str | None = Field(description="name of the flight")
    manoeuvre: str | None = Field(description="kind of manoeuvre")
    channel: str | None = Field(description="channel of the residual")
    from_s: Number = Field(description="begin, s")
    to_s: Number = Field(description="end, s")
    from_Hz: Number = Field(description="lower end of the band, Hz")
    to_Hz: Number = Field(description="upper end of the band, Hz")
    rms_over_noise: Number = Field(description="rms there over the sensors' noise")
    share_of_excess: Number = Field(description="share of the channel's excess that lies there")
    p: Number = Field(default=None, description="chance that noise gives as much anywhere")
    state: StateDependence | None = Field(description="state with which the residual varies")
    channel_on_train: Number = Field(
        description="rms over noise of the channel on training flights"
    )
    would_tell: str | None = Field(description="flight that would tell the cause")
    candidates: list[NearbyCandidate] = Field(description="nearest candidates")
    reason: str | None = Field(description="why there is no place")
    state_reason: str | None = Field(default=None, description="why there is no state")

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
    """A root mean square before and after refinement, in the quantity's unit."""

    rms_before: Number = Field(default=None, description="before")
    rms_after: Number = Field(default=None, description="after")
    noise_rms: Number = Field(description="part that the sensors' noise explains")


class Interval(Part):
    """Error bounds of a coefficient before and after refinement."""

    coverage_before: Number = Field(description="share of the test samples inside, before")
    coverage_std_before: Number = Field(description="standard error of the share, before")
    width_before: Number = Field(description="mean width, before")
    coverage_after: Number = Field(description="share of the test samples inside, after")
    coverage_std_after: Number = Field(description="standard error of the share, after")
    width_after: Number = Field(description="mean width, after")


def _require_all(part: Part, reason: str | None, optional: str) -> None:
    """Raise ValueError if a part lacks fields and has no reason for it."""
    lacking = sorted({*type(part).model_fields} - part.model_fields_set - {"reason", optional})
    if reason is None and lacking:
        raise ValueError(f"needs {', '.join(lacking)}, or a reason")


class Intervals(Part):
    """Error bounds evaluated on the hold-out flights."""

    confidence: float = Field(default=0.0, description="confidence of the intervals")
    coefficients: dict[str, Interval] = Field(default={}, description="bounds by coefficient")
    reason: str | None = Field(description="why some are undefined")

    @model_validator(mode="after")
    def _check_complete(self) -> Intervals:
        """Require all fields unless there is a reason."""
        _require_all(self, self.reason, "")
        return self


class MissionFlights(Part):
    """Flights of a mission with one model."""

    flights: int = Field(default=0, description="number of flights")
    failed: int = Field(description="flights that failed")
    loss_of_control: int = Field(default=0, description="flights that lost control")
    extrapolated_share: Number = Field(
        default=None, description="share of the time outside the data of the bounds"
    )


class MissionMetric(Part):
    """P-boxes of one metric with both models."""

    metric: str = Field(description="column of cases.parquet")
    condition: str = Field(description="condition of the flights")
    quantiles: dict[str, dict[str, Ends]] = Field(
        description="probability to the quantile's interval before and after"
    )
    width_before: Number = Field(description="area between the envelopes, before")
    width_after: Number = Field(description="area between the envelopes, after")


class Mission(Part):
    """A mission flown with the models before and after refinement."""

    reason: str | None = Field(default=None, description="why no mission was flown")
    mission: str = Field(default="", description="run script")
    corners: int = Field(default=0, description="combinations of the intervals' ends")
    flights_per_corner: int = Field(default=0, description="flights of each")
    duration_s: float = Field(default=0.0, description="length of a flight, s")
    before: MissionFlights = Field(default=MissionFlights(failed=0), description="model before")
    after: MissionFlights = Field(default=MissionFlights(failed=0), description="model after")
    folders: Annotated[list[FolderName], Field(max_length=2)] = Field(
        default=[], description="folders of the campaigns"
    )
    metrics: list[MissionMetric] = Field(default=[], description="p-boxes by metric and condition")

    @model_validator(mode="after")
    def _check_complete(self) -> Mission:
        """Require all fields but those that older files lack, unless there is a reason."""
        _require_all(self, self.reason, "metrics")
        return self


class Cost(Part):
    """Sum of squared residuals over noise, before and after."""

    before: Number = Field(description="before")
    after: Number = Field(description="after")
    samples: int = Field(description="number of samples")


class ResidualTables(Part):
    """Residuals on one set of flights."""

    channels: dict[str, BeforeAfter] = Field(description="channels of replays")
    predictions: dict[str, BeforeAfter] = Field(
        default={}, description="one-step prediction errors, where these were fitted"
    )
    coefficients: dict[str, BeforeAfter] = Field(description="dimensionless coefficients")
    theil: Numbers = Field(default={}, description="Theil's U, mean of the channels")
    cost: Cost | None = Field(default=None, description="what was minimised")
    intervals: Intervals | None = Field(default=None, description="error bounds of both models")
    pbox: Mission | None = Field(default=None, description="mission flown with both models")


class Gaps(Part):
    """Residuals by the use of the flights."""

    train: ResidualTables | None = Field(default=None, description="flights that chose effects")
    test: ResidualTables = Field(description="hold-out flights")


class Curve(Part):
    """A smooth term over its state: value, 95 % band, and number of train samples nearby."""

    at: list[float] = Field(description="values of the state")
    value: list[float] = Field(description="the term")
    low: list[float] = Field(description="lower end of the 95 % band")
    high: list[float] = Field(description="upper end of the 95 % band")
    samples: list[int] = Field(description="train samples near the value")

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

    form: str = Field(description="name of the form")
    correlation: float = Field(description="correlation with the term")
    leaves: float = Field(description="rms over noise that it leaves of the channel")


class SmoothTerm(Part):
    """A smooth term that is offered for interpretation; it is no effect."""

    coefficient: str = Field(description="coefficient that it acts on")
    state: str = Field(description="state that it is a function of")
    times: str | None = Field(default=None, description="state that multiplies it")
    name: str = Field(description="name in words")
    property: str = Field(description="property of its table in the XML")
    unit: str = Field(description="unit of the state")
    effective_degrees_of_freedom: float = Field(description="effective degrees of freedom")
    dispersion: Number = Field(default=None, description="dispersion of the coloured residuals")
    in_place_of: Texts = Field(default=[], description="effects that it replaces")
    tried: int | None = Field(default=None, description="number of smooth terms tried")
    p: Number = Field(default=None, description="chance that noise gives as much")
    twice_log_likelihood: Number = Field(
        default=None, description="gain in twice the log likelihood"
    )
    confirmed_on_held_out_manoeuvres: Number = Field(
        default=None, description="the same gain on manoeuvres that were held out"
    )
    channel: str = Field(description="channel of which it explains most")
    channel_on_train: float = Field(description="rms over noise of that channel without it")
    leaves: float = Field(description="rms over noise of that channel with it")
    shapes: list[FunctionalForm] = Field(description="functional forms like it")
    curve: Curve = Field(description="the term over the range of the data")
    test: HoldOutTest = Field(description="test on the hold-out flights")
    gap: dict[str, ResidualTables] = Field(description="residuals of training and hold-out flights")
    model: str = Field(default="", description="XML of the aircraft with the term")


class Remaining(Part):
    """Residual that the refined model does not explain."""

    unexplained: bool = Field(description="whether anything is left beyond noise")
    where: list[RemainingPart] = Field(
        description="residuals that stay unexplained, and where they occur"
    )
    channels_above_noise: Numbers = Field(description="channel to rms over noise")
    coloured_channels: Texts = Field(description="channels whose residual is not white")
    place: ResidualLocation | None = Field(
        default=None, description="place of the largest residual"
    )
    smooth: SmoothTerm | None = Field(
        default=None, description="a smooth term that is offered for naming, no effect"
    )
    smooth_reason: str | None = Field(default=None, description="why there is none")


class Identified(Part):
    """A parameter of refinement.json."""

    value: Number = Field(description="estimate, in the property's unit")
    std: Number = Field(description="standard error")


class Switch(Part):
    """A property that removes an effect from the model."""

    property: str = Field(description="property")
    off: float = Field(description="value without the effect")


class Score(Part):
    """A candidate effect and its t statistic."""

    effect: str = Field(description="coefficient or subsystem, and term")
    t: Number = Field(default=None, description="t beside the parameters alone")


class RefusedCandidate(Score):
    """The best candidate that was not accepted."""

    why: str = Field(description="reason")


class Candidates(Part):
    """Candidate effects, the most likely first."""

    limit: Number = Field(default=None, description="t that the best of all reaches by chance")
    scores: list[Score] = Field(default=[], description="candidates")


class Timing(Part):
    """Time offset that was corrected in the records."""

    controls_late_s: Number = Field(description="delay that all controls share, s")


class Baked(Part):
    """Numbers of the author's functions that hold the estimated scales."""

    changed: dict[str, Ends] = Field(description="property to the number before and after")
    kept: Texts = Field(description="scales that stay properties")


class Refinement(Part):
    """What a model lacks: effects with their evidence and tests, and what remains."""

    verdict: Literal["effects-found", "no-missing-effect", "unexplained"] = Field(
        description="answer"
    )
    disagreement: list[Region] = Field(
        description="where the training flights disagree with the model before refinement"
    )
    effects: list[Effect] = Field(description="effects of the refined model")
    withdrawn: list[Withdrawn] = Field(
        default=[], description="effects that the hold-out flights contradict"
    )
    chosen: list[Effect] = Field(
        default=[], description="effects that the training flights chose, before the test"
    )
    remaining: Remaining = Field(description="what no effect explains")
    gap: Gaps = Field(description="residuals before and after")
    switch: list[Switch] = Field(default=[], description="properties that remove effects")
    parameters: dict[str, Identified] = Field(
        default={}, description="parameters, identified with the effects"
    )
    best_refused: RefusedCandidate | None = Field(
        default=None, description="best candidate that was not accepted"
    )
    candidates: Candidates = Field(default=Candidates(), description="scores of all candidates")
    timing: Timing | None = Field(default=None, description="time offset that was corrected")
    trail: Texts = Field(default=[], description="steps of the search")
    notes: Texts = Field(default=[], description="sentences for the user")
    model: str | None = Field(default=None, description="XML of the refined aircraft")
    train: Texts = Field(default=[], description="files of the training flights")
    test: Texts = Field(default=[], description="files of the hold-out flights")
    command: str | None = Field(default=None, description="command that made the file")
    baked: Baked | None = Field(default=None, description="scales written into the XML's numbers")
    seconds: Number = Field(default=None, description="duration, s")
