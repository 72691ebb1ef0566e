r"""Formulas by MathJax, which is copied beside the pages: they need no network to show a formula.

MathJax comes from a package that carries its files. `tex-svg-full.js` is all that a page loads: it
holds the letters and every LaTeX extension. MathJax runs in the browser, so a wrong formula would
only show there. The build therefore warns of commands that MathJax doesn't know, and of braces and
environments that don't pair.
"""

import re
import shutil
from functools import cache
from importlib.metadata import distribution
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

SCRIPT = "tex-svg-full.js"
CARRIER = "sphinx-mathjax-offline"
COMMAND = re.compile(r"\\([A-Za-z]+)")
BRACE = re.compile(r"(?<!\\)(?:\\\\)*([{}])")
ENVIRONMENT = re.compile(r"\\(begin|end)\{(\w+\*?)\}")


def mathjax() -> Path:
    """Return the file of MathJax that pages load."""
    return Path(distribution(CARRIER).locate_file(f"{CARRIER}/static/mathjax/{SCRIPT}"))


@cache
def _is_known(command: str) -> bool:
    """Whether a command is a key of MathJax's tables."""
    text = mathjax().read_text(encoding="utf-8")
    return re.search(rf"""[{{,]["']?(?:\\\\)?{command}["']?:""", text) is not None


def problems(latex: str) -> list[str]:
    """Return the reasons why MathJax couldn't show a formula."""
    commands, braces = COMMAND.findall(latex), BRACE.findall(latex)
    environments = ENVIRONMENT.findall(latex)
    pairs = {
        "braces": (braces.count("{"), braces.count("}")),
        "\\left and \\right": (commands.count("left"), commands.count("right")),
    }
    for _, name in environments:
        pairs[name] = (environments.count(("begin", name)), environments.count(("end", name)))
    unknown = [f"unknown command \\{name}" for name in set(commands) if not _is_known(name)]
    return [*unknown, *(f"{name} don't pair" for name, (a, b) in pairs.items() if a != b)]


def check(app: Sphinx, page: nodes.document) -> None:
    """Warn of formulas that MathJax couldn't show."""
    for kind in (nodes.math, nodes.math_block):
        for node in page.findall(kind):
            for problem in problems(node.astext()):
                logging.getLogger(__name__).warning("formula: %s", problem, location=node)


def copy_script(app: Sphinx, exception: Exception | None) -> None:
    """Put MathJax among the static files."""
    if exception is None and app.builder.format == "html":
        shutil.copyfile(mathjax(), Path(app.outdir) / "_static" / SCRIPT)


def setup(app: Sphinx) -> dict[str, bool]:
    """Let pages load MathJax from their own files, and check formulas as they are read."""
    app.config.mathjax_path = SCRIPT
    app.config.mathjax3_config = {"options": {"enableMenu": False}}
    app.connect("doctree-read", check)
    app.connect("build-finished", copy_script)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
