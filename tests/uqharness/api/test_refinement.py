"""Refinement in Python asks what the command asks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import uqharness as uq
from sysid.record import FlightRecord
from uqharness.api import refinement
from uqharness.cli.main import main


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list:
    """What refinements were asked for, their flights read; none is made."""
    found = []

    def refine(request, say):
        found.append((request, [FlightRecord.read(p) for p in (*request.train, *request.test)]))
        return SimpleNamespace(document={"verdict": "none"})

    monkeypatch.setattr("uqharness.refinement.run.refine", refine)
    monkeypatch.setattr("uqharness.cli.refine.refine", refine)
    monkeypatch.setattr("uqharness.cli.refine.write_results", lambda *a: None)
    monkeypatch.setattr("uqharness.cli.refine.write_report", lambda *a, **k: SimpleNamespace(text=""))
    monkeypatch.setattr(refinement, "write_results", lambda *a: None)
    monkeypatch.setattr(refinement, "write_report", lambda *a, **k: None)
    return found


def test_it_asks_what_the_command_asks(asked: list, tmp_path: Path):
    files = [tmp_path / f"{name}.parquet" for name in "ab"]
    for seed, path in enumerate(files):
        uq.fly("espaaro", "trim", duration_s=3, noise=True, seed=seed).write(path)
    words = ["--train", str(files[0]), "--test", str(files[1]), "--out", str(tmp_path / "out"), "--no-pbox", "--workers", "1"]
    assert main(["refine", "espaaro", *words]) == 0
    uq.refine("espaaro", train=files[0], test=[str(files[1])], out=tmp_path / "out", pbox=False, workers=1)
    command, python = (request for request, _ in asked)
    assert replace(command, command=()) == replace(python, command=())
    assert python.command == ("uqharness", "refine", "espaaro", "--train", "a.parquet", "--test", "b.parquet")


def test_flights_in_memory_are_handed_on(asked: list, tmp_path: Path):
    flights = [uq.fly("espaaro", "trim", duration_s=3, noise=True, seed=seed) for seed in range(3)]
    flights[2].write(tmp_path / "file.parquet")
    uq.refine("espaaro", train=flights[:2], test=tmp_path / "file.parquet", out=tmp_path / "deep" / "out", servos="ideal")
    request, records = asked[0]
    assert [path.name for path in request.train] == ["trim.parquet", "trim-2.parquet"]
    assert request.ideal_servos
    for record, flight in zip(records, flights, strict=True):
        assert record["q_radps"].tolist() == flight["q_radps"].tolist()
    assert not request.train[0].exists()
    assert (tmp_path / "deep" / "out").is_dir()


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"workers": 0}, "BadInputError", "workers = 0"),
        ({"servos": "slow"}, "BadInputError", "servos = 'slow'"),
        ({"campaign": "c.toml", "pbox": False}, "BadInputError", "leave out one"),
        ({"train": []}, "BadInputError", "at least one flight"),
        ({"effects": "nowhere.toml"}, "LogError", r"nowhere\.toml"),
        ({"out": __file__}, "BadInputError", "no folder"),
    ],
)
def test_bad_input_is_said(asked: list, tmp_path: Path, wrong: dict, error: str, message: str):
    given = {"train": tmp_path / "a.parquet", "test": tmp_path / "b.parquet", "out": tmp_path / "out"}
    with pytest.raises(getattr(uq, error), match=message):
        uq.refine("espaaro", **(given | wrong))
    assert asked == []
