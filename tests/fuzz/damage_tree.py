"""Damage to what JSON and TOML hold: nodes lost, doubled, renamed, of another type, absurd in size
or depth.
"""

from __future__ import annotations

import copy
import json
import math
import tomllib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from tests.fuzz import hostile
from tests.fuzz.damage_text import damaged_text
from tests.fuzz.hostile import pick

_DEEP = "\x02deep\x02"
_LONG = "\x02long\x02"
_PLACES = (30, 400, 5000, 100_000)


def damaged_tree(tree: Any, rng: np.random.Generator) -> Any:
    """A copy of ``tree`` (dicts, lists, plain values) with one to four injuries.

    Text markers stand for depth and long integers.
    """
    box = {"root": copy.deepcopy(tree)}
    for _ in range(int(rng.choice([1, 1, 1, 2, 2, 3, 4]))):
        places = list(_places(box))
        if not places:  # nothing is left
            break
        holder, key = pick(places, rng)
        pick(_KINDS, rng)(holder, key, rng, places)
    return box.get("root")


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """(container, key) of every node below ``tree``."""
    stack = [tree]
    while stack:
        holder = stack.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            yield holder, key
            if isinstance(holder[key], (dict, list)):
                stack.append(holder[key])


def value(rng: np.random.Generator) -> Any:
    """A value of a random type."""
    kind = int(rng.integers(0, 10))
    if kind < 3:
        return hostile.string(rng)
    if kind < 6:
        return hostile.number(rng)
    plain = [None, True, False, [], {}, [None], [[]], {"": 0}, [1, 2, 3], [1, "a"], ["CX"]]
    return pick([*plain, {"a": {"b": []}}, _DEEP, _LONG], rng)


def _delete(holder: Any, key: Any, rng: np.random.Generator, _: Any) -> None:
    del holder[key]


def _replace(holder: Any, key: Any, rng: np.random.Generator, _: Any) -> None:
    holder[key] = value(rng)


def _same_type(holder: Any, key: Any, rng: np.random.Generator, _: Any) -> None:
    """A value of the same type: it passes the first check and meets the second."""
    old = holder[key]
    if isinstance(old, bool):
        holder[key] = not old
    elif isinstance(old, int):
        holder[key] = int(rng.choice([0, 1, -1, 2, 1000, 10**6, 2**31, old + 1, -old]))
    elif isinstance(old, float):
        holder[key] = float(rng.choice([0.0, -old, 1e-9, 1e12, 1e300, 1.0, old * 1000, math.nan]))
    elif isinstance(old, str):
        holder[key] = hostile.string(rng)
    elif isinstance(old, list):
        holder[key] = pick([old * 2, old[:-1], old[::-1], old[:1] * 50], rng)
    elif isinstance(old, dict):
        holder[key] = {hostile.string(rng): v for v in old.values()}


def _rename(holder: Any, key: Any, rng: np.random.Generator, _: Any) -> None:
    if isinstance(holder, dict):
        new = hostile.string(rng) if rng.random() < 0.5 else f"{key}_"
        holder[new] = holder.pop(key)
    else:
        holder.append(copy.deepcopy(holder[key]))


def _add(holder: Any, key: Any, rng: np.random.Generator, _: Any) -> None:
    if isinstance(holder, dict):
        holder[hostile.string(rng)] = value(rng)
    else:
        holder.insert(int(key), value(rng))


def _move(holder: Any, key: Any, rng: np.random.Generator, places: list[tuple[Any, Any]]) -> None:
    """A node from elsewhere in its place."""
    other, name = pick(places, rng)
    try:
        holder[key] = copy.deepcopy(other[name])
    except (KeyError, IndexError):  # an earlier injury took it away
        return


def _wrap(holder: Any, key: Any, rng: np.random.Generator, _: Any) -> None:
    holder[key] = [holder[key]] if rng.random() < 0.5 else {"a": holder[key]}


def _empty(holder: Any, key: Any, rng: np.random.Generator, _: Any) -> None:
    holder[key] = {dict: {}, list: [], str: ""}.get(type(holder[key]))


_KINDS: tuple[Callable[[Any, Any, np.random.Generator, Any], None], ...] = (
    *(_delete, _delete, _replace, _replace, _same_type, _same_type, _same_type, _rename),
    *(_add, _move, _wrap, _empty),
)


def json_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A JSON document with injured content; one in ten is injured as text besides."""
    text = json.dumps(damaged_tree(json.loads(data), rng), indent=None if rng.random() < 0.5 else 1)
    text = _written_out(text, rng)
    return (
        damaged_text(text.encode(), rng)
        if rng.random() < 0.1
        else text.encode("utf-8", "surrogatepass")
    )


def toml_damage(data: bytes, rng: np.random.Generator) -> bytes:
    """A TOML document with injured content, or with injured lines."""
    if rng.random() < 0.3:
        return damaged_text(data, rng)
    tree = damaged_tree(tomllib.loads(data.decode()), rng)
    text = _written_out(toml_text(tree if isinstance(tree, dict) else {"root": tree}), rng)
    return (
        damaged_text(text.encode("utf-8", "surrogatepass"), rng)
        if rng.random() < 0.1
        else text.encode("utf-8", "surrogatepass")
    )


def _written_out(text: str, rng: np.random.Generator) -> str:
    """The markers for depth and for long integers as what they stand for."""
    depth = int(rng.choice(_PLACES))
    return text.replace(json.dumps(_DEEP), "[" * depth + "]" * depth).replace(
        json.dumps(_LONG), "9" * int(rng.choice(_PLACES))
    )


def toml_text(tree: dict[str, Any]) -> str:
    """TOML of a tree, hostile values and all; what TOML has no words for (null) is left as a word
    that is none.
    """
    head = [f"{json.dumps(k)} = {_toml(v)}" for k, v in tree.items() if not _is_section(v)]
    for key, item in tree.items():
        if isinstance(item, dict):
            head += _section(json.dumps(key), item)
        elif _is_section(item):
            for row in item:
                head += [
                    f"[[{json.dumps(key)}]]",
                    *(f"{json.dumps(k)} = {_toml(v)}" for k, v in row.items()),
                ]
    return "\n".join(head) + "\n"


def _section(name: str, rows: dict[str, Any]) -> list[str]:
    out = [
        f"[{name}]",
        *(f"{json.dumps(k)} = {_toml(v)}" for k, v in rows.items() if not _has_tables(v)),
    ]
    for key, item in rows.items():
        if _has_tables(item):
            out += _section(f"{name}.{json.dumps(key)}", item)
    return out


def _has_tables(item: Any) -> bool:
    return isinstance(item, dict) and any(isinstance(v, dict) for v in item.values())


def _is_section(item: Any) -> bool:
    return isinstance(item, dict) or (
        isinstance(item, list) and bool(item) and all(isinstance(row, dict) for row in item)
    )


def _toml(item: Any) -> str:
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, float) and not math.isfinite(item):
        return "nan" if math.isnan(item) else "inf" if item > 0 else "-inf"
    if isinstance(item, (int, float)):
        return repr(item)
    if isinstance(item, str):
        return json.dumps(item)
    if isinstance(item, list):
        return "[" + ", ".join(map(_toml, item)) + "]"
    if isinstance(item, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in item.items()) + " }"
    return "null"
