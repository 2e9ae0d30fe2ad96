"""Properties declared in XML, and which of them an aircraft's files declare, compute or name.

What JSBSim makes by itself does not stand there.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from xml.sax.saxutils import escape

from sysid.foreign.regular_files import read_regular
from uqharness.errors import BadInputError
from uqharness.xml.document import Document, Node, attribute, comment, parse_document, read_document


def declare(name: str, number: str, remark: str | None = None) -> str:
    """``<property value="number">name</property>``, with a remark behind it."""
    return f'<property value="{number}">{escape(name)}</property>' + (
        "" if remark is None else f"  {comment(remark)}"
    )


def declarations(document: Document) -> Iterator[tuple[str, Node]]:
    """Name and element of every ``<property value="...">name</property>``, in the order of the text."""
    for node in document.root.walk():
        if node.tag == "property" and "value" in node.attributes:
            yield node.text.strip(), node


def declaration(document: Document, name: str) -> Node | None:
    """The first element that declares the property; None where none does."""
    return next((node for found, node in declarations(document) if found == name), None)


def computes(document: Document, name: str) -> bool:
    """Whether a ``<function>`` of the file has that name."""
    return any(
        node.tag == "function" and attribute(node, "name") == name for node in document.root.walk()
    )


def folder_declares(folder: Path, name: str) -> bool:
    """Whether a file of the aircraft's folder declares the property."""
    return any(declaration(document, name) is not None for document in folder_documents(folder))


def declared_in(folder: Path, prefix: str) -> tuple[str, ...]:
    """Properties beginning so that files of the aircraft's folder declare and no function or component computes, sorted."""
    declared: set[str] = set()
    computed: set[str] = set()
    for path in sorted(folder.rglob("*.xml")):
        try:
            names, made = _declared_and_computed(read_regular(path))
        except (BadInputError, OSError):
            continue
        declared |= {name for name in names if name.startswith(prefix)}
        computed |= made
    return tuple(sorted(declared - computed))


@lru_cache(maxsize=128)
def _declared_and_computed(raw: bytes) -> tuple[frozenset[str], frozenset[str]]:
    """Properties that a file declares, and those that its functions and components compute. Copies of an aircraft are made by the
    dozen, and hold the same files. Raises BadInputError."""
    document = parse_document(Path("file"), raw)
    computed = {attribute(node, "name") for node in document.root.walk() if node.tag == "function"}
    computed |= {node.text.strip() for node in document.root.walk() if node.tag == "output"}
    return frozenset(name for name, _ in declarations(document)), frozenset(computed)


def folder_names(folder: Path, prefix: str) -> bool:
    """Whether a file of the aircraft's folder has a property that begins so, as an element's text or as an attribute."""
    return any(
        text.strip().startswith(prefix)
        for document in folder_documents(folder)
        for node in document.root.walk()
        for text in (node.text, *node.attributes.values())
    )


def folder_documents(folder: Path) -> Iterator[Document]:
    """The XML files of an aircraft's folder in order of their paths; those that are no XML, or cannot be edited, are left out."""
    for path in sorted(folder.rglob("*.xml")):
        try:
            yield read_document(path)
        except BadInputError:
            continue
