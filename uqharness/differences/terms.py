"""Elements of the XML in which two models differ: numbers, names, elements added or gone; comments, spaces and order of attributes
do not count."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path

from uqharness.errors import BadInputError
from uqharness.xml import Node, folder_documents

_AXIS = {
    "DRAG": "CX",
    "LIFT": "CZ",
    "SIDE": "CY",
    "X": "CX",
    "Y": "CY",
    "Z": "CZ",
    "AXIAL": "CX",
    "NORMAL": "CZ",
    "ROLL": "Cl",
    "PITCH": "Cm",
    "YAW": "Cn",
    "FORWARD": "CX",
    "RIGHT": "CY",
    "DOWN": "CZ",
}
_GROUP = {
    "mass_balance": "mass and CG",
    "propulsion": "propulsion",
    "flight_control": "surfaces",
    "system": "surfaces",
    "autopilot": "surfaces",
    "external_reactions": "external forces",
    "engine": "propulsion",
    "propeller": "propulsion",
    "aerodynamics": "force coefficients",
    "metrics": "force coefficients",
}


@dataclass(frozen=True)
class Term:
    """One element that differs.

    path      its place in words, from the section down: ``aerodynamics / axis PITCH / function aero/coefficient/Cmalpha / value``
    a, b      what stands there, "" where nothing; a_where, b_where: file:line, "" likewise
    group     group of channels it belongs to, "" where that is not known; channel: coefficient of its axis, ""
    """

    path: str
    a: str
    b: str
    a_where: str
    b_where: str
    group: str = ""
    channel: str = ""


@dataclass(frozen=True)
class _Line:
    key: str
    path: str
    said: str
    where: str
    group: str
    channel: str


def differing_terms(a: Path, b: Path) -> list[Term]:
    """What differs between the XML of two aircraft folders, in the order of the files. Raises BadInputError."""
    first, second = _lines(a), _lines(b)
    out: list[Term] = []
    for name in sorted({*first, *second}):
        one, two = first.get(name, []), second.get(name, [])
        matcher = SequenceMatcher(None, [x.key for x in one], [x.key for x in two], autojunk=False)
        for _, i, i_end, j, j_end in (code for code in matcher.get_opcodes() if code[0] != "equal"):
            out += _paired(one[i:i_end], two[j:j_end])
    return _without_inner(_without_moved(out))


def _without_moved(terms: list[Term]) -> list[Term]:
    """The terms less elements that stand elsewhere in the same parent: gone in one place, added in another."""
    gone = [(t.path, t.a) for t in terms if not t.b_where]
    added = [(t.path, t.b) for t in terms if not t.a_where]
    moved = [key for key in gone if key in added]
    return [
        t
        for t in terms
        if (t.path, t.a if not t.b_where else t.b) not in moved or (t.a_where and t.b_where)
    ]


def _without_inner(terms: list[Term]) -> list[Term]:
    """The terms less what lies in an element that is itself added or gone."""
    out: list[Term] = []
    outer = ""
    for t in terms:
        one_sided = not (t.a_where and t.b_where)
        if one_sided and outer and t.path.startswith(f"{outer} / "):
            continue
        outer = t.path if one_sided else ""
        out.append(t)
    return out


def _paired(one: list[_Line], two: list[_Line]) -> list[Term]:
    """Lines that stand for each other, by their path, and those that have no counterpart."""
    rest = list(two)
    out = []
    for x in one:
        y = next((y for y in rest if y.path == x.path), None)
        if y is not None:
            rest.remove(y)
        out.append(
            Term(
                x.path,
                x.said,
                y.said if y else "",
                x.where,
                y.where if y else "",
                x.group,
                x.channel,
            )
        )
    out += [Term(y.path, "", y.said, "", y.where, y.group, y.channel) for y in rest]
    return out


def _lines(folder: Path) -> dict[str, list[_Line]]:
    out: dict[str, list[_Line]] = {}
    for document in folder_documents(folder):
        relative = document.path.relative_to(folder).as_posix()
        # The aircraft's own file is named for its folder, which may be another.
        name = "aircraft" if document.path.stem == folder.name else relative
        found = out.setdefault(name, [])
        for node in document.root.walk():
            if node.tag in ("fileheader",) or any(
                above.tag == "fileheader" for above in _above(node)
            ):
                continue
            if node is document.root:
                continue
            found.append(_line(node, f"{relative}:{node.line}", document.root.tag))
    if not out:
        raise BadInputError(f"{folder}: no XML to compare")
    return out


def _line(node: Node, where: str, root: str) -> _Line:
    chain = [*reversed(list(_above(node))), node][1:]
    path = " / ".join(_label(n) for n in chain)
    attributes = " ".join(f'{k}="{_number(v)}"' for k, v in sorted(node.attributes.items()))
    said = " ".join(x for x in (_text(node.text), attributes) if x) or f"<{node.tag}>"
    section = chain[0].tag if chain else ""
    axis = next((n.attributes.get("name", "").upper() for n in chain if n.tag == "axis"), "")
    group = _GROUP.get(section, _GROUP.get(root, ""))
    return _Line(f"{path}|{said}", path, said, where, group, _AXIS.get(axis, ""))


def _above(node: Node) -> Iterator[Node]:
    above = node.parent
    while above is not None:
        yield above
        above = above.parent


def _label(node: Node) -> str:
    name = node.attributes.get("name", "")
    if node.tag == "property" and not name:
        name = node.text.strip()
    return f"{node.tag} {name}".strip()


def _text(text: str) -> str:
    return " ".join(_number(word) for word in text.split())


def _number(word: str) -> str:
    """A number by its value, anything else as it is."""
    try:
        return repr(float(word) + 0.0)
    except ValueError:
        return word.strip()
