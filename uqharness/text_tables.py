"""Tables as lines of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def text_table(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Rows of equal keys as lines for a terminal."""
    keys = list(rows[0])
    width = {k: max(len(k), *(len(r[k]) for r in rows)) for k in keys}
    return ["  ".join(k.rjust(width[k]) for k in keys), *("  ".join(r[k].rjust(width[k]) for k in keys) for r in rows)]
