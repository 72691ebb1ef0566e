"""The JSON schema of a case file, and what it says of a key, and of a wrong value, in words.

Messages, the commented template and an editor's completion all come from this one schema.
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
"""Problems that are shown at once."""
DIALECT = "https://json-schema.org/draft/2020-12/schema"
NAME_WORDS = "a name of at most 64 letters, digits, _ - or . that does not begin with - or ."
_KIND_OF_SCENE = {"union_tag_not_found": "missing", "union_tag_invalid": "literal_error"}
"""Complaints about the kind of scene, and what they are called of other keys."""
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

    It names no default for keys whose defaults depend on the kind of scene.
    """
    schema = {"$schema": DIALECT, **Case.model_json_schema()}
    for defaults in DEFAULTS.values():
        _forget(schema, schema, defaults)
    return schema


def _forget(schema: dict[str, Any], section: dict[str, Any], defaults: Defaults) -> None:
    """Take the defaults of some keys out of a section, and those of the sections they are in."""
    for key, value in defaults.items():
        node = section["properties"][key]
        node.pop("default", None)
        if isinstance(value, Mapping):
            _forget(schema, schema["$defs"][node["$ref"].rsplit("/", 1)[1]], value)


def resolve(node: Node) -> Node:
    """Follow a node's reference to the definition it stands for."""
    reference = node.get("$ref")
    return json_schema()["$defs"][reference.rsplit("/", 1)[1]] if reference else node


def branches(node: Node) -> Iterator[Node]:
    """Yield the alternatives of a node, itself where there is one only."""
    node = resolve(node)
    alternatives = node.get("anyOf") or node.get("oneOf")
    for alternative in alternatives or ():
        yield from branches(alternative)
    if not alternatives:
        yield node


def node_at(path: Path, kind: str = "") -> Node | None:
    """Return the schema of the value at a path, or None where there can be none.

    In a case with a given kind of scene, or with any.
    """
    node: Node | None = _root(kind)
    for segment in path:
        found = [] if node is None else list(_children(node, segment))
        node = {"anyOf": found} if len(found) > 1 else next(iter(found), None)
    return node


def _root(kind: str) -> Node:
    """Return the schema of a case with a kind of scene, or with any where there is no such kind."""
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
    """Whether a node stands for a mapping with keys of its own."""
    return any(branch.get("type") == "object" for branch in branches(node))


def is_list(path: Path) -> bool:
    """Whether the value at a path has to be a list."""
    node = node_at(path)
    return node is not None and all("items" in branch for branch in branches(node))


def known_keys(path: Path, kind: str = "") -> list[str]:
    """Return the keys that the section at a path may hold."""
    node = node_at(path, kind)
    return [] if node is None else _keys(branches(node))


def _keys(nodes: Iterable[Node]) -> list[str]:
    return list(dict.fromkeys(key for node in nodes for key in node.get("properties", {})))


def key_paths(path: Path = (), kind: str = "") -> Iterator[Path]:
    """Yield the path of every key of fixed name below `path`, of lists in their first entry."""
    below = (*path, 0) if is_list(path) else path
    for key in known_keys(below, kind):
        yield (*below, key)
        yield from key_paths((*below, key), kind)


def words(node: Node) -> list[str]:
    """Return the words that a value may be."""
    found = list(branches(node))
    return [word for b in found for word in b.get("enum", [b["const"]] if "const" in b else [])]


def allowed(node: Node) -> str:
    """Return what a value may be, in words, such as `a whole number from 8 to 100`."""
    found = list(branches(node))
    if len(found) > 1 and all("properties" in branch for branch in found):
        return f"a mapping of keys ({', '.join(_keys(found))})"
    if len(found) > 1 and len(known := words(node)) == len(found):
        return "one of " + ", ".join(known)
    # Words such as auto stand last.
    texts = dict.fromkeys(map(_allowed_branch, found))
    return " or ".join(sorted(texts, key=lambda text: " " not in text))


def _allowed_branch(node: Node) -> str:
    if "const" in node:
        return str(node["const"])
    if "enum" in node:
        return "one of " + ", ".join(node["enum"])
    kind = node.get("type")
    if kind == "array":
        least, most, items = node.get("minItems", 0), node.get("maxItems"), resolve(node["items"])
        number = f"{least} to {most}" if most else f"{least} or more"
        number = f"{least}" if least == most else number
        each = "a mapping" if "properties" in items else allowed(items)
        return f"a list of {number}, each {each}"
    if kind == "object":
        keys = list(node.get("properties", {}))
        return f"a mapping of keys ({', '.join(keys)})" if keys else "a mapping"
    if "pattern" in node:
        return NAME_WORDS
    if "examples" in node:
        return f"text such as {node['examples'][0]}"
    if "maxLength" in node:
        return f"text of at most {node['maxLength']} characters"
    low, high = node.get("minimum"), node.get("maximum")
    if (low, high) == (SMALLEST, LARGEST):
        return f"a number above zero ({_number(low)} to {_number(high)})"
    if low is None or high is None:
        return _KINDS[str(kind)]
    return f"{_KINDS[str(kind)]} from {_number(low)} to {_number(high)}"


def _number(value: Any) -> str:
    text = str(value) if isinstance(value, int) else f"{value:g}"
    return text.replace("e+", "e").replace("e-0", "e-")


def problems_of(error: ValidationError, data: Any) -> list[Problem]:
    """Return pydantic's complaints about `data`, in words that name what is allowed.

    Those beyond `MAX_PROBLEMS` are counted by whoever shows them: they have no words.
    """
    found: dict[Path, tuple[Any, str]] = {}
    scene = kind_of(data)
    for complaint in error.errors(include_url=False, include_context=False, include_input=False):
        location, kind = complaint["loc"], complaint["type"]
        if kind in _KIND_OF_SCENE:
            location, kind = (*location, "kind"), _KIND_OF_SCENE[kind]
        if location[-1:] == ("[key]",):
            kind = "name"
        path, value = _locate(location, kind, data)
        if kind == "value_error":
            text = complaint["msg"].removeprefix("Value error, ")
            path, reason = _place_named(path, text, value, scene)
            found[path] = (reason, kind)
        found.setdefault(path, (value, kind))
    # A value that fits none of several kinds fails for each; the complaint that goes deepest tells.
    parents = {path[:depth] for path in found for depth in range(len(path))}
    told = [path for path in found if path not in parents]
    return [
        Problem(path, _reason(path, *found[path], scene) if n < MAX_PROBLEMS else "")
        for n, path in enumerate(told)
    ]


def _place_named(path: Path, text: str, section: Any, scene: str) -> tuple[Path, str]:
    """Return the path that a section's own complaint begins with, and the rest of it."""
    place, colon, reason = text.partition(": ")
    given = section if isinstance(section, dict) else {}
    if not colon or place.partition(".")[0] not in {*known_keys(path, scene), *given}:
        return path, text
    return (*path, *place.split(".")), reason


def _locate(location: tuple[int | str, ...], kind: str, data: Any) -> tuple[Path, Any]:
    """Drop from pydantic's location what names a kind of value rather than a key."""
    path: list[str | int] = []
    for i, segment in enumerate(location):
        try:
            data = data[segment]
        except (LookupError, TypeError):
            if i > 0 and (kind != "missing" or i < len(location) - 1):
                continue
        path.append(segment)
    return tuple(path), data


def _reason(path: Path, value: Any, kind: str, scene: str) -> str:
    """Return what is wrong with a value, in a case with a kind of scene."""
    if kind == "value_error":
        return str(value)
    if kind == "extra_forbidden":
        word = str(path[-1])
        elsewhere = (other for other in key_paths(kind=scene) if other[-1] == word)
        if (found := next(elsewhere, None)) is not None:
            return f"unknown key; did you mean {show_path(found)}?"
        return f"unknown key; {nearest(word, known_keys(path[:-1], scene))}"
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
