"""The commands and their options, as Markdown, from the command line's own definitions."""

import re
from collections.abc import Iterable, Iterator
from typing import Any

import typer
from typer.main import get_command

from sphrom.cli.app import app

AS_IT_IS = "\b"
"""Begins a paragraph of help whose lines are kept."""


def markdown() -> str:
    """Return one section for each command, below the page's own title."""
    command = get_command(app)
    return "\n".join(_command(command, typer.Context(command, info_name="sphrom"), "")) + "\n"


def _command(command: Any, context: Any, heading: str) -> Iterator[str]:
    if heading:
        yield from ("", f"{heading} `{context.command_path}`", "")
    yield from _help(command.help or "")
    yield from ("", "```text", command.get_usage(context).removeprefix("Usage: "), "```", "")
    yield from _table(command.get_params(context), context)
    for name, child in getattr(command, "commands", {}).items():
        if not child.hidden:
            inner = typer.Context(child, info_name=name, parent=context)
            yield from _command(child, inner, f"{heading}#" if heading else "##")


def _help(text: str) -> Iterator[str]:
    for paragraph in text.replace("\f", "").split("\n\n"):
        lines = paragraph.strip("\n").split("\n")
        if lines[0].strip() != AS_IT_IS:
            yield from ("", *map(_plain, lines))
            continue
        yield from ("", _plain(lines[1]))
        if len(lines) > 2:
            indented = [re.sub("^ +", "", line) for line in lines[2:]]
            shown = all(line.startswith(" ") for line in lines[2:])
            yield from ("", "```text", *indented, "```") if shown else map(_plain, lines[2:])


def _table(parameters: Iterable[Any], context: Any) -> Iterator[str]:
    records = [parameter.get_help_record(context) for parameter in parameters]
    yield from ("| argument or option | |", "|---|---|")
    for name, text in filter(None, records):
        yield f"| `{' '.join(name.split())}` | {_plain(' '.join(text.split()))} |"


def _plain(text: str) -> str:
    """Return text with Markdown's special characters escaped, and options as code."""
    escaped = re.sub(r"([<>|*_\[\]])", r"\\\1", text)
    return re.sub(r"(?<![\w`-])(--[a-z][a-z-]*)(?!`)", r"`\1`", escaped)
