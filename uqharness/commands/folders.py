"""Commands about folders of results: the page and the dossier."""

from __future__ import annotations

from pathlib import Path

from uqharness.dossier import SegmentResult, read_evidence
from uqharness.heartbeat import Callback, silent
from uqharness.report import first_lines, kind_of, write_html, write_report
from uqharness.report.pages import Dossier, dossier_of
from uqharness.requests.folders import DossierRequest, ReportRequest
from uqharness.results.base import Outcome
from uqharness.results.folders import (
    DossierFile,
    DossierRow,
    DossierTest,
    ReportFile,
    SourceFile,
)

DOSSIER = "dossier.html"


def report(request: ReportRequest, callback: Callback = silent) -> Outcome[Path]:
    """Write the page of a folder; the answer is no where files of the folder are damaged."""
    kind = kind_of(request.folder)
    callback("reading and writing")
    pages = write_report(request.folder)
    document = ReportFile(
        report=str(pages.path),
        kind=kind,
        bytes=pages.path.stat().st_size,
        damaged=[fault.name for fault in pages.damaged],
    )
    return Outcome(
        pages.path,
        document,
        [*pages.verdict, f"{document.bytes / 1e6:.2f} MB written"],
        code=1 if pages.damaged else 0,
        report=pages.path,
        warnings=pages.warnings,
    )


def dossier(request: DossierRequest, callback: Callback = silent) -> Outcome[DossierFile]:
    """Write the dossier of a folder; the answer is no where evidence is missing."""
    path = request.folder / DOSSIER if request.out is None else request.out
    callback("reading results")
    evidence = read_evidence(request.folder)
    callback("judging and writing")
    result = dossier_of(evidence)
    write_html(path, result.page)
    tests, not_in_the_data = _match(result)
    document = DossierFile(
        dossier=str(path),
        missing=list(result.missing),
        tests=tests,
        not_in_the_data=not_in_the_data,
        sources=[
            SourceFile(file=s.file, sha256=s.sha256, command=s.command, version=s.version)
            for s in evidence.sources
        ],
    )
    return Outcome(
        document, document, first_lines(result.page), code=1 if result.missing else 0, report=path
    )


def _match(made: Dossier) -> tuple[list[DossierTest], dict[str, str]]:
    """Return the tests of the match, and those whose data are missing."""
    if made.source is None:
        return [], {}
    match = made.source.match
    return [_test_document(result) for result in match.results], dict(match.missing)


def _test_document(result: SegmentResult) -> DossierTest:
    """Return one test with its segment and rows."""
    segment = result.segment
    return DossierTest(
        test=result.test.entry,
        title=result.test.title,
        flight=segment.flight,
        manoeuvre=segment.manoeuvre,
        from_s=float(segment.time_s[0]),
        answer=result.answer,
        why=result.reason,
        rows=[
            DossierRow(
                quantity=row.quantity,
                difference=row.worst,
                tolerance=row.band,
                time_s=row.at_s,
                answer=row.answer,
                share_inside=row.share,
            )
            for row in result.rows
        ],
    )
