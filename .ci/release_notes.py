"""Print the notes of a release from CHANGELOG.md: ``python .ci/release_notes.py 0.6.0``.

Exit code 1 if the version is not that of pyproject.toml, or the changelog has no section for
it.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def section(changelog: str, version: str) -> str:
    """Text of the version's section, without its heading; empty where there is none."""
    found = re.search(
        rf"^## {re.escape(version)} \(\d{{4}}-\d\d-\d\d\)\n(.*?)(?=^## |\Z)", changelog, re.M | re.S
    )
    return "" if found is None else found[1].strip()


def main(words: list[str]) -> int:
    """Print the notes; the exit code."""
    if len(words) != 1:
        print("usage: release_notes.py VERSION", file=sys.stderr)
        return 2
    known = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    text = section((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), words[0])
    if words[0] != known:
        print(
            f"release_notes: version {words[0]} was asked for, pyproject.toml has {known}",
            file=sys.stderr,
        )
    elif not text:
        print(f"release_notes: CHANGELOG.md has no dated section {words[0]}", file=sys.stderr)
    else:
        print(text)
        return 0
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
