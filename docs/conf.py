"""How Sphinx builds these pages; `make docs` calls it, and every warning is an error."""

import logging
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

from sphrom.version import __version__ as release

logging.getLogger("numexpr").setLevel(logging.WARNING)  # it says how many threads it takes

project = "sphrom"
author = "the authors of sphrom"
version = release
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "docstrings",
    "formulas",
    "generated_pages",
    "linked_pictures",
    "search_texts",
    "self_contained",
    "sidebar_groups",
    "type_aliases",
]
exclude_patterns = ["extensions", "templates", "README.md"]
templates_path = ["templates"]
nitpicky = True
# The documentation of other packages would have to be fetched; of sphrom only the API is public.
nitpick_ignore_regex = [("py:.*", r"(?!sphrom\.api).*"), ("py:.*", r".*\._.*")]
default_role = "literal"

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "dollarmath"]
myst_heading_anchors = 3

autodoc_typehints = "signature"
# `docs/python.md` explains them.
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Quantities")}
autodoc_member_order = "bysource"
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"sphrom {release}"
html_logo = "static/logo.svg"
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_show_sphinx = False
html_show_copyright = False
highlight_language = "none"
html_copy_source = False
