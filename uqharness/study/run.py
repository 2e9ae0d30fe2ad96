"""Run a study: one request per stage, and a verdict at the end.

A stage is skipped if its inputs (by content), request and outputs are those of the last run, so
the same call resumes an interrupted study. study.json in the study's folder holds the state of each
stage, the verdict, the answer and the ground tracks; it is rewritten after each stage.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit

import uqharness
from sysid.errors import LogError
from sysid.foreign.regular_files import (
    ParseError,
    file_sha256,
    parse_json,
    read_regular,
    sha256_hex,
)
from uqharness import checksums
from uqharness.campaign import LOCK, binding_versions, read_bounds, run_lock
from uqharness.errors import BadInputError
from uqharness.files import PART, check_output_folder, write_bytes, write_json, write_text
from uqharness.heartbeat import Callback, silent
from uqharness.requests.base import Request, options_of
from uqharness.results.base import Outcome, read_result
from uqharness.results.refinement import Refinement
from uqharness.results.study import FORMAT, Pair, Sentence, Study, Tracks
from uqharness.results.study import Stage as StageResult
from uqharness.simulator import folder_hash
from uqharness.study.answer import (
    REFINEMENT,
    TRACKS,
    TrackRequest,
    answer_of,
    fly_tracks,
    hardest,
    judge,
    read_campaigns,
)
from uqharness.study.spec import ChainSpec
from uqharness.study.stages import AFTER, BEFORE, Stage, plan

# study.json: the study file that a folder belongs to, and for each stage its state, the hash of
# what it was made from, and the hashes of its outputs.

STUDY = "study.json"


def read_study(folder: Path) -> Study | None:
    """Read study.json of a folder.

    Returns
    -------
    Study or None
        None if the folder has none.

    Raises
    ------
    BadInputError
        If it cannot be read, or another version wrote it.
    """
    path = folder / STUDY
    try:
        document = parse_json(read_regular(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise BadInputError(
            f"{path}: cannot be read: {error.strerror or error}; choose another --out"
        ) from None
    except ParseError as error:
        raise BadInputError(f"{path}: {error}; choose another --out") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadInputError(
            f"{path}: written by another version of uqharness, or not by uqharness; choose another"
            " --out"
        )
    return read_result(path, Study)


class _Record:
    """study.json of a study that runs."""

    def __init__(self, folder: Path, study: Study) -> None:
        self.folder, self.study = folder, study

    def update(self, **parts: Any) -> None:
        """Replace parts of the document."""
        self.study = self.study.model_copy(update=parts)

    def update_stage(self, number: int, **parts: Any) -> None:
        """Replace parts of a stage's entry."""
        stages = list(self.study.stages)
        stages[number] = stages[number].model_copy(update=parts)
        self.update(stages=stages)

    def save(self) -> None:
        """Write study.json atomically."""
        write_json(self.folder / STUDY, self.study.as_json())


def begin(spec: ChainSpec, command: str, version: str) -> Study:
    """Return the document of a study of which no stage has run."""
    return Study(
        format=FORMAT,
        study=spec.study.name,
        question=spec.study.question,
        file=spec.path.name,
        path=str(spec.path.resolve()),
        hash=sha256_hex(spec.source.encode()),
        version=version,
        command=command,
        state="running",
        stages=[],
        verdict=[],
        former=[],
    )


def refuse_foreign(folder: Path, old: Study | None, new: Study) -> None:
    """Raise BadInputError if a folder holds something other than this study.

    The same file in the same place may have been edited, and the same content may have moved: the
    hashes of the stages decide which results are still valid.

    Parameters
    ----------
    folder : Path
        The study's folder.
    old : Study or None
        Its study.json; None if it has none, then the folder must be empty.
    new : Study
        study.json of the study that is about to run.
    """
    # No study.json: the folder must be empty, except for locks and partial files.
    if old is None:
        foreign_files = (
            sorted(p.name for p in folder.iterdir() if p.name != LOCK and p.suffix != PART)
            if folder.is_dir()
            else []
        )
        if foreign_files:
            raise BadInputError(
                f"--out {folder}: not empty and no study's folder (it has {foreign_files[0]});"
                " choose another --out"
            )
        return
    elsewhere = old.path != new.path and old.hash != new.hash
    if old.study != new.study or elsewhere:
        raise BadInputError(
            f'--out {folder}: this folder holds the study "{old.study}" of {old.path}, not'
            f' "{new.study}" of {new.path}; choose another --out, or remove the folder'
        )


def content(path: Path) -> str:
    """Return the SHA-256 of a file or of an aircraft's folder; empty if there is neither."""
    if path.is_dir():
        return folder_hash(path)
    try:
        return file_sha256(path)
    except OSError:
        return ""


def stage_key(stage: Stage, inputs: Mapping[str, str]) -> str:
    """Hash everything that a stage's result depends on.

    These are the command, its options, the content of the inputs, and the versions of the programs
    that compute the result. Paths count by the content of what they name.

    Parameters
    ----------
    stage : Stage
        The stage.
    inputs : mapping
        Label -> SHA-256 of each input.
    """
    digests = {os.path.abspath(path): inputs[label] for label, path in stage.inputs.items()}
    return _key(
        stage.kind,
        _options_of(stage.request, digests),
        stage.settings,
        sorted(inputs.items()),
        (uqharness.__version__, binding_versions()),
    )


def _options_of(request: Request, digests: Mapping[str, str]) -> dict[str, Any]:
    """Return a request's values that bear on its result, paths as the digests of their files.

    The aircraft, which may be named by a text, is among the inputs.
    """

    def plain(value: Any) -> Any:
        if isinstance(value, Path):
            return digests.get(os.path.abspath(value))
        if isinstance(value, Mapping):
            return {key: plain(item) for key, item in value.items()}
        return [plain(item) for item in value] if isinstance(value, tuple | list) else value

    return {
        name: plain(getattr(request, name))
        for name, (_, option) in options_of(type(request)).items()
        if option.cli and option.provenance and name not in ("aircraft", "workers")
    }


def _key(*parts: Any) -> str:
    """Return the digest of plain JSON types."""
    return sha256_hex(json.dumps(parts, sort_keys=True).encode())


LOGS = "log"
"""Folder of the output of each stage."""
_SUPERSEDED = "superseded"
Runner = Callable[[Request, Callback], Outcome[Any]]
"""Runs the request of a stage; the callback takes the name of what is being done."""


def run_chain(
    run: Runner,
    spec: ChainSpec,
    out: Path,
    workers: int | None = None,
    command: str = "",
    callback: Callback = silent,
) -> Study:
    """Run a study: all stages that are not up to date.

    A stage that ends with 1 (its answer is no) is done, and the study goes on. Results of finished
    stages are kept whatever happens.

    Parameters
    ----------
    run : callable
        Runs the request of a stage and returns its outcome.
    spec : ChainSpec
        The study.
    out : Path
        Folder of the results; created if necessary.
    workers : int, optional
        Processes of each stage; None for the stage's default.
    command : str
        Command line that is stored in study.json.
    callback : callable
        Called with one line of text as stages start and end.

    Returns
    -------
    Study
        The content of study.json.

    Raises
    ------
    BadInputError
        If the folder holds something else, if another process runs a study in it, or if a stage
        cannot use its input.
    KeyboardInterrupt
        Passed on; the same call resumes.
    """
    check_output_folder(out)
    stages = plan(spec, out)
    new = begin(spec, command, uqharness.__version__)
    refuse_foreign(out, read_study(out), new)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"--out {out}: cannot be made: {error.strerror or error}; choose another"
        ) from None
    # One process at a time.
    with run_lock(out):
        old_sums = checksums.remove_sums(out)
        last_run = read_study(out)
        old = (
            {}
            if last_run is None
            else {row.name: row for row in (*last_run.former, *last_run.stages)}
        )
        record = _Record(out, new)
        record.update(stages=[_row(stage, old.pop(stage.name, None)) for stage in stages])
        # Stages that were removed from the file keep their entry: their folders belong to this
        # study.
        record.update(former=list(old.values()))
        record.save()
        for number, stage in enumerate(stages):
            try:
                _run_stage(run, stage, number, record, workers, callback)
            except KeyboardInterrupt:
                # Interrupted: the state "running" stays, and the next call resumes.
                raise
            except BaseException as error:
                # Any other error ends the study; the finished stages stay.
                record.update_stage(number, state="failed", exit=2, error=str(error))
                record.update(state="failed")
                with contextlib.suppress(BadInputError):
                    record.save()
                if isinstance(error, BadInputError):
                    lines = f"stage {stage.name}: {error}".split("\n")
                    raise BadInputError(*lines, f"  the stage alone: {stage.command}") from None
                raise
        names = {stage.name for stage in stages}
        if {f"campaign-{BEFORE}", f"campaign-{AFTER}"} <= names:
            pair = Pair(before=f"campaign-{BEFORE}", after=f"campaign-{AFTER}")
            record.update(before_after=pair)
        callback("answering the question")
        _conclude(spec, stages, record, last_run, workers)
        record.update(state="done")
        record.save()
        checksums.write_sums(out, old_sums)
    return record.study


def _conclude(
    spec: ChainSpec,
    stages: Sequence[Stage],
    record: _Record,
    last_run: Study | None,
    workers: int | None,
) -> None:
    """Write verdict, answer and ground tracks into study.json, from the results of all stages.

    ``last_run`` is study.json of the last run, whose tracks are kept if the campaigns are
    unchanged.
    """
    out, rows = record.folder, record.study.stages
    kinds = {stage.kind for stage in stages}
    campaigns = read_campaigns(out, "refine" in kinds) if "campaign" in kinds else {}
    sentences = judge(spec, stages, rows, out, campaigns)
    refinement = read_result(out / REFINEMENT, Refinement) if "refine" in kinds else None
    refused = [row.name for row in rows if row.exit == 1]
    record.update(
        verdict=[Sentence(text=text, level=level) for text, level in sentences],
        answer=answer_of(campaigns, refinement, sentences, refused),
    )
    track_requests = {
        when: TrackRequest(item.folder, item.frame, hardest(item.statements))
        for when, item in campaigns.items()
    }
    # The tracks depend on the campaigns only, so the hashes of their tables decide whether the
    # tracks are up to date.
    tables = {when: content(item.folder / "cases.parquet") for when, item in campaigns.items()}
    key = _key("tracks", {}, sorted(tables.items()), uqharness.__version__)
    old = None if last_run is None else last_run.tracks
    if old is not None and old.key == key and content(out / TRACKS) == old.sha256:
        record.update(tracks=old)
    elif track_requests:
        tracks = fly_tracks(out, track_requests, workers)
        record.update(tracks=Tracks(**tracks, key=key, sha256=content(out / TRACKS)))


def _row(stage: Stage, old: StageResult | None) -> StageResult:
    """Return a stage's entry in study.json: the state of an earlier run, with this run's
    command.
    """
    new = StageResult(
        state="waiting",
        exit=None,
        seconds=None,
        inputs={},
        error="",
        key="",
        outputs={},
        name=stage.name,
        kind=stage.kind,
        folder=stage.folder,
        command=stage.command,
    )
    if old is None:
        return new
    return old.model_copy(
        update={"kind": stage.kind, "folder": stage.folder, "command": stage.command}
    )


def _run_stage(
    run: Runner,
    stage: Stage,
    number: int,
    record: _Record,
    workers: int | None,
    callback: Callback,
) -> None:
    """Run one stage unless it is up to date; its entry in study.json is updated and saved.

    Raises BadInputError if an input is missing, or if the command did not write its outputs.
    """
    out, row = record.folder, record.study.stages[number]
    title = f"[{number + 1}/{len(record.study.stages)}] {stage.name}"
    callback(title)

    def show(text: str) -> object:
        """Name the stage with what it does."""
        return callback(f"{title}: {text}")

    inputs = {label: content(path) for label, path in stage.inputs.items()}
    # Inputs are files of earlier stages or of the user.
    missing = [label for label, digest in inputs.items() if not digest]
    if missing:
        raise BadInputError(f"{', '.join(missing)}: needed, but no earlier stage has written it")
    key = stage_key(stage, inputs)
    same_key = row.key == key
    # Up to date: same inputs, options and outputs.
    if same_key and row.state == "done" and row.outputs == _outputs(stage, out):
        show("unchanged")
        return
    # Without the old outputs a failed command cannot be mistaken for a finished one.
    _clear_outputs(stage, row, out, same_key)
    record.update_stage(
        number,
        state="running",
        exit=None,
        seconds=None,
        inputs=inputs,
        error="",
        key=key,
        outputs={},
    )
    # Saved as running, so that a killed run is not mistaken for a finished one.
    record.save()
    if stage.belongs is not None:
        _refuse_other_model(*stage.belongs)
    if stage.writes is not None:
        path, data = stage.writes
        write_bytes(path, (_HEADER + tomlkit.dumps(data)).encode())
    start_s = time.monotonic()
    code = _run_request(run, stage, out, workers, show)
    seconds, outputs = round(time.monotonic() - start_s, 1), _outputs(stage, out)
    record.update_stage(number, exit=code, seconds=seconds, outputs=outputs, state="done")
    missing_outputs = [name for name, digest in outputs.items() if not digest]
    # A command that wrote nothing has not succeeded, whatever its exit code.
    if missing_outputs:
        raise BadInputError(
            f"ended with {code} without {', '.join(missing_outputs)}, which later stages need; its"
            f" output is in {out / LOGS / stage.name}.txt"
        )
    record.save()
    show(f"{seconds:.0f} s" + ("" if code == 0 else f", exit {code}: the answer is no"))


_HEADER = "# Written by `uqharness study`; edit the study's file instead.\n\n"


def _outputs(stage: Stage, out: Path) -> dict[str, str]:
    """Return path -> hash of a stage's outputs; the hash of a missing output is empty."""
    return {path.relative_to(out).as_posix(): content(path) for path in stage.outputs}


def _clear_outputs(stage: Stage, row: StageResult, out: Path, same_key: bool) -> None:
    """Remove the results of an earlier run, unless the stage can resume from them.

    Flights of a campaign are moved to ``superseded`` instead: they may have taken hours.
    """
    if same_key and stage.resumes:
        return
    for path in stage.owns:
        # A folder that no stage has made is not removed.
        if path.is_dir() and not row.key:
            raise BadInputError(
                f"{path}: is there, and not from this study; move it away, for the stage writes"
                " there"
            )
        if stage.kind == "campaign" and path.is_dir():
            backup = out / _SUPERSEDED / f"{stage.name}-{row.key[:12]}"
            number = 1
            while backup.exists():
                number += 1
                backup = backup.with_name(f"{stage.name}-{row.key[:12]}-{number}")
            backup.parent.mkdir(exist_ok=True)
            os.replace(path, backup)
        elif path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _refuse_other_model(form: Path, folder: Path) -> None:
    """Raise BadInputError if bounds were made for another aircraft than the one that will fly."""
    bounds_hash, aircraft_hash = read_bounds(form).aircraft.sha256, content(folder)
    if bounds_hash != aircraft_hash:
        raise BadInputError(
            f"{form}: these bounds are of another model ({bounds_hash[:12]}) than {folder}"
            f" ({aircraft_hash[:12]}); remove {form.parent} and run again"
        )


def _run_request(
    run: Runner, stage: Stage, out: Path, workers: int | None, callback: Callback
) -> int:
    """Run the stage's request and write what it tells to ``log/STAGE.txt``; return its exit
    code.
    """
    request = stage.request
    if workers is not None and "workers" in type(request).model_fields:
        request = request.model_copy(update={"workers": workers})
    lines = [f"$ {stage.command}"]
    try:
        with _collect_notes(lines):
            outcome = run(request, callback)
        lines += [f"warning: {text}" for text in outcome.warnings]
        lines += outcome.lines
        lines += [] if outcome.report is None else [f"Report: {outcome.report}"]
    except (BadInputError, LogError) as error:
        lines.append(f"error: {error}")
        raise BadInputError(*str(error).split("\n")) from None
    finally:
        with contextlib.suppress(BadInputError):
            write_text(out / LOGS / f"{stage.name}.txt", "\n".join(lines) + "\n")
    return outcome.code


class _Collector(logging.Handler):
    """Appends the program's notes to lines."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__()
        self.lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        """Append one note."""
        self.lines.append(f"note: {record.getMessage()}")


@contextlib.contextmanager
def _collect_notes(lines: list[str]) -> Iterator[None]:
    """Append the program's notes to ``lines`` instead of printing them."""
    logger = logging.getLogger("uqharness")
    handlers = logger.handlers
    logger.handlers = [_Collector(lines)]
    try:
        yield
    finally:
        logger.handlers = handlers
