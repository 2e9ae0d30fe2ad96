"""Journal, manifest and lock: what is stored stays, what cannot be stored is said, and nobody else
gets in.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from uqharness.campaign.manifest import refuse_if_different
from uqharness.campaign.processes import CaseOutcome
from uqharness.campaign.read_spec import checked_settings
from uqharness.campaign.store import JOURNAL, Store, is_running, run_lock
from uqharness.errors import BadInputError


def outcome(number, status="ok", **metrics):
    return CaseOutcome(
        f"{number:016x}", status, "" if status == "ok" else "why", 210.0, metrics, {}
    )


def test_outcomes_survive_a_round_trip(tmp_path):
    stored = [outcome(2, x=0.1), outcome(1, "diverged"), outcome(3, x=float("nan"))]
    with Store(tmp_path) as store:
        store.add(stored)
        store.add([])
    with Store(tmp_path) as store:
        back = list(store.outcomes())
        assert [item.case_id for item in back] == sorted(item.case_id for item in stored)
        assert back[1] == stored[0]
        assert back[2].metrics["x"] != back[2].metrics["x"]
        assert store.finished() == {item.case_id for item in stored}
        assert store.statuses() == {"ok": 2, "diverged": 1}


def test_a_damaged_journal_is_a_sentence(tmp_path):
    (tmp_path / JOURNAL).write_bytes(b"this is no database" * 100)
    with pytest.raises(
        BadInputError,
        match=r"journal\.sqlite: damaged: file is not a database; nothing was changed",
    ):
        Store(tmp_path)


def test_a_torn_transaction_is_rolled_back(tmp_path):
    with Store(tmp_path) as store:
        store.add([outcome(1)])
    script = (
        "import os, sqlite3, sys\n"
        "database = sqlite3.connect(sys.argv[1])\n"
        "database.execute('pragma cache_size = 1')\n"
        "database.execute('pragma cache_spill = 1')\n"
        "rows = [(f'x{i}', 'ok', '', 1.0, '{}' * 200, '{}', '') for i in range(5000)]\n"
        "database.executemany('insert into outcome values (?,?,?,?,?,?,?)', rows)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path / JOURNAL)], check=False)
    assert (tmp_path / f"{JOURNAL}-journal").exists()
    with Store(tmp_path) as store:
        assert store.finished() == {outcome(1).case_id}
        assert store._database.execute("pragma integrity_check").fetchone() == ("ok",)


def test_the_folder_is_held_by_one_run(tmp_path):
    assert not is_running(tmp_path)
    with run_lock(tmp_path):
        assert is_running(tmp_path)
        with (
            pytest.raises(
                BadInputError, match=f"another run is using this folder.*process {os.getpid()}"
            ),
            run_lock(tmp_path),
        ):
            pass
        # Refused from another process too, even after this one was asked twice.
        program = (
            "import sys; from pathlib import Path; from uqharness.campaign.store import"
            " is_running, run_lock\nprint(is_running(Path(sys.argv[1])))\nwith"
            " run_lock(Path(sys.argv[1])): pass"
        )
        done = subprocess.run(
            [sys.executable, "-c", program, str(tmp_path)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stdout == "True\n"
        assert f"another run is using this folder (process {os.getpid()} on " in done.stderr
    assert not is_running(tmp_path)
    with run_lock(tmp_path):
        pass


def test_a_read_only_folder_is_refused(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    tmp_path.chmod(0o500)
    with pytest.raises(BadInputError, match="choose another --out"), run_lock(tmp_path):
        pass


CAMPAIGN = {
    "campaign": {"aircraft": "plane", "mission": "m.xml", "seed": 7},
    "aleatory": {"flights": 4, "duration_s": 60.0, "sensor_noise": True},
    "epistemic": {"method": "none"},
}


def manifest(**changes):
    base = {
        "format": 2,
        "state": "running",
        "command": "",
        "seed": 7,
        "cases": 4,
        "campaign": checked_settings(CAMPAIGN),
        "versions": {"uqharness": "0.1.0", "jsbsim": "1.3.3", "numpy": "2.4.6", "pyarrow": "26"},
        "hashes": {"aircraft": "a" * 64, "script": "b" * 64},
    }
    return base | changes


@pytest.mark.parametrize(
    ("change", "listed"),
    [
        (
            {"versions": manifest()["versions"] | {"jsbsim": "1.4.0"}},
            "jsbsim 1.3.3 then, 1.4.0 now",
        ),
        (
            {"hashes": {"aircraft": "c" * 64, "script": "b" * 64}},
            r"content of the aircraft \(plane\) has changed: aaaaaaaaaaaa",
        ),
        (
            {"hashes": {"aircraft": "a" * 64, "script": "c" * 64}},
            r"content of the script \(m.xml\) has changed",
        ),
        (
            {"campaign": {**manifest()["campaign"], "aleatory": {"flights": 8}}},
            r"\[aleatory\] flights was 4, is 8",
        ),
    ],
)
def test_each_difference_is_named(tmp_path, change, listed):
    with pytest.raises(BadInputError, match=listed):
        refuse_if_different(tmp_path, manifest(), manifest(**change))


def test_differences_that_change_no_flight_are_allowed(tmp_path):
    moved = {
        **manifest()["campaign"],
        "campaign": {"aircraft": "../plane", "mission": "m.xml", "seed": 7},
    }
    refuse_if_different(tmp_path, manifest(), manifest(campaign=moved, state="complete"))
    refuse_if_different(
        tmp_path, manifest(), manifest(versions=manifest()["versions"] | {"pyarrow": "27"})
    )
