"""Format numbers for names without loss of digits, and texts without control characters."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

MAX_SHOWN = 60
"""Characters of a value that a message quotes."""
DECIMAL = re.compile(r"[-+]?\d*([.,])\d*(e[-+]?\d+)?", re.IGNORECASE)
"""A number with a decimal point or comma."""


def exact(value: float) -> str:
    """Return a number so that it reads back the same: `100`, `0.05`, `100.0000001`, `1e+06`.

    Two numbers never have the same text, so it is safe in names and labels.
    """
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value)).removesuffix(".0")


def repeated(names: Iterable[str]) -> list[str]:
    """Return the names that occur more than once."""
    return [name for name, count in Counter(names).items() if count > 1]


def visible(text: str, keep: str = "") -> str:
    """Return an external text with its control characters as escapes, such as `\\x1b`.

    Apart from the space and the characters in `keep`, all that Unicode classes as other or as a
    separator is escaped: controls, marks of writing direction, zero-width characters, surrogates.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text
    )


def shortened(text: str, most: int = 300, keep: str = "") -> str:
    """Return an external text in visible characters; a long text loses its middle.

    No word or number at the gap is cut, unless it is long. Characters in `keep` are never escaped.
    """
    half = most // 2
    if len(text) > most:
        text = f"{_begin(text, half)} ... {_begin(text[::-1], half)[::-1]}"
    return visible(text, keep)


def _begin(text: str, most: int) -> str:
    """Return the first characters of a longer text, without the part of a last word."""
    part = rf"\s\S{{,{most // 2}}}$"
    return re.sub(part, "", text[: most + 1])[:most]


def quoted(value: Any) -> str:
    """Return an external value on one line, in printable characters, cut if it is long."""
    text = json.dumps(value, default=str)
    if isinstance(value, str):
        text = "'" + text[1:-1].replace('\\"', '"') + "'"
    return text if len(text) <= MAX_SHOWN else _begin(text, MAX_SHOWN - 3) + "..."


def nearest(word: str, known: Iterable[str]) -> str:
    """Return a hint that names the most similar known word, or all known words."""
    words = list(known)
    close = get_close_matches(word, words, n=1, cutoff=0.5)
    if close:
        return f"did you mean {close[0]}?"
    return "known: " + ", ".join(words) if words else "none is known here"


def table_rows(text: str) -> list[tuple[int, list[str]]]:
    """Return the rows of a CSV table with their line numbers, the names of columns first.

    Cells end at commas, or at semicolons or tabs if the first row has any; numbers may then have
    decimal commas, which become points. Blank lines and lines that begin with # are left out, and
    missing cells at the end of a row are empty.

    Raises ValueError for a row with more cells than names, and for points beside decimal commas;
    csv.Error for a damaged line.
    """
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    separator = next((mark for mark in ";\t" if lines and mark in lines[0][1]), ",")
    rows: list[tuple[int, list[str]]] = []
    marks: dict[str, int] = {}  # the last lines with decimal points and commas
    for number, line in lines:
        row = [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
        if separator != ",":
            found = [DECIMAL.fullmatch(cell) for cell in row]
            marks |= {match[1]: number for match in found if match}
            row = [c.replace(",", ".") if m else c for c, m in zip(row, found, strict=True)]
        missing = len(rows[0][1]) - len(row) if rows else 0
        if missing < 0:
            raise ValueError(
                f"line {number}: has {len(row)} cells for {len(rows[0][1])} columns; numbers with "
                "decimal commas need semicolons between cells"
            )
        rows.append((number, row + [""] * missing))
    if len(marks) > 1:
        reason = f"line {marks[',']} has decimal commas, and line {marks['.']} points"
        raise ValueError(f"{reason}: use one of them")
    return rows


def place_text(place: Iterable[float], digits: str = "g") -> str:
    """Return coordinates as a text such as `(0.5, 1)`, in a format for numbers."""
    return f"({', '.join(format(coordinate, digits) for coordinate in place)})"


def data_size(n_bytes: int) -> str:
    """Format a number of bytes with four digits, such as `256 KiB` or `93.13 GiB`."""
    unit, exponent = ("KiB", 10) if n_bytes < 2**20 else ("MiB", 20)
    if n_bytes >= 2**30:
        unit, exponent = "GiB", 30
    return f"{n_bytes / 2**exponent:.4g} {unit}"


def counted(number: int, noun: str) -> str:
    """Format a count, such as `1 run` or `2000 runs`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def duration(seconds: float) -> str:
    """Format a duration with three digits, such as `13.4 µs`, `57 s` or `2.5 hours`."""
    if seconds < 1e-3:
        return f"{1e6 * seconds:.3g} µs"
    if seconds < 1.0:
        return f"{1e3 * seconds:.3g} ms"
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
