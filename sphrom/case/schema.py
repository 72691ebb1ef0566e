"""The JSON schema of a case file, and sentences about keys and wrong values derived from it.

Messages, the commented template and the completion of editors all use this schema.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from typing import Any

from pydantic import ValidationError

from sphrom.case.fields import LARGEST, SMALLEST
from sphrom.case.models import Case
from sphrom.case.scenes import DEFAULTS, Defaults, kind_of
from sphrom.case.yaml_reader import Path, Problem, show_path
from sphrom.text import nearest, quoted

Node = Mapping[str, Any]

MAX_PROBLEMS = 20
"""Largest number of problems that one message lists."""
DIALECT = "https://json-schema.org/draft/2020-12/schema"
NAME_WORDS = "a name of at most 64 letters, digits, _ - or . that does not begin with - or ."
_KIND_OF_SCENE = {"union_tag_not_found": "missing", "union_tag_invalid": "literal_error"}
"""Pydantic's errors about the kind of scene, with the names of the same errors for other keys."""
_KINDS = {
    "integer": "a whole number",
    "number": "a number",
    "boolean": "true or false",
    "null": "null",
    "string": "text",
}


@cache
def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a case file.

    It has no default for keys whose defaults depend on the kind of scene.
    """
    schema = {"$schema": DIALECT, **Case.model_json_schema()}
    for defaults in DEFAULTS.values():
        _forget(schema, schema, defaults)
    return schema


def _forget(schema: dict[str, Any], section: dict[str, Any], defaults: Defaults) -> None:
    """Remove the defaults of some keys from a section, and of the sections that contain them."""
    for key, value in defaults.items():
        node = section["properties"][key]
        node.pop("default", None)
        if isinstance(value, Mapping):
            _forget(schema, schema["$defs"][node["$ref"].rsplit("/", 1)[1]], value)


def resolve(node: Node) -> Node:
    """Return the definition that a node refers to, or the node."""
    reference = node.get("$ref")
    return json_schema()["$defs"][reference.rsplit("/", 1)[1]] if reference else node


def branches(node: Node) -> Iterator[Node]:
    """Yield the alternatives of a node, or the node if there are none."""
    node = resolve(node)
    alternatives = node.get("anyOf") or node.get("oneOf")
    for alternative in alternatives or ():
        yield from branches(alternative)
    if not alternatives:
        yield node


def node_at(path: Path, kind: str = "") -> Node | None:
    """Return the schema of the value at a path, or None if no value is possible there.

    `kind` is the kind of scene of the case; by default, it is any.
    """
    node: Node | None = _root(kind)
    for segment in path:
        node = None if node is None else _merged(_children(node, segment))
    return node


def _merged(nodes: Iterable[Node]) -> Node | None:
    """Return one node for the key of several kinds of a section, described as in the first."""
    several = list[Node]()
    for node in nodes:
        if node not in several:
            several.append(node)
    if len(several) < 2:
        return next(iter(several), None)
    shared = {name: several[0][name] for name in ("description", "unit") if name in several[0]}
    return {"anyOf": several, **shared}


def _root(kind: str) -> Node:
    """Return the schema of a case with a kind of scene, or with any if there is no such kind."""
    schema = json_schema()
    scene = schema["properties"]["scene"]
    reference = scene["discriminator"]["mapping"].get(kind)
    if reference is None:
        return schema
    chosen = {"$ref": reference, "description": scene["description"]}
    return {**schema, "properties": {**schema["properties"], "scene": chosen}}


def _children(node: Node, segment: str | int) -> Iterator[Node]:
    for branch in branches(node):
        if isinstance(segment, int) and "items" in branch:
            yield branch["items"]
        elif segment in branch.get("properties", {}):
            yield branch["properties"][segment]
        else:
            yield from branch.get("patternProperties", {}).values()
            if isinstance(branch.get("additionalProperties"), dict):
                yield branch["additionalProperties"]


def is_section(node: Node) -> bool:
    """Return whether a node describes a mapping with keys of its own."""
    return any(branch.get("type") == "object" for branch in branches(node))


def is_list(path: Path) -> bool:
    """Return whether the value at a path must be a list."""
    node = node_at(path)
    return node is not None and all("items" in branch for branch in branches(node))


def known_keys(path: Path, kind: str = "") -> list[str]:
    """Return the keys that the section at a path may have."""
    node = node_at(path, kind)
    return [] if node is None else _keys(branches(node))


def _keys(nodes: Iterable[Node]) -> list[str]:
    return list(dict.fromkeys(key for node in nodes for key in node.get("properties", {})))


def key_paths(path: Path = (), kind: str = "") -> Iterator[Path]:
    """Yield the paths of all keys with fixed names below `path`; a list stands for its entry 0."""
    below = (*path, 0) if is_list(path) else path
    for key in known_keys(below, kind):
        yield (*below, key)
        yield from key_paths((*below, key), kind)


def words(node: Node) -> list[str]:
    """Return the words that are allowed as a value."""
    nodes = list(branches(node))
    return [word for b in nodes for word in b.get("enum", [b["const"]] if "const" in b else [])]


def allowed(node: Node) -> str:
    """Describe the allowed values, such as `a whole number from 8 to 100`."""
    nodes = list(branches(node))
    if len(nodes) > 1 and all("properties" in branch for branch in nodes):
        return f"a mapping of keys ({', '.join(_keys(nodes))})"
    if len(nodes) > 1 and len(known := words(node)) == len(nodes):
        return "one of " + ", ".join(known)
    # Words such as auto come last.
    texts = dict.fromkeys(map(_allowed_branch, nodes))
    return " or ".join(sorted(texts, key=lambda text: " " not in text))


def _allowed_branch(node: Node) -> str:
    if "const" in node:
        return str(node["const"])
    if "enum" in node:
        return "one of " + ", ".join(node["enum"])
    kind = node.get("type")
    if kind == "array":
        least = node.get("minItems", 0)
        most = node.get("maxItems")
        items = list(branches(node["items"]))
        number = f"{least} to {most}" if most else f"{least} or more"
        number = f"{least}" if least == most else number
        is_mapping = all("properties" in branch for branch in items)
        each = "a mapping" if is_mapping else allowed(node["items"])
        return f"a list of {number}, each {each}"
    if kind == "object":
        if keys := list(node.get("properties", {})):
            return f"a mapping of keys ({', '.join(keys)})"
        values = [value for child in _children(node, "name") for value in branches(child)]
        keys = [key for one in values for key in one.get("required", ())] or _keys(values)
        value = f"{{{keys[0]}: ...}}" if keys else "..."
        return f"a mapping of names, such as {{name: {value}}}" if values else "a mapping"
    if "pattern" in node:
        return NAME_WORDS
    if "examples" in node:
        return f"text such as {node['examples'][0]}"
    if "maxLength" in node:
        return f"text of at most {node['maxLength']} characters"
    low = node.get("minimum")
    high = node.get("maximum")
    if (low, high) == (SMALLEST, LARGEST):
        return f"a number above zero ({_number(low)} to {_number(high)})"
    if low is None or high is None:
        return _KINDS[str(kind)]
    return f"{_KINDS[str(kind)]} from {_number(low)} to {_number(high)}"


def _number(value: Any) -> str:
    text = str(value) if isinstance(value, int) else f"{value:g}"
    return text.replace("e+", "e").replace("e-0", "e-")


def problems_of(error: ValidationError, data: Any) -> list[Problem]:
    """Return pydantic's errors about `data` as problems that name the allowed values.

    Problems beyond `MAX_PROBLEMS` have no text, because a message only counts them.
    """
    errors: dict[Path, tuple[Any, str]] = {}
    scene = kind_of(data)
    for entry in error.errors(include_url=False, include_context=False, include_input=False):
        location, kind = entry["loc"], entry["type"]
        if kind in _KIND_OF_SCENE:
            location, kind = (*location, "kind"), _KIND_OF_SCENE[kind]
        if location[-1:] == ("[key]",):
            kind = "name"
        path, value = _locate(location, kind, data)
        if kind == "value_error":
            text = entry["msg"].removeprefix("Value error, ")
            path, reason = _place_named(path, text, value, scene)
            errors[path] = (reason, kind)
        errors.setdefault(path, (value, kind))
    # A value that fits none of several types has one error per type; the deepest path is reported.
    parents = {path[:depth] for path in errors for depth in range(len(path))}
    deepest = [path for path in errors if path not in parents]
    return [
        Problem(path, _reason(path, *errors[path], data) if n < MAX_PROBLEMS else "")
        for n, path in enumerate(deepest)
    ]


def _place_named(path: Path, text: str, section: Any, scene: str) -> tuple[Path, str]:
    """Split a section's own error message into the path that it begins with, and the rest."""
    place, colon, reason = text.partition(": ")
    own = section if isinstance(section, dict) else {}
    if not colon or place.partition(".")[0] not in {*known_keys(path, scene), *own}:
        return path, text
    return (*path, *place.split(".")), reason


def _locate(location: tuple[int | str, ...], kind: str, data: Any) -> tuple[Path, Any]:
    """Remove the names of types from pydantic's location, and return the path and its value."""
    path: list[str | int] = []
    for i, segment in enumerate(location):
        try:
            data = data[segment]
        except (LookupError, TypeError):
            if i > 0 and (kind != "missing" or i < len(location) - 1):
                continue
        path.append(segment)
    return tuple(path), data


def _reason(path: Path, value: Any, kind: str, data: Any) -> str:
    """Describe the error of a value in a case with some data."""
    scene = kind_of(data)
    if kind == "value_error":
        return str(value)
    if kind == "extra_forbidden":
        word = str(path[-1])
        known = known_keys(path[:-1], scene)
        for inner in {"parameters", "train"}.intersection(known):
            if word in _parameter_names(data):
                return f"unknown key; did you mean {show_path((*path[:-1], inner, word))}?"
        elsewhere = (other for other in key_paths(kind=scene) if other[-1] == word)
        is_misspelt = get_close_matches(word, known, n=1, cutoff=0.8)
        if not is_misspelt and (similar := next(elsewhere, None)) is not None:
            return f"unknown key; did you mean {show_path(similar)}?"
        return f"unknown key; {nearest(word, known)}"
    if kind == "name":
        return f"must be {NAME_WORDS}"
    node = node_at(path, scene) or {}
    may_be = allowed(node) if node else "something else"
    if kind == "missing":
        return f"is missing; it must be {may_be}"
    known = words(node) if isinstance(value, str) else []
    close = get_close_matches(str(value), known, n=1, cutoff=0.5)
    hint = f"; did you mean {close[0]}?" if close else ""
    return f"must be {may_be}; got {quoted(value)}{hint}"


def _parameter_names(data: Any) -> set[str]:
    """Return the names of a case's parameters and constants, from unchecked data."""

    def section(*path: str) -> Mapping[str, Any]:
        found = data
        for name in path:
            found = found.get(name) if isinstance(found, Mapping) else None
        return found if isinstance(found, Mapping) else {}

    given = section("scene", "constants"), section("parameters", "train")
    return {str(name) for names in given for name in names}
