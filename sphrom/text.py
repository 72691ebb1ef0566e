"""Numbers and texts as people read them: no digit lost, no character that a terminal obeys."""

from __future__ import annotations


def exact(value: float) -> str:
    """Return a number so that it reads back the same: `100`, `0.05`, `100.0000001`, `1e+06`.

    Two numbers never have the same text, so names and labels may be made of it.
    """
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value)).removesuffix(".0")


def visible(text: str, keep: str = "") -> str:
    """Return a text from outside with its control characters as escapes, such as `\\x1b`.

    Escaped is all that Unicode calls other or a separator, but the space: controls, marks of the
    direction of writing, what has no width, halves of characters. `keep` are characters to leave.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else _escape(c) for c in text)


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
