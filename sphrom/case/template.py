"""Write a commented case file to start from, out of the models' own descriptions."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from difflib import get_close_matches
from typing import Any

from sphrom.case import schema
from sphrom.case.model_kinds import PROJECTIONS
from sphrom.case.models import Case
from sphrom.case.schema import Path
from sphrom.case.yaml_reader import dump_yaml
from sphrom.errors import CaseError

WIDTH = 100
INDENT = "  "
SCHEMA_FILE = "sphrom.schema.json"
"""What a new case calls the schema, beside it, that an editor reads."""


def scene_kinds() -> tuple[str, ...]:
    """Return the kinds of scene that a case can have."""
    return tuple(schema.words(schema.node_at(("scene", "kind")) or {}))


def new_case(kind: str) -> str:
    """Return a commented case file for a kind of scene, every key at its default.

    Raises CaseError for a kind that isn't known.
    """
    known = scene_kinds()
    if kind not in known:
        close = get_close_matches(kind, known, n=1, cutoff=0.3)
        hint = f"did you mean {close[0]}?" if close else f"the kinds are {', '.join(known)}"
        raise CaseError(f"no scene is of kind {kind!r}; {hint}")
    head = (
        f"# yaml-language-server: $schema={SCHEMA_FILE}",
        f"# A case of sphrom: {kind}.",
        "# Every key but name and scene.kind may be left out: it then has the value below, except",
        "# for parameters, rom and sweep, which hold an example. Units are in brackets.",
    )
    values = _example(kind).model_dump(mode="json")
    return "\n".join([*head, *_section(values, (), "", kind)]) + "\n"


def _example(kind: str) -> Case:
    least = {"name": f"my-{kind}", "scene": {"kind": kind}}
    (reynolds,) = Case.model_validate(least).parameters.train.reynolds
    values = {"train": (reynolds, 2.0 * reynolds), "test": (1.5 * reynolds,)}
    return Case.model_validate(
        {
            **least,
            "parameters": {group: {"reynolds": given} for group, given in values.items()},
            "rom": [
                {"name": f"{projection}-m5", "projection": projection, "n_modes": 5}
                for projection in PROJECTIONS
            ],
            "sweep": {"reynolds": {"low": reynolds, "high": 2.0 * reynolds, "count": 11}},
        }
    )


def _section(values: dict[str, Any], path: Path, indent: str, kind: str) -> Iterator[str]:
    for key, value in values.items():
        at = (*path, key)
        if not path:
            yield ""
        yield from _comment(at, indent, kind)
        if isinstance(value, dict) and value:
            yield f"{indent}{key}:"
            yield from _section(value, at, indent + INDENT, kind)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            yield f"{indent}{key}:"
            yield from _list(value, at, indent + INDENT, kind)
        else:
            yield f"{indent}{key}: {_inline(value)}"


def _list(entries: list[dict[str, Any]], path: Path, indent: str, kind: str) -> Iterator[str]:
    """Explain the keys of the first entry, and list the others."""
    for i, entry in enumerate(entries):
        lines = list(_section(entry, (*path, i), indent + INDENT, kind))
        first = next(n for n, line in enumerate(lines) if not line.lstrip().startswith("#"))
        yield from lines[:first] if i == 0 else ()
        yield f"{indent}- {lines[first].lstrip()}"
        for line in lines[first + 1 :]:
            if i == 0 or not line.lstrip().startswith("#"):
                yield line


def _comment(path: Path, indent: str, kind: str) -> Iterator[str]:
    node = schema.node_at(path, kind) or {}
    text = str(node.get("description", ""))
    if unit := node.get("unit"):
        text += f" [{unit}]"
    if not schema.is_section(node):
        text += f"; {schema.allowed(node)}"
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=indent + "# ", subsequent_indent=indent + "# "
    )


def _inline(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    return "{}" if value == {} else dump_yaml(value).removesuffix("...\n").strip()
