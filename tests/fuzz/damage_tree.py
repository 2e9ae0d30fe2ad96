"""Damage to what JSON, TOML and XML hold: nodes lost, doubled, renamed, of another type, absurd in
size or depth; in XML also what an attacker would put in.
"""

from __future__ import annotations

import copy
import json
import math
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from lxml import etree

from tests.fuzz import hostile
from tests.fuzz.damage_bytes import damaged, damaged_text
from tests.fuzz.hostile import WORDS, pick

_DEEP, _MANY = "\x02deep\x02", "\x02long\x02"
"""Markers for depth and for long integers, which are put in once the text is written."""
_SIZES = (30, 400, 5000, 100_000)
_NODES = "lost lost other other same same same renamed added moved wrapped emptied"
_ELEMENTS = (
    "lost lost doubled renamed moved attribute attribute bare text number number planted planted"
    " lent"
)


def damaged_tree(tree: Any, rng: np.random.Generator) -> Any:
    """A copy of ``tree`` (dicts, lists, plain values) with one to four injuries."""
    box = {"root": copy.deepcopy(tree)}
    for _ in range(pick([1, 1, 1, 2, 2, 3, 4], rng)):
        places = list(_places(box))
        if places:
            _injure_node(*pick(places, rng), rng, places)
    return box.get("root")


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """(container, key) of every node below ``tree``."""
    stack = [tree]
    while stack:
        holder = stack.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            yield holder, key
            if isinstance(holder[key], dict | list):
                stack.append(holder[key])


def value(rng: np.random.Generator) -> Any:
    """A value of a random type."""
    kind = int(rng.integers(0, 10))
    if kind < 6:
        return hostile.string(rng) if kind < 3 else hostile.number(rng)
    plain = [None, True, False, [], {}, [None], [[]], {"": 0}, [1, 2, 3], [1, "a"], ["CX"]]
    return pick([*plain, {"a": {"b": []}}, _DEEP, _MANY], rng)


def _injure_node(holder: Any, key: Any, rng: np.random.Generator, places: list) -> None:
    old, listed = holder[key], isinstance(holder, dict)
    match pick(_NODES.split(), rng):
        case "lost":
            del holder[key]
        case "other":
            holder[key] = value(rng)
        case "same":
            holder[key] = _same_type(old, rng)
        case "renamed" if listed:
            new = hostile.string(rng) if rng.random() < 0.5 else f"{key}_"
            holder[new] = holder.pop(key)
        case "renamed":
            holder.append(copy.deepcopy(old))
        case "added" if listed:
            holder[hostile.string(rng)] = value(rng)
        case "added":
            holder.insert(key, value(rng))
        case "moved":
            other, name = pick(places, rng)
            holder[key] = copy.deepcopy(other[name])
        case "wrapped":
            holder[key] = [old] if rng.random() < 0.5 else {"a": old}
        case "emptied":
            holder[key] = {dict: {}, list: [], str: ""}.get(type(old))


def _same_type(old: Any, rng: np.random.Generator) -> Any:
    """A value of the same type: it passes the first check and meets the second."""
    match old:
        case bool():
            return not old
        case int():
            return pick([0, 1, -1, 2, 1000, 10**6, 2**31, old + 1, -old], rng)
        case float():
            return pick([0.0, -old, 1e-9, 1e12, 1e300, 1.0, old * 1000, math.nan], rng)
        case str():
            return hostile.string(rng)
        case list():
            return pick([old * 2, old[:-1], old[::-1], old[:1] * 50], rng)
        case dict():
            return {hostile.string(rng): item for item in old.values()}
    return old


def json_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A JSON document with injured content; one in ten is injured as text besides."""
    tree = damaged_tree(json.loads(data), rng)
    return _write_files(json.dumps(tree, indent=None if rng.random() < 0.5 else 1), rng)


def toml_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A TOML document with injured content, or with injured lines."""
    if rng.random() < 0.3:
        return damaged_text(data, rng)
    tree = damaged_tree(tomllib.loads(data.decode()), rng)
    return _write_files(toml_text(tree if isinstance(tree, dict) else {"root": tree}), rng)


def _write_files(text: str, rng: np.random.Generator) -> bytes:
    """The text with depth and long integers for their markers."""
    depth = pick(_SIZES, rng)
    text = text.replace(json.dumps(_DEEP), "[" * depth + "]" * depth)
    text = text.replace(json.dumps(_MANY), "9" * pick(_SIZES, rng))
    out = text.encode("utf-8", "surrogatepass")
    return damaged_text(out, rng) if rng.random() < 0.1 else out


def toml_text(tree: dict[str, Any], name: str = "") -> str:
    """TOML of a tree, hostile values and all; what TOML has no words for (null) is left as a word
    that is none.
    """
    lines, sections = [], []
    for key, item in tree.items():
        full = f"{name}.{json.dumps(key)}" if name else json.dumps(key)
        if isinstance(item, dict) and (not name or any(isinstance(v, dict) for v in item.values())):
            sections.append(f"[{full}]\n{toml_text(item, full)}")
        elif (
            not name and isinstance(item, list) and item and all(isinstance(r, dict) for r in item)
        ):
            sections += [f"[[{full}]]\n{toml_text(row, full)}" for row in item]
        else:
            lines.append(f"{json.dumps(key)} = {_toml(item)}\n")
    return "".join(lines + sections)


def _toml(item: Any) -> str:
    match item:
        case bool() | None | str():
            return json.dumps(item)
        case list():
            return "[" + ", ".join(map(_toml, item)) + "]"
        case dict():
            pairs = ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in item.items())
            return "{ " + pairs + " }"
    return repr(item)


def xml_damage(data: bytes, rng: np.random.Generator, remaining: Sequence[bytes] = ()) -> bytes:
    """An XML document with injured content; ``others`` lend it elements.

    One in five is injured as text or bytes instead.
    """
    kind = rng.random()
    if kind < 0.33:
        ways = ((0.12, damaged_text), (0.2, damaged), (0.3, _with_entities), (0.33, _deep))
        return next(way for limit, way in ways if kind < limit)(data, rng)
    root = etree.fromstring(data)
    for _ in range(pick([1, 1, 1, 2, 2, 3, 5], rng)):
        _injure_element(root, rng, remaining)
    coding = pick(["UTF-8"] * 8 + ["UTF-16", "ISO-8859-1"], rng)
    return etree.tostring(root, xml_declaration=True, encoding=coding)


def _elements(root: Any) -> list[Any]:
    return [node for node in root.iter() if isinstance(node.tag, str)]


def _injure_element(root: Any, rng: np.random.Generator, remaining: Sequence[bytes]) -> None:
    nodes = _elements(root)
    node = pick(nodes, rng)
    parent = node.getparent()
    match pick(_ELEMENTS.split(), rng):
        case "lost" if parent is not None:
            parent.remove(node)
        case "doubled" if parent is not None:
            for _ in range(pick([1, 1, 30], rng)):
                node.addnext(copy.deepcopy(node))
        case "renamed":
            node.tag = pick(WORDS["xml_tags"], rng)
        case "moved":
            pick(nodes, rng).append(copy.deepcopy(node))
        case "attribute":
            usual = ["file", "name", "unit", "type", "value"]
            names = list(node.attrib) if node.attrib and rng.random() < 0.8 else usual
            node.set(pick(names, rng), _word(rng, 0.6))
        case "bare":
            node.attrib.clear()
        case "text":
            node.text = _word(rng, 0.4)
        case "number":
            digits = [n for n in nodes if (n.text or "").strip(" \n.-").replace(".", "").isdigit()]
            if digits:
                pick(digits, rng).text = pick(WORDS["xml_numbers"], rng)
        case "planted":
            where = nodes[0] if rng.random() < 0.5 else node
            planted = etree.fromstring(f"<r>{pick(hostile.ELEMENTS, rng)}</r>")[0]
            where.insert(int(rng.integers(0, len(where) + 1)), planted)
        case "lent" if remaining:
            donor = etree.fromstring(pick(remaining, rng))
            node.append(copy.deepcopy(pick(_elements(donor), rng)))


def _word(rng: np.random.Generator, share: float) -> str:
    """Text as far as XML may hold it at all, or a number."""
    if rng.random() >= share:
        return pick(WORDS["xml_numbers"], rng)
    return "".join(
        c
        for c in hostile.string(rng)
        if c in "\t\n\r" or (c >= " " and not "\ud800" <= c <= "\udfff" and c not in "\ufffe\uffff")
    )


def _with_entities(data: bytes, rng: np.random.Generator) -> bytes:
    """A document type with entities, and a use of one."""
    head, _, remainder = data.partition(b"?>")
    places = [k for k in range(len(remainder)) if remainder[k : k + 2] == b"</"]
    a = pick(places, rng) if places else 0
    doctype, entity = (pick(WORDS[k], rng).encode() for k in ("xml_doctypes", "xml_entities"))
    return head + b"?>" + doctype + remainder[:a] + entity + remainder[a:]


def _deep(data: bytes, rng: np.random.Generator) -> bytes:
    """Elements within elements, or very many, or a very long one."""
    a = data.rfind(b"</")
    depth = pick([60, 300, 3000, 30_000], rng)
    tag = pick([b"a", b"sum", b"function", b"system"], rng)
    sums = b"<sum>" * depth + b"<value>1</value>" + b"</sum>" * depth
    more = (
        b"<%s>" % tag * depth + b"</%s>" % tag * depth,
        b'<function name="deep">' + sums + b"</function>",
        b'<property value="1">a/b</property>' * depth,
        b'<property value="' + b"9" * depth + b'">' + b"x" * depth + b"</property>",
    )
    return data[:a] + pick(more, rng) + data[a:]
