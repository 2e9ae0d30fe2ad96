"""study.json: what a study's folder belongs to, how far it is, and what each stage was made from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sysid.digests import file_sha256, sha256_hex
from sysid.foreign.parsed_text import ParseError, parse_json
from sysid.foreign.regular_files import read_regular
from uqharness.campaign.folder import LOCK
from uqharness.errors import BadInputError
from uqharness.files import PART, write_bytes
from uqharness.simulator import folder_hash
from uqharness.study.spec import ChainSpec

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
            f"{path}: written by another version of uqharness, or not by uqharness; choose another --out"
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
    """BadInputError where the folder holds something else than this study: other files, or the stages of another study file.

    The same file in the same place may have been edited, and the same content may have moved: the stages tell what still holds.
    """
    if old is None:
        others = (
            sorted(p.name for p in folder.iterdir() if p.name != LOCK and p.suffix != PART)
            if folder.is_dir()
            else []
        )
        if others:
            raise BadInputError(
                f"--out {folder}: not empty and no study's folder (it has {others[0]}); choose another --out"
            )
        return
    elsewhere = old["path"] != new["path"] and old["hash"] != new["hash"]
    if old["study"] != new["study"] or elsewhere:
        raise BadInputError(
            f'--out {folder}: this folder holds the study "{old["study"]}" of {old["path"]}, not "{new["study"]}" of '
            f"{new['path']}; choose another --out, or remove the folder if its results are not wanted"
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
    """What a stage's result depends on, as one hash: its command's kind and settings, what it reads, what computes it."""
    text = json.dumps([kind, options, sorted(inputs.items()), versions], sort_keys=True)
    return sha256_hex(text.encode())
