"""Docstrings as they are written here, as reStructuredText.

Sections are those of numpydoc, but `name : text` describes a parameter and doesn't tell its type,
which is in the signature.
"""

import re

from sphinx.application import Sphinx

SECTION = re.compile(r"(?:^|\n)(Parameters|Returns|Raises)\n-{3,}\n")
PARAMETER = re.compile(r"^(\S+(?:, \S+)*) : ", re.MULTILINE)
ERROR = re.compile(r"^(\w+)\n(?=    )", re.MULTILINE)
NAMED_ERROR = re.compile(r"(?<!:raises )\b(?:Case|Artifact|Unstable|Resource)Error\b")


def restructured(text: str) -> str:
    """Return a docstring whose sections are lists of fields, and whose errors are links."""
    before, *sections = SECTION.split(text)
    for name, content in zip(sections[::2], sections[1::2], strict=True):
        entries, rest = (*content.split("\n\n", 1), "")[:2]
        before += f"\n\n{_fields(name, entries.rstrip())}\n\n{rest}"
    return NAMED_ERROR.sub(r":exc:`~sphrom.errors.\g<0>`", before)


def _fields(section: str, entries: str) -> str:
    if section == "Parameters":
        return PARAMETER.sub(r":param \1: ", entries)
    if section == "Raises":
        return ERROR.sub(r":raises \1:\n", entries)
    return ":returns: " + entries.replace("\n", "\n    ")


def process(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Rewrite one docstring in place."""
    lines[:] = restructured("\n".join(lines)).split("\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Rewrite docstrings as they are read."""
    app.connect("autodoc-process-docstring", process)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
