"""Where the files lie that come with the package: aircraft, run scripts, campaigns, published figures.

In a working copy that is the folder above the packages; in an installed wheel, ``uqharness/data``, with the same names inside.
"""

from __future__ import annotations

from pathlib import Path

from uqharness.errors import BadInputError

_INSTALLED = Path(__file__).resolve().parent / "data"

PROJECT_ROOT = _INSTALLED if _INSTALLED.is_dir() else Path(__file__).resolve().parent.parent
"""Folder that holds ``aircraft``, ``scripts``, ``campaigns`` and ``tests/reference``. Read, never written to."""


def find_campaign(name_or_path: str | Path, file: str = "campaign.toml") -> Path:
    """The campaign file of that path (here, then in the project), or of the project's campaign of that name.

    ``file`` is what is taken where a folder or a name is given. Raises BadInputError naming what there is.
    """
    given = Path(name_or_path)
    for root in (Path(), PROJECT_ROOT, PROJECT_ROOT / "campaigns"):
        for path in (root / given, root / given / file):
            if path.is_file():
                return path
    known = sorted(path.parent.name for path in (PROJECT_ROOT / "campaigns").glob(f"*/{file}"))
    raise BadInputError(
        f"campaign '{name_or_path}' not found: no such file here or in {PROJECT_ROOT}, no folder with a {file}, "
        f"and no name of one under campaigns/ (there: {', '.join(known) or 'none'})"
    )
