"""Cases for ``pytest.mark.parametrize``: a few of many alike, or a table of text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def few(cases: Iterable[Any], number: int) -> list[Any]:
    """The cases for ``pytest.mark.parametrize``: ``number`` of them, spread evenly from the first
    to the last, as they are, the others marked slow. A tuple is a case of several names."""
    inputs = list(cases)
    retained = {round(k * (len(inputs) - 1) / max(number - 1, 1)) for k in range(number)}
    return [case if k in retained else _slow(case) for k, case in enumerate(inputs)]


def _slow(case: Any) -> Any:
    if hasattr(case, "marks"):
        return pytest.param(*case.values, marks=[*case.marks, pytest.mark.slow], id=case.id)
    return (
        pytest.param(*case, marks=pytest.mark.slow)
        if isinstance(case, tuple)
        else pytest.param(case, marks=pytest.mark.slow)
    )


def rows(text: str) -> list[tuple[str, ...]]:
    """The cases of a table: a line each, cells between bars; ``\\n`` in a cell ends a line."""
    return [
        tuple(cell.strip().replace("\\n", "\n") for cell in line.split(" | "))
        for line in text.strip().splitlines()
    ]
