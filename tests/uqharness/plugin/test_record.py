"""What an instrumentation did, written, read and taken back to the byte."""

from __future__ import annotations

import json

import pytest

from sysid.foreign.regular_files import sha256_hex
from uqharness.errors import BadInputError
from uqharness.plugin.instrument import FILE_NAME, make_change, read_record, restore, to_json
from uqharness.xml.document import Insertion

BEFORE = b"<a>\n <b/>\n <c/>\n</a>\n"
INSERTIONS = [Insertion(11, b" <uq/two/>\n"), Insertion(4, b" <uq/one>\n", b" <b/>\n")]


def edited() -> bytes:
    out = BEFORE
    for item in sorted(INSERTIONS, key=lambda i: -i.at):
        out = out[: item.at] + item.text + out[item.at + len(item.removed) :]
    return out


def test_a_record_comes_back(tmp_path):
    changes = {
        "plane.xml": make_change(BEFORE, edited(), INSERTIONS),
        "Systems/new.xml": make_change(None, b"new"),
        "old.xml": make_change(b"\xff", b"x"),
    }
    (tmp_path / FILE_NAME).write_bytes(to_json(changes))
    assert read_record(tmp_path) == changes
    assert changes["plane.xml"].edited
    assert not changes["old.xml"].edited
    assert [i.at for i in changes["plane.xml"].insertions] == [4, 11]


def test_undoing_gives_every_byte_back(tmp_path):
    change = make_change(BEFORE, edited(), INSERTIONS)
    assert edited() != BEFORE
    assert restore(tmp_path / "a.xml", change, edited()) == BEFORE
    assert restore(tmp_path / "new.xml", make_change(None, b"new"), b"new") is None
    assert restore(tmp_path / "old.xml", make_change(b"old", b"x"), b"whatever") == b"old"


def test_an_authors_later_change_elsewhere_stays(tmp_path):
    change = make_change(BEFORE, edited(), INSERTIONS)
    now = edited().replace(b"</a>", b" <mine/>\n</a>")
    assert restore(tmp_path / "a.xml", change, now) == BEFORE.replace(b"</a>", b" <mine/>\n</a>")
    for touched in (now.replace(b"<uq/one>", b"<uq/ONE>"), now + b" <uq/two/>\n"):
        with pytest.raises(BadInputError, match="changed since it was instrumented"):
            restore(tmp_path / "a.xml", change, touched)


def test_a_record_of_another_file_does_not_fit(tmp_path):
    change = make_change(BEFORE.replace(b"<c/>", b"<d/>"), edited(), INSERTIONS)
    assert change.after == sha256_hex(edited())
    with pytest.raises(BadInputError, match="does not fit this file"):
        restore(tmp_path / "a.xml", change, edited())


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"format": "instrument 9", "files": {}}, "format is 'instrument 9'"),
        ([], "is no record"),
        ({"files": {}}, "is no record"),
        *(
            (
                {"format": "instrument 1", "files": {name: {"before": "", "after": ""}}},
                "no file that an instrumentation makes",
            )
            for name in ("../a.xml", "/a.xml", "C:a.xml", ".hidden", "a//b", "a\\b", FILE_NAME)
        ),
        (
            {
                "format": "instrument 1",
                "files": {"a": {"before": "", "after": "", "insertions": [[-1, "x", ""]]}},
            },
            "before its file",
        ),
        (
            {"format": "instrument 1", "files": {"a": {"before": 3, "after": ""}}},
            "a hash is no text",
        ),
    ],
    ids=str,
)
def test_a_strangers_record_is_refused(tmp_path, document, said):
    (tmp_path / FILE_NAME).write_text(json.dumps(document))
    with pytest.raises(BadInputError, match=said):
        read_record(tmp_path)


def test_a_folder_without_a_record(tmp_path):
    with pytest.raises(BadInputError, match="nothing here was instrumented"):
        read_record(tmp_path)
