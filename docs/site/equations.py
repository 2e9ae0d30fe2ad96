"""Equations as MathML, which browsers draw themselves: no script and nothing fetched from a
network.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

# Accents of one letter become combining characters: without a font made for mathematics a browser
# sets them into the letter.
_ACCENT = re.compile(r'<mover accent="true">\s*<mi>(.)</mi>\s*<mo[^>]*>([˙ˉˆ])</mo>\s*</mover>')
_COMBINING = {"˙": "\u0307", "ˉ": "\u0304", "ˆ": "\u0302"}


def mathml(tex: str, display: bool) -> str:
    """MathML of a TeX formula."""
    text = tex2mathml(tex, as_block=display)
    return _ACCENT.sub(
        lambda found: f'<mi class="accented">{found[1]}{_COMBINING[found[2]]}</mi>', text
    )


def _inline(self: Any, node: nodes.math) -> None:
    self.body.append(mathml(node.astext(), display=False))
    raise nodes.SkipNode


def _display(self: Any, node: nodes.math_block) -> None:
    # The label is the equation's number in the source it comes from, not one counted here.
    label = node.get("label")
    anchor = f' id="{node["ids"][0]}"' if node["ids"] else ""
    number = f'<span class="eqno">({label})</span>' if label else ""
    formula = f'<div class="formula">{mathml(node.astext(), display=True)}</div>'
    self.body.append(f'<div class="math"{anchor}>{formula}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
