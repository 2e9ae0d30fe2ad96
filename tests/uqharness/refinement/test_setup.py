"""What a refinement begins with: flights that chose are not asked to prove, and a third of the
manoeuvres confirms the rest.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from uqharness.errors import BadInputError
from uqharness.refinement.estimators import confirming_segments
from uqharness.refinement.run import file_hash, refuse_shared_flights


def test_a_flight_that_chose_is_refused_by_its_content_not_its_name(tmp_path: Path):
    for name, content in (("a.csv", "one"), ("b.csv", "two"), ("copy.csv", "one")):
        (tmp_path / name).write_text(content, encoding="utf-8")
    a, b, copy = (tmp_path / name for name in ("a.csv", "b.csv", "copy.csv"))
    refuse_shared_flights([a], [b])
    with pytest.raises(BadInputError, match=r"copy\.csv: the same flight as --train .*a\.csv"):
        refuse_shared_flights([a, b], [copy])
    with pytest.raises(BadInputError, match="cannot be read"):
        file_hash(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("kinds", "confirms"),
    [
        (["doublet"] * 6, [0, 1, 0, 0, 1, 0]),
        (["doublet", "pull", "doublet", "pull", "turn"], [0, 0, 1, 1, 0]),
        # Of kinds flown once each there is no second one to confirm: every third of all does.
        (["a", "b", "c", "d", "e"], [0, 1, 0, 0, 1]),
        (["a", "b"], [0, 0]),
    ],
)
def test_every_third_manoeuvre_of_a_kind_confirms_beginning_with_the_second(kinds, confirms):
    data = SimpleNamespace(segments=[SimpleNamespace(kind=kind) for kind in kinds])
    assert confirming_segments(data).astype(int).tolist() == confirms
