"""How figures get to the disk."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.text import Text

from sysid.terminal import visible
from uqharness.files import write_whole


def save(figure: Figure, path: Path) -> None:
    """Write the figure as SVG, whole or not at all. Names of flights and files in it are text, whatever they look like."""
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        words = text.get_text()
        # Between dollars matplotlib reads formulas; its own labels of powers of ten, made when it draws, have them.
        if "$" in words and "\\mathdefault" not in words:
            text.set_parse_math(False)
        text.set_text(visible(words))
    # No date in the file: the same input gives the same bytes.
    write_whole(path, lambda target: figure.savefig(target, format="svg", metadata={"Date": None}))
