"""Prose of the project, piece by piece: pages without their code, strings and docstrings of the packages."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.helpers.places import ROOT

PAGES = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "docs/*.md", "docs/site/*.md", "campaigns/*/README.md")
CODE = ("uqharness/**/*.py", "sysid/**/*.py", "docs/site/*.py", "uqharness/report/templates/*")
_CODE_SPAN = re.compile(r"``[^`\n]+``|`[^`\n]+`|(?<=\])\([^)\s]+\)")


@dataclass(frozen=True)
class Piece:
    """A text and where it begins; ``text`` keeps its line breaks."""

    path: str
    line: int
    text: str

    def where(self, offset: int) -> str:
        return f"{self.path}:{self.line + self.text.count(chr(10), 0, offset)}"


def without_code(text: str) -> str:
    """The text with code spans and addresses of links blanked out, line breaks kept."""
    return _CODE_SPAN.sub("", text)


def newest_section(changelog: str) -> str:
    """The changelog up to the second release, so that line numbers stay."""
    heads = [found.start() for found in re.finditer(r"^## ", changelog, re.M)]
    return changelog[: heads[1]] if len(heads) > 1 else changelog


def strings(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of every string of several words; what an f-string fills in stands as {}."""
    tree = ast.parse(source)
    inside = {id(value) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for value in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [str(v.value) if isinstance(v, ast.Constant) else "{}" for v in node.values]
            text = "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
            text = node.value
        else:
            continue
        if len(text.split()) > 1:
            yield node.lineno, text


def pieces() -> Iterator[Piece]:
    """All prose of the project but the style page, which lists what is retired."""
    for pattern in PAGES:
        for path in sorted(ROOT.glob(pattern)):
            if path != ROOT / "docs" / "style.md":
                yield Piece(_name(path), 1, without_code(path.read_text(encoding="utf-8")))
    yield Piece("CHANGELOG.md", 1, without_code(newest_section((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))))
    for pattern in CODE:
        for path in sorted(ROOT.glob(pattern)):
            text = path.read_text(encoding="utf-8")
            if path.suffix == ".py":
                yield from (Piece(_name(path), line, without_code(found)) for line, found in strings(text))
            elif path.suffix == ".j2":
                yield Piece(_name(path), 1, re.sub(r"\{[{%#].*?[}%#]\}", "", text))


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()
