"""Requests of study, about folders of results, and about the command line itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator

from uqharness.requests import fields
from uqharness.requests.base import FilePath, Request, option


def _html(path: Path | None) -> Path | None:
    """Return the path of a page; other formats would be HTML under a wrong name."""
    if path is not None and path.suffix not in (".html", ".htm"):
        raise ValueError("a file whose name ends with .html is needed")
    return path


def _folder() -> Any:
    """Return the field of a folder of results."""
    return option(
        ...,
        "folder that another command wrote",
        flag="",
        metavar="DIR",
        positional=True,
        toml=False,
    )


class ReportRequest(Request):
    """Write the page of a folder of results from its files; nothing is simulated or fitted (see
    docs/report.md).
    """

    command: ClassVar[str] = "report"
    examples: ClassVar[str] = """
  uqharness report results
  uqharness report refined --json

DIR is the --out of study, campaign run, identify, compare, bounds, validate-bounds or refine.
Writes DIR/report.html, one file that needs no network, for a screen, a phone or a printer."""
    no: ClassVar[str] = "files of the folder were changed after they were written"

    folder: FilePath = _folder()


class DossierRequest(Request):
    """Write the evidence for a model as one document: provenance, proof of match, credibility,
    claims, validity envelope, sources (see docs/dossier.md). Nothing is simulated or fitted.
    """

    command: ClassVar[str] = "dossier"
    examples: ClassVar[str] = """
  uqharness dossier results
  uqharness dossier refined --out evidence.html --json

DIR is the --out of study, refine, campaign run, identify or compare, or a folder that holds several
of them. Writes DIR/dossier.html, one file that can be printed. It presents evidence and claims no
compliance with any regulation or standard."""
    no: ClassVar[str] = "the folder is incomplete or damaged; the dossier lists the missing items"

    folder: FilePath = _folder()
    out: Annotated[FilePath | None, AfterValidator(_html)] = option(
        None,
        "file to write (default: DIR/dossier.html)",
        metavar="FILE.html",
        provenance=False,
        toml=False,
    )


class CompletionRequest(Request):
    """Print a script that completes uqharness in a shell."""

    command: ClassVar[str] = "completion"
    examples: ClassVar[str] = """
  uqharness completion bash > ~/.local/share/bash-completion/completions/uqharness
  uqharness completion zsh > ~/.zfunc/_uqharness

bash reads its file at the next start. zsh needs in ~/.zshrc:
fpath+=~/.zfunc; autoload -U compinit; compinit
Completion does not run this program; write the file again after an update."""

    shell: Literal["bash", "zsh"] = option(..., "the shell", flag="", toml=False, python=False)


# Request of study.


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
