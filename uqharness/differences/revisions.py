"""An aircraft as it stood in a revision of a git repository: ``REVISION:PATH``."""

from __future__ import annotations

import io
import subprocess
import tarfile
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, find_aircraft


def named_revision(text: str) -> tuple[str, str] | None:
    """Revision and path of ``REVISION:PATH``; None for a name or a path that exists, and for a drive letter."""
    revision, colon, path = text.partition(":")
    if not colon or len(revision) < 2 or not path or Path(text).exists():
        return None
    return revision, path


def aircraft_at(text: str, scratch: Path) -> Aircraft:
    """An aircraft by name, folder or ``REVISION:PATH``, the last unpacked under ``scratch``. Raises BadInputError."""
    found = named_revision(text)
    if found is None:
        return find_aircraft(text)
    revision, path = found
    wanted = Path(path)
    top = _git(["rev-parse", "--show-toplevel"], Path.cwd(), text).decode().strip()
    inside = (
        wanted.resolve().relative_to(top) if wanted.is_absolute() else Path(_prefix(text)) / wanted
    )
    content = _git(["archive", "--format=tar", revision, inside.as_posix()], Path(top), text)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        archive.extractall(scratch, filter="data")
    return find_aircraft(scratch / inside)


def _prefix(text: str) -> str:
    return _git(["rev-parse", "--show-prefix"], Path.cwd(), text).decode().strip()


def _git(words: list[str], place: Path, asked: str) -> bytes:
    try:
        done = subprocess.run(["git", *words], cwd=place, capture_output=True, check=False)
    except FileNotFoundError:
        raise BadInputError(f"{asked}: a revision needs git, which is not installed") from None
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        raise BadInputError(
            f"{asked}: git {words[0]}: {said[-1] if said else 'failed'}; give REVISION:FOLDER, such as HEAD~1:aircraft/espaaro"
        )
    return done.stdout
