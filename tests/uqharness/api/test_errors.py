"""The errors of the public face are those that the packages raise."""

from __future__ import annotations

from pathlib import Path

import pytest

import sysid
import uqharness as uq
from uqharness.errors import BadInputError, LogError


def test_they_are_the_packages_own():
    assert uq.BadInputError is BadInputError
    assert uq.LogError is LogError is sysid.LogError


def test_they_are_caught_by_these_names(tmp_path: Path):
    with pytest.raises(uq.BadInputError, match="not found"):
        uq.find_aircraft("no-such-aircraft")
    with pytest.raises(uq.LogError, match="nowhere"):
        sysid.read_model_form(tmp_path / "nowhere.json")
