"""A place to run refine in which this examination can be neither imported nor read.

The packages and aircraft are copied; Python is started there with a guard (an audit hook, inherited by every worker process) that
refuses to open anything under the project's tests or under the folder that holds the results.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
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
    """Copy a project's packages and aircraft to ``folder`` and set the guard. Returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("sysid", "uqharness", "aircraft", "scripts"):
        shutil.rmtree(folder / name, ignore_errors=True)
        shutil.copytree(project / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    closed = tuple(str(p.resolve()) for p in (ROOT / "tests", project / "tests", *forbidden))
    (folder / "sitecustomize.py").write_text(_GUARD.format(forbidden=closed, root=str(ROOT)), encoding="utf-8")
    return folder


def run(folder: Path, arguments: Sequence[str], timeout_s: float | None = None) -> subprocess.CompletedProcess[str]:
    """python with the arguments, in the sealed folder."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False
    )  # fmt: skip
