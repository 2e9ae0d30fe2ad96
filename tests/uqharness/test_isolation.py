"""An aircraft that ends JSBSim's process in flight ends no command and no interpreter."""

from __future__ import annotations

import json
import logging
import operator
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import uqharness as uq
from tests.helpers.isolated_calls import call_twice, chatter, sleeping, survived_crash
from uqharness.child_process import child_environment
from uqharness.cli.main import main
from uqharness.errors import BadInputError
from uqharness.isolation import SUPERVISED, ProcessEndedError, run_isolated
from uqharness.simulator import find_aircraft

MODULO = """<function name="aero/modulo"><product><value>0</value><mod><value>7</value>
 <floor><difference><value>{}</value><property>{}</property></difference></floor></mod></product></function>"""


@pytest.fixture(autouse=True)
def without_supervisor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody would report the end of the test's process: the worker is used, as in a script."""
    monkeypatch.delenv(SUPERVISED, raising=False)


def dividing(folder: Path, start: str, falling: str) -> Path:
    """A copy of espaaro that divides 7 by floor(start - falling): SIGFPE once that is 0."""
    copy = folder / "espaaro"
    shutil.copytree(find_aircraft("espaaro").folder, copy)
    path = copy / "espaaro.xml"
    text = path.read_text()
    at = text.index("<function", text.index("<aerodynamics"))
    path.write_text(text[:at] + MODULO.format(start, falling) + text[at:])
    return copy


def test_a_flight_that_ends_its_process_is_a_crashed_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    folder, out = dividing(tmp_path, "3.5", "simulation/sim-time-sec"), tmp_path / "flight.parquet"
    words = ["fly", str(folder), "--script", "doublet-elevator", "--json", "--out", str(out)]
    assert main([*words, "--duration-s", "6"]) == 1
    summary = json.loads(capsys.readouterr().out)
    assert summary["status"] == "crashed"
    assert "signal 8 (SIGFPE) after 2.5" in summary["reason"]
    # What was flown is in the record, the same as before the division. The sound aircraft needs
    # no worker.
    monkeypatch.setenv(SUPERVISED, str(os.getpid()))
    sound = uq.fly("espaaro", "doublet-elevator", duration_s=3.0)
    flight = pd.read_parquet(out)
    assert (sound.status, len(flight), summary["rows"]) == ("ok", 126, 126)
    np.testing.assert_array_equal(flight["alpha_rad"], sound["alpha_rad"][:126])


def test_a_divisor_that_stays_is_flown(tmp_path: Path):
    folder = dividing(tmp_path, "9.5", "simulation/sim-time-sec")
    assert uq.fly(folder, "doublet-elevator", duration_s=4.0).status == "ok"


def test_diff_names_the_model_whose_flight_ends_its_process(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = dividing(tmp_path, "3.5", "simulation/sim-time-sec")
    assert main(["diff", "espaaro", str(folder), "--script", "doublet-elevator", "--json"]) == 1
    (flight,) = json.loads(capsys.readouterr().out)["flights"]
    assert "signal 8 (SIGFPE) after 2.5" in flight["reason"]
    assert main(["diff", str(folder), "espaaro", "--script", "doublet-elevator"]) == 2
    assert "A cannot be simulated: JSBSim's process ended with signal 8" in capsys.readouterr().err


def test_a_trim_that_ends_its_process_is_an_error_of_python_and_of_the_command(tmp_path: Path):
    folder = dividing(tmp_path, "1.5", "velocities/u-fps")
    text = (folder / "espaaro.xml").read_text()
    property_ = "<property>velocities/u-fps</property>"
    scaled = f"<quotient>{property_}<value>60</value></quotient>"
    (folder / "espaaro.xml").write_text(text.replace(property_, scaled, 1))
    with pytest.raises(BadInputError, match="signal 8"):
        uq.find_trim(folder, 22.2)
    ended = subprocess.run(
        [sys.executable, "-m", "uqharness", "modes", str(folder), "--speed-mps", "22.2"],
        capture_output=True,
        text=True,
        env=child_environment(),
        check=False,
    )
    assert ended.returncode == 2
    assert "the command's process ended with signal 8 (SIGFPE)" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_dead_worker_is_replaced():
    with pytest.raises(ProcessEndedError, match="SIGABRT") as caught:
        run_isolated(os.abort)
    assert caught.value.time_s is None
    assert run_isolated(operator.add, 1, 2) == 3
    assert run_isolated(os.getpid) == run_isolated(os.getpid) != os.getpid()


def test_exceptions_callbacks_logs_and_the_working_folder_are_those_of_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    with pytest.raises(ZeroDivisionError):
        run_isolated(operator.truediv, 1, 0)
    heard: list[int] = []
    assert run_isolated(call_twice, heard.append) == 2
    assert heard == [0, 1]
    monkeypatch.chdir(tmp_path)
    assert run_isolated(os.getcwd) == str(tmp_path)
    with caplog.at_level(logging.INFO, logger="uqharness"):
        run_isolated(chatter, "a note")
    assert "a note of 1" in caplog.messages


def test_ctrl_c_ends_the_function_and_keeps_the_worker(tmp_path: Path):
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    worker, mark = run_isolated(os.getpid), tmp_path / "tidied"
    with pytest.raises(KeyboardInterrupt):
        run_isolated(sleeping, interrupt, mark)
    assert mark.read_text() == "tidied"
    assert run_isolated(os.getpid) == worker


def test_a_worker_survives_the_end_of_its_own_worker():
    assert "SIGABRT" in run_isolated(survived_crash)
