"""The built pages: complete, without a broken link, nothing fetched from a network, a reference
that is the code's.
"""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.helpers.places import ROOT

pytest.importorskip("sphinx", reason="the documentation's extra is not installed")
pytest.importorskip("myst_parser")
pytest.importorskip("furo")

SITE = ROOT / "docs" / "site"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` builds it."""
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, str(SITE / "build.py"), "--out", str(out)],
        cwd=out,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture
def reference(monkeypatch: pytest.MonkeyPatch):
    """The module that writes the reference."""
    monkeypatch.syspath_prepend(str(SITE))
    import reference

    return reference


def test_a_page_is_listed_once_and_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SITE))
    import build

    pages = re.findall(r"^docs/([\w*-]+)$", build.index(), re.M)
    assert sorted(pages) == sorted(path.stem for path in (ROOT / "docs").glob("*.md"))


class _Fetched(HTMLParser):
    """What a browser loads by itself: scripts, styles, images, fonts."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        inputs = dict(attrs)
        if tag in {"script", "img", "iframe", "source"}:
            self.addresses.append(inputs.get("src") or "")
        if tag == "link" and inputs.get("rel") not in {
            "next",
            "prev",
            "search",
            "index",
            "canonical",
        }:
            self.addresses.append(inputs.get("href") or "")


def test_every_public_name_has_a_chapter(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(SITE))
    import reference_python

    import uqharness

    chapters = [name for names in reference_python.CHAPTERS.values() for name in names]
    assert sorted([*chapters, "sensitivity"]) == sorted(uqharness.__all__)


@pytest.mark.slow
def test_every_page_is_built_and_nothing_is_fetched_from_a_network(site: Path):
    pages = {path.relative_to(site).with_suffix("").as_posix() for path in site.rglob("*.html")}
    assert {f"docs/{path.stem}" for path in (ROOT / "docs").glob("*.md")} <= pages
    assert {
        f"docs/notebooks/{path.stem}" for path in (ROOT / "docs" / "notebooks").glob("*.ipynb")
    } <= pages
    assert {
        f"campaigns/{path.parent.name}/README" for path in (ROOT / "campaigns").glob("*/README.md")
    } <= pages
    assert {"index", "README", "docs/reference/commands", "docs/reference/files"} <= pages
    for path in site.rglob("*.html"):
        parser = _Fetched()
        parser.feed(path.read_text(encoding="utf-8"))
        assert [a for a in parser.addresses if re.match(r"(https?:)?//", a)] == [], path
    for path in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//", path.read_text(encoding="utf-8")), path


@pytest.mark.slow
def test_every_page_can_be_reached_from_the_first(site: Path):
    first = (site / "index.html").read_text(encoding="utf-8")
    pages = {path.relative_to(site).as_posix() for path in site.rglob("*.html")} - {
        "search.html",
        "genindex.html",
        "index.html",
    }
    assert {page for page in pages if f'href="{page}"' not in first} == set()


@pytest.mark.slow
def test_a_broken_link_fails_the_build(tmp_path: Path):
    (tmp_path / "index.md").write_text("# A page\n\n[nowhere](nowhere.md), $x^2$\n")
    words = ["-b", "html", "-W", "-q", "-c", str(SITE), str(tmp_path), str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "nowhere" in done.stderr
    (tmp_path / "index.md").write_text("# A page\n\n$x^2$\n\n$$\\frac{a}{b}$$ (1.2)\n")
    subprocess.run([sys.executable, "-m", "sphinx", *words], capture_output=True, check=True)
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "<msup>" in page
    assert "<mfrac>" in page
    assert "(1.2)" in page


def test_the_reference_has_every_command_and_option(reference):
    text = reference.commands()
    parsers = reference.leaves(reference.cli.complete_parser())
    assert len(parsers) >= 18
    for parser in parsers:
        assert f"## {parser.prog}\n" in text
        for action in parser._actions:
            for option in action.option_strings:
                assert option in text
    assert str(Path.home()) not in text


def test_the_reference_has_every_property_of_the_plugin(reference):
    assert reference.plugin_names() == set(reference.words.PROPERTIES)


def test_the_reference_refuses_names_that_nobody_described(reference):
    with pytest.raises(KeyError, match="described nowhere"):
        reference.described([("new_column", "")], {"old": "words"})
    with pytest.raises(KeyError, match="written by no code"):
        reference.keys(["a"], {"a": "words", "gone": "words"})
