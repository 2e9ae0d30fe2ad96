"""A campaign that was flown by the command."""

from __future__ import annotations

import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.cli.main import run_words


@pytest.fixture
def flown(tmp_path, monkeypatch):
    """Folder with campaign.toml and out, the results."""
    monkeypatch.setattr("uqharness.flight.fly.fly", fakes.steady)
    path = fakes.campaign_file(tmp_path)
    assert (
        run_words(["campaign", "run", str(path), "--out", str(tmp_path / "out"), "--serial"]) == 0
    )
    return tmp_path
