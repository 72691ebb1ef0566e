"""Cases to start from: the example cases, and new commented cases for all kinds of scene.

The short case of a kind is a file in `cases/new`; the full one is made from the schema.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path as FilePath
from typing import Any, get_args

from sphrom.case import schema
from sphrom.case.models import Case
from sphrom.case.scenes import AnyScene, kind_of_section
from sphrom.case.yaml_reader import Path, dump_yaml, show_path
from sphrom.errors import CaseError
from sphrom.text import nearest, quoted

WIDTH = 80
INDENT = "  "
NAME = "NAME"
"""Placeholder in a path for a key that the user names."""
FOLDER = FilePath(__file__).parent.parent / "cases"
_END_OF_CLAUSE = re.compile(r"(?<!et al)\.(?:\s|$)|;")
_FULL_HEAD = """\
# yaml-language-server: $schema=sphrom.schema.json
# A case of sphrom: {kind}.
# Only name and scene.kind are required. The values of other keys are defaults,
# except those of parameters, rom and sweep, which are an example. Units are in
# brackets. Comments with dots list the keys of sections that are empty here:
# NAME is a name that you choose, 0 the first entry of a list."""


def examples() -> Mapping[str, FilePath]:
    """Return the example case files by name, with those of the gallery at the end."""
    paths = [*sorted(FOLDER.glob("*.yaml")), *sorted(FOLDER.glob("gallery/*.yaml"))]
    return {path.stem: path for path in paths}


def example(name: str) -> FilePath:
    """Return the example case file with a name. Raises CaseError if there is none."""
    paths = examples()
    if name not in paths:
        raise CaseError(f"no example case is called {quoted(name)}; {nearest(name, paths)}")
    return paths[name]


def title(path: FilePath) -> str:
    """Return the first clause of the comments of a case file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    return _END_OF_CLAUSE.split(comment, maxsplit=1)[0]


def new_case(kind: str | None, *, full: bool = False) -> str:
    """Return a commented case file for a kind of scene: a short one, or one with every key.

    Raises CaseError, with a list of the kinds, for an unknown or missing kind.
    """
    titles = {kind_of_section(section): section.title for section in get_args(AnyScene)}
    if kind not in titles:
        kinds = "\n".join(f"  {name:18} {title}" for name, title in titles.items())
        hint = f"got {quoted(kind)}; {nearest(kind, titles)}" if kind else "is missing"
        raise CaseError(f"KIND: {hint}\nthe kinds are\n{kinds}")
    if not full:
        return (FOLDER / "new" / f"{kind}.yaml").read_text(encoding="utf-8")
    values = _example(kind).model_dump(mode="json")
    head = _FULL_HEAD.format(kind=kind)
    return "\n".join([head, *_section(values, (), "", kind)]) + "\n"


def _example(kind: str) -> Case:
    least = {"name": f"my-{kind}", "scene": {"kind": kind}}
    (reynolds,) = Case.model_validate(least).parameters.train.reynolds
    return Case.model_validate(
        {
            **least,
            "parameters": {
                "train": {"reynolds": (reynolds, 2.0 * reynolds)},
                "test": {"reynolds": (1.5 * reynolds,)},
            },
            "rom": [{"name": "fast-m5", "evaluation": "operators", "n_modes": 5}],
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
            for i, entry in enumerate(value):
                lines = list(_section(entry, (*at, i), indent + 2 * INDENT, kind))
                first = next(n for n, line in enumerate(lines) if not line.lstrip().startswith("#"))
                lines[first] = f"{indent}{INDENT}- {lines[first].lstrip()}"
                yield from lines
        else:
            yield f"{indent}{key}: {_inline(value)}"
            for below in () if value else _keys_of(at, kind):
                yield from _comment(below, indent, kind, f"  {show_path(below[len(path) :])}: ")
    # Keys of other kinds of the section.
    for key in schema.known_keys(path, kind):
        if key not in values:
            yield from _comment((*path, key), indent, kind, f"{key}: ")


def _keys_of(path: Path, kind: str, above: tuple[list[str], ...] = ()) -> Iterator[Path]:
    """Yield the paths of keys with empty values, including those below names and list entries."""
    for below in (path, (*path, NAME), (*path, 0)):
        keys = schema.known_keys(below, kind)
        if keys and keys not in above:  # shapes contain shapes without end
            named = [NAME] if schema.node_at((*below, NAME), kind) and below[-1] != NAME else []
            for key in [*keys, *named]:
                yield (*below, key)
                yield from _keys_of((*below, key), kind, (*above, keys))
            return


def _comment(path: Path, indent: str, kind: str, before: str = "") -> Iterator[str]:
    node = schema.node_at(path, kind) or {}
    texts = {each.get("description", "") for each in node.get("anyOf", [node])} - {""}
    text = before + str(node.get("description", texts.pop() if len(texts) == 1 else ""))
    if unit := node.get("unit"):
        text += f" [{unit}]"
    if not schema.is_section(node):
        text += f"{'; ' * (text != before)}{schema.allowed(node)}"
    begin = indent + "# "
    more = f"{begin}    " if before else begin
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=begin, subsequent_indent=more, break_on_hyphens=False
    )


def _inline(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    return "{}" if value == {} else dump_yaml(value).removesuffix("...\n").strip()
