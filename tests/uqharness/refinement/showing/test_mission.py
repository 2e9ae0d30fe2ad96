"""An earlier refinement's campaign: it goes where its model was another, and stays where that
cannot be told.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.refinement import mission


def refused(*given: object) -> None:
    raise BadInputError("another model")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An earlier campaign of a hundred flights, whose manifest says the same as today's."""
    monkeypatch.setattr(mission, "read_manifest", lambda folder: {})
    monkeypatch.setattr(mission, "find_mission", lambda spec, folder: None)
    monkeypatch.setattr(mission, "describe", lambda *given: {})
    monkeypatch.setattr(mission, "refuse_if_different", lambda *given: None)
    monkeypatch.setattr(mission, "has_digests", lambda manifest: True)
    for name in (mission.MANIFEST, "cases.parquet"):
        (tmp_path / name).write_text("a hundred flights")
    return tmp_path


def test_the_same_campaign_goes_on(folder: Path) -> None:
    mission._clear_if_other(folder, None)
    assert (folder / "cases.parquet").is_file()


def test_that_of_another_model_is_removed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mission, "refuse_if_different", refused)
    mission._clear_if_other(folder, None)
    assert not folder.exists()


def test_a_mission_that_cannot_be_flown_removes_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mission, "find_mission", refused)
    with pytest.raises(BadInputError, match="another model"):
        mission._clear_if_other(folder, None)
    assert (folder / "cases.parquet").is_file()
