"""Sphinx configuration: `make docs` builds the pages to build/docs/."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent / "_ext")]

project = "gyrobench"
author = "The gyrobench authors"
extensions = ["myst_parser", "mathml"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_ext", "_build", "examples"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nitpicky = True
suppress_warnings = ["misc.highlighting_failure"]
pygments_style = "friendly"

html_math_renderer = "mathml"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
smartquotes = False
html_title = "gyrobench"
html_show_copyright = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
