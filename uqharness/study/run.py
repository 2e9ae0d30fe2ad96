"""Run a study: stage after stage, each skipped that is done and would come out the same; after a
stop the same call goes on.
"""

from __future__ import annotations

import contextlib
import dataclasses
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
from uqharness.files import PART, check_folder, write_bytes
from uqharness.result_documents import Part, read_document
from uqharness.simulator import folder_hash
from uqharness.study.answer import (
    REFINEMENT,
    TRACKS,
    Asked,
    answer_of,
    fly_tracks,
    hardest,
    judge,
    read_flown,
)
from uqharness.study.spec import ChainSpec
from uqharness.study.stages import AFTER, BEFORE, Stage, plan

# study.json: what a study's folder belongs to, how far it is, and what each stage was made
# from.

STUDY = "study.json"
_FORMAT = "study 1"


def read_study(folder: Path) -> dict[str, Any] | None:
    """study.json of a folder; None if it has none. Raises BadInputError if it cannot be read."""
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
    """Write it whole or not at all."""
    write_bytes(folder / STUDY, (json.dumps(document, indent=1) + "\n").encode())


def begin(spec: ChainSpec, command: str, version: str) -> dict[str, Any]:
    """The document of a study of which nothing has run."""
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
    """BadInputError where the folder holds something else than this study: other files, or the
    stages of another study file.

    The same file in the same place may have been edited, and the same content may have moved: the
    stages tell what still holds."""
    if old is None:
        others = (
            sorted(p.name for p in folder.iterdir() if p.name != LOCK and p.suffix != PART)
            if folder.is_dir()
            else []
        )
        if others:
            raise BadInputError(
                f"--out {folder}: not empty and no study's folder (it has {others[0]}); choose"
                " another --out"
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
    """SHA-256 of a file, or of an aircraft's folder; empty where there is neither."""
    if path.is_dir():
        return folder_hash(path)
    try:
        return file_sha256(path)
    except OSError:
        return ""


def stage_key(
    kind: str, options: Mapping[str, Any], inputs: Mapping[str, str], versions: Any
) -> str:
    """What a stage's result depends on, as one hash: its command's kind and settings, what it
    reads, what computes it.
    """
    text = json.dumps([kind, options, sorted(inputs.items()), versions], sort_keys=True)
    return sha256_hex(text.encode())


LOGS = "log"
"""Folder of what each stage printed."""
_SUPERSEDED = "superseded"
Say = Callable[[str], None]
Command = Callable[[list[str]], int]
"""Runs the words of one ``uqharness`` command in this process; its exit code."""


def run_chain(
    run: Command,
    spec: ChainSpec,
    out: Path,
    workers: int | None = None,
    command: str = "",
    say: Say = lambda _: None,
) -> dict[str, Any]:
    """Run the stages that are missing into ``out``, each by ``run``; the content of its study.json.

    A stage that ends with 1, its answer being no, is done, and the study goes on. Raises
    BadInputError for a folder of something else, a second run in the same folder, and a stage that
    cannot use its input; KeyboardInterrupt passes. What is done is kept."""
    check_folder(out)
    stages = plan(spec, out)
    new = begin(spec, command, uqharness.__version__)
    refuse_foreign(out, read_study(out), new)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"--out {out}: cannot be made: {error.strerror or error}; choose another"
        ) from None
    with run_lock(out):
        earlier = checksums.take_away(out)
        was = read_study(out) or {}
        old = {row["name"]: row for row in (*was.get("former", []), *was.get("stages", []))}
        document = {**new, "stages": [_row(stage, old.pop(stage.name, None)) for stage in stages]}
        # Stages that the file no longer asks for left folders, which are this study's all the same.
        document["former"] = list(old.values())
        write_study(out, document)
        for number, (stage, row) in enumerate(
            zip(stages, document["stages"], strict=True), start=1
        ):
            say(f"[{number}/{len(stages)}] {stage.name}")
            try:
                _settle(run, stage, row, out, workers, lambda: write_study(out, document), say)
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                row |= {"state": "failed", "exit": 2, "error": str(error)}
                document["state"] = "failed"
                with contextlib.suppress(BadInputError):
                    write_study(out, document)
                if isinstance(error, BadInputError):
                    said = f"stage {stage.name}: {error}".split("\n")
                    raise BadInputError(*said, f"  the stage alone: {stage.command}") from None
                raise
        pair = {
            when: f"campaign-{when}"
            for when in (BEFORE, AFTER)
            if f"campaign-{when}" in {s.name for s in stages}
        }
        if len(pair) == 2:
            document["before_after"] = pair
        _conclude(spec, stages, document, out, was, workers)
        document["state"] = "done"
        write_study(out, document)
        checksums.write_sums(out, earlier)
    return document


def _conclude(
    spec: ChainSpec,
    stages: Sequence[Stage],
    document: dict[str, Any],
    out: Path,
    was: Mapping[str, Any],
    workers: int | None,
) -> None:
    """The verdict, the answer and the ground tracks, from what all stages left."""
    kinds, rows = {stage.kind for stage in stages}, document["stages"]
    flown = read_flown(out, "refine" in kinds) if "campaign" in kinds else {}
    said = judge(spec, stages, rows, out, flown)
    refinement = read_document(out / REFINEMENT, Part) if "refine" in kinds else None
    no = [row["name"] for row in rows if row["exit"] == 1]
    answer = answer_of(flown, refinement, said, no)
    document["verdict"] = [{"text": text, "level": level} for text, level in said]
    document["answer"] = dataclasses.asdict(answer)
    asked = {
        when: Asked(item.folder, item.frame, hardest(item.signed)) for when, item in flown.items()
    }
    # They depend on nothing but the campaigns, whose tables tell whether they are the same.
    key = stage_key(
        "tracks",
        {},
        {when: content(item.folder / "cases.parquet") for when, item in flown.items()},
        uqharness.__version__,
    )
    old = was.get("tracks") or {}
    if old.get("key") == key and content(out / TRACKS) == old.get("sha256"):
        document["tracks"] = old
    elif asked:
        document["tracks"] = fly_tracks(out, asked, workers) | {
            "key": key,
            "sha256": content(out / TRACKS),
        }


def _row(stage: Stage, old: Mapping[str, Any] | None) -> dict[str, Any]:
    """A stage's entry in study.json: what an earlier run left, under the words of this one."""
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


def _settle(
    run: Command,
    stage: Stage,
    row: dict[str, Any],
    out: Path,
    workers: int | None,
    save: Callable[[], None],
    say: Say,
) -> None:
    """Bring one stage to done, unless it is and would come out the same; ``row`` is brought up to
    date and saved.
    """
    inputs = {label: content(path) for label, path in stage.inputs.items()}
    missing = [label for label, digest in inputs.items() if not digest]
    if missing:
        raise BadInputError(f"{', '.join(missing)}: needed, and no stage before has left it")
    key = stage_key(stage.kind, stage.options, inputs, (uqharness.__version__, binding_versions()))
    same = row["key"] == key
    if same and row["state"] == "done" and row["outputs"] == _outputs(stage, out):
        say("  unchanged")
        return
    _make_room(stage, row, out, same)
    row |= {
        "state": "running",
        "exit": None,
        "seconds": None,
        "inputs": inputs,
        "error": "",
        "key": key,
        "outputs": {},
    }
    save()
    if stage.belongs is not None:
        _refuse_other_model(*stage.belongs)
    if stage.writes is not None:
        path, data = stage.writes
        write_bytes(path, (_HEADER + tomlkit.dumps(data)).encode())
    begun = time.monotonic()
    code = _call(run, stage, out, workers)
    row |= {
        "exit": code,
        "seconds": round(time.monotonic() - begun, 1),
        "outputs": _outputs(stage, out),
        "state": "done",
    }
    lost = [name for name, digest in row["outputs"].items() if not digest]
    if lost:
        raise BadInputError(
            f"ended with {code} and left no {', '.join(lost)}, which the study goes on from; what"
            f" it said is in {out / LOGS / stage.name}.txt"
        )
    save()
    say(f"  {row['seconds']:.0f} s" + ("" if code == 0 else f", exit {code}: the answer is no"))


_HEADER = "# Written by `uqharness study`; edit the study's file instead.\n\n"


def _outputs(stage: Stage, out: Path) -> dict[str, str]:
    return {path.relative_to(out).as_posix(): content(path) for path in stage.outputs}


def _make_room(stage: Stage, row: Mapping[str, Any], out: Path, same: bool) -> None:
    """Take away what an earlier run of this stage left, unless the stage goes on from it.

    Flights of a campaign are put aside.
    """
    if same and stage.resumes:
        return
    for path in stage.owns:
        if path.is_dir() and not row["key"]:
            raise BadInputError(
                f"{path}: is there, and not from this study; move it away, for the stage writes"
                " there"
            )
        if stage.kind == "campaign" and path.is_dir():
            aside = out / _SUPERSEDED / f"{stage.name}-{row['key'][:12]}"
            number = 1
            while aside.exists():
                number += 1
                aside = aside.with_name(f"{stage.name}-{row['key'][:12]}-{number}")
            aside.parent.mkdir(exist_ok=True)
            os.replace(path, aside)
        elif path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _refuse_other_model(form: Path, folder: Path) -> None:
    """BadInputError where bounds are not those of the aircraft that is about to fly with them."""
    said, flown = read_bounds(form).aircraft.sha256, content(folder)
    if said != flown:
        raise BadInputError(
            f"{form}: these bounds are of another model ({said[:12]}) than {folder} ({flown[:12]});"
            f" remove {form.parent} and run again"
        )


def _call(run: Command, stage: Stage, out: Path, workers: int | None) -> int:
    """Run the stage's command; what it prints goes to a file."""
    words = [
        *stage.argv,
        *(["--workers", str(workers)] if stage.workers and workers is not None else []),
    ]
    # Whoever asked for the study asked for its campaigns.
    words += ["--yes"] if stage.kind == "campaign" else []
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), _quiet(said):
            return run(words)
    finally:
        text = f"$ {stage.command}\n{said.getvalue()}"
        with contextlib.suppress(BadInputError):
            write_bytes(out / LOGS / f"{stage.name}.txt", text.encode())


@contextlib.contextmanager
def _quiet(said: TextIO) -> Iterator[None]:
    """On a terminal the stage's own progress is seen; in a pipe its remarks go where its results
    go.
    """
    if sys.stderr.isatty():
        yield
        return
    with contextlib.redirect_stderr(said):
        yield
