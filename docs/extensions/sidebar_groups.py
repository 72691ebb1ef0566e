"""Fold the groups of the sidebar, so that it fits a screen; the group of the shown page is open."""

import re
from itertools import count
from typing import Any

from sphinx.application import Sphinx

CAPTION = re.compile(
    r'<p class="caption"[^>]*><span class="caption-text">([^<]*)</span></p>\s*(<ul\b.*?)'
    r'(?=<p class="caption"|\Z)',
    re.DOTALL,
)
AFTER_THE_THEME = 900
"""A priority: the theme makes the list of pages at 500."""


def fold(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: object) -> None:
    """Turn each caption and its list into an element that opens and closes."""
    pages = context.get("furo_navigation_tree", "")
    somewhere = 'class="current"' in pages or " current" in pages
    groups = count()

    def folded(group: re.Match[str]) -> str:
        is_first = next(groups) == 0
        is_open = "current" in group[2] if somewhere else is_first
        return (
            f'<details name="pages"{" open" * is_open}><summary>{group[1]}</summary>'
            f"{group[2]}</details>"
        )

    context["furo_navigation_tree"] = CAPTION.sub(folded, pages)


def setup(app: Sphinx) -> dict[str, bool]:
    """Fold them when a page is made."""
    app.connect("html-page-context", fold, priority=AFTER_THE_THEME)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
