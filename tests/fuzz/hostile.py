"""Values that readers trip over, shared by the mutators."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

OUTSIDE = "/tmp/uq-fuzz-outside"
"""A folder that exists while the fuzzer runs and that no command has a reason to touch."""

WORDS = json.loads(Path(__file__).with_name("words.json").read_text(encoding="utf-8"))
"""What the mutators plant, by kind."""
STRINGS, ELEMENTS = (
    tuple(
        text.replace("{OUTSIDE}", OUTSIDE).replace("{LONG}", "x" * 20_000) for text in WORDS[kind]
    )
    for kind in ("strings", "xml_elements")
)
NUMBERS = tuple(WORDS["numbers"])


def pick(items: Any, rng: np.random.Generator) -> Any:
    """One of ``items``."""
    return items[int(rng.integers(0, len(items)))]


def string(rng: np.random.Generator) -> str:
    """One of ``STRINGS``, now and then two of them joined."""
    text = pick(STRINGS, rng)
    return text + pick(STRINGS, rng) if rng.random() < 0.1 else text


def number(rng: np.random.Generator) -> int | float:
    """One of ``NUMBERS``."""
    return pick(NUMBERS, rng)
