"""Child processes: their environment, running a module in one, and how it ended.

A foreign aircraft may crash the interpreter that loads it, or never return. Code that loads one for
the first time therefore runs as ``python -m MODULE`` with a time limit, and answers with one line
of JSON (`give_answer`, read by `run_module`).
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.foreign.regular_files import ParseError, parse_json
from sysid.parallel import ONE_THREAD
from uqharness.errors import BadInputError

# With code on the command line, as multiprocessing starts it, Python puts the working folder first
# on the import path: a `socket.py` there would be imported.
CHILD_ENVIRONMENT = {**ONE_THREAD, "PYTHONSAFEPATH": "1"}
_ANSWER = "uqharness-answer "
_ERROR_CHARACTERS = 300
_one_at_a_time = threading.RLock()


@contextlib.contextmanager
def child_settings() -> Iterator[None]:
    """Set CHILD_ENVIRONMENT for children started inside, and restore the environment afterwards."""
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
    """Keep processes spawned inside from running the caller's script again.

    Spawned processes usually import the script that started the parent, guarded or not. Functions
    sent to them must therefore come from a module, not from the script.
    """
    script = vars(sys.modules["__main__"])
    with _one_at_a_time:
        saved: dict[str, Any] = {
            name: script[name] for name in ("__file__", "__spec__") if name in script
        }
        # Without these, multiprocessing does not know which script to import.
        script.pop("__file__", None)
        script["__spec__"] = None
        try:
            yield
        finally:
            script.update(saved)


@dataclass(frozen=True)
class ProcessResult:
    """How a child process ended.

    Attributes
    ----------
    code : int or None
        Exit code, negative for a signal; None if the time limit ended it.
    answer : mapping
        What it passed to `give_answer`; empty without an answer.
    output : str
        Other standard output, in one line.
    errors : str
        End of its standard error, in one line.
    """

    code: int | None
    answer: Mapping[str, Any]
    output: str
    errors: str


def run_module(
    module: str, *arguments: object, timeout_s: float, python: Path | None = None
) -> ProcessResult:
    """Run ``python -m module arguments`` and wait for its end.

    Parameters
    ----------
    module : str
        Module to run.
    *arguments : object
        Its arguments, converted to text.
    timeout_s : float
        Time limit [s].
    python : Path, optional
        Interpreter of another environment with its own libraries; this one by default.

    Returns
    -------
    ProcessResult
        Exit code, answer and output.

    Raises
    ------
    BadInputError
        If the interpreter cannot be started.
    """
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
    # Other lines were printed by a library.
    answers = [line.removeprefix(_ANSWER) for line in lines if line.startswith(_ANSWER)]
    output = " ".join(" ".join(line for line in lines if not line.startswith(_ANSWER)).split())
    # A shell script that starts Python reports a signal as 128 plus its number.
    code = 128 - process.returncode if process.returncode >= 128 else process.returncode
    return ProcessResult(
        code, _answer(answers[-1:]), output, " ".join(process.stderr.split())[-_ERROR_CHARACTERS:]
    )


def give_answer(answer: Mapping[str, Any]) -> None:
    """Answer the parent that called `run_module`, from the child. The last answer counts."""
    # A library may have left an unfinished line.
    sys.stdout.write(f"\n{_ANSWER}{json.dumps(answer)}\n")
    sys.stdout.flush()


def _answer(lines: list[str]) -> Mapping[str, Any]:
    """Return the parsed answer; empty if it is no JSON object."""
    try:
        answer = parse_json(lines[0]) if lines else {}
    except ParseError:
        return {}
    return answer if isinstance(answer, dict) else {}


def describe_exit(code: int | None) -> str:
    """Return an exit code as text.

    Examples
    --------
    >>> ending(3), ending(-11)
    ('exit code 3', 'signal 11 (SIGSEGV)')
    """
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"signal {-code}"


def other_environment() -> dict[str, str]:
    """Return environment variables for an interpreter of another environment.

    It finds this package but none of this environment's libraries.
    """
    root = Path(__file__).resolve().parents[1]
    own_variables = {"VIRTUAL_ENV", "PYTHONPATH", "PYTHONHOME"}
    inherited = {name: value for name, value in os.environ.items() if name not in own_variables}
    installed = root.name in ("site-packages", "dist-packages")
    return inherited | CHILD_ENVIRONMENT | ({} if installed else {"PYTHONPATH": str(root)})


def child_environment() -> dict[str, str]:
    """Return environment variables with which ``python -m`` finds this package.

    The working folder is removed from the import path.
    """
    root = str(Path(__file__).resolve().parents[1])
    foreign = {"", os.curdir, os.getcwd()}
    places = [root, *(place for place in sys.path if place not in foreign)]
    return os.environ | CHILD_ENVIRONMENT | {"PYTHONPATH": os.pathsep.join(places)}
