"""Validation of result documents (fit.json, compare.json, ...) before a page is made from them.

Folders of results are passed on, edited and damaged. Report pages read only documents that passed
here, so that a missing key is an error of the file, not of the page. Unknown keys are allowed. The
classes also document the files: one class for each object, one field for each key.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from sysid.foreign.regular_files import ParseError, parse_json, read_regular
from uqharness.errors import BadInputError
from uqharness.toml import dotted


def _inside(name: str) -> str:
    """Return the name of an inner folder; ValueError if it leads out of the folder of results."""
    # Checked as a POSIX and as a Windows path: results move between systems.
    windows = PureWindowsPath(name)
    parts = {*PurePosixPath(name).parts, *windows.parts}
    if ".." in parts or name.startswith("/") or windows.drive or windows.root or "\0" in name:
        raise ValueError("must be a folder within the folder of results")
    return name


FolderName = Annotated[str, AfterValidator(_inside)]
Number = float | None
Numbers = dict[str, Number]
Ends = Annotated[list[Number], Field(min_length=2, max_length=2)]
_IDENTIFIED = "identified"
_MAX_BYTES = 16_000_000
"""Largest document; as Python objects it takes up to thirty times as much memory."""


class Part(BaseModel):
    """An object in a document: no type conversion, further keys allowed."""

    model_config = ConfigDict(strict=True, extra="allow")


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


class BoundsWidth(Part):
    """Widths of one coefficient's bounds in bounds.json."""

    mean_width: Number = None
    noise_width: Number = None
    noise_std: Number = None
    left_out_share: Number = None


class Filters(Part):
    """Alternative low-pass filters in bounds.json, and the bounds that they give."""

    cutoff_hz: Number
    airspeed_cutoff_hz: Number = None
    mean_width: Numbers
    left_out_share: Numbers = Field(default_factory=dict)


class Bounds(Part):
    """bounds.json of `uqharness bounds`: diagnostics of the model form."""

    coefficients: dict[str, BoundsWidth] = Field(default_factory=dict)
    left_out: dict[str, Numbers] = Field(default_factory=dict)
    cutoffs: list[Filters] = Field(default_factory=list)
    warnings: list[str] = Field(default_factory=list)
    notes: list[str] = Field(default_factory=list)
    command: str | None = None
    version: str = ""


class Stage(Part):
    """A stage of study.json."""

    name: str
    kind: str
    state: str
    folder: FolderName | None = None
    command: str | None = None
    exit: int | None = None
    seconds: Number = None
    inputs: dict[str, str] | None = None
    error: str | None = None


class Pair(Part):
    """Folders of the campaigns before and after refinement."""

    before: FolderName
    after: FolderName


class Sentence(Part):
    """A sentence of a verdict."""

    text: str
    level: str | None = None


class StudyAnswer(Part):
    """The answer of a study in sentences; `lacked` is empty without refinement."""

    level: str
    answer: str
    why: str
    lacked: str
    next: str


class Tracks(Part):
    """Flights in tracks.parquet, or the reason why there are none."""

    reason: str = ""
    wind_mps: float | None = None
    turbulence: str | None = None
    radius_m: float | None = None


class Study(Part):
    """study.json of `uqharness study`."""

    study: str
    stages: list[Stage]
    before_after: Pair | Annotated[dict[str, Any], Field(max_length=0)] | None = None
    verdict: list[Sentence] | None = None
    answer: StudyAnswer | None = None
    tracks: Tracks | None = None
    state: str = "running"
    question: str | None = None
    command: str | None = None
    version: str = ""
    file: str = ""
    hash: str | None = None


def read_document(path: Path, shape: type[Part]) -> dict[str, Any]:
    """Read and validate a JSON document.

    Parameters
    ----------
    path : Path
        The file.
    shape : type of Part
        Model that it must match.

    Returns
    -------
    dict
        Its content, unknown keys included.

    Raises
    ------
    BadInputError
        If the file cannot be read or does not match; the message names file and key.
    """
    try:
        document = parse_json(read_regular(path, _MAX_BYTES))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ParseError as error:
        place = "" if error.line is None else f", line {error.line}"
        raise BadInputError(f"{path}{place}: {error}; run its command again") from None
    if not isinstance(document, dict):
        raise BadInputError(f"{path}: is no JSON object; run its command again")
    try:
        shape.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = dotted(first["loc"]) or "the document"
        problem = (
            "is missing"
            if first["type"] == "missing"
            else first["msg"].removeprefix("Value error, ")
        )
        raise BadInputError(f"{path}: {where}: {problem}; run its command again") from None
    return document


# Objects of refinement.json.


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
