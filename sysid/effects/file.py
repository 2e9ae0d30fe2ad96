"""A user's own effects from a TOML file:

[[effect]]
coefficient = "Cm"
term = "p_hat^2*CT"
physics = "slipstream on the tail in a roll"        # optional, as are name, regime, sign, reference
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sysid.effects.catalogue import Effect, coefficient_effect
from sysid.errors import LogError
from sysid.foreign.parsed_text import ParseError, parse_toml
from sysid.foreign.regular_files import read_regular_text

_KEYS = {"coefficient", "term", "name", "physics", "regime", "sign", "reference"}
_MOST_CHARACTERS = 2000
"""Of a text of an effect: some paragraphs."""


def read_effects(path: Path) -> list[Effect]:
    """The effects of a file. Raises LogError with file, entry and what is allowed."""
    try:
        data = parse_toml(read_regular_text(path))
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror or error}", path) from None
    except ParseError as error:
        raise LogError(str(error), path) from None
    except UnicodeDecodeError:
        raise LogError("not a text file in UTF-8", path) from None
    rows = data.get("effect")
    if set(data) - {"effect"} or not isinstance(rows, list) or not rows:
        raise LogError(
            f"holds {sorted(data) or 'nothing'}; it needs tables [[effect]] with coefficient and term",
            path,
        )
    out: list[Effect] = []
    numbers: dict[str, int] = {}
    for number, row in enumerate(rows, 1):
        where = f"[[effect]] {number}"
        if not isinstance(row, dict) or {"coefficient", "term"} - set(row):
            raise LogError("needs coefficient and term", path, where)
        if unknown := sorted(set(row) - _KEYS):
            raise LogError(
                f"unknown key '{unknown[0]}'; allowed are {', '.join(sorted(_KEYS))}", path, where
            )
        if wrong := [k for k, v in row.items() if not isinstance(v, str)]:
            raise LogError(f"{wrong[0]} must be text; received {row[wrong[0]]!r}", path, where)
        # The texts go into pages and into comments of the refined XML, which has no place for control characters.
        for key, text in row.items():
            if len(text) > _MOST_CHARACTERS:
                raise LogError(
                    f"{key} has {len(text)} characters; allowed are {_MOST_CHARACTERS}", path, where
                )
            if control := [c for c in text if ord(c) < 32 and c not in "\n\r\t"]:
                raise LogError(
                    f"{key} has the control character {control[0]!r}; give plain text", path, where
                )
        try:
            effect = coefficient_effect(row["coefficient"], row["term"])
        except ValueError as error:
            raise LogError(str(error), path, where) from None
        if effect.key in numbers:
            raise LogError(
                f"{effect.coefficient}, {row['term']} is [[effect]] {numbers[effect.key]} too; give each effect once",
                path,
                where,
            )
        numbers[effect.key] = number
        told = {k: text for k, text in row.items() if text and k not in ("coefficient", "term")}
        out.append(replace(effect, odds=0.0, **told))
    return out
