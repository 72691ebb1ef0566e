"""Problems of a case, and the words of messages: places, values, and near misses."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from sphrom.text import shortened

Path = tuple[str | int, ...]
"""The keys that lead to a value, and the places in lists, counted from 0."""
MAX_PROBLEMS = 20
"""Problems that are shown at once."""
MAX_SHOWN = 60
"""Characters of a value that a message shows."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong, the path of the key it is about, and its line where it differs."""

    path: Path
    reason: str
    line: int | None = None


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


def is_unicode(text: str) -> bool:
    """Whether text can be written out: it holds no half of a character."""
    return not any("\ud800" <= character <= "\udfff" for character in text)
