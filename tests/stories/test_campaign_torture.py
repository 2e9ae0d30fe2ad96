"""Kill whatever flies a campaign, at random moments and in the middle of its writes: the end is
that of the undisturbed run.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from tests.helpers import campaign_fakes as fakes
from tests.helpers.places import ROOT
from uqharness.campaign.processes import ProcessExecutor, SerialExecutor
from uqharness.campaign.run import run_campaign
from uqharness.campaign.store import Store
from uqharness.campaign.tables import CASES
from uqharness.errors import BadInputError

TABLES = (CASES, "pbox.parquet", "excursions.csv")
LOCAL, DASK = ("parent", "worker"), ("parent on dask", "dask worker", "child of a dask worker")
WRITES = ("journal", "table")


@pytest.fixture
def cluster():
    with fakes.dask_cluster() as result:
        yield result


def finished(out):
    try:
        with Store(out, read_only=True) as store:
            return len(store.finished())
    except BadInputError:
        return 0


class Victim:
    """A campaign that flies in another process, here or on the cluster, and what of it may be
    killed.
    """

    def __init__(self, folder, cluster, flights):
        self.folder, self.out, self.cluster, self.flights = folder, folder / "out", cluster, flights
        self.process, self.on_dask = None, False

    def start(self, on_dask, moment=None):
        options = self.cluster.scheduler_address if on_dask else "fork"
        words = [
            sys.executable,
            "-m",
            "tests.helpers.torture",
            str(self.folder),
            str(self.out),
            str(self.flights),
            "slow",
            options,
        ]
        self.process = subprocess.Popen(
            [*words, *([moment] if moment else [])], cwd=ROOT, stderr=subprocess.DEVNULL
        )
        self.on_dask = on_dask

    def flying(self, on_dask):
        """Have it fly there; a run that is elsewhere is killed, which counts for nothing."""
        if self.process is None or self.process.poll() is not None or self.on_dask != on_dask:
            self.end()
            self.start(on_dask)

    def await_progress(self):
        before, deadline = finished(self.out), time.monotonic() + 60
        while (
            finished(self.out) <= before
            and self.process.poll() is None
            and time.monotonic() < deadline
        ):
            time.sleep(0.02)

    def end(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def kill(self, kind, chance):
        """True if something was there to be killed."""
        self.flying(kind in DASK)
        self.await_progress()
        time.sleep(chance.uniform(0.0, 0.2))
        if self.process.poll() is not None:
            return False
        if kind.startswith("parent"):
            self.process.kill()
            self.process.wait()
            return True
        if kind == "worker":
            targets = children(self.process.pid)
        else:
            nannies = [nanny.pid for nanny in self.cluster.workers.values() if nanny.pid]
            targets = (
                nannies
                if kind == "dask worker"
                else [child for pid in nannies for child in children(pid)]
            )
        if not targets:
            return False
        os.kill(chance.choice(targets), signal.SIGKILL)
        return True

    def tear(self, kind, chance, number):
        """Let it run into its own end in the middle of a write; for a table that is its
        last act.
        """
        self.end()
        self.start(False, f"{kind}:{number}")
        self.process.wait(120)
        return self.process.returncode == -signal.SIGKILL


def children(pid):
    try:
        result = psutil.Process(pid).children()
        return [
            child.pid for child in result if "resource_tracker" not in " ".join(child.cmdline())
        ]
    except psutil.Error:
        return []


def torture(folder, cluster, flights, kills, seed):
    """Names of the kills that hit."""
    chance = random.Random(seed)
    victim = Victim(folder, cluster, flights)
    hit = []
    try:
        for kind in kills:
            result = (
                victim.tear(kind, chance, chance.randint(1, 2))
                if kind in WRITES
                else victim.kill(kind, chance)
            )
            hit += [kind] if result else []
        victim.end()
        # Killed among the tables, of which the last run writes a manifest and three, or at the
        # manifest that says complete.
        victim.start(False, f"table:{chance.randint(2, 5)}")
        victim.process.wait(300)
        hit += ["table"] if victim.process.returncode == -signal.SIGKILL else []
    finally:
        victim.end()
    return hit


def check(tmp_path, flights, at_least, hit, options="spawn"):
    spec = fakes.small_spec(tmp_path, flights)
    summary = run_campaign(
        spec, tmp_path / "out", executor=ProcessExecutor(2, options), fly=fakes.steady
    )
    assert summary.statuses == {"ok": 64 * flights}
    run_campaign(spec, tmp_path / "undisturbed", executor=SerialExecutor(), fly=fakes.steady)
    for name in TABLES:
        assert (tmp_path / "out" / name).read_bytes() == (
            tmp_path / "undisturbed" / name
        ).read_bytes(), name
    remaining = {path.name for path in (tmp_path / "out").iterdir()} - {
        path.name for path in (tmp_path / "undisturbed").iterdir()
    }
    assert all(name.endswith(".part") for name in remaining), remaining
    assert len(hit) >= at_least, hit


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_disk_that_fills_up_is_a_sentence_and_the_same_command_goes_on(tmp_path):
    spec, out = fakes.small_spec(tmp_path, 2), tmp_path / "out"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    retained = []

    def fill(progress):
        # No file may grow any more: what a full disk does, without filling one.
        retained.append(progress.done)
        resource.setrlimit(
            resource.RLIMIT_FSIZE, ((out / "journal.sqlite").stat().st_size, before[1])
        )

    try:
        with pytest.raises(
            BadInputError,
            match=r"journal\.sqlite: cannot write: .*kept: free space .* same command again",
        ):
            run_campaign(
                spec, out, executor=ProcessExecutor(2, "fork"), fly=fakes.slow, on_progress=fill
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert finished(out) == retained[-1] < 128
    check(tmp_path, 2, 0, [], "fork")


@pytest.mark.skipif(
    not Path("/sys/kernel").is_dir(), reason="no file system at hand on which nobody may write"
)
def test_a_folder_that_nobody_may_write_is_refused(tmp_path):
    spec = fakes.small_spec(tmp_path)
    with pytest.raises(
        BadInputError,
        match=r"/sys/kernel: not empty and not a campaign folder .*choose another --out",
    ):
        run_campaign(spec, "/sys/kernel", executor=SerialExecutor(), fly=fakes.steady)
    with pytest.raises(
        BadInputError, match=r"/sys/kernel/campaign: cannot be made: .*choose another --out"
    ):
        run_campaign(spec, "/sys/kernel/campaign", executor=SerialExecutor(), fly=fakes.steady)
    empty = next(
        (
            place
            for place in Path("/sys/kernel").iterdir()
            if place.is_dir() and not any(place.iterdir())
        ),
        None,
    )
    if empty is not None:
        with pytest.raises(
            BadInputError, match=rf"{empty}.*: cannot be written: .*choose another --out"
        ):
            run_campaign(spec, empty, executor=SerialExecutor(), fly=fakes.steady)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(64, 69))
def test_twenty_kills_at_random(tmp_path, cluster, seed):
    fakes.campaign_file(tmp_path)
    chance = random.Random(seed)
    kills = [*LOCAL, *DASK, "journal", *chance.choices([*LOCAL, *DASK, "journal"], k=18)]
    chance.shuffle(kills)
    hit = torture(tmp_path, cluster, 60, kills, seed=seed - 57)
    check(tmp_path, 60, 20, hit)
    assert set(hit) == {*LOCAL, *DASK, *WRITES}
