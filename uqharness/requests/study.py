"""Request of study."""

from __future__ import annotations

from typing import ClassVar

from uqharness.requests import fields
from uqharness.requests.base import FilePath, Request, option


class StudyRequest(Request):
    """Run a study file stage by stage, or resume it."""

    command: ClassVar[str] = "study"
    no: ClassVar[str] = "done, and a stage that is named answered no"
    keeps_stages: ClassVar[bool] = True
    examples: ClassVar[str] = """
  uqharness study campaigns/chain/chain.toml --out campaigns/chain/results
  uqharness study mine.toml --out results --workers 8

Stages: flights (simulated or logged), identification, model-form bounds, a campaign over their
corners, refinement, and the same again with the refined model. DIR/study.json lists the stages,
DIR/report.html shows the results (see docs/study.md). The same command resumes after an
interruption; a stage with unchanged inputs and options is not repeated."""

    study: FilePath = option(
        ...,
        "the study file: flights and stages",
        flag="",
        metavar="STUDY.toml",
        positional=True,
        toml=False,
    )
    out: FilePath = fields.out(positional=True)
    workers: fields.Workers = fields.workers("one a core")
