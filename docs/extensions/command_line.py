"""The commands and their options, as Markdown, from the command line's own definitions."""

import re

import typer
from typer.cli import get_docs_for_click
from typer.main import get_command

from sphrom.cli.app import app

EXAMPLE = re.compile(r"^(Example[^\n]*:\n)((?:  [^\n]*\n)+)", re.MULTILINE)


def _fence(found: re.Match[str]) -> str:
    commands = re.sub(r"^  ", "", found[2], flags=re.MULTILINE)
    return f"{found[1]}\n```console\n{commands}```\n"


def markdown() -> str:
    """Return one section for each command, below the page's own title."""
    command = get_command(app)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="sphrom")
    text = text.split("\n", 1)[1]  # the page has a title
    return EXAMPLE.sub(_fence, text).replace("$ sphrom", "sphrom")
