"""How far a campaign is, from its folder; its tables, and what happens to one that was changed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.helpers import campaign_fakes as fakes
from uqharness.campaign.manifest import MANIFEST, DamageError, read_manifest, write_manifest
from uqharness.campaign.processes import SerialExecutor
from uqharness.campaign.read_spec import read_campaign
from uqharness.campaign.run import run_campaign
from uqharness.campaign.shards import read_status
from uqharness.campaign.store import JOURNAL
from uqharness.errors import BadInputError

pytestmark = pytest.mark.usefixtures("flights_here")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two walks of three flights."""
    root = tmp_path_factory.mktemp("walks")
    text = fakes.CAMPAIGN.replace('"corners"', '"walk"\nsamples = 2\nwalk_rate_per_sqrt_s = 0.01')
    spec = read_campaign(fakes.campaign_file(root, text))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uqharness.campaign.run.validate_model", lambda fly, case: None)
        run_campaign(spec, root / "out", executor=SerialExecutor(), fly=fakes.steady)
    return root / "out"


@pytest.fixture
def folder(flown: Path, tmp_path: Path) -> Path:
    shutil.copytree(flown, tmp_path / "copy")
    return tmp_path / "copy"


def test_a_complete_campaign(folder: Path) -> None:
    found = read_status(folder)
    assert (found.state, found.cases, found.done) == ("complete", 6, 6)
    assert dict(found.statuses) == {"ok": 6}
    assert found.answers


def test_one_that_nobody_holds_was_interrupted(folder: Path) -> None:
    manifest = {key: value for key, value in read_manifest(folder).items() if key != "digest"}
    write_manifest(folder, manifest | {"state": "running"})
    assert read_status(folder).state == "interrupted"


def test_a_journal_that_lost_flights_is_damaged(folder: Path) -> None:
    manifest = {key: value for key, value in read_manifest(folder).items() if key != "digest"}
    write_manifest(folder, manifest | {"journal": manifest["journal"] | {"rows": 7}})
    with pytest.raises(DamageError, match="6 flights are in it, the manifest lists 7"):
        read_status(folder)


def test_a_folder_without_a_campaign(folder: Path) -> None:
    (folder / MANIFEST).write_text(json.dumps({"format": 9}))
    with pytest.raises(BadInputError):
        read_status(folder)
    (folder / MANIFEST).unlink()
    with pytest.raises(BadInputError):
        read_status(folder)


def test_the_journal_of_an_old_folder_must_be_there(folder: Path) -> None:
    manifest = {key: value for key, value in read_manifest(folder).items() if key != "digest"}
    (folder / MANIFEST).write_text(json.dumps(manifest | {"format": 1}))
    (folder / JOURNAL).unlink()
    with pytest.raises(BadInputError, match=r"made by uqharness 0\.1"):
        read_status(folder)
