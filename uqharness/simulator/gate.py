"""What a foreign XML file may ask of JSBSim: nothing but to be read. The one gate before JSBSim opens a file.

JSBSim does what an XML says as soon as it is loaded. ``<output>`` writes a file of any name, ``<input>`` listens on the network,
``<child>`` loads another aircraft, and a ``file`` attribute may name any file of the machine. A file's bytes pass through here
first: elements of the first two kinds are blanked (line numbers stay), the rest is refused with file and line. Reads and writes
nothing.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any
from xml.parsers import expat

from uqharness.errors import BadInputError

TAKEN_OUT = frozenset({"output", "input"})
"""Children of a file's root that are blanked: a host records and commands for itself."""

_LONGEST_NAME = 250
_TAG = re.compile(rb"""(?:[^"'>]++|"[^"]*+"|'[^']*+')*+>""")
DEEPEST = 200
"""Levels of nesting that are read; aircraft have some fifteen, and JSBSim follows each with a call of its own."""


@dataclass(frozen=True)
class Reference:
    """A ``file`` attribute: the element that has it, the file named (``.xml`` added as JSBSim does), and its line."""

    tag: str
    name: str
    line: int


@dataclass(frozen=True)
class Passed:
    """A file that may be loaded. ``taken_out``: tag and line of each element that ``content`` no longer has."""

    content: bytes
    root: str
    references: tuple[Reference, ...]
    taken_out: tuple[tuple[str, int], ...]


@dataclass
class _Scan:
    """One pass over the elements: what stands right below the root, and every ``file`` attribute."""

    raw: bytes
    where: str
    parser: Any = field(default_factory=expat.ParserCreate)
    depth: int = 0
    root: str = ""
    references: list[Reference] = field(default_factory=list)
    spans: list[tuple[str, int, int, int]] = field(default_factory=list)
    _open: tuple[str, int, int] | None = None

    def run(self) -> _Scan:
        self.parser.StartElementHandler = self._opened
        self.parser.EndElementHandler = self._closed
        try:
            self.parser.Parse(self.raw, True)
        except expat.ExpatError as error:
            raise BadInputError(
                f"{self.where}:{error.lineno}: not well-formed XML: {expat.ErrorString(error.code)}"
            ) from None
        except (ValueError, LookupError) as error:  # an encoding that Python does not know
            raise BadInputError(f"{self.where}:1: not readable as XML: {error}") from None
        return self

    def _opened(self, tag: str, attributes: dict[str, str]) -> None:
        line = self.parser.CurrentLineNumber
        self.depth += 1
        if self.depth > DEEPEST:
            raise BadInputError(
                f"{self.where}:{line}: elements are nested more than {DEEPEST} deep"
            )
        if self.depth == 1:
            self.root = tag
        if self.depth == 2:
            if tag in TAKEN_OUT:
                start = self.parser.CurrentByteIndex
                if self.raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
                    raise BadInputError(
                        f"{self.where}:{line}: has <{tag}> and is in UTF-16; save the file as UTF-8"
                    )
                if not self.raw.startswith(b"<" + tag.encode(), start):
                    raise BadInputError(
                        f"{self.where}:{line}: <{tag}> comes from an entity; such a file is not loaded"
                    )
                self._open = (tag, line, start)
            if tag == "child":
                raise BadInputError(
                    f"{self.where}:{line}: <child> loads a second aircraft, which is not supported; remove it"
                )
        if "file" in attributes and self._open is None:
            self.references.append(
                Reference(tag, self._inside(tag, attributes["file"].strip(), line), line)
            )

    def _closed(self, tag: str) -> None:
        if self.depth == 2 and self._open is not None:
            tag, line, start = self._open
            end = tag_end(self.raw, start)
            if self.raw[end - 2 : end] != b"/>":
                end = tag_end(self.raw, self.parser.CurrentByteIndex)
            self.spans.append((tag, line, start, end))
            self._open = None
        self.depth -= 1

    def _inside(self, tag: str, name: str, line: int) -> str:
        if leads_out(name):
            raise BadInputError(
                f'{self.where}:{line}: <{tag} file="{name}"> leads out of the aircraft; a file must be named within the '
                "aircraft's folder or within the folders engine and systems beside it: put it there"
            )
        if max(map(len, name.encode(errors="replace").split(b"/"))) > _LONGEST_NAME:
            raise BadInputError(
                f'{self.where}:{line}: <{tag} file="{name[:60]}..."> is longer than a file\'s name may be'
            )
        return name if not name or name.endswith(".xml") else f"{name}.xml"


def leads_out(name: str) -> bool:
    """Whether a file's name, read as this or as another system reads it, may lie outside the folder that it is looked for in."""
    windows = PureWindowsPath(name)
    parts = {*PurePosixPath(name).parts, *windows.parts}
    return bool(
        name.startswith(("/", "~"))
        or windows.drive
        or windows.root
        or ".." in parts
        or "\0" in name
    )


@lru_cache(maxsize=128)
def passed(raw: bytes, where: str) -> Passed:
    """A file's bytes as JSBSim may load them. ``where`` is the file's name in messages.

    Raises BadInputError with file and line for what is not well formed, for a second aircraft, for a file named outside the
    aircraft, and for an encoding in which elements cannot be taken out.
    """
    scan = _Scan(raw, where).run()
    if not scan.spans:
        return Passed(raw, scan.root, tuple(scan.references), ())
    pieces, position = [], 0
    for _, _, start, end in scan.spans:
        pieces += [raw[position:start], bytes(_blank(raw[start:end]))]
        position = end
    content = b"".join([*pieces, raw[position:]])
    left = _Scan(content, where).run()
    if left.spans or left.references != scan.references:
        raise BadInputError(
            f"{where}:{scan.spans[0][1]}: <{scan.spans[0][0]}> cannot be taken out of this file; remove it"
        )
    return Passed(
        content,
        scan.root,
        tuple(scan.references),
        tuple((tag, line) for tag, line, _, _ in scan.spans),
    )


def _blank(text: bytes) -> Iterator[int]:
    """Spaces for everything but line ends: messages keep their line numbers."""
    return (byte if byte in b"\r\n" else 0x20 for byte in text)


def tag_end(raw: bytes, start: int) -> int:
    """Byte behind the ``>`` of the tag at ``start``; a ``>`` in quotes does not count."""
    found = _TAG.match(raw, start)
    return len(raw) if found is None else found.end()
