"""Build the documentation: `python docs/site/build.py [--out DIR]`; `make docs` calls it.

The pages are read where they lie in the repository, so a link that works there works here. The
reference is written from the code at every build. A link without a target, or any other warning,
fails the build."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
FIGURES = {".svg", ".png", ".csv"}


def stage(folder: Path) -> None:
    """Copy every page and figure to ``folder``, paths kept, and write the reference beside them."""
    pages = [
        ROOT / "README.md",
        ROOT / "CHANGELOG.md",
        ROOT / "SECURITY.md",
        ROOT / "CONTRIBUTING.md",
        *(ROOT / "docs").glob("*.md"),
        *(ROOT / "campaigns").glob("*/README.md"),
    ]
    figures = [
        path
        for top in ("docs", "campaigns")
        for path in (ROOT / top).rglob("*")
        if path.suffix in FIGURES
        and HERE not in path.parents
        and not any(p.startswith("results") for p in path.parts)
    ]
    for path in (*pages, *figures):
        target = folder / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    for target in {target for page in pages for target in linked(page)}:
        if not (folder / target).exists():
            (folder / target).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / target, folder / target)
    for path in (ROOT / "docs" / "notebooks").glob("*.ipynb"):
        target = (folder / path.relative_to(ROOT)).with_suffix(".md")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(notebook_page(path), encoding="utf-8")
    (folder / "index.md").write_text(index(), encoding="utf-8")
    import reference

    for name, text in reference.pages().items():
        target = folder / "docs" / "reference" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")


def notebook_page(path: Path) -> str:
    """A notebook as a page: its text, and its code to read; it is committed without results."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    pieces = []
    for cell in cells:
        text = "".join(cell["source"]) if isinstance(cell["source"], list) else cell["source"]
        pieces.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    return (
        "\n\n".join(
            [*pieces, f"The notebook is `{path.relative_to(ROOT).as_posix()}`; a test runs it."]
        )
        + "\n"
    )


def linked(page: Path) -> set[Path]:
    """Files of the repository that a page links to, relative to its root; what is not there stays a
    broken link.
    """
    found = set()
    for address in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        path = (page.parent / address).resolve() if "://" not in address else ROOT
        if path.is_file() and path.is_relative_to(ROOT):
            found.add(path.relative_to(ROOT))
    return found


def index() -> str:
    """The first page; a page of docs/ that it does not place yet is listed under "Tasks"."""
    text = (HERE / "index.md").read_text(encoding="utf-8")
    placed = set(re.findall(r"^docs/([\w-]+)$", text, re.M))
    more = [
        f"docs/{path.stem}"
        for path in sorted((ROOT / "docs").glob("*.md"))
        if path.stem not in placed
    ]
    return text.replace("docs/extend\n", "\n".join(["docs/extend", *more]) + "\n")


def build(out: Path) -> int:
    """Build the site into ``out``; the exit code, 1 for any warning."""
    try:
        from sphinx.cmd.build import main as sphinx
    except ImportError:
        print(
            "the documentation needs its extra: pip install 'uqharness[docs]' (make setup"
            " installs it)",
            file=sys.stderr,
        )
        return 2
    with tempfile.TemporaryDirectory(prefix="uqharness-docs-") as name:
        source = Path(name) / "source"
        source.mkdir()
        stage(source)
        # Built anew each time, in a cache that goes with the source: what is tested is what a fresh
        # checkout gives.
        options = [
            "-b",
            "html",
            "-W",
            "--keep-going",
            "-q",
            "-c",
            str(HERE),
            "-d",
            str(Path(name) / "cache"),
        ]
        return int(sphinx([*options, str(source), str(out)]))


def _main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "build" / "docs",
        metavar="DIR",
        help="default build/docs",
    )
    out = parser.parse_args().out
    sys.path[:0] = [str(HERE), str(ROOT)]
    code = build(out)
    if code == 0:
        print(f"{out / 'index.html'}")
    return code


if __name__ == "__main__":
    sys.exit(_main())
