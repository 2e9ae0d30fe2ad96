"""Run a study: one ``uqharness`` command per stage, and a verdict at the end.

A stage is skipped if its inputs (by content), settings and outputs are those of the last run, so
the same call resumes an interrupted study. study.json in the study's folder holds the state of each
stage, the verdict, the answer and the ground tracks; it is rewritten after each stage.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import tomlkit

import uqharness
from sysid.digests import file_sha256, sha256_hex
from sysid.foreign.regular_files import ParseError, parse_json, read_regular
from uqharness import checksums
from uqharness.campaign import read_bounds
from uqharness.campaign.folder import LOCK, binding_versions, run_lock
from uqharness.errors import BadInputError
from uqharness.files import PART, check_output_folder, write_bytes
from uqharness.results.base import read_result
from uqharness.results.refinement import Refinement
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
_FORMAT = "study 1"


def read_study(folder: Path) -> dict[str, Any] | None:
    """Read study.json of a folder.

    Returns
    -------
    dict or None
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
    if not isinstance(document, dict) or document.get("format") != _FORMAT:
        raise BadInputError(
            f"{path}: written by another version of uqharness, or not by uqharness; choose another"
            " --out"
        )
    return document


def write_study(folder: Path, document: Mapping[str, Any]) -> None:
    """Write study.json atomically."""
    write_bytes(folder / STUDY, (json.dumps(document, indent=1) + "\n").encode())


def begin(spec: ChainSpec, command: str, version: str) -> dict[str, Any]:
    """Return the document of a study of which no stage has run."""
    return {
        "format": _FORMAT,
        "study": spec.study.name,
        "question": spec.study.question,
        "file": spec.path.name,
        "path": str(spec.path.resolve()),
        "hash": sha256_hex(spec.source.encode()),
        "version": version,
        "command": command,
        "state": "running",
        "stages": [],
        "verdict": [],
    }


def refuse_foreign(folder: Path, old: Mapping[str, Any] | None, new: Mapping[str, Any]) -> None:
    """Raise BadInputError if a folder holds something other than this study.

    The same file in the same place may have been edited, and the same content may have moved: the
    hashes of the stages decide which results are still valid.

    Parameters
    ----------
    folder : Path
        The study's folder.
    old : mapping or None
        Its study.json; None if it has none, then the folder must be empty.
    new : mapping
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
    elsewhere = old["path"] != new["path"] and old["hash"] != new["hash"]
    if old["study"] != new["study"] or elsewhere:
        raise BadInputError(
            f'--out {folder}: this folder holds the study "{old["study"]}" of {old["path"]}, not'
            f' "{new["study"]}" of '
            f"{new['path']}; choose another --out, or remove the folder if its results are not"
            " wanted"
        )


def content(path: Path) -> str:
    """Return the SHA-256 of a file or of an aircraft's folder; empty if there is neither."""
    if path.is_dir():
        return folder_hash(path)
    try:
        return file_sha256(path)
    except OSError:
        return ""


def stage_key(
    kind: str, options: Mapping[str, Any], inputs: Mapping[str, str], versions: Any
) -> str:
    """Hash everything that a stage's result depends on.

    Parameters
    ----------
    kind : str
        Command of the stage.
    options : mapping
        Settings, as plain JSON types.
    inputs : mapping
        Label -> SHA-256 of each input.
    versions : Any
        Versions of the programs that compute the result, as plain JSON types.
    """
    text = json.dumps([kind, options, sorted(inputs.items()), versions], sort_keys=True)
    return sha256_hex(text.encode())


LOGS = "log"
"""Folder of the output of each stage."""
_SUPERSEDED = "superseded"
Callback = Callable[[str], None]
Command = Callable[[list[str]], int]
"""Runs the words of one ``uqharness`` command in this process; returns its exit code."""


def run_chain(
    run: Command,
    spec: ChainSpec,
    out: Path,
    workers: int | None = None,
    command: str = "",
    callback: Callback = lambda _: None,
) -> dict[str, Any]:
    """Run a study: all stages that are not up to date.

    A stage that ends with 1 (its answer is no) is done, and the study goes on. Results of finished
    stages are kept whatever happens.

    Parameters
    ----------
    run : callable
        Runs the words of one ``uqharness`` command in this process and returns its exit code.
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
    dict
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
        last_run = read_study(out) or {}
        old = {
            row["name"]: row for row in (*last_run.get("former", []), *last_run.get("stages", []))
        }
        document = {**new, "stages": [_row(stage, old.pop(stage.name, None)) for stage in stages]}
        # Stages that were removed from the file keep their entry: their folders belong to this
        # study.
        document["former"] = list(old.values())
        write_study(out, document)
        for number, (stage, row) in enumerate(
            zip(stages, document["stages"], strict=True), start=1
        ):
            callback(f"[{number}/{len(stages)}] {stage.name}")
            try:
                _run_stage(
                    run,
                    stage,
                    row,
                    out,
                    workers,
                    save=lambda: write_study(out, document),
                    callback=callback,
                )
            except KeyboardInterrupt:
                # Interrupted: the state "running" stays, and the next call resumes.
                raise
            except BaseException as error:
                # Any other error ends the study; the finished stages stay.
                row |= {"state": "failed", "exit": 2, "error": str(error)}
                document["state"] = "failed"
                with contextlib.suppress(BadInputError):
                    write_study(out, document)
                if isinstance(error, BadInputError):
                    lines = f"stage {stage.name}: {error}".split("\n")
                    raise BadInputError(*lines, f"  the stage alone: {stage.command}") from None
                raise
        pair = {
            when: f"campaign-{when}"
            for when in (BEFORE, AFTER)
            if f"campaign-{when}" in {s.name for s in stages}
        }
        if len(pair) == 2:
            document["before_after"] = pair
        _conclude(spec, stages, document, out, last_run, workers)
        document["state"] = "done"
        write_study(out, document)
        checksums.write_sums(out, old_sums)
    return document


def _conclude(
    spec: ChainSpec,
    stages: Sequence[Stage],
    document: dict[str, Any],
    out: Path,
    last_run: Mapping[str, Any],
    workers: int | None,
) -> None:
    """Write verdict, answer and ground tracks into ``document``, from the results of all stages.

    ``last_run`` is study.json of the last run, whose tracks are kept if the campaigns are
    unchanged.
    """
    kinds, rows = {stage.kind for stage in stages}, document["stages"]
    campaigns = read_campaigns(out, "refine" in kinds) if "campaign" in kinds else {}
    sentences = judge(spec, stages, rows, out, campaigns)
    refinement = read_result(out / REFINEMENT, Refinement) if "refine" in kinds else None
    refused = [row["name"] for row in rows if row["exit"] == 1]
    answer = answer_of(campaigns, refinement, sentences, refused)
    document["verdict"] = [{"text": text, "level": level} for text, level in sentences]
    document["answer"] = answer.as_json()
    track_requests = {
        when: TrackRequest(item.folder, item.frame, hardest(item.statements))
        for when, item in campaigns.items()
    }
    # The tracks depend on the campaigns only, so the hashes of their tables decide whether the
    # tracks are up to date.
    key = stage_key(
        "tracks",
        {},
        {when: content(item.folder / "cases.parquet") for when, item in campaigns.items()},
        uqharness.__version__,
    )
    old = last_run.get("tracks") or {}
    if old.get("key") == key and content(out / TRACKS) == old.get("sha256"):
        document["tracks"] = old
    elif track_requests:
        document["tracks"] = fly_tracks(out, track_requests, workers) | {
            "key": key,
            "sha256": content(out / TRACKS),
        }


def _row(stage: Stage, old: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a stage's entry in study.json: the state of an earlier run, with this run's
    command.
    """
    row = {
        "state": "waiting",
        "exit": None,
        "seconds": None,
        "inputs": {},
        "error": "",
        "key": "",
        "outputs": {},
        **(old or {}),
    }
    return row | {
        "name": stage.name,
        "kind": stage.kind,
        "folder": stage.folder,
        "command": stage.command,
    }


def _run_stage(
    run: Command,
    stage: Stage,
    row: dict[str, Any],
    out: Path,
    workers: int | None,
    *,
    save: Callable[[], None],
    callback: Callback,
) -> None:
    """Run one stage unless it is up to date; ``row``, its entry in study.json, is updated and
    saved.

    Raises BadInputError if an input is missing, or if the command did not write its outputs.
    """
    inputs = {label: content(path) for label, path in stage.inputs.items()}
    # Inputs are files of earlier stages or of the user.
    missing = [label for label, digest in inputs.items() if not digest]
    if missing:
        raise BadInputError(f"{', '.join(missing)}: needed, and no stage before has left it")
    key = stage_key(stage.kind, stage.options, inputs, (uqharness.__version__, binding_versions()))
    same_key = row["key"] == key
    # Up to date: same inputs, settings and outputs.
    if same_key and row["state"] == "done" and row["outputs"] == _outputs(stage, out):
        callback("  unchanged")
        return
    # Without the old outputs a failed command cannot be mistaken for a finished one.
    _clear_outputs(stage, row, out, same_key)
    row |= {
        "state": "running",
        "exit": None,
        "seconds": None,
        "inputs": inputs,
        "error": "",
        "key": key,
        "outputs": {},
    }
    # Saved as running, so that a killed run is not mistaken for a finished one.
    save()
    if stage.belongs is not None:
        _refuse_other_model(*stage.belongs)
    if stage.writes is not None:
        path, data = stage.writes
        write_bytes(path, (_HEADER + tomlkit.dumps(data)).encode())
    start_s = time.monotonic()
    code = _run_command(run, stage, out, workers)
    row |= {
        "exit": code,
        "seconds": round(time.monotonic() - start_s, 1),
        "outputs": _outputs(stage, out),
        "state": "done",
    }
    missing_outputs = [name for name, digest in row["outputs"].items() if not digest]
    # A command that wrote nothing has not succeeded, whatever its exit code.
    if missing_outputs:
        raise BadInputError(
            f"ended with {code} and left no {', '.join(missing_outputs)}, which the study goes on"
            f" from; what it said is in {out / LOGS / stage.name}.txt"
        )
    save()
    callback(
        f"  {row['seconds']:.0f} s" + ("" if code == 0 else f", exit {code}: the answer is no")
    )


_HEADER = "# Written by `uqharness study`; edit the study's file instead.\n\n"


def _outputs(stage: Stage, out: Path) -> dict[str, str]:
    """Return path -> hash of a stage's outputs; the hash of a missing output is empty."""
    return {path.relative_to(out).as_posix(): content(path) for path in stage.outputs}


def _clear_outputs(stage: Stage, row: Mapping[str, Any], out: Path, same_key: bool) -> None:
    """Remove the results of an earlier run, unless the stage can resume from them.

    Flights of a campaign are moved to ``superseded`` instead: they may have taken hours.
    """
    if same_key and stage.resumes:
        return
    for path in stage.owns:
        # A folder that no stage has made is not removed.
        if path.is_dir() and not row["key"]:
            raise BadInputError(
                f"{path}: is there, and not from this study; move it away, for the stage writes"
                " there"
            )
        if stage.kind == "campaign" and path.is_dir():
            backup = out / _SUPERSEDED / f"{stage.name}-{row['key'][:12]}"
            number = 1
            while backup.exists():
                number += 1
                backup = backup.with_name(f"{stage.name}-{row['key'][:12]}-{number}")
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


def _run_command(run: Command, stage: Stage, out: Path, workers: int | None) -> int:
    """Run the stage's command and write its output to ``log/STAGE.txt``; return its exit code."""
    words = [
        *stage.argv,
        *(["--workers", str(workers)] if stage.workers and workers is not None else []),
    ]
    # The user has agreed to the campaigns by running the study.
    words += ["--yes"] if stage.kind == "campaign" else []
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), _redirect_stderr(output):
            return run(words)
    finally:
        text = f"$ {stage.command}\n{output.getvalue()}"
        with contextlib.suppress(BadInputError):
            write_bytes(out / LOGS / f"{stage.name}.txt", text.encode())


@contextlib.contextmanager
def _redirect_stderr(output: TextIO) -> Iterator[None]:
    """Send messages to ``output``, except on a terminal, where the stage's progress is
    displayed.
    """
    if sys.stderr.isatty():
        yield
        return
    with contextlib.redirect_stderr(output):
        yield
