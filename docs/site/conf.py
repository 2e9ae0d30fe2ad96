"""Settings of the built pages; build.py calls Sphinx with them."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

project = "uqharness"
author = "The uqharness authors"
copyright = f"2026, {author}"
extensions = ["myst_parser", "equations", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
# Docstrings give types, units and shapes in words.
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_class_signature = "separated"
autodoc_default_options = {"exclude-members": "__init__, __new__"}
napoleon_google_docstring = False
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
source_suffix = {".md": "markdown"}
root_doc = "index"
html_theme = "furo"
html_title = "uqharness"
html_static_path = ["static"]
html_css_files = ["tables.css"]
html_math_renderer = "mathml"
# Nothing is fetched from a network, neither while building nor while reading.
html_theme_options = {"top_of_page_buttons": []}
html_copy_source = False
html_show_sphinx = False
