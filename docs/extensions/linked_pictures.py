"""Pictures fill the page, and open in full size when they are clicked."""

from docutils import nodes
from sphinx.application import Sphinx


def widen(app: Sphinx, page: nodes.document) -> None:
    """Give each picture a width: Sphinx then links it to the whole picture."""
    for picture in page.findall(nodes.image):
        picture.setdefault("width", "100%")


def setup(app: Sphinx) -> dict[str, bool]:
    """Widen pictures when a page is read."""
    app.connect("doctree-read", widen)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
