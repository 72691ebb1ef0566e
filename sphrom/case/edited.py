"""Change keys in the text of a case file, and leave all else as its author wrote it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

import yaml

from sphrom.case.loader import case_data
from sphrom.case.yaml_reader import InvalidText, Loader, dump_yaml, read_yaml
from sphrom.text import exact

INDENT = "  "


def with_value(text: str, path: Sequence[str], value: Any) -> str:
    """Return a text with the value at a path of keys changed; keys that are missing are added.

    A mapping in braces on the way is written anew, in lines.
    """
    place: Any = Loader(text).get_single_node()
    for depth, name in enumerate(path):
        found = next(((key, node) for key, node in place.value if key.value == name), None)
        if found is None:
            return _with_key(text, place, name, _nested(path[depth + 1 :], value))
        key, place = found
        rest = path[depth + 1 :]
        if not rest or not _in_lines(place):
            known = read_yaml(text).value
            for above in path[: depth + 1]:
                known = known[above]
            return _replaced(text, key, place, _changed(known, rest, value))
    raise ValueError("the path of a key has a name at least")


def _in_lines(node: yaml.Node) -> bool:
    """Return whether a node is a mapping whose keys stand in lines of their own."""
    return isinstance(node, yaml.MappingNode) and not node.flow_style


def _changed(known: Any, path: Sequence[str], value: Any) -> Any:
    """Return a plain value with what is at a path in it changed."""
    if not path:
        return value
    known = known if isinstance(known, dict) else {}
    return {**known, path[0]: _changed(known.get(path[0]), path[1:], value)}


def _nested(path: Sequence[str], value: Any) -> Any:
    return _changed(None, path, value)


def _end(node: yaml.Node) -> int:
    """Return where the text of a node ends, without comments and lines that follow."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last)
    return int(node.end_mark.index)


def _replaced(text: str, key: yaml.Node, old: yaml.Node, value: Any) -> str:
    """Return the text with the value of a key changed."""
    begin = key.end_mark.index
    colon = text.index(":", begin) + 1
    return (
        text[:begin]
        + ":"
        + _written(value, " " * key.start_mark.column)
        + text[max(_end(old), colon) :]
    )


def _with_key(text: str, place: yaml.Node, name: str, value: Any) -> str:
    """Return the text with a key added at the end of a mapping."""
    indent = " " * place.value[0][0].start_mark.column
    at = text.find("\n", _end(place))
    end = len(text) if at < 0 else at
    return text[:end] + f"\n{indent}{name}:{_written(value, indent)}" + text[end:]


def _written(value: Any, indent: str) -> str:
    """Return a value as it stands after a key's colon; lists of numbers stand in one line."""
    if isinstance(value, dict) and value:
        lines = (f"\n{indent}{INDENT}{k}:{_written(v, indent + INDENT)}" for k, v in value.items())
        return "".join(lines)
    if isinstance(value, list) and any(isinstance(each, dict) for each in value):
        return "".join(f"\n{indent}{INDENT}- {_inline(each)}" for each in value)
    return f" {_inline(value)}"


def _inline(value: Any) -> str:
    """Return a value in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, float):
        return exact(value)
    return dump_yaml([value]).rstrip("\n").removeprefix("- ")


def retrained(
    source: str | os.PathLike[str], overrides: Sequence[str], train: Mapping[str, Any]
) -> str:
    """Return the text of a case file with keys overridden, and other values to train at.

    Comments stay, unless the file is written in a way that can't be changed in place.

    Raises CaseError where the file can't be read, or an override is none.
    """
    expected = case_data(source, overrides)
    parameters = expected.get("parameters") or {}
    expected["parameters"] = {**parameters, "train": train}
    try:
        text = _read(FilePath(source))
        for override in overrides:
            name, _, value = override.partition("=")
            text = with_value(text, name.strip().split("."), read_yaml(value).value)
        text = with_value(text, ["parameters", "train"], train)
        if read_yaml(text).value == expected:
            return text
    except (InvalidText, yaml.YAMLError, LookupError, TypeError, ValueError):
        pass  # lists on the way, anchors and the like
    return dump_yaml(expected)


def _read(path: FilePath) -> str:
    return path.read_text(encoding="utf-8-sig")
