"""Results of report, dossier and completion."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from uqharness.results.base import Number, Part, Texts


class ReportFile(Part):
    """What `uqharness report` wrote."""

    report: str = Field(description="path of report.html")
    kind: str = Field(description="command that wrote the folder")
    bytes: int = Field(ge=0, description="size of the page, bytes")
    damaged: Texts = Field(description="files that are not as they were written")


class CompletionScript(Part):
    """What `uqharness completion` prints."""

    shell: Literal["bash", "zsh"] = Field(description="shell that the script is for")
    script: str = Field(description="text of the script")


class DossierRow(Part):
    """A quantity of a test and its tolerance."""

    quantity: str = Field(description="quantity that is compared")
    difference: Number = Field(description="largest difference, in the quantity's unit")
    tolerance: Number = Field(description="tolerance, in the quantity's unit")
    time_s: Number = Field(description="time of the largest difference, s")
    answer: str = Field(description="whether the difference is within the tolerance")
    share_inside: Number = Field(description="share of the samples within the tolerance")


class DossierTest(Part):
    """A test of the proof of match on one segment."""

    test: str = Field(description="entry of the regulation's table")
    title: str = Field(description="title of the entry")
    flight: str = Field(description="flight of the segment")
    manoeuvre: str = Field(description="manoeuvre of the segment")
    from_s: Number = Field(description="time at which the segment begins, s")
    answer: str = Field(description="result of the test")
    why: str = Field(description="reason of the result")
    rows: list[DossierRow] = Field(description="quantities of the test")


class SourceFile(Part):
    """A file that the dossier cites."""

    file: str = Field(description="path relative to the folder")
    sha256: str = Field(description="digest of its content")
    command: str = Field(description="command that wrote it")
    version: str = Field(description="version of uqharness that wrote it")


class DossierFile(Part):
    """What `uqharness dossier` wrote."""

    dossier: str = Field(description="path of the page")
    missing: Texts = Field(description="what the folder lacks, sentences")
    tests: list[DossierTest] = Field(description="tests of the proof of match")
    not_in_the_data: dict[str, str] = Field(
        description="entry of the regulation's table to the data that it lacks"
    )
    sources: list[SourceFile] = Field(description="files that the dossier cites")
