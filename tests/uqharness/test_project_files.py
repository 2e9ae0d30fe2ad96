"""Files that come with the package, found by name and by path."""

from __future__ import annotations

from pathlib import Path

import pytest

from uqharness.errors import BadInputError
from uqharness.files import PROJECT_ROOT, find_campaign


def test_campaigns_are_found_by_name_and_by_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    demo = PROJECT_ROOT / "campaigns" / "demo" / "campaign.toml"
    for inputs in ("demo", "campaigns/demo", "campaigns/demo/campaign.toml", demo):
        assert find_campaign(inputs) == demo
    specific = tmp_path / "demo" / "campaign.toml"
    specific.parent.mkdir()
    specific.write_text("")
    assert find_campaign("demo").resolve() == specific
    with pytest.raises(BadInputError, match=r"campaign 'demonstration' not found.*there: .*demo"):
        find_campaign("demonstration")


def test_another_file_of_a_folder_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "study.toml").write_text("")
    assert find_campaign("mine", "study.toml") == Path("mine/study.toml")
    with pytest.raises(BadInputError, match=r"no folder with a campaign\.toml"):
        find_campaign("mine")
