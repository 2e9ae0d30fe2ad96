"""Memory of tables: made-up shards are like those that are flown, and a million flights fit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from campaigns.excursions.full_size import HOME as EXCURSIONS
from campaigns.excursions.full_size import plan as excursions
from campaigns.library import memory
from campaigns.library.store import cell_table, records, shard_table
from uqharness.files import PROJECT_ROOT


def test_made_up_shards_are_like_those_that_are_flown(tmp_path):
    plan = excursions().with_flights(25)
    condition = plan.condition(memory.CELL)
    assert memory.fill(plan, tmp_path / "shards", condition) == 1600
    ours, theirs = (
        shard_table(folder, next(iter(plan.only([memory.CELL]))))
        for folder in (tmp_path / "shards", EXCURSIONS / "shards")
    )
    assert ours.schema.equals(theirs.schema)
    assert ours.num_rows == theirs.num_rows
    frame, _ = cell_table(plan, tmp_path / "shards", condition)
    flown, _ = cell_table(plan, EXCURSIONS / "shards", condition)
    assert list(frame.dtypes.items()) == list(flown.dtypes.items())
    assert frame.groupby("epistemic_id")["cross_track_median_m"].median().nunique() > 8
    sizes = [one.memory_usage(deep=True).sum() / len(one) for one in (frame, flown)]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.05)
    assert 1_000_000 * sizes[1] < 300e6, "bytes of a million rows"


def test_flights_that_end_early_are_among_them(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "ENDS_EARLY", 0.1)
    plan = excursions().with_flights(25)
    condition = plan.condition(memory.CELL)
    memory.fill(plan, tmp_path / "shards", condition)
    frame, (line,) = cell_table(plan, tmp_path / "shards", condition)
    ended = frame["status"] != "ok"
    assert 80 < ended.sum() == line.failed < 240
    assert frame.loc[ended, "cross_track_median_m"].isna().all()
    assert np.isclose(line.hours, frame["duration_s"].sum() / 3600.0)
    assert records(tmp_path / "shards", condition)[0] == line


def test_the_peak_decides_the_exit_code(monkeypatch, capsys):
    monkeypatch.setattr(memory, "corners", lambda folder, flights: flights)
    for allowed, code in ((1e6, 0), (1.0, 1)):
        monkeypatch.setattr(memory, "ALLOWED_MB", allowed)
        assert memory.main(["corners", "--flights", "64000"]) == code
    assert "tables of 64000 flights" in capsys.readouterr().out
    assert memory.main(["corners", "--flights", "10"]) == 2


def peak_mb(kind: str, flights: int) -> float:
    """Of a process of its own."""
    words = [sys.executable, "-m", "campaigns.library.memory", kind, "--flights", str(flights)]
    done = subprocess.run(words, cwd=PROJECT_ROOT, capture_output=True, text=True, check=True)
    return float(done.stdout.partition(" flights, ")[2].split()[0])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["corners", "walks"])
def test_tables_of_a_million_flights_fit_into_2_gb(kind):
    assert peak_mb(kind, 1_000_000) <= memory.ALLOWED_MB
