"""TOML and JSON from files that anybody may have written: plain types, or one error that says what is wrong.

The standard readers raise other things too: nesting thousands of levels deep ends in a RecursionError, an integer of more than
4300 digits in a ValueError that speaks of an interpreter setting.
"""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any

_TOO_DEEP = "its brackets are nested too deeply"
_TOO_LONG = "it holds an integer of thousands of digits"


class ParseError(ValueError):
    """Text that is not what it should be. ``str`` completes a sentence; ``line`` counts from 1, None where it is not known."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ParseError."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        at_end = text.count("\n") + 1
        raise ParseError(
            f"not valid TOML: {error}", int(found.group(1)) if found else at_end
        ) from None
    except RecursionError:
        raise ParseError(f"not usable as TOML: {_TOO_DEEP}") from None
    except ValueError:
        raise ParseError(f"not usable as TOML: {_TOO_LONG}") from None


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds. Raises ParseError, also for bytes that are no UTF-8."""
    try:
        return json.loads(text.decode("utf-8") if isinstance(text, bytes) else text)
    except UnicodeDecodeError:
        raise ParseError("not a text file in UTF-8") from None
    except json.JSONDecodeError as error:
        raise ParseError(f"is no JSON ({error.msg})", error.lineno) from None
    except RecursionError:
        raise ParseError(f"not usable as JSON: {_TOO_DEEP}") from None
    except ValueError:
        raise ParseError(f"not usable as JSON: {_TOO_LONG}") from None
