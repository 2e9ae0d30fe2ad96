"""Every format that a user can hand in: what a sound input is, how it is damaged, and what the
program does with it.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

CORPUS = Path(__file__).parent / "corpus"
SOUND = -1
"""The seed of an undamaged input."""

Files = dict[str, bytes]
Mutator = Callable[[bytes, np.random.Generator], bytes]


@dataclass(frozen=True)
class Format:
    """One format.

    sources   inputs: files below CORPUS by the name they get in the input's folder; the first is
    sound, the seed takes one damaged   names of the files that are damaged, one of them each time
    mutate    bytes and a generator to other bytes
    run       called with the input's folder and the seed: returns what came out, or raises; see
    ``outcome``
    share     of the time of a run, relative to the others
    afterwards  may change other files to fit the damaged one, as somebody would who means harm
    """

    name: str
    sources: tuple[Mapping[str, str], ...]
    damaged: tuple[str, ...]
    mutate: Mutator
    run: Callable[[Path, int], None]
    share: float = 1.0
    afterwards: Callable[[Files, str, np.random.Generator], None] | None = None

    def make(self, seed: int) -> Files:
        """The input of that seed: the same for the same seed, corpus and libraries."""
        rng = np.random.default_rng([seed + 1, zlib.crc32(self.name.encode())])
        source = self.sources[0 if seed == SOUND else int(rng.integers(0, len(self.sources)))]
        files = {name: _content(place) for name, place in source.items()}
        if seed != SOUND:
            name = self.damaged[int(rng.integers(0, len(self.damaged)))]
            files[name] = self.mutate(files[name], rng)
            if self.afterwards is not None:
                self.afterwards(files, name, rng)
        return files


@cache
def _content(place: str) -> bytes:
    return (CORPUS / place).read_bytes()


def folder(place: str, under: str = "") -> dict[str, str]:
    """All files of a folder of the corpus, as a source; ``under``: the folder that they stand in
    within the input.
    """
    root = CORPUS / place
    prefix = f"{under}/" if under else ""
    paths = sorted(path for path in root.rglob("*") if path.is_file())
    return {
        f"{prefix}{path.relative_to(root).as_posix()}": os.path.relpath(path, CORPUS)
        for path in paths
    }


def all_formats() -> dict[str, Format]:
    """Every format by name."""
    from tests.fuzz.targets import FORMATS

    return {item.name: item for item in FORMATS}
