"""Worker processes import nothing from the working folder, whoever put it there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.places import ROOT
from uqharness import child_process
from uqharness.child_process import CHILD_ENVIRONMENT, child_settings, describe_exit, run_module
from uqharness.errors import BadInputError

HOSTILE = (
    "jsbsim.py",
    "socket.py",
    "signal.py",
    "numpy.py",
    "pickle.py",
    "multiprocessing/__init__.py",
    "uqharness/__init__.py",
)
SCRIPT = """
import sys
from pathlib import Path

import tests.helpers.campaign_fakes as fakes
import uqharness.child_process
from uqharness.campaign.processes import ProcessExecutor
from uqharness.flight.spec import FlightSpec
from uqharness.parallel import worker_map

if __name__ == "__main__":
    if "careless" in sys.argv:
        del uqharness.child_process.CHILD_ENVIRONMENT["PYTHONSAFEPATH"]
    if "pool" in sys.argv:
        with worker_map(2) as by:
            print([*by(abs, [-1, 2])])
    else:
        flights = [("0001", FlightSpec(Path("plane"), Path("loiter.xml"), 150.0))]
        found = [o.status for batch in ProcessExecutor(1, sys.argv[1]).run(fakes.steady, flights) for o in batch]
        print(found)
"""


@pytest.fixture
def place(tmp_path) -> Path:
    """A working folder with modules that leave a mark where they are imported."""
    folder = tmp_path / "downloads"
    for name in HOSTILE:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            f"open({str(tmp_path / 'marks')!r}, 'a').write({name!r})\nraise SystemExit('imported"
            f" {name}')\n"
        )
    return folder


def run(place: Path, *command: str) -> tuple[subprocess.CompletedProcess, str]:
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONSAFEPATH", "PYTHONPATH")
    }
    done = subprocess.run(
        command,
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    marks = place.parent / "marks"
    return done, marks.read_text() if marks.exists() else ""


def run_script(place: Path, *options: str) -> tuple[subprocess.CompletedProcess, str]:
    script = place.parent / "elsewhere" / "script.py"
    script.parent.mkdir(exist_ok=True)
    script.write_text(f"import sys\nsys.path.insert(1, {str(ROOT)!r})\n{SCRIPT}")
    return run(place, sys.executable, str(script), *options)


@pytest.mark.parametrize(
    ("options", "output"),
    [
        ("spawn", "['ok']"),
        ("pool", "[1, 2]"),
        *(
            pytest.param(options, "['ok']", marks=pytest.mark.slow)
            for options in ("forkserver", "fork")
        ),
    ],
)
def test_no_worker_imports_what_lies_in_the_working_folder(place, options, output):
    done, marks = run_script(place, options)
    assert (done.returncode, done.stdout.strip(), marks) == (0, output, ""), done.stderr


def test_without_the_setting_they_would(place):
    assert run_script(place, "spawn", "careless")[1] != ""


def test_this_process_keeps_its_own_settings(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    with child_settings():
        assert {name: os.environ[name] for name in CHILD_ENVIRONMENT} == CHILD_ENVIRONMENT
    assert os.environ["OMP_NUM_THREADS"] == "8"
    assert "PYTHONSAFEPATH" not in os.environ


def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> str:
    """Name of a module with that code, which children find."""
    (tmp_path / "asked_in_a_child.py").write_text(
        f"import os, sys\nfrom uqharness.child_process import give_answer\n{code}\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    return "asked_in_a_child"


def test_a_module_answers_from_a_process_of_its_own(tmp_path, monkeypatch):
    code = (
        "print('one'); give_answer({'first': 1}); give_answer({'words': sys.argv[1:], 'pid':"
        " os.getpid()})\nprint('two')"
    )
    ended = run_module(module(tmp_path, monkeypatch, code), tmp_path, 1.5, timeout_s=60)
    assert (ended.code, ended.output, ended.errors) == (0, "one two", "")
    assert ended.answer["words"] == [str(tmp_path), "1.5"]
    assert ended.answer["pid"] != os.getpid()


@pytest.mark.parametrize(
    ("code", "number", "words"),
    [
        ("sys.exit(3)", 3, "exit code 3"),
        ("os.abort()", -6, "signal 6 (SIGABRT)"),
        ("os._exit(139)", -11, "signal 11 (SIGSEGV)"),  # as a script around Python tells of it
    ],
)
def test_how_a_child_ended_is_said_in_words(tmp_path, monkeypatch, code, number, words):
    ended = run_module(
        module(tmp_path, monkeypatch, f"print('last words', flush=True)\n{code}"), timeout_s=60
    )
    assert (ended.code, ended.answer, ended.output) == (number, {}, "last words")
    assert describe_exit(ended.code) == words


def test_a_child_that_does_not_come_back_is_ended(tmp_path, monkeypatch):
    assert (
        run_module(
            module(tmp_path, monkeypatch, "import time\ntime.sleep(600)"), timeout_s=1.0
        ).code
        is None
    )


def test_what_looks_like_an_answer_and_is_none_counts_as_none(tmp_path, monkeypatch):
    code = "print('uqharness-answer {\"a\"')"
    assert run_module(module(tmp_path, monkeypatch, code), timeout_s=60).answer == {}
    code = "print('uqharness-answer [1]')"
    assert run_module(module(tmp_path, monkeypatch, code), timeout_s=60).answer == {}


def test_another_environment_gets_none_of_our_libraries(tmp_path, monkeypatch):
    visible = tmp_path / "python"
    visible.write_text('#!/bin/sh\necho "path=$PYTHONPATH venv=$VIRTUAL_ENV"\n')
    visible.chmod(0o755)
    monkeypatch.setenv("PYTHONPATH", "/somewhere/of/ours")
    monkeypatch.setenv("VIRTUAL_ENV", "/ours")
    ended = run_module("module", timeout_s=10, python=visible)
    assert ended.output == f"path={Path(child_process.__file__).parents[1]} venv="
    with pytest.raises(BadInputError, match="cannot be started"):
        run_module("module", timeout_s=10, python=tmp_path / "none")
