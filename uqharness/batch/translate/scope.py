"""What the translation of XML to the intermediate form shares: the builder, the document, how a property is read, and refusals."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import NoReturn

from uqharness.batch.form.ir import Builder, Value
from uqharness.errors import BadInputError
from uqharness.xml import Document, Node

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_.\-]*(\[\d+\])?(/[A-Za-z_][A-Za-z0-9_.\-]*(\[\d+\])?)*")
_ROOT = "/fdm/jsbsim/"


@dataclass(frozen=True)
class Scope:
    """Where XML is read.

    builder   makes the values
    document  the file, for messages
    read      the value of a property, None if nobody computes it: then the file is refused
    draw      the standard normal (``random``) or the number of -1 to 1 (``urandom``) that an element draws in this frame;
              None: refused
    note_beyond  is handed a condition under which JSBSim computes what the engine cannot: the flight does not count then
    """

    builder: Builder
    document: Document
    read: Callable[[str], Value | None]
    draw: Callable[[Node], Value | None] = lambda _: None
    note_beyond: Callable[[Value], None] = lambda _: None

    def where(self, condition: Value) -> Scope:
        """The same for what JSBSim computes only where the condition holds: elsewhere nothing is noted."""

        def note(beyond: Value) -> None:
            self.note_beyond(self.builder.op("and", condition, beyond))

        return replace(self, note_beyond=note)

    def refuse(self, node: Node, why: str) -> NoReturn:
        """Raise BadInputError with file and line."""
        raise BadInputError(f"{self.document.where(node)}: {why}")

    def only(self, node: Node, attributes: Collection[str] = ()) -> None:
        """Refuse attributes that are not understood."""
        for name in node.attributes:
            if name not in attributes:
                self.refuse(
                    node,
                    f"attribute '{name}' of <{node.tag}> is not understood by the batch engine; fly it with engine = \"jsbsim\"",
                )

    def number(self, node: Node, text: str | None = None) -> float:
        """A number as JSBSim writes it: decimal, without blanks inside."""
        text = (node.text if text is None else text).strip()
        if not _NUMBER.fullmatch(text) or not math.isfinite(float(text)):
            self.refuse(node, f"<{node.tag}> must be a finite decimal number; received {text!r}")
        return float(text)

    def property_value(self, node: Node) -> Value:
        """The value of the property that the element's text names; a minus sign before the name negates it."""
        if node.children:
            self.refuse(
                node,
                f"<{node.tag}> must be the name of a property; received <{node.children[0].tag}>, which JSBSim ignores",
            )
        return self.named_property(node, node.text)

    def named_property(self, node: Node, text: str) -> Value:
        """The value of the property that a text of the element names; a minus sign before the name negates it."""
        text = text.strip()
        negative = text.startswith("-")
        name = property_of(self, node, text.removeprefix("-"))
        value = self.read(name)
        if value is None:
            self.refuse(
                node,
                f'property {name} is not computed by the batch engine; fly this aircraft with engine = "jsbsim"',
            )
        return -value if negative else value

    def parameter(self, node: Node, text: str | None = None) -> Value:
        """A number, or the value of a property with or without a minus sign."""
        text = (node.text if text is None else text).strip()
        return (
            self.builder.constant(self.number(node, text))
            if is_number(text)
            else self.named_property(node, text)
        )

    @property
    def undefined(self) -> Value:
        """NaN: what JSBSim ends the flight for."""
        return self.builder.constant(math.nan)


def canonical(name: str) -> str:
    """One spelling of a property's name: no root, no index 0."""
    return name.strip().removeprefix(_ROOT).replace("[0]", "")


def property_of(scope: Scope, node: Node, text: str) -> str:
    """The property that a text names; refused if it is no name."""
    name = canonical(text)
    if not _NAME.fullmatch(name):
        scope.refuse(
            node, f"<{node.tag}> must be the name of a property; received {text.strip()!r}"
        )
    return name


def is_number(text: str) -> bool:
    """Whether JSBSim takes the text for a number; otherwise it is the name of a property."""
    return bool(_NUMBER.fullmatch(text.strip()))
