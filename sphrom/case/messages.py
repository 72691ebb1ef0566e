"""Say what is wrong with a case: where, what was given, and what is allowed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError

from sphrom.case import schema
from sphrom.case.scenes import kind_of
from sphrom.case.schema import Path
from sphrom.case.yaml_reader import Problem
from sphrom.text import shortened

MAX_PROBLEMS = 20
"""Problems that are shown at once."""
MAX_SHOWN = 60
"""Characters of a value that a message shows."""
_KIND_OF_SCENE = {"union_tag_not_found": "missing", "union_tag_invalid": "literal_error"}
"""Complaints about the kind of scene, and what they are called of other keys."""


def show(value: Any) -> str:
    """Return a value on one line, in printable characters, cut where it is long."""
    text = json.dumps(value, default=str)
    if isinstance(value, str):
        text = "'" + text[1:-1].replace('\\"', '"') + "'"
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."


def show_path(path: Path) -> str:
    """Return a path as it is written for --set, such as `rom.0.n_modes`."""
    return ".".join(
        shortened(segment, MAX_SHOWN)
        if isinstance(segment, str) and re.fullmatch(r"[\w-]+", segment, re.ASCII)
        else show(segment)
        for segment in path
    )


def nearest(word: str, known: Iterable[str]) -> str:
    """Return a hint that names the nearest of the known words, or all of them."""
    words = list(known)
    close = get_close_matches(word, words, n=1, cutoff=0.5)
    if close:
        return f"did you mean {close[0]}?"
    return "known: " + ", ".join(words) if words else "none is known here"


def problems_of(error: ValidationError, data: Any) -> list[Problem]:
    """Return pydantic's complaints about `data`, in words that name what is allowed.

    Those beyond `MAX_PROBLEMS` are counted by whoever shows them: they have no words.
    """
    found: dict[Path, tuple[Any, str]] = {}
    for complaint in error.errors(include_url=False, include_context=False, include_input=False):
        kind = "name" if complaint["loc"][-1:] == ("[key]",) else complaint["type"]
        location = complaint["loc"]
        if kind in _KIND_OF_SCENE:
            location, kind = (*location, "kind"), _KIND_OF_SCENE[kind]
        path, value = _locate(location, kind, data)
        if kind == "value_error":
            text = complaint["msg"].removeprefix("Value error, ")
            path, reason = _place_named(path, text, value, kind_of(data))
            found[path] = (reason, kind)
        found.setdefault(path, (value, kind))
    # A value that fits none of several kinds fails for each; the complaint that goes deepest tells.
    parents = {path[:depth] for path in found for depth in range(len(path))}
    told = [path for path in found if path not in parents]
    scene = kind_of(data)
    return [
        *(Problem(path, _reason(path, *found[path], scene)) for path in told[:MAX_PROBLEMS]),
        *(Problem(path, "") for path in told[MAX_PROBLEMS:]),
    ]


def _place_named(path: Path, text: str, section: Any, scene: str) -> tuple[Path, str]:
    """Return the path that a section's own complaint begins with, and the rest of it."""
    place, colon, reason = text.partition(": ")
    given = section if isinstance(section, dict) else {}
    if not colon or place.partition(".")[0] not in {*schema.known_keys(path, scene), *given}:
        return path, text
    return (*path, *place.split(".")), reason


def _locate(location: tuple[int | str, ...], kind: str, data: Any) -> tuple[Path, Any]:
    """Drop from pydantic's location what names a kind of value rather than a key."""
    path: list[str | int] = []
    for i, segment in enumerate(location):
        if isinstance(data, dict) and segment in data:
            data = data[str(segment)]
        elif isinstance(data, list) and isinstance(segment, int) and segment < len(data):
            data = data[segment]
        elif not (kind == "missing" and i == len(location) - 1):
            continue
        path.append(segment)
    return tuple(path), data


def _reason(path: Path, value: Any, kind: str, scene: str) -> str:
    """Return what is wrong with a value, in a case with a kind of scene."""
    if kind == "value_error":
        return str(value)
    if kind == "extra_forbidden":
        return f"unknown key; {_nearest_key(path, scene)}"
    if kind == "name":
        return f"must be {schema.NAME_WORDS}"
    node = schema.node_at(path, scene)
    allowed = schema.allowed(node) if node is not None else "something else"
    if kind == "missing":
        return f"is missing; it must be {allowed}"
    words = schema.words(node) if node is not None else []
    close = get_close_matches(value, words, n=1, cutoff=0.5) if isinstance(value, str) else []
    hint = f"; did you mean {close[0]}?" if close else ""
    return f"must be {allowed}; got {show(value)}{hint}"


def _nearest_key(path: Path, scene: str) -> str:
    word, known = str(path[-1]), schema.known_keys(path[:-1], scene)
    elsewhere = (other for other in schema.key_paths(kind=scene) if other[-1] == word)
    found = next(elsewhere, None)
    return f"did you mean {show_path(found)}?" if found else nearest(word, known)
