"""XML files edited as text: insertions that leave every other byte unchanged.

Parsing and serialising a tree would lose the author's quotes, indentation, line ends and encoding.
Here expat reports the bytes at which elements begin and end, and an edit is text put at a byte. The
module also reads property declarations and writes FlightGear's protocol file.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import escape

from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.malformed_xml import malformed_xml
from uqharness.simulator import tag_end


@dataclass(eq=False)
class Node:
    """An element and its place in the bytes of the file.

    Attributes
    ----------
    tag, attributes, text
        Tag, attributes, and character data without that of children.
    line : int
        Line, from 1.
    start, open_end, close_start, end : int
        Byte of ``<``, byte behind the start tag, byte of ``</``, and byte behind the element. For
        ``<a/>`` the last three are equal.
    parent, children
        Neighbours in the tree.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    start: int
    parent: Node | None = None
    open_end: int = -1
    close_start: int = -1
    end: int = -1
    text: str = ""
    children: list[Node] = field(default_factory=list)

    @property
    def empty_tag(self) -> bool:
        """Return whether it is written ``<a/>``."""
        return self.open_end == self.end

    def find(self, tag: str) -> Node | None:
        """Return the first child with a tag; None without one."""
        return next((child for child in self.children if child.tag == tag), None)

    def all(self, tag: str) -> list[Node]:
        """Return the children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def walk(self) -> Iterator[Node]:
        """Yield the element and all below it, in the order of the text."""
        pending = [self]
        while pending:
            node = pending.pop()
            yield node
            pending.extend(reversed(node.children))


@dataclass(frozen=True)
class Document:
    """A file's bytes and its root element."""

    path: Path
    raw: bytes
    root: Node

    def where(self, node: Node) -> str:
        """Return ``file:line`` of an element."""
        return f"{self.path}:{node.line}"

    @property
    def newline(self) -> bytes:
        """Return the line end that most lines have."""
        crlf = self.raw.count(b"\r\n")
        return b"\r\n" if crlf * 2 > self.raw.count(b"\n") else b"\n"

    @property
    def encoding(self) -> str:
        """Return the encoding of the XML declaration; UTF-8 without one."""
        declared = re.match(
            rb"(?:\xef\xbb\xbf)?<\?xml[^>]*?\bencoding\s*=\s*[\"']([^\"']+)[\"']", self.raw
        )
        return declared.group(1).decode("ascii", errors="replace") if declared else "utf-8"

    def encoded(self, text: str) -> bytes:
        """Return text in the file's encoding, with character references where needed."""
        return text.encode(self.encoding, errors="xmlcharrefreplace")

    def indent(self, node: Node) -> str:
        """Return the white space before an element; empty if other text precedes it on the line."""
        # A file may be one line of megabytes: read back only the white space.
        begin = node.start
        while begin and self.raw[begin - 1] in b" \t":
            begin -= 1
        return (
            self.raw[begin : node.start].decode("ascii")
            if not begin or self.raw[begin - 1] == 0x0A
            else ""
        )

    def step(self) -> str:
        """Return one level of the author's indentation: the shortest of the root's children."""
        steps = [self.indent(child) for child in self.root.children]
        # Indentation of the children beyond that of the root.
        steps = [
            s.removeprefix(self.indent(self.root)) for s in steps if s != self.indent(self.root)
        ]
        return min((s for s in steps if s), key=len, default="  ")


# Root element <PropertyList> behind declaration, comments and document type; atomic, since a failed
# match would otherwise try every pair of comment marks.
_PROPERTY_LIST = re.compile(
    rb"(?:\xef\xbb\xbf)?(?>\s+|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>\[]*>)*+<PropertyList[\s>/]",
    re.DOTALL,
)
_BEHIND_NAME = frozenset(bytes([byte]) for byte in b" \t\n\r\f\v/>")


def read_document(path: Path) -> Document:
    """Read and parse a file.

    Raises BadInputError with file and line if it is malformed, or in UTF-16.
    """
    try:
        return parse_document(path, read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read: {error.strerror or error}") from None


def parse_document(path: Path, raw: bytes) -> Document:
    """Parse bytes; ``path`` names the file in messages. Raises BadInputError as `read_document`."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise BadInputError(
            f"{path}:1: UTF-16 is not edited here; save the file as UTF-8 or ISO-8859-1"
        )
    parser = expat.ParserCreate()
    # Without a buffer, text arrives and is copied line by line.
    parser.buffer_text, parser.buffer_size = True, 1 << 20
    stack: list[Node] = []
    top: list[Node] = []

    # expat reports the byte of "<"; the ends of tags are searched in the text.
    def opened(tag: str, attributes: dict[str, str]) -> None:
        parent = stack[-1] if stack else None
        node = Node(tag, attributes, parser.CurrentLineNumber, parser.CurrentByteIndex, parent)
        node.open_end = tag_end(raw, node.start)
        (parent.children if parent is not None else top).append(node)
        stack.append(node)

    def closed(_: str) -> None:
        node = stack.pop()
        at = parser.CurrentByteIndex
        if raw[node.open_end - 2 : node.open_end] == b"/>":
            node.close_start = node.end = node.open_end
        else:
            node.close_start, node.end = at, tag_end(raw, at)

    def characters(data: str) -> None:
        if stack:
            stack[-1].text += data

    parser.StartElementHandler = opened
    parser.EndElementHandler = closed
    parser.CharacterDataHandler = characters
    try:
        parser.Parse(raw, True)
    except expat.ExpatError:
        raise malformed_xml(raw, str(path)) from None
    for node in top[0].walk():
        # An element from an entity has no bytes of its own.
        begin = b"<" + node.tag.encode()
        behind = node.start + len(begin)
        if not raw.startswith(begin, node.start) or raw[behind : behind + 1] not in _BEHIND_NAME:
            raise BadInputError(
                f"{path}:{node.line}: <{node.tag}> comes from an entity; such a file is not edited"
                " here"
            )
    return Document(path, raw, top[0])


@dataclass(frozen=True)
class Insertion:
    """Text put before a byte.

    Attributes
    ----------
    at : int
        Byte.
    text : bytes
        Text with the file's line ends.
    removed : bytes
        Bytes that it replaces.
    opening, closing : bytes
        New parts of the tags where ``<a/>`` is opened for a child.
    """

    at: int
    text: bytes
    removed: bytes = b""
    opening: bytes = b""
    closing: bytes = b""


def append_child(document: Document, parent: Node, lines: list[str]) -> Insertion:
    """Return the insertion of lines as the last child of ``parent``.

    ``lines`` are indented relative to one another by two blanks; the author's indentation and line
    ends are used. An empty element is opened.
    """
    newline = document.newline.decode()
    outer = document.indent(parent)
    inner = document.indent(parent.children[-1]) if parent.children else ""
    inner = inner or outer + document.step()
    step = document.step()
    block = newline.join(_indented(line, inner, step) for line in lines)
    if parent.empty_tag:
        # Open the empty element: "/>" becomes ">" and a closing tag follows.
        slash = document.raw.rindex(b"/", parent.start, parent.open_end)
        opening, closing = (
            document.encoded(f">{newline}"),
            document.encoded(f"{outer}</{parent.tag}>"),
        )
        return Insertion(
            slash,
            document.encoded(f"{block}{newline}"),
            document.raw[slash : parent.open_end],
            opening,
            closing,
        )
    # The closing tag is on a separate line, or shares one with content.
    begin = document.raw.rfind(b"\n", 0, parent.close_start) + 1
    if document.raw[begin : parent.close_start].strip(b" \t"):
        return Insertion(parent.close_start, document.encoded(f"{newline}{block}{newline}{outer}"))
    return Insertion(begin, document.encoded(f"{block}{newline}"))


def insert_before(document: Document, node: Node, lines: list[str]) -> Insertion:
    """Return the insertion of lines as siblings before ``node``."""
    newline, indent, step = document.newline.decode(), document.indent(node), document.step()
    block = newline.join(_indented(line, indent, step) for line in lines)
    begin = document.raw.rfind(b"\n", 0, node.start) + 1
    if document.raw[begin : node.start].strip(b" \t"):
        return Insertion(node.start, document.encoded(f"{newline}{block}{newline}"))
    return Insertion(begin, document.encoded(f"{block}{newline}"))


def insert_after(document: Document, node: Node, lines: list[str]) -> Insertion:
    """Return the insertion of lines as siblings after ``node``, below the line on which it ends.

    A comment on that line stays with the node.
    """
    newline, indent, step = document.newline.decode(), document.indent(node), document.step()
    block = newline.join(_indented(line, indent, step) for line in lines)
    end_of_line = document.raw.find(b"\n", node.end)
    # A comment behind the element belongs to it.
    line_end = document.raw[node.end : end_of_line] if end_of_line >= 0 else b""
    if end_of_line >= 0 and not re.sub(rb"<!--.*?-->", b"", line_end).strip():
        return Insertion(end_of_line + 1, document.encoded(f"{block}{newline}"))
    return Insertion(node.end, document.encoded(f"{newline}{block}"))


def replace_text(document: Document, node: Node, text: str) -> Insertion:
    """Return the insertion that replaces an element's text, keeping white space and comments."""
    # The text is searched in the element's own bytes.
    old = document.encoded(node.text.strip())
    at = document.raw.index(old, node.open_end, node.close_start)
    return Insertion(at, document.encoded(text), old)


def replace_attribute(document: Document, node: Node, name: str, value: str) -> Insertion:
    """Return the insertion that replaces the value of an existing attribute, keeping its quotes."""
    tag = document.raw[node.start : node.open_end]
    match = re.search(rb"\s" + re.escape(name.encode()) + rb"\s*=\s*([\"'])(.*?)\1", tag, re.DOTALL)
    assert match is not None
    return Insertion(node.start + match.start(2), document.encoded(value), match.group(2))


def append_remark(document: Document, node: Node, remark: str) -> Insertion:
    """Return the insertion of a comment behind an element and the comments on its line."""
    comments = re.compile(rb"(?:[ \t]*<!--(?:(?!-->)[^\n])*-->)*").match(document.raw, node.end)
    return Insertion(
        comments.end() if comments else node.end, document.encoded(f"  {comment(remark)}")
    )


def comment(remark: str) -> str:
    """Return ``<!-- remark -->``."""
    return f"<!-- {in_comment(remark)} -->"


def in_comment(text: str) -> str:
    """Return text without double hyphens, which XML comments must not contain.

    Examples
    --------
    >>> in_comment("a--b")
    'a- -b'
    """
    return re.sub("-(?=-)", "- ", text)


def merge_insertions(insertions: list[Insertion]) -> list[Insertion]:
    """Return insertions in the order of the file; children put into one ``<a/>`` are merged."""
    merged: list[Insertion] = []
    pending: list[Insertion] = []
    # None marks the end of the list.
    for insertion in [*sorted(insertions, key=lambda item: item.at), None]:
        if pending and (
            insertion is None or not insertion.opening or insertion.at != pending[0].at
        ):
            text = b"".join(
                [pending[0].opening, *(item.text for item in pending), pending[0].closing]
            )
            merged.append(Insertion(pending[0].at, text, pending[0].removed))
            pending = []
        if insertion is not None:
            (pending if insertion.opening else merged).append(insertion)
    return merged


def apply(document: Document, insertions: list[Insertion]) -> bytes:
    """Return the file's bytes with the insertions; two at one byte keep their order.

    Raises ValueError if insertions overlap.
    """
    pieces, position = [], 0
    for insertion in merge_insertions(insertions):
        if insertion.at < position:
            raise ValueError("insertions overlap")
        # Unchanged bytes up to the insertion, then its text.
        pieces += [document.raw[position : insertion.at], insertion.text]
        position = insertion.at + len(insertion.removed)
    return b"".join([*pieces, document.raw[position:]])


def _indented(line: str, indent: str, step: str) -> str:
    """Return a line with the author's indentation; two leading blanks are one level."""
    body = line.lstrip(" ")
    return indent + step * ((len(line) - len(body)) // 2) + body if body else ""


def elements(lines: str) -> list[str]:
    """Return the lines of a block of text without common indentation and outer blank lines."""
    return textwrap.dedent(lines).strip("\n").splitlines()


def number(node: Node, name: str, document: Document) -> float:
    """Return an element's text as a number; BadInputError with file and line."""
    try:
        return float(node.text)
    except ValueError:
        raise BadInputError(
            f"{document.where(node)}: {name} must be a number; received {node.text.strip()!r}"
        ) from None


def attribute(node: Node, name: str) -> str:
    """Return an attribute's value without surrounding white space; empty if it is absent."""
    value: Any = node.attributes.get(name, "")
    return str(value).strip()


# Properties that an aircraft's files declare, compute or name. JSBSim's own are not among them.


def declare(name: str, number: str, remark: str | None = None) -> str:
    """Return ``<property value="number">name</property>`` with an optional comment."""
    return f'<property value="{number}">{escape(name)}</property>' + (
        "" if remark is None else f"  {comment(remark)}"
    )


def declarations(document: Document) -> Iterator[tuple[str, Node]]:
    """Yield name and element of every property declared with a value, in the order of the text."""
    for node in document.root.walk():
        if node.tag == "property" and "value" in node.attributes:
            yield node.text.strip(), node


def declaration(document: Document, name: str) -> Node | None:
    """Return the first element that declares a property; None without one."""
    return next((node for declared, node in declarations(document) if declared == name), None)


def has_function(document: Document, name: str) -> bool:
    """Return whether a ``<function>`` of the file has a name."""
    return any(
        node.tag == "function" and attribute(node, "name") == name for node in document.root.walk()
    )


def folder_declares(folder: Path, name: str) -> bool:
    """Return whether a file of an aircraft's folder declares a property."""
    return any(declaration(document, name) is not None for document in folder_documents(folder))


def declared_properties(folder: Path, prefix: str) -> tuple[str, ...]:
    """Return the properties with a prefix that files declare and nothing computes, sorted."""
    declared: set[str] = set()
    computed: set[str] = set()
    for path in sorted(folder.rglob("*.xml")):
        try:
            names, computed_names = _declared_and_computed(read_regular(path))
        except (BadInputError, OSError):
            continue
        declared |= {name for name in names if name.startswith(prefix)}
        computed |= computed_names
    return tuple(sorted(declared - computed))


@lru_cache(maxsize=128)
def _declared_and_computed(raw: bytes) -> tuple[frozenset[str], frozenset[str]]:
    """Return the properties that a file declares, and those that functions and components compute.

    Cached by content: aircraft are copied many times. Raises BadInputError.
    """
    document = parse_document(Path("file"), raw)
    computed = {attribute(node, "name") for node in document.root.walk() if node.tag == "function"}
    computed |= {node.text.strip() for node in document.root.walk() if node.tag == "output"}
    return frozenset(name for name, _ in declarations(document)), frozenset(computed)


def folder_names(folder: Path, prefix: str) -> bool:
    """Return whether a file of an aircraft's folder names a property with a prefix."""
    return any(
        text.strip().startswith(prefix)
        for document in folder_documents(folder)
        for node in document.root.walk()
        for text in (node.text, *node.attributes.values())
    )


def folder_documents(folder: Path) -> Iterator[Document]:
    """Yield the XML files of an aircraft's folder in the order of their paths.

    Malformed files, files that cannot be edited, and FlightGear's property lists (models, panels,
    sounds), which JSBSim does not read, are skipped.
    """
    for path in sorted(folder.rglob("*.xml")):
        try:
            raw = read_regular(path)
            if not _PROPERTY_LIST.match(raw):
                yield parse_document(path, raw)
        except (BadInputError, OSError):
            continue


# FlightGear's protocol file for playing back a flight from text (README.protocol, README.IO:
# generic protocol, ASCII): one line per sample, fields in the order of the chunks.

FIELDS = (
    ("latitude-deg", "double", "/position/latitude-deg"),
    ("longitude-deg", "double", "/position/longitude-deg"),
    ("altitude-ft", "double", "/position/altitude-ft"),
    ("roll-deg", "double", "/orientation/roll-deg"),
    ("pitch-deg", "double", "/orientation/pitch-deg"),
    ("heading-deg", "double", "/orientation/heading-deg"),
    ("airspeed-kt", "double", "/velocities/airspeed-kt"),
)
"""Name, type and property of each field; altitude above sea level, true heading."""


def protocol_xml() -> str:
    """Return the protocol file; FlightGear looks for it under Protocol/ of its data folder."""
    lines = ['<?xml version="1.0"?>', "<PropertyList>", "  <generic>", "    <input>"]
    lines += [
        "      <line_separator>newline</line_separator>",
        "      <var_separator>,</var_separator>",
    ]
    for name, kind, node in FIELDS:
        lines += [
            "      <chunk>",
            f"        <name>{name}</name>",
            f"        <type>{kind}</type>",
            f"        <node>{node}</node>",
        ]
        lines.append("      </chunk>")
    return "\n".join([*lines, "    </input>", "  </generic>", "</PropertyList>"]) + "\n"
