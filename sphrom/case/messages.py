"""Say what is wrong with a case: where, what was given, and what is allowed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError

from sphrom.case import schema
from sphrom.case.schema import Path
from sphrom.case.yaml_reader import Problem

MAX_SHOWN = 60
"""Characters of a value that a message shows."""


def show(value: Any) -> str:
    """Return a value on one line, in printable characters, cut where it is long."""
    text = json.dumps(value, default=str)
    if isinstance(value, str):
        text = "'" + text[1:-1].replace('\\"', '"') + "'"
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."


def show_path(path: Path) -> str:
    """Return a path as it is written for --set, such as `rom.0.n_modes`."""
    return ".".join(
        segment
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
    """Return pydantic's complaints about `data`, in words that name what is allowed."""
    found: dict[Path, Problem] = {}
    for complaint in error.errors(include_url=False, include_context=False, include_input=False):
        kind = "name" if complaint["loc"][-1:] == ("[key]",) else complaint["type"]
        path, value = _locate(complaint["loc"], kind, data)
        found.setdefault(path, Problem(path, _reason(path, value, kind)))
    # A value that fits none of several kinds fails for each; the complaint that goes deepest tells.
    parents = {path[:depth] for path in found for depth in range(len(path))}
    return [problem for path, problem in found.items() if path not in parents]


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


def _reason(path: Path, value: Any, kind: str) -> str:
    if kind == "extra_forbidden":
        return f"unknown key; {_nearest_key(path)}"
    if kind == "name":
        return f"must be {schema.NAME_WORDS}"
    node = schema.node_at(path)
    allowed = schema.allowed(node) if node is not None else "something else"
    if kind == "missing":
        return f"is missing; it must be {allowed}"
    return f"must be {allowed}; got {show(value)}"


def _nearest_key(path: Path) -> str:
    word, known = str(path[-1]), schema.known_keys(path[:-1])
    elsewhere = next((other for other in schema.key_paths() if other[-1] == word), None)
    return f"did you mean {show_path(elsewhere)}?" if elsewhere else nearest(word, known)
