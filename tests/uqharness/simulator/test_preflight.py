"""A model is loaded in a process of its own before it is loaded here, once for each content."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.child_process import Ended
from uqharness.errors import BadInputError
from uqharness.simulator import preflight
from uqharness.simulator.aircraft import find_aircraft

AIRCRAFT = find_aircraft("espaaro")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(preflight, "_checked", set())
    return tmp_path / "uqharness" / "loadable"


def ends(monkeypatch: pytest.MonkeyPatch, ended: Ended) -> list[tuple[object, ...]]:
    asked: list[tuple[object, ...]] = []

    def run_module(module: str, *arguments: object, timeout_s: float) -> Ended:
        asked.append(arguments)
        assert module == "uqharness.simulator.preflight"
        return ended

    monkeypatch.setattr(preflight, "run_module", run_module)
    return asked


def test_a_model_that_loads_is_loaded_once_and_remembered(
    cache: Path, monkeypatch: pytest.MonkeyPatch
):
    asked = ends(monkeypatch, Ended(0, {}, "", ""))
    preflight.ensure_loadable(AIRCRAFT, "content")
    preflight.ensure_loadable(AIRCRAFT, "content")
    monkeypatch.setattr(preflight, "_checked", set())  # another process
    preflight.ensure_loadable(AIRCRAFT, "content")
    assert len(asked) == 1
    assert [path.name.partition("-")[0] for path in cache.iterdir()] == ["content"]
    preflight.ensure_loadable(AIRCRAFT, "other")
    assert len(asked) == 2


@pytest.mark.parametrize(
    ("ended", "said"),
    [
        (Ended(None, {}, "", ""), "JSBSim did not finish loading it within 20 s"),
        (
            Ended(-11, {}, "Unknown function", ""),
            r"ends JSBSim's process \(signal 11 \(SIGSEGV\)\); its last words: Unknown function;",
        ),
        (Ended(-6, {}, "", ""), "its last words: no message;"),
        (Ended(0, {"refused": "no <mass_balance>"}, "", ""), "espaaro: no <mass_balance>"),
    ],
)
def test_one_that_does_not_is_named_and_not_remembered(
    cache: Path, monkeypatch: pytest.MonkeyPatch, ended: Ended, said: str
):
    asked = ends(monkeypatch, ended)
    for _ in range(2):
        with pytest.raises(BadInputError, match=said):
            preflight.ensure_loadable(AIRCRAFT, "content")
    assert len(asked) == 2
    assert not cache.exists()


def test_the_child_loads_the_real_thing_and_refuses_what_is_none(cache: Path, tmp_path: Path):
    preflight.ensure_loadable(AIRCRAFT, "content")
    folder = tmp_path / "empty"
    folder.mkdir()
    (folder / "empty.xml").write_text("<fdm_config name='empty' version='2.0'/>")
    empty = preflight._Unread(
        folder, folder / "empty.xml", AIRCRAFT.engine_path, AIRCRAFT.systems_path
    )
    with pytest.raises(BadInputError, match="empty"):
        preflight.ensure_loadable(empty, "empty")
