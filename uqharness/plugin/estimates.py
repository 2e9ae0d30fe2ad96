"""Write numbers into an aircraft's XML as a hand would: the value changes, formatting and comments stay, a remark says why."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, copy_folder
from uqharness.xml import (
    Document,
    Insertion,
    Node,
    apply,
    comment,
    declaration,
    declarations,
    folder_documents,
    parse_document,
    with_attribute,
)

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_REMARK = re.compile(rb"[ \t]*<!-- identified [^>]*?-->")


@dataclass(frozen=True)
class Estimate:
    """New value of a property and the remark that stands behind it in the XML (no double hyphen)."""

    value: float
    remark: str


def write_estimates(aircraft: Aircraft, estimates: Mapping[str, Estimate], out: Path) -> list[str]:
    """Copy the aircraft's folder to ``out`` with the estimates in its XML; names that no XML file declares are returned.

    The copy appears whole or not at all; an existing ``out`` is replaced only if it is an aircraft's folder. Raises BadInputError.
    """
    if out.exists() and not (out / "airframe.toml").is_file() and any(out.iterdir()):
        raise BadInputError(
            f"{out}: exists and is no aircraft folder of an earlier run; remove it or choose another --out"
        )
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".aircraft-") as temporary:
        copy = Path(temporary) / "new"
        copy_folder(aircraft.folder, copy)
        left = put_values(copy, estimates)
        old = Path(temporary) / "old"
        if out.exists():
            out.rename(old)
        copy.rename(out)
    return left


def with_value(document: Document, name: str, estimate: Estimate) -> bytes | None:
    """The file with another number in ``<property value="...">name</property>``; None where it does not declare the property.

    An earlier remark of ours is replaced as well; the author's comments are not.
    """
    node = declaration(document, name)
    return None if node is None else apply(document, _edits(document, node, estimate))


def _edits(document: Document, node: Node, estimate: Estimate) -> list[Insertion]:
    end = document.raw.find(b"\n", node.end)
    old = document.raw[node.end : None if end < 0 else end].removesuffix(b"\r")
    rest = _REMARK.sub(b"", old).rstrip(b" \t")
    # A remark inside a comment that runs over lines would end it early; such a line keeps its number alone.
    runs_on = b"<!--" in _COMMENT.sub(b"", rest)
    remark = b"" if runs_on else document.encoded(f"  {comment(f'identified {estimate.remark}')}")
    number = with_attribute(document, node, "value", f"{estimate.value:.8g}")
    return [number, Insertion(node.end, rest + remark, old)]


def put_values(folder: Path, values: Mapping[str, Estimate]) -> list[str]:
    """Write values of properties into the XML files of a folder, in place; names that no file declares are returned."""
    left = dict(values)
    for document in folder_documents(folder):
        edited = document
        while edits := _together(edited, left):
            edited = parse_document(document.path, apply(edited, edits))
        if edited is not document:
            document.path.write_bytes(edited.raw)
    return list(left)


def _together(document: Document, left: dict[str, Estimate]) -> list[Insertion]:
    """Edits of the declarations of a file's properties ``left``, one to a line; the properties are taken out of ``left``."""
    edits: list[Insertion] = []
    until = -1
    for name, node in declarations(document):
        if name in left and node.start > until:
            edits += _edits(document, node, left.pop(name))
            end = document.raw.find(b"\n", node.end)
            until = len(document.raw) if end < 0 else end
    return edits
