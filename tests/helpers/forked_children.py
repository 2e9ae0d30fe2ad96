"""Trial loads and trial flights of an aircraft in a forked process.

`run_module` starts Python, which takes a third of a second of processor time, and the tests make
hundreds of aircraft. A fork is as safe from an aircraft that ends its process and takes
milliseconds. tests/uqharness/test_child_process.py starts Python.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import runpy
import sys
import tempfile
import warnings
from io import BufferedRandom, FileIO, TextIOWrapper
from os import dup2
from pathlib import Path

from uqharness import child_process
from uqharness.child_process import ProcessResult, run_module

USERS = (
    "uqharness.simulator.aircraft_checks",
    "uqharness.simulator.facts",
    "uqharness.plugin.apply",
)
"""Modules that run themselves in a child."""


def run_forked(
    module: str, *arguments: object, timeout_s: float, python: Path | None = None
) -> ProcessResult:
    """Do as `run_module`, in a forked process."""
    # Daemons may have no children of multiprocessing.
    if python is not None or multiprocessing.current_process().daemon:
        return run_module(module, *arguments, timeout_s=timeout_s, python=python)
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        child = multiprocessing.get_context("fork").Process(
            target=_run_main, args=(module, list(map(str, arguments)), out, errors)
        )
        with warnings.catch_warnings():
            # Of a fork beside threads, since Python 3.12.
            warnings.simplefilter("ignore", DeprecationWarning)
            child.start()
        child.join(timeout_s)
        if child.exitcode is None:
            child.kill()
            child.join()
            return ProcessResult(None, {}, "", "")
        out.seek(0)
        errors.seek(0)
        lines = out.read().decode(errors="replace").splitlines()
        mark = child_process._ANSWER
        answers = [line.removeprefix(mark) for line in lines if line.startswith(mark)]
        words = " ".join(" ".join(line for line in lines if not line.startswith(mark)).split())
        output = " ".join(errors.read().decode(errors="replace").split())
        return ProcessResult(child.exitcode, child_process._answer(answers[-1:]), words, output)


def _run_main(module: str, arguments: list[str], out: BufferedRandom, err: BufferedRandom) -> None:
    """Run a module as a program, with its output in files."""
    faulthandler.disable()
    dup2(out.fileno(), 1)
    dup2(err.fileno(), 2)
    sys.stdout, sys.stderr = (
        TextIOWrapper(FileIO(number, "w", closefd=False)) for number in (1, 2)
    )
    sys.argv = [module, *arguments]
    # runpy warns of a module that is imported already.
    warnings.simplefilter("ignore")
    try:
        runpy.run_module(module, run_name="__main__")
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
