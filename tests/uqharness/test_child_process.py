"""Worker processes import nothing from the working folder, whoever put it there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.places import ROOT
from uqharness.child_process import CHILD_ENVIRONMENT, child_settings

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
from uqharness.campaign.execution.processes import ProcessExecutor
from uqharness.flight.spec import FlightSpec
from uqharness.shared_jobs import worker_map

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
        path.write_text(f"open({str(tmp_path / 'marks')!r}, 'a').write({name!r})\nraise SystemExit('imported {name}')\n")
    return folder


def run(place: Path, *command: str) -> tuple[subprocess.CompletedProcess, str]:
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONSAFEPATH", "PYTHONPATH")}
    done = subprocess.run(
        command, cwd=place, env=environment, capture_output=True, text=True, timeout=120, check=False
    )  # fmt: skip
    marks = place.parent / "marks"
    return done, marks.read_text() if marks.exists() else ""


def run_script(place: Path, *how: str) -> tuple[subprocess.CompletedProcess, str]:
    script = place.parent / "elsewhere" / "script.py"
    script.parent.mkdir(exist_ok=True)
    script.write_text(f"import sys\nsys.path.insert(1, {str(ROOT)!r})\n{SCRIPT}")
    return run(place, sys.executable, str(script), *how)


@pytest.mark.parametrize(("how", "said"), [("spawn", "['ok']"), ("forkserver", "['ok']"), ("fork", "['ok']"), ("pool", "[1, 2]")])
def test_no_worker_imports_what_lies_in_the_working_folder(place, how, said):
    done, marks = run_script(place, how)
    assert (done.returncode, done.stdout.strip(), marks) == (0, said, ""), done.stderr


def test_without_the_setting_they_would(place):
    assert run_script(place, "spawn", "careless")[1] != ""


def test_the_command_flies_a_campaign_in_such_a_folder(place):
    command = Path(sys.executable).with_name("uqharness")
    (place / "campaign.toml").write_text(
        '[campaign]\naircraft = "espaaro"\nmission = "loiter"\nseed = 7\n[aleatory]\nflights = 2\nduration_s = 2\n'
        '[epistemic]\nmethod = "none"\n'
    )
    done, marks = run(place, str(command), "campaign", "run", "campaign.toml", "--out", "out", "--workers", "2")
    assert (done.returncode, marks) == (0, ""), done.stderr
    assert "2 flights done" in done.stdout


def test_this_process_keeps_its_own_settings(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    with child_settings():
        assert {name: os.environ[name] for name in CHILD_ENVIRONMENT} == CHILD_ENVIRONMENT
    assert os.environ["OMP_NUM_THREADS"] == "8"
    assert "PYTHONSAFEPATH" not in os.environ
