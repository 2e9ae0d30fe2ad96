"""docs/architecture.md and its picture name the rooms that there are; dotted names of every page
lead somewhere.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.architecture.rooms import LAYERS
from tests.helpers.doc_examples import pages
from tests.helpers.doc_names import wrong_folders, wrong_names, wrong_places
from tests.helpers.places import ROOT

DOCS = ROOT / "docs"
PAGE = (DOCS / "architecture.md").read_text(encoding="utf-8")
PAGES = [
    *pages(),
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    *sorted((ROOT / "campaigns").glob("*/README.md")),
]


def rooms(package: str) -> set[str]:
    """Names of a package's own packages."""
    return {path.parent.name for path in (ROOT / package).glob("*/__init__.py")}


@pytest.fixture
def drawing(monkeypatch: pytest.MonkeyPatch):
    """The module that draws the picture."""
    monkeypatch.syspath_prepend(str(DOCS / "figures"))
    import make_rooms

    return make_rooms


def test_files_and_names_of_the_page_exist():
    assert wrong_places(PAGE) == []
    assert wrong_folders(PAGE) == []
    assert len(re.findall(r"`(?:sysid|uqharness)\.", PAGE)) > 40


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_dotted_names_lead_somewhere(page: Path):
    assert wrong_names(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("package", ["sysid", "uqharness"])
def test_every_room_stands_on_the_page_and_in_the_picture(package: str, drawing):
    named = set(re.findall(rf"^\| `{package}\.(\w+)` \|", PAGE, re.M))
    assert named == rooms(package)
    drawn = {name for room in getattr(drawing, package.upper()) for name in room.name.split(", ")}
    assert drawn == rooms(package) | {"base"}


@pytest.mark.parametrize("package", ["sysid", "uqharness"])
def test_page_picture_and_contributors_page_have_the_layers_in_their_order(package: str, drawing):
    layers = [name for name in LAYERS[package] if name]
    (line,) = re.findall(
        rf"^- {package}: base modules, (.*)[;.]$",
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
        re.M,
    )
    listed = re.findall(rf"^\| `{package}\.(\w+)` \|", PAGE, re.M)
    drawn = [
        name
        for room in reversed(getattr(drawing, package.upper()))
        for name in room.name.split(", ")
    ]
    for found in (line.split(", "), listed, drawn):
        assert [name for name in found if name in layers] == layers


def test_the_picture_is_what_the_script_draws(drawing):
    assert drawing.PICTURE.read_text(encoding="utf-8") == drawing.picture()


def test_what_does_not_exist_is_seen():
    text = (
        "`sysid.logs.load.import_log` `sysid.logs.load.nothing` `uqharness.nowhere`"
        " `uqharness.campaign` `sysid.output_error`"
    )
    assert wrong_names(text) == ["sysid.logs.load.nothing", "uqharness.nowhere"]
    assert wrong_folders("`docs/figures/` `docs/nowhere/`") == ["docs/nowhere/"]
