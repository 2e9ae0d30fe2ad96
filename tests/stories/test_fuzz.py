"""The fuzzer finds what it is there to find, every sound input is read, and fixed seeds of every
format give no findings.
"""

from __future__ import annotations

import json

import pytest

from tests.fuzz.__main__ import main
from tests.fuzz.bad_targets import BAD, GOOD, formats
from tests.fuzz.formats import SOUND, all_formats
from tests.fuzz.harness import Counts, Worker, by_number, run

FORMATS = all_formats()


@pytest.fixture(scope="module")
def bad_worker():
    with Worker("tests.fuzz.bad_targets", limit_s=2.5, limit_mb=280.0) as worker:
        yield worker


@pytest.fixture(scope="module")
def worker():
    with Worker() as result:
        yield result


SAID = {
    "raises": "KeyError",
    "hangs": "no answer",
    "grows": "MB",
    "grows-in-a-child": "MB",
    "writes": "writes",
    "writes-unseen": "leaves",
    "writes-far-away": "uq-fuzz-outside",
    "removes": "removes",
    "leaves": "among temporary files",
    "listens": "socket.bind",
    "listens-in-a-child": "opens the network: tcp",
    "unpickles": "unpickles",
    "runs": "starts",
    "aborts": "SIGABRT",
    "leaves-the-process": "exit code 3",
    "bare-error": "ValueError",
    "says-nothing": "says nothing",
    "names-no-file": "names no file",
    "prints-escapes": "U+001B",
    "prints-bidi": "U+202E",
    "prints-a-traceback": "traceback",
    "says-too-much": "more than a sentence",
    "quotes-everything": "characters",
}


@pytest.mark.parametrize("name", BAD)
def test_bad_targets_are_findings(name, bad_worker):
    result = bad_worker.attempt(name, 1)
    assert result.outcome == "finding"
    assert SAID[name] in result.what


@pytest.mark.parametrize("name", GOOD)
def test_good_targets_are_no_findings(name, bad_worker):
    result = bad_worker.attempt(name, 1)
    assert result.outcome == ("result" if name == "fine" else "refusal"), result.what


def test_the_worker_serves_on_after_each_death(bad_worker):
    for name in ("aborts", "fine", "hangs", "fine"):
        result = bad_worker.attempt(name, 1)
        assert (result.outcome == "result") == (name == "fine")


def test_run_counts_findings():
    counts, reports = {"raises": Counts(), "fine": Counts()}, []
    run(by_number(counts, 7, 3), counts, reports.append, "tests.fuzz.bad_targets")
    assert (counts["raises"].findings, counts["fine"].results) == (3, 3)
    assert [(t.name, t.seed) for t in reports] == [("raises", 7), ("raises", 8), ("raises", 9)]


@pytest.mark.parametrize("name", FORMATS)
def test_a_sound_input_is_read(name, worker):
    """Otherwise nothing behind the first refusal is ever tried."""
    result = worker.attempt(name, SOUND)
    assert result.outcome == "result", result.what


@pytest.mark.parametrize("name", FORMATS)
def test_an_input_follows_from_its_seed(name):
    item = FORMATS[name]
    assert item.make(3) == item.make(3)
    assert (
        len({json.dumps({k: v.hex() for k, v in item.make(seed).items()}) for seed in range(12)})
        > 6
    )


@pytest.mark.parametrize("name", FORMATS)
def test_fixed_seeds_give_no_findings(name, worker):
    # JSBSim's own process is started for each of the flown ones.
    result = [worker.attempt(name, seed) for seed in range(1 if name.endswith("-flown") else 3)]
    assert [f for f in result if f.outcome == "finding"] == []


def test_the_command_line(tmp_path, monkeypatch, capsys):
    def call(*words: str) -> int:
        return main([*words], formats(), "tests.fuzz.bad_targets")

    monkeypatch.chdir(tmp_path)
    assert call("--inputs", "2", "--seed", "5", "--format", "fine", "--json") == 0
    counts = json.loads(capsys.readouterr().out)["formats"]["fine"]
    assert (counts["inputs"], counts["seeds"]) == (2, [5, 6])
    assert call("--inputs", "1", "--format", "fine", "--format", "raises") == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("(raises, 0): ")
    assert captured.out.splitlines()[-1].split()[:5] == ["all", "2", "1", "0", "1"]
    assert call("--reproduce", "raises", "5") == 1
    result = tmp_path / "fuzz-raises-5" / "input.bin"
    assert result.read_bytes() == formats()["raises"].make(5)["input.bin"]
    assert capsys.readouterr().out.splitlines()[1].startswith("finding in")
    with pytest.raises(SystemExit) as remaining:
        call("--reproduce", "nothing", "5")
    assert remaining.value.code == 2
