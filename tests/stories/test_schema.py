"""The XML files of the project fit JSBSim's schema, and the grammar refuses what that schema
refuses.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.jsbsim_schema import schema_errors
from tests.helpers.places import ROOT

FILES = sorted(
    path for folder in ("aircraft", "scripts") for path in (ROOT / folder).rglob("*.xml")
)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_file_fits(path: Path) -> None:
    errors = schema_errors(path)
    assert not errors, "\n".join(errors)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("aircraft/espaaro/espaaro.xml", "fdm_config", "fdm_configs"),
        ("aircraft/espaaro/espaaro.xml", "</metrics>", "<note/></metrics>"),
        ("aircraft/espaaro/espaaro.xml", "<chord ", "<chords "),
        ("aircraft/espaaro/espaaro.xml", '<axis name="', '<axis nam="'),
        ("aircraft/espaaro/espaaro.xml", "<product>", "<produkt>"),
        ("aircraft/espaaro/espaaro.xml", "<lag>", "<lagg>"),
        ("scripts/loiter.xml", ' end="', ' ends="'),
        ("scripts/loiter.xml", "</run>", "<property>test/x</property></run>"),
    ],
)
def test_faulty_document_is_refused(name: str, old: str, new: str, tmp_path: Path) -> None:
    """Each change takes all places of its text, so the document stays well-formed."""
    text = (ROOT / name).read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "case.xml"
    path.write_text(text.replace(old, new).replace("</" + old[1:], "</" + new[1:]))
    errors = schema_errors(path)
    assert errors
    assert all(f"{path}:" in error for error in errors)
