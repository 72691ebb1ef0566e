"""Write the texts that the search page searches: those of every section of every page.

The index of Sphinx knows which pages have a word, but neither where nor how often. The search page
of Sphinx fetches other pages to show excerpts; browsers refuse this to a page that is opened from a
folder. So `static/search.js` searches the texts that this module writes. Rows of `words.md` are
synonyms: a search for a word of the first cell shows the second one, which leads to the page of its
first link.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

FILE = "_static/search-texts.js"
SYNONYMS = "words"
WEIGHTS = {
    "changelog": 0.01,
    "conduct": 0.3,
    "contributing": 0.3,
    "artifacts": 0.4,
    "ledger": 0.4,
    "faults": 0.4,
    "reference-data": 0.5,
    "paper": 0.5,
    "paper/": 0.3,
    "index": 0.6,
    "glossary": 0.7,
    "gallery": 0.7,
    "case-file": 1.5,
    "command-line": 0.8,
    "python/": 0.8,
}
"""Factors of the scores of pages, or of all pages of a folder; other pages have the factor 1."""
ROW = re.compile(r"^\| (?P<words>[^|]+) \| (?P<answer>[^|]+) \|$", re.MULTILINE)
LINK = re.compile(r"\[([^\]]+)\]\(([\w/-]+)\.md(#[\w-]+)?\)")
UNREAD = (nodes.section, nodes.title, nodes.math_block, nodes.raw, nodes.comment)
"""Parts that are not in the text of a section; its title and subsections are stored separately."""


def words_of(node: nodes.Node) -> Iterator[str]:
    """Yield the texts within a node, without those of `UNREAD`."""
    for child in node.children:
        if isinstance(child, nodes.Text):
            yield child.astext()
        elif isinstance(child, nodes.math):
            yield "…"
        elif not isinstance(child, UNREAD):
            yield from words_of(child)
            if not isinstance(child, nodes.Inline):
                yield " "


def names_of(section: nodes.section) -> Iterator[str]:
    """Yield the names that tables of a section describe: first cells that contain only code."""
    tables = (part for part in section.children if isinstance(part, nodes.table))
    for table in tables:
        for row in table.findall(nodes.row):
            name = row[0].astext()
            if [code.astext() for code in row[0].findall(nodes.literal)] == [name]:
                yield name


def sections_of(page: nodes.document) -> Iterator[list[Any]]:
    """Yield the title, the anchor, the text and the described names of every section of a page."""
    for section in page.findall(nodes.section):
        title = section.next_node(nodes.title)
        text = " ".join("".join(words_of(section)).split())
        yield [title.astext(), section["ids"][0], text, list(names_of(section))]


def synonyms(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the words, the page with its anchor, and the answer of every row."""
    for row in ROW.finditer(path.read_text(encoding="utf-8")):
        if target := LINK.search(row["answer"]):
            text = LINK.sub(r"\1", row["answer"]).replace("`", "")
            words = row["words"].split(", ")
            yield {"words": words, "page": target[2], "anchor": target[3] or "", "text": text}


def weight_of(page: str) -> float:
    """Return the weight of a page."""
    folder = page.split("/")[0] + "/"
    return WEIGHTS.get(page, WEIGHTS.get(folder, 1.0) if "/" in page else 1.0)


def write(app: Sphinx, exception: Exception | None) -> None:
    """Write the texts of all pages as a script, which a page may load from a folder."""
    if exception is not None or app.builder.name != "html":
        return
    pages = [
        {
            "page": page,
            "title": app.env.titles[page].astext(),
            "weight": weight_of(page),
            "sections": list(sections_of(app.env.get_doctree(page))),
        }
        for page in sorted(app.env.all_docs)
        if page != SYNONYMS
    ]
    rows = list(synonyms(Path(app.srcdir) / f"{SYNONYMS}.md"))
    content = json.dumps({"pages": pages, "synonyms": rows}, ensure_ascii=False)
    path = Path(app.outdir) / FILE
    path.write_text(f"const TEXTS = {content};\n", encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write them when all pages are written."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
