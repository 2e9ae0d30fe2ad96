"""Results of a study: study.json."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from uqharness.results.base import FolderName, Number, Part


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
