"""Every module has its tests in the mirrored folder, in a file of its name or one that imports it. The exceptions may only become
fewer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tests.architecture.rooms import imported_by, modules
from tests.helpers.places import ROOT, TESTS

# Rooms that are tested from their doors.
WHOLE: Mapping[str, str] = {}
# Single modules, and where they are tested.
ELSEWHERE: Mapping[str, str] = {}


def own_tests(name: str, path: Path) -> list[Path]:
    """Test files of a module in its mirrored folder."""
    folder = TESTS / path.relative_to(ROOT).parent
    found = [folder / f"test_{path.stem}.py"] if (folder / f"test_{path.stem}.py").is_file() else []
    for test in folder.rglob("test_*.py"):
        if any(name in names for names in imported_by(test.read_text(encoding="utf-8"))):
            found.append(test)
    return found


def untested() -> set[str]:
    """Modules without a test file of their own."""
    return {name for name, path in modules().items() if path.stem not in ("__init__", "__main__") and not own_tests(name, path)}


def test_every_module_has_its_tests():
    missing = {name for name in untested() if not any(name.startswith(f"{room}.") for room in WHOLE)}
    assert missing == set(ELSEWHERE)


def test_exceptions_lead_somewhere():
    known = modules()
    assert [room for room in WHOLE if not any(name.startswith(f"{room}.") for name in known)] == []
    for name, place in ELSEWHERE.items():
        assert name in known
        assert (TESTS / place).is_file(), place
