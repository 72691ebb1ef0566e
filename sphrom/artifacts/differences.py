"""Name the keys in which two case texts differ, without knowing what a case is."""

from __future__ import annotations

import re

SHOWN = 4
"""Keys that are named."""
MOST_CHARACTERS = 60
"""Of a value: whoever wrote the file may have written anything."""


def case_differences(made_with: str, asked: str) -> str:
    """Return, in words, the keys that differ between two texts of block-style YAML.

    Of the text that something was made with, only the sections count that the other has.
    """
    there, here = _flattened(made_with), _flattened(asked)
    sections = set(map(_section, here))
    keys = [k for k in here | there if here.get(k) != there.get(k) and _section(k) in sections]
    # What only one of them has may be newer than the other, and is then no difference.
    keys.sort(key=lambda key: key not in here or key not in there)
    if not keys:
        return ""
    shown = [
        f"{_cut(key)} is {_cut(there.get(key, 'absent'))} there, "
        f"{_cut(here.get(key, 'absent'))} here"
        for key in keys[:SHOWN]
    ]
    more = f", and {len(keys) - SHOWN} more" if len(keys) > SHOWN else ""
    return "; ".join(shown) + more


def _cut(text: str) -> str:
    return text if len(text) <= MOST_CHARACTERS else f"{text[: MOST_CHARACTERS - 3]}..."


def _section(key: str) -> str:
    return re.split(r"[.\[]", key, maxsplit=1)[0]


def _flattened(text: str) -> dict[str, str]:
    """Return `a.b[0]: value` for every line with a value; the indentation tells the nesting."""
    values: dict[str, str] = {}
    stack: list[tuple[int, str]] = []
    counts: dict[str, int] = {}
    for line in text.splitlines():
        content = line.lstrip(" ")
        indent = len(line) - len(content)
        while content.startswith("- ") or content == "-":
            # A list may stand at its key's own indentation; its items count as deeper.
            stack = [entry for entry in stack if entry[0] < 2 * indent + 1]
            parent = "".join(part for _, part in stack)
            counts[parent] = counts.get(parent, -1) + 1
            stack.append((2 * indent + 1, f"[{counts[parent]}]"))
            content, indent = content[2:].lstrip(" "), indent + 2
        if not content or content.startswith("#"):
            continue
        stack = [entry for entry in stack if entry[0] < 2 * indent]
        key, colon, value = content.partition(":")
        path = "".join(part for _, part in stack)
        if not colon or (value and not value.startswith(" ")):
            values[path] = f"{values.get(path, '')} {content}".strip()
            continue
        stack.append((2 * indent, f".{key}" if path else key))
        if value.strip():
            values["".join(part for _, part in stack)] = value.strip()
    return values
