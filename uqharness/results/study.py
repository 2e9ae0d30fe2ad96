"""Result of a study: study.json."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from uqharness.results.base import FolderName, Number, Part

FORMAT = "study 1"


class Stage(Part):
    """A stage of study.json."""

    state: Literal["waiting", "running", "done", "failed"] = Field(description="state of the stage")
    exit: int | None = Field(default=None, description="exit code: 1 ran, but the answer is no")
    seconds: Number = Field(default=None, description="duration, s")
    inputs: dict[str, str] | None = Field(default=None, description="input to its SHA-256")
    error: str | None = Field(default=None, description="why the stage failed")
    key: str = Field(default="", description="digest of all that the result depends on")
    outputs: dict[str, str] = Field(default={}, description="file or folder to its SHA-256")
    name: str = Field(description="name of the stage")
    kind: str = Field(description="command of the stage")
    folder: FolderName | None = Field(default=None, description="folder of the results")
    command: str | None = Field(default=None, description="command that repeats the stage")


class Pair(Part):
    """Folders of the campaigns before and after refinement."""

    before: FolderName
    after: FolderName


class Sentence(Part):
    """A sentence of a verdict."""

    text: str = Field(description="the sentence")
    level: str | None = Field(default=None, description="good, warn, bad or empty")


class StudyAnswer(Part):
    """The answer of a study in sentences."""

    level: str = Field(description="good, warn or bad")
    answer: str = Field(description="answer to the question")
    why: str = Field(description="reason")
    lacked: str = Field(description="effects that the model lacked; empty without refinement")
    next: str = Field(description="next step")


class Tracks(Part):
    """Flights in tracks.parquet, or the reason why there are none."""

    reason: str = Field(default="", description="why there are none")
    wind_mps: float | None = Field(default=None, description="wind, m/s")
    turbulence: str | None = Field(default=None, description="turbulence")
    aleatory_id: int | None = Field(default=None, description="sample of wind and noise")
    radius_m: float | None = Field(default=None, description="radius of the excursion, m")
    key: str | None = Field(default=None, description="digest of the campaigns' tables")
    sha256: str | None = Field(default=None, description="digest of tracks.parquet")


class Study(Part):
    """The stages of a study, its verdict and its answer."""

    format: str = Field(default=FORMAT, description="format of the file")
    study: str = Field(description="name of the study")
    question: str | None = Field(default=None, description="question that it answers")
    file: str = Field(default="", description="name of the study file")
    path: str = Field(default="", description="path of the study file")
    hash: str | None = Field(default=None, description="SHA-256 of the study file")
    version: str = Field(default="", description="version that made the file")
    command: str | None = Field(default=None, description="command that made the file")
    state: str = Field(default="running", description="running, done or failed")
    stages: list[Stage] = Field(description="stages in the order in which they run")
    verdict: list[Sentence] | None = Field(default=None, description="findings")
    former: list[Stage] = Field(default=[], description="stages that the study file had earlier")
    before_after: Pair | Annotated[dict[str, Any], Field(max_length=0)] | None = Field(
        default=None, description="folders of the campaigns before and after refinement"
    )
    answer: StudyAnswer | None = Field(default=None, description="answer of the study")
    tracks: Tracks | None = Field(default=None, description="ground tracks of the page")
    report: str | None = Field(default=None, description="path of the page, with --json only")

    @property
    def pair(self) -> dict[str, str]:
        """Folders of the campaigns before and after refinement; empty without both."""
        both = self.before_after
        return {"before": both.before, "after": both.after} if isinstance(both, Pair) else {}
