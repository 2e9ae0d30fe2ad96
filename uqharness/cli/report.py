"""Damaged files of a folder whose page a command has written."""

from __future__ import annotations

import sys
from pathlib import Path

from uqharness.report import Report


def note_damage(folder: Path, report: Report) -> int:
    """Print which files are damaged; return exit code 1 where some could not be restored."""
    for sentence in report.warnings:
        print(sentence, file=sys.stderr)
    return 1 if report.damaged else 0
