"""The public face in a script without a guard, through a pipe, and in a notebook: workers do not
run the script again.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.places import ROOT

CAMPAIGN = """
import sys
import uqharness as uq

open("begun", "a").write("x")
result = uq.run_campaign(
    {
        "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
        "aleatory": {"flights": 2, "duration_s": 2, "burn_in_s": 0},
        "epistemic": {"method": "none"},
    },
    "results",
    workers=2,
)
print(len(result.cases), sorted(set(result.cases["status"])))
"""
IDENTIFY = """
import uqharness as uq

open("begun", "a").write("x")
flight = uq.fly("espaaro", "doublet-elevator", duration_s=8, noise=True, seed=1)
print(uq.identify("espaaro", flight, parameters=["aero/Cm_q"], workers=2).converged)
"""
POOL = """
from uqharness.parallel import worker_map

open("begun", "a").write("x")
with worker_map(2) as pool:
    print([*pool(abs, [-1, 2])])
"""
# A notebook's main module is no file.
NOTEBOOK = """
import sys, types
cell = sys.stdin.read()
sys.modules["__main__"] = main = types.ModuleType("__main__")
exec(compile(cell, "<cell>", "exec"), vars(main))
"""


def run(options: str, code: str, folder: Path) -> subprocess.CompletedProcess:
    words = {"script": ["script.py"], "pipe": ["-"], "notebook": ["-c", NOTEBOOK]}[options]
    (folder / "script.py").write_text(code)
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *words],
        input=code,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.parametrize(
    ("options", "code", "output"),
    [
        pytest.param("script", CAMPAIGN, "2 ['ok']", marks=pytest.mark.slow),
        pytest.param("pipe", CAMPAIGN, "2 ['ok']", marks=pytest.mark.slow),
        pytest.param("notebook", CAMPAIGN, "2 ['ok']", marks=pytest.mark.slow),
        pytest.param("script", IDENTIFY, "True", marks=pytest.mark.slow),
        pytest.param("pipe", IDENTIFY, "True", marks=pytest.mark.slow),
        pytest.param("notebook", IDENTIFY, "True", marks=pytest.mark.slow),
        ("notebook", POOL, "[1, 2]"),
    ],
    ids=[
        "campaign-script",
        "campaign-pipe",
        "campaign-notebook",
        "identify-script",
        "identify-pipe",
        "identify-notebook",
        "pool-notebook",
    ],
)
def test_workers_of_an_unguarded_script_do_not_run_it_again(
    options: str, code: str, output: str, tmp_path: Path
):
    done = run(options, code, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, output + "\n", "")
    assert (tmp_path / "begun").read_text() == "x"


OWN = """
from uqharness.campaign.run import run_campaign
from uqharness.commands.campaign import campaign_of
from uqharness.flight.fly import fly

def own(spec):
    return fly(spec)

open("begun", "a").write("x")
campaign = campaign_of(
    {
        "campaign": {"aircraft": "espaaro", "mission": "loiter", "seed": 1},
        "aleatory": {"flights": 2, "duration_s": 2, "burn_in_s": 0},
        "epistemic": {"method": "none"},
    }
)
GUARD
    print(run_campaign(campaign, "results", workers=2, fly=own).statuses)
"""


@pytest.mark.slow
def test_a_flight_function_of_the_script_needs_a_guard_and_that_is_said(tmp_path: Path):
    done = run("script", OWN.replace("GUARD", "if True:"), tmp_path)
    assert done.returncode == 1
    assert 'put what starts the campaign under if __name__ == "__main__":' in done.stderr
    # The worker's own message and the script's.
    assert done.stderr.count("Traceback") <= 2 + done.stderr.count("During handling")
    assert (tmp_path / "begun").read_text() == "xx"
