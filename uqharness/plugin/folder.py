"""An instrumented aircraft's folder, whole or not at all: the copy with a plan carried out, and the way back."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from uqharness.errors import BadInputError
from uqharness.plugin.carry import carried_files
from uqharness.plugin.record import FILE_NAME, Change, changed, read_record, restored, to_json
from uqharness.simulator import Aircraft, copy_folder

if TYPE_CHECKING:
    from uqharness.plugin.instrument import Plan


def write(aircraft: Aircraft, planned: Plan, out: Path) -> None:
    """Copy the aircraft's folder to ``out`` with the plan carried out, and the record beside it; whole or not at all.

    ``out`` may be the aircraft's own folder; any other folder that exists has to be empty or an earlier result. Raises
    BadInputError.
    """
    in_place = out.exists() and out.resolve() == aircraft.folder
    if (
        out.exists()
        and not in_place
        and not (out / FILE_NAME).is_file()
        and (not out.is_dir() or any(out.iterdir()))
    ):
        raise BadInputError(
            f"{out}: exists and is no instrumented aircraft; remove it or choose another --out"
        )
    out.absolute().parent.mkdir(parents=True, exist_ok=True)
    changes, files = dict(planned.changes), dict(planned.files)
    if not in_place:
        for name, content in carried_files(aircraft, out).items():
            files[name], changes[name] = content, changed(None, content)
    if (aircraft.folder / FILE_NAME).is_file():
        changes = _chained(read_record(aircraft.folder), changes)
    with tempfile.TemporaryDirectory(dir=out.absolute().parent, prefix=".instrument-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(aircraft.folder, copy, keep_links=in_place)
        for name, content in files.items():
            _put(copy / name, content)
        (copy / FILE_NAME).write_bytes(to_json(changes))
        _swap(copy, out, Path(temporary) / "old")


def undo(folder: Path, out: Path) -> list[tuple[str, str]]:
    """Write to ``out`` what ``folder`` was before it was instrumented; (file, what became of it). ``out`` may be ``folder``.

    Raises BadInputError where a file changed since in a way that leaves no clean way back; nothing is written then.
    """
    changes = read_record(folder)
    done = []
    with tempfile.TemporaryDirectory(dir=out.absolute().parent, prefix=".instrument-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(folder, copy, keep_links=out.resolve() == folder.resolve())
        for name, change in changes.items():
            path = copy / name
            if not path.is_file():
                if change.edited:
                    raise BadInputError(f"{folder / name}: is gone; undo cannot bring it back")
                continue
            content = restored(folder / name, change, path.read_bytes())
            if content is None:
                path.unlink()
                if not any(path.parent.iterdir()):
                    path.parent.rmdir()
                done.append((name, "removed"))
            else:
                _put(path, content)
                same = changed(None, content).after == change.before
                done.append(
                    (
                        name,
                        "as it was, byte for byte"
                        if same
                        else "without the plugin; other changes since are kept",
                    )
                )
        (copy / FILE_NAME).unlink()
        if (
            out.exists()
            and out.resolve() != folder.resolve()
            and not (out / FILE_NAME).is_file()
            and any(out.iterdir())
        ):
            raise BadInputError(
                f"{out}: exists and is no instrumented aircraft; remove it or choose another --out"
            )
        _swap(copy, out, Path(temporary) / "old")
    return done


def _put(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # Written through a link, the file of another aircraft would change.
    if path.is_symlink():
        path.unlink()
    path.write_bytes(content)


def _swap(new: Path, out: Path, old: Path) -> None:
    """Put ``new`` in the place of ``out``; whatever fails, ``out`` is one of the two."""
    if (out / ".git").exists():
        # A working copy's own data are not ours to copy: they go over.
        os.rename(out / ".git", new / ".git")
    if out.exists():
        out.rename(old)
    try:
        new.rename(out)
    except OSError:
        if old.exists():
            old.rename(out)
        raise


def _chained(earlier: Mapping[str, Change], now: Mapping[str, Change]) -> dict[str, Change]:
    """The record of both: what an earlier instrumentation changed goes on being undone to the author's own bytes."""
    out = dict(earlier)
    for name, change in now.items():
        first = earlier.get(name)
        if first is None:
            out[name] = change
        elif first.edited or change.edited:
            raise BadInputError(f"{name}: was instrumented before; undo that first (--undo)")
        else:
            out[name] = Change(first.before, change.after, (), first.content)
    return out
