"""What a campaign's epistemic samples are called: texts are written for corners, and say what was flown instead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from uqharness.report.parts import Figure

Part = TypeVar("Part")
NOUNS: Mapping[str, str] = {"corners": "corner", "levels": "combination", "walk": "walk"}
"""[epistemic] method -> one of its samples; any other: sample."""


def kind_of(epistemic: Mapping[str, Any]) -> str:
    """What ``called`` takes for a campaign's [epistemic]: its method, unless other samples flew beside or in place of corners."""
    mixed = epistemic["method"] == "corners" and (
        epistemic.get("interior") or epistemic.get("nominal") or epistemic["set"] != "box"
    )
    return "samples" if mixed else str(epistemic["method"])


def called(part: Part, method: str) -> Part:
    """A text, or a part of a page with all texts in it, that names the samples of ``method``. Drawings stay as they are."""
    noun = NOUNS.get(method, "sample")
    return part if noun == "corner" else _renamed(part, noun)


def _renamed(part: Any, noun: str) -> Any:
    if isinstance(part, str):
        return part.replace("corner", noun).replace("Corner", noun.capitalize())
    if isinstance(part, tuple):
        return tuple(_renamed(item, noun) for item in part)
    if isinstance(part, Figure):
        return replace(part, caption=_renamed(part.caption, noun))
    if is_dataclass(part) and not isinstance(part, type):
        return replace(
            part, **{f.name: _renamed(getattr(part, f.name), noun) for f in fields(part)}
        )
    return part
