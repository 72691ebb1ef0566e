"""Aliases of types keep their names in signatures, and link to the page that explains them.

Sphinx replaces an alias by a placeholder. Inside of another type, such as
`Callable[[Array], ArrayLike]`, it prints the placeholder's `repr`, which is the alias here. The
build warns about signatures that spell out a type of arrays.
"""

import re

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import inspect, logging

SPELLED_OUT = re.compile(r"TypeAliasForwardRef|_Buffer|_SupportsArray|_NestedSequence|ndarray\[")


def check(app: Sphinx, page: nodes.document) -> None:
    """Warn about signatures that spell an alias out."""
    for node in page.findall(addnodes.desc_signature):
        if SPELLED_OUT.search(node.astext()):
            logging.getLogger(__name__).warning(
                "signature: %s has a type that needs an entry in autodoc_type_aliases",
                node.get("fullname"),
                location=node,
            )


def setup(app: Sphinx) -> dict[str, bool]:
    """Print placeholders as aliases, and check signatures as pages are read."""
    inspect.TypeAliasForwardRef.__repr__ = lambda alias: alias.name
    app.connect("doctree-read", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
