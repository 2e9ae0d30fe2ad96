"""A process that tries inputs one after another: a line ``FORMAT SEED`` in, a line of JSON out.

``python -m tests.fuzz.worker BASE ANSWERS`` with BASE a private folder and ANSWERS the number of a
pipe. What the inputs make the program print goes to BASE/printed.txt."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import sys
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.fuzz.formats import Format, all_formats
from tests.fuzz.guard import Guard, forget_peak, internet_sockets, peak_mb, resident_mb, tree
from tests.fuzz.hostile import OUTSIDE, STRINGS
from tests.fuzz.outcome import Refused, faults, stop_colour

INPUT = "a/b/in"
"""Where an input is put below BASE: deep enough that ``../..`` stays in it."""
_OWN_FOLDER = re.compile(r"uqharness-\d+-[a-z0-9_]{8}")
_MAX_KEPT = 40
# A settings file may name any file; a refusal that tells of that one tells of the right one.
_NAMED = tuple(text for text in STRINGS if text.startswith("/") and len(text) > 1)


class Bench:
    """A private tree of folders, and one input at a time in it."""

    def __init__(self, base: Path) -> None:
        self.base, self.place = base, base / INPUT
        self._temporary, self._cache = base / "tmp", base / "home" / ".cache"
        self._guard = Guard((self.place, self._temporary, self._cache))

    def attempt(self, item: Format, seed: int) -> dict[str, Any]:
        """Make the input, run its target, and say how it ended: outcome, what, seconds, MB,
        resident MB.
        """
        self._put(item.make(seed))
        before, temporary = self._seen(), set(os.listdir(self._temporary))
        outcome, kind = "result", ""
        forget_peak()
        start = time.monotonic()
        with self._guard.watching() as deeds:
            try:
                item.run(self.place, seed)
            except Refused as refused:
                outcome, kind = "refusal", str(refused)
            except BaseException as error:  # whatever an input makes the program raise
                outcome, kind = "finding", _last_words(error)
        seconds, megabytes = time.monotonic() - start, self._megabytes()
        if outcome == "refusal" and (fault := faults(kind, (str(self.place), *_NAMED))):
            outcome, kind = "finding", f"refusal {fault}"
        deeds = [*deeds, *self._changes(before), *self._left_behind(temporary)]
        if deeds:
            outcome, kind = "finding", "; ".join(dict.fromkeys(deeds))[:600]
        return {
            "outcome": outcome,
            "what": kind,
            "s": seconds,
            "MB": megabytes,
            "resident": resident_mb(),
        }

    def _put(self, files: dict[str, bytes]) -> None:
        shutil.rmtree(self.place, ignore_errors=True)
        for name, content in files.items():
            path = self.place / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    def _megabytes(self) -> float:
        # Children count with the largest there has been: a child that grew is found, which one it
        # was tells --reproduce.
        children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
        return max(peak_mb(), children)

    def _seen(self) -> dict[str, tuple[int, int]]:
        result = tree(self.base / "cwd", self.base / "home", self.base / "a", Path(OUTSIDE))
        saved = (str(self.place), str(self._cache))
        return {path: state for path, state in result.items() if not path.startswith(saved)}

    def _changes(self, before: dict[str, tuple[int, int]]) -> list[str]:
        after = self._seen()
        new = [
            f"leaves {path}" for path in after if path not in before or after[path] != before[path]
        ]
        absent = [f"removes {path}" for path in before if path not in after]
        for path in after:
            if path not in before and os.path.isfile(path):
                os.unlink(path)
        return [
            *new,
            *absent,
            *(f"opens the network: {row}" for row in internet_sockets([os.getpid()])),
        ]

    def _left_behind(self, before: set[str]) -> list[str]:
        current = set(os.listdir(self._temporary))
        # A process' own folder goes when the process does, one of a process that was killed with
        # the next that needs one.
        specific = {name for name in current if _OWN_FOLDER.fullmatch(name)}
        for name in current - specific:
            shutil.rmtree(self._temporary / name, ignore_errors=True)
        retained = sum(len(os.listdir(self._temporary / name)) for name in specific)
        much = [f"keeps {retained} temporary folders"] if retained > _MAX_KEPT else []
        return [
            *(
                f"leaves {name} among temporary files"
                for name in sorted(current - specific - before)
            ),
            *much,
        ]


def _last_words(error: BaseException) -> str:
    """The error and where it was raised, innermost of the project's own lines last."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [
        f
        for f in frames
        if "site-packages" not in f.filename and f"{os.sep}fuzz{os.sep}" not in f.filename
    ]
    where = " < ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in reversed(ours[-3:]))
    return f"{type(error).__name__}: {str(error)[:300]!r} at {where or 'the harness'}"


def main(base: Path, answers: int, formats: Mapping[str, Format]) -> None:
    """Serve until the parent closes our input."""
    questions = os.fdopen(os.dup(0), "r")
    printed = os.open(base / "printed.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    empty = os.open(os.devnull, os.O_RDONLY)
    for target, source in ((0, empty), (1, printed), (2, printed)):
        os.dup2(source, target)
    stop_colour()
    # What Python compiles of this project is no input's doing, and in a fresh checkout nothing is
    # compiled.
    sys.dont_write_bytecode = True
    bench = Bench(base)
    with os.fdopen(answers, "w") as out:
        for line in questions:
            name, seed = line.split()
            row = bench.attempt(formats[name], int(seed))
            out.write(json.dumps(row) + "\n")
            out.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), all_formats())
