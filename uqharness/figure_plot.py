"""How figures get to the disk."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from uqharness.whole_files import write_whole


def save(figure: Figure, path: Path) -> None:
    """Write the figure as SVG, whole or not at all."""
    # No date in the file: the same input gives the same bytes.
    write_whole(path, lambda target: figure.savefig(target, format="svg", metadata={"Date": None}))
