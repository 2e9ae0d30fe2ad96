"""Single flipped bits of a campaign's folder are without effect or found; the tool that says so
would see one that is not.
"""

from __future__ import annotations

import json
import random
from collections import Counter

import pytest

from tests.helpers import bit_flips
from uqharness.campaign.processes import CaseOutcome
from uqharness.campaign.store import Store

pytestmark = pytest.mark.usefixtures("flights_here")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("flips")


@pytest.mark.parametrize("flips", [6, pytest.param(800, marks=pytest.mark.slow)])
def test_no_flip_is_silent(root, flips):
    said = []
    found = bit_flips.run(flips, 20161201, root, said.append)
    assert said == []
    counted = sum(found.values(), Counter())
    assert counted.total() == flips
    assert counted[bit_flips.FOUND] > 0.4 * flips
    assert counted[bit_flips.NO_EFFECT] > 0.1 * flips
    assert len(found) > min(10, flips // 3)


def test_a_reader_that_believes_everything_is_seen(root, monkeypatch):
    """The tool's own no: the same flips in journals whose rows are not held against their
    digests.
    """
    with bit_flips.harmless():
        folders = [
            folder
            for folder in bit_flips.make_folders(root / "made")
            if folder.path.name == "unfinished"
        ]
        reference = bit_flips.look(folders[0], bit_flips.copied(folders[0], root / "copy"))
        monkeypatch.setattr(Store, "_tally", lambda self: (Counter(), ""))
        monkeypatch.setattr(Store, "outcomes", believed)
        seen = Counter()
        chance = random.Random(2)
        for _ in range(5):
            place = bit_flips.copied(folders[0], root / "copy")
            content = (place / "journal.sqlite").read_bytes()
            digits = content.index(b'"altitude_max_m": ', chance.randrange(len(content) // 2)) + 24
            bit_flips.flip(place / "journal.sqlite", 8 * digits)
            seen[bit_flips.judge(bit_flips.look(folders[0], place, False), reference)] += 1
    assert seen[bit_flips.SILENT] > 3


def believed(self):
    for row in self._database.execute("select * from outcome order by case_id"):
        yield CaseOutcome(*row[:4], json.loads(row[4]), json.loads(row[5]))


@pytest.mark.parametrize("traceback", ["", "run: KeyError: 'x'"])
def test_outcomes(traceback):
    reference = bit_flips.Seen({"status": "a", "cases.parquet": b"1"}, ())
    same = bit_flips.Seen({"status": "a"}, (), traceback)
    assert bit_flips.judge(same, reference) == (
        bit_flips.TRACEBACK if traceback else bit_flips.NO_EFFECT
    )
    assert (
        bit_flips.judge(bit_flips.Seen({"status": "b"}, ("verify",)), reference) == bit_flips.SILENT
    )
    assert (
        bit_flips.judge(bit_flips.Seen({"status": "a"}, ("verify", "run")), reference)
        == bit_flips.FOUND
    )
    assert (
        bit_flips.judge(bit_flips.Seen({}, ("verify", "run"), changed=True), reference)
        == bit_flips.SILENT
    )
    assert bit_flips.judge(bit_flips.Seen({}, ("run",)), reference) == bit_flips.SILENT
