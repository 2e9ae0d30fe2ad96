"""Damage to XML, and what an attacker would put in: outputs, inputs, entities, names that lead out
of the folder, depth.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import numpy as np
from lxml import etree

from tests.fuzz import damage_bytes, hostile
from tests.fuzz.damage_text import damaged_text
from tests.fuzz.hostile import pick

_DOCTYPES, _ENTITIES = hostile.WORDS["xml_doctypes"], hostile.WORDS["xml_entities"]
_NUMBERS, _TAGS = hostile.WORDS["xml_numbers"], hostile.WORDS["xml_tags"]


def xml_damage(data: bytes, rng: np.random.Generator, others: Sequence[bytes] = ()) -> bytes:
    """An XML document with injured content; ``others`` lend it elements.

    One in five is injured as text or bytes instead.
    """
    kind = rng.random()
    if kind < 0.12:
        return damaged_text(data, rng)
    if kind < 0.2:
        return damage_bytes.damaged(data, rng)
    if kind < 0.3:
        return _declared(data, rng)
    if kind < 0.33:
        return _deep(data, rng)
    root = etree.fromstring(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 2, 3, 5]))):
        nodes = [node for node in root.iter() if isinstance(node.tag, str)]
        node = pick(nodes, rng)
        pick(_KINDS, rng)(node, nodes, rng, others)
    return etree.tostring(
        root,
        xml_declaration=True,
        encoding=str(rng.choice(["UTF-8"] * 8 + ["UTF-16", "ISO-8859-1"])),
    )


def _xml_text(text: str) -> str:
    """What of a text XML may hold at all."""
    return "".join(
        c
        for c in text
        if c in "\t\n\r" or (c >= " " and not "\ud800" <= c <= "\udfff" and c not in "\ufffe\uffff")
    )


def _word(rng: np.random.Generator, share: float) -> str:
    return _xml_text(hostile.string(rng)) if rng.random() < share else str(rng.choice(_NUMBERS))


def _delete(node, nodes, rng, others) -> None:
    if node.getparent() is not None:
        node.getparent().remove(node)


def _double(node, nodes, rng, others) -> None:
    if node.getparent() is not None:
        for _ in range(int(rng.choice([1, 1, 30]))):
            node.addnext(copy.deepcopy(node))


def _rename(node, nodes, rng, others) -> None:
    node.tag = str(rng.choice(_TAGS))


def _move(node, nodes, rng, others) -> None:
    pick(nodes, rng).append(copy.deepcopy(node))


def _attribute(node, nodes, rng, others) -> None:
    names = list(node.attrib) or ["name"]
    others = ["file", "name", "unit", "type", "value"]
    name = pick(names, rng) if rng.random() < 0.8 else str(rng.choice(others))
    node.set(name, _word(rng, 0.6))


def _lose_attribute(node, nodes, rng, others) -> None:
    if node.attrib:
        del node.attrib[pick(list(node.attrib), rng)]


def _text(node, nodes, rng, others) -> None:
    node.text = _word(rng, 0.4)


def _number(node, nodes, rng, others) -> None:
    """Something absurd where a number stands."""
    found = [
        n for n in nodes if n.text and n.text.strip().replace(".", "").replace("-", "").isdigit()
    ]
    if found:
        pick(found, rng).text = str(rng.choice(_NUMBERS))


def _plant(node, nodes, rng, others) -> None:
    """An element that an attacker would add, at the top or anywhere."""
    where = nodes[0] if rng.random() < 0.5 else node
    text = pick(hostile.ELEMENTS, rng)
    where.insert(int(rng.integers(0, len(where) + 1)), etree.fromstring(f"<r>{text}</r>")[0])


def _lend(node, nodes, rng, others) -> None:
    """An element of another file."""
    if others:
        donor = etree.fromstring(pick(others, rng))
        nodes = [n for n in donor.iter() if isinstance(n.tag, str)]
        node.append(copy.deepcopy(pick(nodes, rng)))


_KINDS: tuple[Callable[..., None], ...] = (
    *(_delete, _delete, _double, _rename, _move, _attribute, _attribute, _lose_attribute),
    *(_text, _number, _number, _plant, _plant, _lend),
)


def _declared(data: bytes, rng: np.random.Generator) -> bytes:
    """A document type with entities, and a use of one."""
    head, _, rest = data.partition(b"?>")
    doctype = pick(_DOCTYPES, rng).encode()
    entity = str(rng.choice(_ENTITIES)).encode()
    places = [k for k in range(len(rest)) if rest[k : k + 2] == b"</"]
    a = pick(places, rng) if places else 0
    return head + b"?>" + doctype + rest[:a] + entity + rest[a:]


def _deep(data: bytes, rng: np.random.Generator) -> bytes:
    """Elements within elements, or very many, or a very long one."""
    a = data.rfind(b"</")
    kind = int(rng.integers(0, 4))
    depth = int(rng.choice([60, 300, 3000, 30_000]))
    tag = str(rng.choice(["a", "sum", "function", "system"])).encode()
    if kind == 0:
        more = b"<%s>" % tag * depth + b"</%s>" % tag * depth
    elif kind == 1:
        more = (
            b'<function name="deep">'
            + b"<sum>" * depth
            + b"<value>1</value>"
            + b"</sum>" * depth
            + b"</function>"
        )
    elif kind == 2:
        more = b'<property value="1">a/b</property>' * depth
    else:
        more = b'<property value="' + b"9" * depth + b'">' + b"x" * depth + b"</property>"
    return data[:a] + more + data[a:]
