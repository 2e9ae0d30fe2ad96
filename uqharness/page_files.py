"""Reading the documents that pages are made from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uqharness.errors import BadInputError


def read_document(path: Path, keys: Sequence[str]) -> dict[str, Any]:
    """A JSON object that has ``keys``. Raises BadInputError naming what is wrong with the file."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    except json.JSONDecodeError as error:
        raise BadInputError(f"{path}, line {error.lineno}: is no JSON ({error.msg}); run its command again") from None
    if not isinstance(document, dict):
        raise BadInputError(f"{path}: is no JSON object; run its command again")
    missing = [key for key in keys if key not in document]
    if missing:
        raise BadInputError(f"{path}: lacks {', '.join(missing)}; run its command again")
    return document


def read_optional(path: Path) -> dict[str, Any]:
    """The same for a file that need not be there: empty then."""
    return read_document(path, ()) if path.is_file() else {}
