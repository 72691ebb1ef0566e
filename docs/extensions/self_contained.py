"""Warn of files that a built page would fetch from the network while it is read."""

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

LOADED = re.compile(
    r"<(?:script|img|iframe|source|video|audio)\b[^>]*\bsrc=[\"'](?:https?:)?//[^\"']+"
    r"|<link\b[^>]*\brel=[\"'](?:stylesheet|preload|icon|preconnect)[^>]*(?:https?:)?//[^\"']+"
    r"|(?:@import|url\()\s*[\"']?(?:https?:)?//[^\"')]+"
)


def check(app: Sphinx, exception: Exception | None) -> None:
    """Warn of every address in a page or style sheet that a browser would load by itself."""
    if exception is not None or app.builder.format != "html":
        return
    for path in sorted(Path(app.outdir).rglob("*")):
        if path.suffix not in (".html", ".css"):
            continue
        for found in LOADED.findall(path.read_text(encoding="utf-8")):
            logging.getLogger(__name__).warning("%s loads from the network: %s", path, found)


def setup(app: Sphinx) -> dict[str, bool]:
    """Check when the pages are written."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
