"""What the documents of results must hold for a page to be written from them: fit.json, compare.json and others; refinement.json
in `refinement_document`.

Folders of results are passed on, edited and damaged. A page is written from a document that has passed here, so that a missing key
or a text in place of a number is told of the file. Keys that no page reads may be anything.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from sysid.foreign.parsed_text import ParseError, parse_json
from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.toml import dotted


def _inside(name: str) -> str:
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
_MOST_BYTES = 16_000_000
"""A document may have; as Python objects it takes up to thirty times as much."""


class Part(BaseModel):
    """A part of a document: types are not bent, further keys are allowed."""

    model_config = ConfigDict(strict=True, extra="allow")


class Spread(Part):
    """A root mean square beside what noise gives."""

    rms: Number = None
    noise: Number = None


class Parameter(Part):
    """A row of fit.json."""

    value: Number
    std: Number = None
    std_crb: Number = None
    status: str
    reason: str | None = None
    initial: Number = None

    @model_validator(mode="after")
    def _known(self) -> Parameter:
        if self.status == _IDENTIFIED and (
            self.value is None or not {"std", "std_crb"} <= self.model_fields_set
        ):
            raise ValueError("an identified parameter needs value, std and std_crb")
        return self


class FitChannel(Spread):
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


class Gap(Spread):
    """A coefficient of compare.json."""

    mean: Number = None


class Manoeuvre(Part):
    """A manoeuvre of compare.json: rms over noise."""

    channels: Numbers
    coefficients: Numbers


class Moment(Part):
    """A moment of compare.json."""

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
    def _known(self) -> Compare:
        for name in self.above:
            if name not in self.channels or self.channels[name].ratio is None:
                raise ValueError(f"above names {name!r}, which is no channel with a ratio")
        return self


class Share(Part):
    """A coefficient of coverage.json."""

    share_95: float = Field(alias="0.95")
    share_68: float = Field(alias="0.68")
    n_effective: Number = None
    mean_width: Number = None


class StateBin(Part):
    """A range of a state in coverage.json, and the share of its samples inside by coefficient."""

    state: str
    low: Number = Field(alias="from")
    high: Number = Field(alias="to")
    samples: int = 0
    share: Numbers = Field(default_factory=dict)


class Coverage(Part):
    """coverage.json of `uqharness validate-bounds`."""

    coverage: Annotated[dict[str, Share], Field(min_length=1)]
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
    def _known(self) -> Coverage:
        for name in self.failed:
            if name not in self.coverage:
                raise ValueError(f"failed names {name!r}, of which there is no coverage")
        return self


class Width(Part):
    """A coefficient of bounds.json."""

    mean_width: Number = None
    noise_width: Number = None
    noise_std: Number = None
    left_out_share: Number = None


class Filters(Part):
    """Other low-passes tried on bounds, in bounds.json, and what they gave by coefficient."""

    cutoff_hz: Number
    airspeed_cutoff_hz: Number = None
    mean_width: Numbers
    left_out_share: Numbers = Field(default_factory=dict)


class Bounds(Part):
    """bounds.json of `uqharness bounds`: what stands beside the model form."""

    coefficients: dict[str, Width] = Field(default_factory=dict)
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
    """The campaigns before and after refinement."""

    before: FolderName
    after: FolderName


class Sentence(Part):
    """A sentence of a verdict."""

    text: str
    level: str | None = None


class StudyAnswer(Part):
    """The answer of a study in lines, ``lacked`` empty without refinement."""

    level: str
    answer: str
    why: str
    lacked: str
    next: str


class Tracks(Part):
    """The flights of tracks.parquet, or the reason why there are none."""

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
    """The content of a document that has ``shape``. Raises BadInputError naming the file and what is wrong with it."""
    try:
        document = parse_json(read_regular(path, _MOST_BYTES))
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
        what = (
            "is missing"
            if first["type"] == "missing"
            else first["msg"].removeprefix("Value error, ")
        )
        raise BadInputError(f"{path}: {where}: {what}; run its command again") from None
    return document
