"""Properties declared in XML, and which of them an aircraft's files declare, compute or name.

What JSBSim makes by itself does not stand there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import escape

from uqharness.errors import BadInputError
from uqharness.xml.document import Document, Node, attribute, comment, read_document


def declare(name: str, number: str, remark: str | None = None) -> str:
    """``<property value="number">name</property>``, with a remark behind it."""
    return f'<property value="{number}">{escape(name)}</property>' + ("" if remark is None else f"  {comment(remark)}")


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
    return any(node.tag == "function" and attribute(node, "name") == name for node in document.root.walk())


def folder_declares(folder: Path, name: str) -> bool:
    """Whether a file of the aircraft's folder declares the property."""
    return any(declaration(document, name) is not None for document in folder_documents(folder))


def declared_in(folder: Path, prefix: str) -> tuple[str, ...]:
    """Properties beginning so that files of the aircraft's folder declare and no function or component computes, sorted."""
    declared: set[str] = set()
    computed: set[str] = set()
    for document in folder_documents(folder):
        declared |= {name for name, _ in declarations(document) if name.startswith(prefix)}
        for node in document.root.walk():
            if node.tag == "function":
                computed.add(attribute(node, "name"))
            elif node.tag == "output":
                computed.add(node.text.strip())
    return tuple(sorted(declared - computed))


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
