"""Fill in the parts of pages that are written elsewhere, or made from the program itself.

A line `<!-- generated: command-line -->` is replaced by the text of `command_line.markdown`, and
`<!-- file: CONTRIBUTING.md -->` by a file of the repository, whose links to other files become
links to the pages that show them.
"""

import re
from importlib import import_module
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]
MARK = re.compile(r"^<!-- (generated|file): (\S+) -->$", re.MULTILINE)


def shown_files(docs: Path) -> dict[str, str]:
    """Return, by the path of a file in the repository, the page that shows it."""
    pages = [(page, page.read_text(encoding="utf-8")) for page in docs.glob("*.md")]
    return {mark[2]: page.name for page, text in pages for mark in MARK.finditer(text)}


def file_text(path: str, pages: dict[str, str]) -> str:
    """Return a file with its links as they are from a page."""

    def linked(link: re.Match[str]) -> str:
        target = (ROOT / path).parent / link[1]
        name = str(target.resolve().relative_to(ROOT)) if target.exists() else link[1]
        return f"]({pages.get(name, link[1])}"

    return re.sub(r"\]\((?!\w+:|#)([^)#\s]+)", linked, (ROOT / path).read_text(encoding="utf-8"))


def fill_in(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the marks of one page."""
    pages = shown_files(Path(app.srcdir))

    def replacement(mark: re.Match[str]) -> str:
        if mark[1] == "generated":
            return import_module(mark[2].replace("-", "_")).markdown()
        app.env.note_dependency(str(ROOT / mark[2]))
        return file_text(mark[2], pages)

    source[0] = MARK.sub(replacement, source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Fill pages in as they are read."""
    app.connect("source-read", fill_in)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
