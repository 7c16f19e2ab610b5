"""Sphinx configuration. Pages that can be derived from the code are generated at build time."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402

import lambent  # noqa: E402

project = "Lambent"
author = "The Lambent authors"
copyright = "2026, the Lambent authors"
release = lambent.__version__
version = release

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "mathml",
]
html_math_renderer = "mathml"
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
smartquotes_action = "qe"  # no dashes: --option stays two hyphens
source_suffix = {".md": "markdown"}
exclude_patterns = [
    "_build",
    "methods/filters_intro.md",
    "_generated/dialects.md",
    "_generated/metrics.md",
    "results/*",
]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
html_theme = "furo"
html_title = "Lambent"
html_static_path = ["_static"]
html_css_files = ["lambent.css"]
html_theme_options = {"sidebar_hide_name": False}
nitpicky = False

generate.everything(HERE / "_generated")
