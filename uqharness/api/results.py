"""Folders of results in Python: studies, pages and dossiers."""

from __future__ import annotations

from pathlib import Path

from uqharness.commands import folders
from uqharness.commands import study as studies
from uqharness.heartbeat import notebook_line
from uqharness.isolation import isolated
from uqharness.requests.base import accepts
from uqharness.requests.folders import DossierRequest, ReportRequest, StudyRequest
from uqharness.results.folders import DossierFile
from uqharness.results.study import Study


@notebook_line("study")
@accepts(StudyRequest)
@isolated
def study(request: StudyRequest) -> Study:
    """Run a study file stage by stage, or resume it, as ``uqharness study`` does.

    Returns
    -------
    Study
        The content of study.json: ``question``, ``answer``, ``stages`` with their exit codes, and
        ``report``, the page's path.

    Raises
    ------
    BadInputError
        For mistakes in the file, each with its line, and a stage that cannot use its input.

    Examples
    --------
    >>> import uqharness as uq
    >>> uq.study("missing.toml", "results")  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    uqharness.errors.BadInputError: missing.toml
    """
    return studies.study(request).value


@accepts(ReportRequest)
def report(request: ReportRequest) -> Path:
    """Write the page of a folder of results from its files, as ``uqharness report`` does.

    Returns
    -------
    Path
        report.html, one file that needs no network.

    Raises
    ------
    BadInputError
        For a folder of no results, or one that is damaged.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.report("results").name
    'report.html'
    """
    return folders.report(request).value


@accepts(DossierRequest)
@isolated
def dossier(request: DossierRequest) -> DossierFile:
    """Write the evidence of a folder of results as one document, as ``uqharness dossier`` does.

    Returns
    -------
    DossierFile
        ``dossier``, the page's path; ``missing``, what the folder lacks; ``tests``,
        ``not_in_the_data`` and ``sources``.

    Raises
    ------
    BadInputError
        For a folder of no results, and a file whose name does not end with .html.

    Examples
    --------
    >>> import uqharness as uq
    >>> campaign = {
    ...     "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
    ...     "aleatory": {"flights": 2, "duration_s": 5, "burn_in_s": 0},
    ...     "epistemic": {"method": "none"},
    ... }
    >>> flown = uq.run_campaign(campaign, "results", workers=1)
    >>> uq.dossier("results").tests
    []
    """
    return folders.dossier(request).value
