"""Child processes: what every one of this program is started with, a module of this program run in
one, and how it ended.

A foreign aircraft may end the interpreter that loads it, or never come back: whatever loads one
first runs as ``python -m`` of its own, with a time limit, and answers with a line of JSON."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import ParseError, parse_json
from sysid.parallel import ONE_THREAD
from uqharness.errors import BadInputError

# Python puts the working folder before everything else where code is handed to it on the command
# line, as multiprocessing does: a `socket.py` there would be imported.
CHILD_ENVIRONMENT = {**ONE_THREAD, "PYTHONSAFEPATH": "1"}
_ANSWER = "uqharness-answer "
_ERROR_CHARACTERS = 300
_one_at_a_time = threading.RLock()


@contextlib.contextmanager
def child_settings() -> Iterator[None]:
    """Children started inside inherit CHILD_ENVIRONMENT; this process's own environment is as
    before afterwards.
    """
    saved = {name: os.environ.get(name) for name in CHILD_ENVIRONMENT}
    os.environ.update(CHILD_ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def main_not_imported() -> Iterator[None]:
    """Processes spawned inside do not run the script again that this one was started with, guard or
    not.

    What they are to do must then come from a module: nothing that the script defines is known to
    them."""
    script = vars(sys.modules["__main__"])
    with _one_at_a_time:
        saved: dict[str, Any] = {
            name: script[name] for name in ("__file__", "__spec__") if name in script
        }
        script.pop("__file__", None)
        script["__spec__"] = None
        try:
            yield
        finally:
            script.update(saved)


@dataclass(frozen=True)
class ProcessResult:
    """How a child ended.

    code    exit code, minus the number of the signal that ended it; None where it was killed
    because its time was over answer  what it said by `give_answer`; empty where it did not
    said    what else it, or a library in it, wrote to standard output, in one line
    errors  the end of what it wrote to standard error, in one line
    """

    code: int | None
    answer: Mapping[str, Any]
    output: str
    errors: str


def run_module(
    module: str, *arguments: object, timeout_s: float, python: Path | None = None
) -> ProcessResult:
    """Run ``python -m module arguments`` and wait for its end, for at most ``timeout_s`` seconds.

    python: interpreter of another environment, whose own libraries count; None: this one. Raises
    BadInputError where it cannot be started."""
    command = [str(python or sys.executable), "-m", module, *map(str, arguments)]
    environment = child_environment() if python is None else other_environment()
    try:
        process = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return ProcessResult(None, {}, "", "")
    except OSError as error:
        raise BadInputError(
            f"{command[0]}: cannot be started: {error.strerror or error}; a Python interpreter is"
            " needed"
        ) from None
    lines = process.stdout.splitlines()
    answers = [line.removeprefix(_ANSWER) for line in lines if line.startswith(_ANSWER)]
    output = " ".join(" ".join(line for line in lines if not line.startswith(_ANSWER)).split())
    # Where Python is started by a script, that tells of a signal by 128 and its number.
    code = 128 - process.returncode if process.returncode >= 128 else process.returncode
    return ProcessResult(
        code, _answer(answers[-1:]), output, " ".join(process.stderr.split())[-_ERROR_CHARACTERS:]
    )


def give_answer(answer: Mapping[str, Any]) -> None:
    """In the child: the answer that `run_module` hands to the parent. The last one counts."""
    # A library may have written half a line.
    sys.stdout.write(f"\n{_ANSWER}{json.dumps(answer)}\n")
    sys.stdout.flush()


def _answer(lines: list[str]) -> Mapping[str, Any]:
    try:
        answer = parse_json(lines[0]) if lines else {}
    except ParseError:
        return {}
    return answer if isinstance(answer, dict) else {}


def ending(code: int | None) -> str:
    """A process's exit code in words: "exit code 3", "signal 11 (SIGSEGV)"."""
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"signal {-code}"


def other_environment() -> dict[str, str]:
    """The same for an interpreter of another environment: this package, unless it is installed
    there, and none of our libraries.
    """
    root = Path(__file__).resolve().parents[1]
    own_variables = {"VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME"}
    inherited = {name: value for name, value in os.environ.items() if name not in own_variables}
    installed = root.name in ("site-packages", "dist-packages")
    return inherited | CHILD_ENVIRONMENT | ({} if installed else {"PYTHONPATH": str(root)})


def child_environment() -> dict[str, str]:
    """The environment in which ``python -m`` finds this package, wherever it was imported from, and
    nothing of its folder.
    """
    root = str(Path(__file__).resolve().parents[1])
    foreign = {"", os.curdir, os.getcwd()}
    places = [root, *(place for place in sys.path if place not in foreign)]
    return os.environ | CHILD_ENVIRONMENT | {"PYTHONPATH": os.pathsep.join(places)}


def run_command(words: Sequence[str]) -> tuple[int, str, str]:
    """Run a command of this program in a process of its own: its exit code, standard output and
    standard error.
    """
    process = subprocess.run(
        [sys.executable, "-m", "uqharness", *words], capture_output=True, text=True, check=False
    )
    return process.returncode, process.stdout, process.stderr
