"""Commands about campaigns: cost, flights, status, page, shards, repeated flights, checks.

The work is done by `uqharness.campaign`; a function here takes a request and returns an `Outcome`.
"""

from __future__ import annotations

import io
import logging
import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uqharness.campaign import (
    AREAS,
    CONFIDENCE,
    CONVERGENCE,
    RERUN,
    STATEMENTS,
    CampaignSpec,
    Cost,
    Executor,
    ProcessExecutor,
    Progress,
    RunOptions,
    SerialExecutor,
    as_rows,
    band_confidence,
    bounds_notes,
    campaign_from,
    corners_only_words,
    corrections,
    describe,
    engine_words,
    fly_pairs,
    joint_level,
    joint_words,
    make_copy,
    needs_copy,
    noise_notes,
    parse_shard,
    pboxes,
    points_flown,
    read_campaign,
    read_cases,
    read_checked,
    read_complete,
    read_flights,
    read_manifest,
    read_status,
    refuse_if_long,
    rerun_case,
    sentences,
    size_of,
    unavailable_reason,
    with_samples,
    write_area,
    write_convergence,
)
from uqharness.campaign import lines as answer_lines
from uqharness.campaign import merge as merge_shards
from uqharness.campaign import run as running
from uqharness.campaign import salvage as salvage_folder
from uqharness.campaign.verify import verify as verify_folder
from uqharness.errors import BadInputError
from uqharness.files import find_campaign, scratch_folder
from uqharness.flight import AutopilotSettings
from uqharness.heartbeat import Callback, clock, silent
from uqharness.parallel import usable_cores
from uqharness.report import (
    convergence_section,
    draw_rerun,
    track_cases,
    write_campaign_report,
    write_figures,
)
from uqharness.requests.campaign import (
    AreaRequest,
    CampaignRequest,
    CheckRequest,
    ConvergenceRequest,
    MergeRequest,
    ReportRequest,
    RerunRequest,
    RunRequest,
    SalvageRequest,
    StatusRequest,
    SurrogateCheckRequest,
    VerifyRequest,
)
from uqharness.results.base import Outcome
from uqharness.results.campaign import (
    AreaRow,
    Areas,
    CampaignCost,
    CampaignPage,
    CampaignRun,
    CampaignStatus,
    Convergence,
    ConvergenceRow,
    FolderCheck,
    Merged,
    Rerun,
    Salvaged,
    SurrogateCheck,
    SurrogateFlight,
    SurrogateMetric,
    SurrogateQuantile,
)
from uqharness.statistics import PBox

if TYPE_CHECKING:
    import pandas as pd

ProgressCallback = Callable[[Progress], object]

MAX_REFLOWN_S = 600.0
"""Longest flight time that a report flies again unasked [s]. 1800 s of the E-SPAARO take 15 s of a
core, recording and drawing included, so this takes some 5 s."""
_NO_FILE = Path("campaign.toml")
"""File name in the messages of a campaign that has no file."""
_FILE_AND_LINE = re.compile(rf"^{re.escape(str(_NO_FILE))}:\d+: (the file: )?")
_TABLE_COMMANDS = {
    "sensitivity": "sensitivity",
    "convergence": "campaign convergence",
    "area": "campaign area",
}
"""Tables that other commands write: the command by the table's name."""
_logger = logging.getLogger("uqharness")


@dataclass(frozen=True)
class CampaignResult:
    """Results of a complete campaign, read from its folder on demand.

    Attributes
    ----------
    folder : Path
        The results; every ``uqharness campaign`` command takes it.
    manifest : Mapping
        What was flown: settings, versions, hashes.
    notes : tuple of str
        Remarks on the bounds that were flown.
    """

    folder: Path
    manifest: Mapping[str, Any] = field(repr=False)
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        settings = self.manifest["campaign"]
        name = Path(settings["campaign"]["aircraft"]).name
        return (
            f"CampaignResult({str(self.folder)!r}: {self.manifest['cases']} flights of {name}, "
            f"epistemic samples by {settings['epistemic']['method']})"
        )

    def _repr_html_(self) -> str:
        # Imported here: only notebooks need charts.
        from uqharness.report import campaign_view

        return campaign_view(self.folder, self.manifest, self.cases, self.statements())

    @cached_property
    def cases(self) -> pd.DataFrame:
        """Table with one row a flight (docs/campaigns.md describes the columns).

        Raises BadInputError where the file is damaged.
        """
        return read_cases(self.folder, self.manifest)

    def pboxes(self) -> dict[tuple[str, str], PBox]:
        """Return the p-box of each (metric, condition), the rows of pbox.parquet."""
        confidence = band_confidence(self.manifest["campaign"], CONFIDENCE)
        return {
            (metric, condition.label): box
            for metric, condition, box in pboxes(self.cases, confidence)
        }

    def statements(self) -> pd.DataFrame:
        """Return statements.csv: excursions per hour and their limits by condition and radius
        (docs/statements.md).
        """
        import pandas as pd

        content = read_checked(self.folder, self.manifest, STATEMENTS)
        return pd.read_csv(
            io.BytesIO(content),
            dtype={"best": str, "worst": str},
            keep_default_na=False,
            na_values=[""],
        )


# The campaign of a request.


def campaign_of(campaign: Any) -> CampaignSpec:
    """Return the campaign of a file, name or dictionary. Raises BadInputError."""
    if isinstance(campaign, CampaignSpec):
        return campaign
    if isinstance(campaign, Mapping):
        try:
            # The dictionary passes the same checks as a file; messages omit the missing file's
            # name.
            return campaign_from(_plain(campaign), _NO_FILE)
        except BadInputError as error:
            raise BadInputError(*(_FILE_AND_LINE.sub("", line) for line in error.args)) from None
    if not isinstance(campaign, str | PathLike):
        raise BadInputError(
            "a campaign is a file, a name or its sections as a dictionary; received"
            f" {type(campaign).__name__}"
        )
    return read_campaign(find_campaign(Path(campaign)))


def _plain(value: Any) -> Any:
    """Convert numpy values and paths to what TOML can hold."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return os.fspath(value) if isinstance(value, PathLike) else value


def _resized(request: CampaignRequest | SalvageRequest) -> CampaignSpec:
    """Return the request's campaign with its size and engine applied. Raises BadInputError."""
    spec = campaign_of(request.campaign)
    if isinstance(request, CampaignRequest) and request.engine is not None:
        spec = spec.with_engine(request.engine)
    if request.hours is not None:
        spec = spec.with_hours(request.hours)
    return spec if request.samples is None else with_samples(spec, request.samples)


def _name(request: CampaignRequest) -> str:
    """Return the campaign's name in sentences."""
    named = isinstance(request.campaign, str | PathLike)
    return str(request.campaign) if named else "the campaign"


def flying_command(request: RunRequest | SalvageRequest, out: Path) -> list[str]:
    """Return the words of the command that flies the campaign into a folder at the requested size;
    empty for a campaign without a file, which only the same call resumes.
    """
    if not isinstance(request.campaign, str | PathLike):
        return []
    words = ["uqharness", "campaign", "run", str(request.campaign), "--out", str(out)]
    # Only options that change the campaign: the command must resume with any number of workers.
    words += [] if request.hours is None else ["--hours", f"{request.hours:g}"]
    if isinstance(request, RunRequest):
        words += [] if request.engine is None else ["--engine", request.engine]
    return words if request.samples is None else [*words, "--samples", str(request.samples)]


def _cost_checker(agreed: bool, name: object) -> Callable[[Cost], None]:
    """Return the function that a campaign calls before it flies.

    It refuses more than a day without consent, and notes the cost.
    """

    def check_cost(cost: Cost) -> None:
        refuse_if_long(cost, agreed, name)
        _logger.info("%s: %s", name, cost.words)

    return check_cost


def _note_rewritten(folder: Path, names: tuple[str, ...] | list[str]) -> None:
    """Note which files were damaged and are written again."""
    for name in names:
        _logger.info(
            "%s was not as it had been written; it is written again from the journal", folder / name
        )


def _failures(statuses: Mapping[str, int]) -> str:
    """Describe how many flights failed, and how."""
    failed = {status: number for status, number in statuses.items() if status != "ok"}
    if not failed:
        return "none failed"
    return (
        f"{sum(failed.values())} failed"
        f" ({', '.join(f'{number} {status}' for status, number in failed.items())})"
    )


# check and run: the cost of a campaign, and its flights.


def check(request: CheckRequest, callback: Callback = silent) -> Outcome[CampaignCost]:
    """Try out a few flights and extrapolate time and disk space."""
    spec = _resized(request)
    for note in noise_notes(spec):
        _logger.info(note)
    callback("trying out flights")
    # Check flights run on a copy, so that nothing of the user's is touched.
    with scratch_folder("check") as scratch:
        mission = running.find_mission(spec, scratch.path)
        if needs_copy(spec):
            make_copy(spec, mission, scratch.path)
        choice, pace = running.check_campaign(spec, mission, scratch.path)
    size = size_of(spec)
    cost = Cost(size, 0, pace, request.workers or usable_cores(), choice.engine)
    described = describe(choice.spec, mission, size.flights, "")
    epistemic = described["campaign"]["epistemic"]
    document = CampaignCost(
        flights=size.flights,
        at_most=size.at_most,
        flights_each=size.aleatory,
        conditions=size.conditions,
        conditions_tried=size.trial_conditions,
        epistemic_samples=size.epistemic,
        interior_samples=size.interior,
        flight_hours=size.hours,
        workers=cost.workers,
        expected_s=cost.seconds,
        disk_bytes=size.disk_bytes,
        more_than_a_day=cost.is_long,
        engine=choice.engine,
        engine_why=list(choice.reasons),
        joint_level=joint_level(described),
        joint=joint_words(described),
        bounds_hold_at=points_flown(epistemic),
    )
    long = "; more than a day of this machine: `campaign run` needs --yes or --hours"
    lines = [
        f"{cost.words}{long if cost.is_long else ''}",
        f"engine {choice.words}",
        *document.joint,
        *corners_only_words(epistemic),
    ]
    if size.trial_conditions < size.conditions:
        lines.append(
            f"{size.trial_conditions} of {size.conditions} conditions were tried out:"
            " each turbulence with its weakest and strongest wind and winds between them"
        )
    return Outcome(document, document, [f"{_name(request)}: {line}" for line in lines])


def run(
    request: RunRequest, callback: ProgressCallback = lambda _: None, agreed: bool = False
) -> Outcome[CampaignResult | None]:
    """Fly a campaign or resume it: in this process, in worker processes or on a Dask cluster.

    ``agreed`` is consent to more than a day, which is not repeated by the command that resumes. A
    shard has no value: its flights become results when the shards are merged.
    """
    spec = _resized(request)
    notes = (*noise_notes(spec), *bounds_notes(spec))
    for note in notes:
        _logger.info(note)
    shard = None if request.shard is None else parse_shard(request.shard)
    # Whoever gives a number of hours knows the size.
    agreed = agreed or request.yes or request.hours is not None
    command = flying_command(request, request.out)
    if command:
        command += [] if request.shard is None else ["--shard", request.shard]
        command += ["--yes"] if request.yes else []
    try:
        with ExitStack() as stack:
            executor = _executor(request, stack)
            # Refuse first what is too long at any pace, before anything is created or tried out.
            size = size_of(spec, 1 if shard is None else shard.count)
            fastest = (
                "jsbsim"
                if spec.campaign.engine == "jsbsim" or unavailable_reason("batch") is not None
                else "batch"
            )
            refuse_if_long(
                Cost(size, _done_before(request.out), None, executor.workers, fastest),
                agreed,
                _name(request),
            )
            summary = running.run_campaign(
                spec,
                request.out,
                executor=executor,
                on_progress=callback,
                command=shlex.join(command),
                shard=shard,
                before_flying=_cost_checker(agreed, _name(request)),
            )
    except KeyboardInterrupt:
        _logger.info(
            "%s: stopped; every finished flight is kept, the same command resumes", request.out
        )
        raise
    _note_rewritten(summary.folder, summary.rewritten)
    epistemic = spec.as_dict()["epistemic"]
    progress = summary.progress
    document = CampaignRun(
        folder=str(summary.folder),
        cases=summary.cases,
        done_before=summary.done_before,
        failed=summary.failed,
        statuses=summary.statuses,
        flight_hours=progress.flown_s / 3600.0,
        elapsed_s=progress.elapsed_s,
        flight_hours_per_core_hour=progress.hours_per_core_hour,
        engine=summary.engine,
        bounds_hold_at=points_flown(epistemic),
    )
    sentence = f"{summary.folder}: {summary.cases} flights done"
    if summary.done_before:
        sentence += f", {summary.done_before} of them before this run"
    sentence += f", {_failures(summary.statuses)}"
    if summary.cases > summary.done_before:
        sentence += (
            f"; {document.flight_hours:.2f} flight h in {clock(progress.elapsed_s)} on"
            f" {progress.workers} workers, {progress.hours_per_core_hour:.0f} flight h per core h,"
            f" engine {summary.engine}"
        )
    remarks = [f"{summary.folder}: {text}" for text in corners_only_words(epistemic)]
    value = None if shard else CampaignResult(request.out, read_complete(request.out), notes)
    return Outcome(value, document, [sentence, *remarks])


def _done_before(folder: Path) -> int:
    """Return the number of stored flights; 0 for a folder that cannot be read, which is reported
    later.
    """
    try:
        return read_status(folder).done
    except BadInputError:
        return 0


def _executor(request: RunRequest, stack: ExitStack) -> Executor:
    """Return the executor of the cases, closed with the stack. Raises BadInputError."""
    if request.dask is not None:
        # Imported here: Dask is an extra.
        from uqharness.campaign import DaskExecutor

        return stack.enter_context(DaskExecutor(request.dask))
    if request.serial:
        return SerialExecutor()
    return ProcessExecutor(request.workers or usable_cores(), request.start_method)


# Commands on an existing folder.


def status(request: StatusRequest, callback: Callback = silent) -> Outcome[CampaignStatus]:
    """Read the progress of a campaign, also while it runs."""
    document = read_status(request.folder)
    done = f"{document.done} of {document.cases} flights done, {_failures(document.statuses)}"
    lines = [
        f"{request.folder}: {document.state}, {done}",
        f"engine {engine_words(document.engine, tuple(document.engine_why))}",
        *document.joint,
        *answer_lines(document.answers),
    ]
    if document.state == "interrupted":
        command = document.command or "the command that began it"
        lines.insert(1, f"resume with: {command}")
    return Outcome(document, document, lines, int(document.state != "complete"))


def report(request: ReportRequest, callback: Callback = silent) -> Outcome[CampaignPage]:
    """Write the page and the figures; a short campaign's two main flights are flown again."""
    callback("simulating two flights again")
    cases = _fly_displayed(request.folder) if request.tracks else []
    callback("report")
    pages = write_campaign_report(request.folder)
    document = CampaignPage(
        report=str(pages.path),
        figures=[str(path) for path in pages.figures],
        verdict=pages.verdict,
        flown_again=cases,
    )
    lines = [*pages.verdict, f"{len(pages.figures)} figures in {request.folder / 'figures'}"]
    lines += [f"Flown again for the ground track: {', '.join(cases)}."] if cases else []
    code = 1 if pages.damaged else 0
    return Outcome(document, document, lines, code, pages.path, pages.warnings)


def _fly_displayed(folder: Path) -> list[str]:
    """Fly the worst and the median flight again for the page's ground track; return their case ids.

    None are flown where records exist, or where that takes too long; a note says where it is
    impossible.
    """
    manifest = read_manifest(folder)
    # Only complete campaigns have a worst flight; existing records are kept.
    if manifest.get("state") != "complete" or any((folder / RERUN).glob("*/record.parquet")):
        return []
    cases = track_cases(read_cases(folder, manifest))
    seconds = len(cases) * sum(
        float(manifest["campaign"]["aleatory"][key]) for key in ("duration_s", "burn_in_s")
    )
    if seconds > MAX_REFLOWN_S:
        return []
    case_ids: list[str] = []
    try:
        for case in cases:
            draw_rerun(rerun_case(folder, case))
            case_ids.append(case)
    except BadInputError as error:
        _logger.info("the page has no new ground track: %s", error)
    return case_ids


def merge(request: MergeRequest, callback: Callback = silent) -> Outcome[Merged]:
    """Merge shards and write the tables."""
    merged = merge_shards(request.folder)
    _note_rewritten(request.folder, merged.rewritten)
    done = f"{merged.done} of {merged.cases} flights from {len(merged.shards)} shards"
    lines = [f"{request.folder}: {done}, {_failures(merged.statuses)}"]
    if merged.missing:
        lines.append(
            f"{merged.missing} flights are in none of {', '.join(merged.shards)}; fly the shards"
            " that lack, then merge again"
        )
    return Outcome(merged, merged, lines, 1 if merged.missing else 0)


def rerun(request: RerunRequest, callback: Callback = silent) -> Outcome[Rerun]:
    """Fly one case again and compare it with the stored result."""
    callback("simulating the case")
    repeated = rerun_case(request.folder, request.case)
    files = [*repeated.files, *draw_rerun(repeated)]
    outcome, same = repeated.outcome, repeated.same
    document = Rerun(
        case_id=repeated.case.case_id,
        status=outcome.status,
        reason=outcome.reason,
        same_as_stored=same,
        differences=list(repeated.differences),
        files=[str(path) for path in files],
    )
    comparison = {True: "as stored", False: "NOT as stored", None: "not flown before"}[same]
    end = f" ({outcome.reason})" if outcome.reason else ""
    line = f"{repeated.folder}: {outcome.status}{end}, {comparison}"
    lines = [f"{line}; {', '.join(path.name for path in files)}", *repeated.differences]
    return Outcome(document, document, lines, 1 if same is False else 0)


def surrogate_check(
    request: SurrogateCheckRequest, callback: Callback = silent
) -> Outcome[SurrogateCheck]:
    """Fly cases with a real autopilot, and compare and correct the metrics."""
    callback("flying with the real autopilot")
    settings = AutopilotSettings(
        request.autopilot_process, request.autopilot_warmup_s, port=request.autopilot_port
    )
    pairs = fly_pairs(request.folder, request.flights, settings, request.metric)
    by_metric = corrections(pairs)
    document = SurrogateCheck(
        condition=pairs.condition.label,
        flights=[
            SurrogateFlight(
                case_id=case.case_id,
                epistemic_id=case.epistemic_id,
                aleatory_id=case.aleatory_id,
                status=outcome.status,
                reason=outcome.reason,
                metrics=dict(outcome.metrics),
            )
            for case, outcome in zip(pairs.cases, pairs.outcomes, strict=True)
        ],
        failed=sum(outcome.status != "ok" for outcome in pairs.outcomes),
        metrics={
            name: SurrogateMetric(
                pairs=c.pairs,
                difference=c.difference[0],
                difference_limits=list(c.difference[1:]),
                scatter=c.scatter,
                correlation=c.correlation,
                slope=c.slope,
                mean_surrogate=c.mean_surrogate,
                mean=c.mean[0],
                mean_limits=list(c.mean[1:]),
                differs=c.differs,
                quantiles=[
                    SurrogateQuantile(probability=p, surrogate=list(a), corrected=list(b))
                    for p, (a, b) in c.quantiles.items()
                ],
            )
            for name, c in by_metric.items()
        },
    )
    # The answer is no if a flight failed or a metric differs beyond its interval.
    code = int(document.failed > 0 or not by_metric or any(c.differs for c in by_metric.values()))
    return Outcome(document, document, list(_surrogate_lines(document)), code)


def _surrogate_lines(document: SurrogateCheck) -> Iterator[str]:
    """Yield the lines of a surrogate check."""
    yield (
        f"{document.condition}: {len(document.flights)} flights with the real autopilot, in the air"
        f" of the stored ones, {document.failed} failed"
    )
    failed = [row for row in document.flights if row.status != "ok"]
    yield from (f"{row.case_id}: {row.status}: {row.reason}" for row in failed[:3])
    if not document.metrics:
        yield "no metric has four pairs of flights; ask for more flights, or name one by --metric"
    for name, row in document.metrics.items():
        low, high = row.difference_limits
        verdict = "differs" if row.differs else "no difference beyond chance"
        yield (
            f"{name}: real less built-in {row.difference:+.3g} [{low:+.3g}, {high:+.3g}]"
            f" ({row.pairs} pairs, correlation {row.correlation:.2f}): {verdict}"
        )
        for quantile in row.quantiles:
            if quantile.probability in (0.5, 0.95):
                before, after = quantile.surrogate, quantile.corrected
                yield (
                    f"  {100 * quantile.probability:g} %: p-box {before[0]:.3g} to {before[1]:.3g},"
                    f" corrected {after[0]:.3g} to {after[1]:.3g}"
                )


def verify(request: VerifyRequest, callback: Callback = silent) -> Outcome[FolderCheck]:
    """Check a folder against its digests."""
    check_result = verify_folder(request.folder)
    lines = list(_verified_lines(check_result))
    return Outcome(check_result, check_result, lines, 0 if check_result.whole else 1)


def _verified_lines(verification: FolderCheck) -> Iterator[str]:
    """Yield the lines of a folder and its shards, damaged files first."""
    state = "whole" if verification.whole else "NOT whole"
    # None: a folder whose manifest does not say.
    incomplete = "; the campaign is not complete; existing files were checked"
    yield f"{verification.folder}: {state}" + (incomplete if verification.complete is False else "")
    for item in sorted(verification.files, key=lambda item: item.state == "whole"):
        details = "; ".join(
            text for text in (item.remark, item.digest and f"SHA-256 {item.digest}") if text
        )
        yield f"  {item.name}: {item.state}" + (f" ({details})" if details else "")
    for part in sorted(verification.shards, key=lambda part: part.whole):
        yield from _verified_lines(part)


def salvage(
    request: SalvageRequest, callback: ProgressCallback = lambda _: None
) -> Outcome[Salvaged]:
    """Repair a damaged campaign."""
    spec = None if request.campaign is None else _resized(request)
    command = "" if spec is None else shlex.join(flying_command(request, request.folder))
    flying = RunOptions(
        ProcessExecutor(request.workers or usable_cores()),
        _cost_checker(request.yes, request.folder),
        callback,
    )
    result = salvage_folder(request.folder, flying, spec, command)
    return Outcome(result, result, list(_salvaged_lines(result)), 1 if result.missing else 0)


def _salvaged_lines(result: Salvaged) -> Iterator[str]:
    """Yield the lines of a folder and its shards."""
    text = f"{result.folder}: {result.kept} flights kept, {result.flown} flown again"
    text += f", {result.missing} are in no shard" if result.missing else ""
    text += f"; written again: {', '.join(result.rewritten)}" if result.rewritten else ""
    text += f"; damaged, under another name: {', '.join(result.aside)}" if result.aside else ""
    yield text
    # Derived tables are not repaired, but can be computed again.
    for name, command in _TABLE_COMMANDS.items():
        if any(item.startswith(f"{name}.damaged-") for item in result.aside):
            yield (
                f"  {name}.csv is written again by: uqharness {command}"
                f" {shlex.quote(result.folder)}"
            )
    for part in result.shards:
        yield from _salvaged_lines(part)


def convergence(request: ConvergenceRequest, callback: Callback = silent) -> Outcome[Convergence]:
    """Study whether a campaign has enough flights and epistemic samples."""
    results = write_convergence(request.folder, request.metric, request.repeats)
    callback("figures")
    sections = [
        convergence_section(item) for item in results if item.repeats is not None or item.growth
    ]
    figures = write_figures(request.folder, sections, "Convergence")
    table = str(request.folder / CONVERGENCE)
    document = Convergence(
        table=table,
        figures=[str(path) for path in figures],
        rows=[ConvergenceRow(**row) for row in as_rows(results)],
    )
    end = f"{table}: written, with {len(figures)} figures"
    return Outcome(document, document, [*sentences(results), end])


def area(request: AreaRequest, callback: Callback = silent) -> Outcome[Areas]:
    """Compare real flights with the p-boxes by the area metric."""
    flights = read_flights(request.flight, request.value)
    rows = [
        AreaRow(
            metric=item.metric,
            condition=item.condition.label,
            verdict=item.verdict,
            **asdict(item.area_metric),
        )
        for item in write_area(request.folder, flights)
    ]
    document = Areas(table=str(request.folder / AREAS), rows=rows)
    # Contradictions first: a terminal shows the first lines.
    rows = sorted(rows, key=lambda row: row.verdict != "outside")
    lines = [
        f"{row.metric}, {row.condition}: {row.flights} flights, area {row.area:.3g} outside the"
        f" p-box, {row.beyond_chance:.3g} beyond chance: {row.verdict}"
        for row in rows
    ]
    return Outcome(document, document, lines, int(any(row.verdict == "outside" for row in rows)))
