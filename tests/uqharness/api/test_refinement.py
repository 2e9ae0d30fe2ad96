"""Refinement in Python asks what the command asks."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

import uqharness as uq
from sysid.record import FlightRecord
from tests.helpers.report_folders import refinement
from uqharness.cli.main import main
from uqharness.commands import refinement as commands
from uqharness.results.refinement import Refinement


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list:
    """What refinements were asked for, their flights read; none is made."""
    # The stand-ins are this process's own: nothing may run in a worker.
    monkeypatch.setenv("UQHARNESS_SUPERVISED", str(os.getpid()))
    result = []

    def refine(job, callback):
        result.append((job, [FlightRecord.read(p) for p in (*job.train, *job.test)]))
        return SimpleNamespace(document=Refinement(**refinement()))

    page = SimpleNamespace(verdict=["found"], path=Path("report.html"))
    monkeypatch.setattr(commands, "run_refinement", refine)
    monkeypatch.setattr(commands, "write_results", lambda *a: None)
    monkeypatch.setattr(commands, "write_report", lambda *a: page)
    return result


def test_flights_in_memory_are_handed_on(requests: list, tmp_path: Path):
    flights = [uq.fly("espaaro", "trim", duration_s=3, noise=True, seed=seed) for seed in range(3)]
    flights[2].write(tmp_path / "file.parquet")
    uq.refine(
        "espaaro",
        train=flights[:2],
        test=tmp_path / "file.parquet",
        out=tmp_path / "deep" / "out",
        servos="ideal",
    )
    job, records = requests[0]
    assert [path.name for path in job.train] == ["trim.parquet", "trim-2.parquet"]
    assert job.ideal_servos
    for record, flight in zip(records, flights, strict=True):
        assert record["q_radps"].tolist() == flight["q_radps"].tolist()
    assert not job.train[0].exists()
    # No command reads what is in memory.
    assert job.command == ()
    assert not (tmp_path / "deep").exists()


@pytest.mark.parametrize(
    ("invalid", "error", "message"),
    [
        ({"train": []}, "BadInputError", "at least one flight"),
        ({"effects": "nowhere.toml"}, "LogError", r"nowhere\.toml"),
        ({"out": __file__}, "BadInputError", "no folder"),
        ({"train": 5}, "BadInputError", "train = 5: at least one flight"),
        (
            {"workers": "2"},
            "BadInputError",
            "workers = '2': a whole number of at least 1 is needed",
        ),
        ({"on_stage": 3}, "BadInputError", "on_stage = 3"),
        ({"effects": 3}, "BadInputError", "effects = 3"),
    ],
)
def test_bad_input_is_said(requests: list, tmp_path: Path, invalid: dict, error: str, message: str):
    inputs = {
        "aircraft": "espaaro",
        "train": tmp_path / "a.parquet",
        "test": tmp_path / "b.parquet",
        "out": tmp_path / "out",
    }
    with pytest.raises(getattr(uq, error), match=message):
        uq.refine(**(inputs | invalid))
    assert requests == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("way", ["python", "command"])
def test_flights_that_cannot_be_used_leave_no_folder(way: str, tmp_path: Path):
    file, out = tmp_path / "a.parquet", tmp_path / "out"
    uq.fly("espaaro", "trim", duration_s=3, noise=True).write(file)
    for test, message in ((tmp_path / "none.parquet", r"none\.parquet"), (file, "the same flight")):
        if way == "python":
            with pytest.raises((uq.BadInputError, uq.LogError), match=message):
                uq.refine("espaaro", train=file, test=test, out=out)
        else:
            assert (
                main(
                    [
                        "refine",
                        "espaaro",
                        "--train",
                        str(file),
                        "--test",
                        str(test),
                        "--out",
                        str(out),
                    ]
                )
                == 2
            )
        assert not out.exists()
