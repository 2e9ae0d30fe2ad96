"""A place to run refine in which this examination can be neither imported nor read.

The packages and aircraft are copied; Python is started there with a guard (an audit hook, inherited
by every worker process) that refuses to open anything under the project's tests or under the folder
that holds the results."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.hidden_effects.airframes import ROOT

_GUARD = """
import os, sys

_forbidden = {forbidden!r}


def _refuse(event, args):
    if event in ("open", "os.listdir", "os.scandir", "import", "exec"):
        for arg in args[:2]:
            if isinstance(arg, bytes):
                arg = os.fsdecode(arg)
            if isinstance(arg, str) and os.path.abspath(arg).startswith(_forbidden):
                raise PermissionError("the examination is sealed: " + event + " " + arg)


sys.addaudithook(_refuse)
sys.path[:] = [p for p in sys.path if os.path.abspath(p or ".") != {root!r}]
"""


def seal(folder: Path, forbidden: Sequence[Path] = (), project: Path = ROOT) -> Path:
    """Copy a project's packages and aircraft to ``folder`` and set the guard.

    Returns the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("sysid", "uqharness", "aircraft", "scripts"):
        shutil.rmtree(folder / name, ignore_errors=True)
        shutil.copytree(project / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    closed = tuple(str(p.resolve()) for p in (ROOT / "tests", project / "tests", *forbidden))
    (folder / "sitecustomize.py").write_text(
        _GUARD.format(forbidden=closed, root=str(ROOT)), encoding="utf-8"
    )
    return folder


def run(
    folder: Path, arguments: Sequence[str], timeout_s: float | None = None
) -> subprocess.CompletedProcess[str]:
    """python with the arguments, in the sealed folder."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(folder),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


_running: set[int] = set()
"""Groups of the processes that are being measured."""


def stop() -> None:
    """End every process that is being measured, with its children; whoever waits for one is told
    code -9.
    """
    for group in list(_running):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)


@dataclass(frozen=True)
class Measured:
    """A process that ended: exit code (-1: not in time), what it printed, processor time [s] and
    largest resident memory [MB].

    Both are of the process and of every child it waited for: times added up, memory of the largest.
    """

    returncode: int
    stdout: str
    stderr: str
    cpu_s: float
    peak_MB: float


_MEASURE = """
import os, subprocess, sys

child = subprocess.Popen([sys.executable, *sys.argv[2:]])
_, status, used = os.wait4(child.pid, 0)
with open(sys.argv[1], "w") as handle:
    handle.write(f"{used.ru_utime + used.ru_stime} {used.ru_maxrss}")
sys.exit(os.waitstatus_to_exitcode(status))
"""


def run_measured(folder: Path, arguments: Sequence[str], timeout_s: float) -> Measured:
    """python with the arguments, in the sealed folder, with what it cost.

    A process of its own starts and measures it: Linux counts the memory of whoever starts a program
    as the program's own."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(folder),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    with tempfile.TemporaryDirectory() as scratch:
        cost = Path(scratch) / "cost"
        child = subprocess.Popen(
            [sys.executable, "-S", "-c", _MEASURE, str(cost), *arguments],
            cwd=folder,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        _running.add(child.pid)
        try:
            out, err = child.communicate(timeout=timeout_s)
        except BaseException as stopped:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.communicate()
            if not isinstance(stopped, subprocess.TimeoutExpired):
                raise
            return Measured(-1, "", f"not finished after {timeout_s:g} s", timeout_s, float("nan"))
        finally:
            _running.discard(child.pid)
        if not cost.is_file():
            return Measured(-9, out, err, float("nan"), float("nan"))
        cpu_s, peak_kB = map(float, cost.read_text(encoding="utf-8").split())
    return Measured(child.returncode, out, err, cpu_s, peak_kB / 1024.0)
