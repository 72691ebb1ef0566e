"""Fields at points in a CSV file: columns x, y, u, v and perhaps p, named in its first line."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sphrom.case.fields import LARGEST
from sphrom.text import visible
from sphrom.whole_files import read_whole

if TYPE_CHECKING:
    from sphrom.scenes.scattered_fields import ScatteredFields

MOST_BYTES = 16 * 1024 * 1024
"""The largest file that is read."""
MOST_POINTS = 200_000
"""Of one file; to join them takes seconds."""
COLUMNS = ("x", "y", "u", "v")
PRESSURE = "p"


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file. Raises ValueError when it can't be read or is too large."""
    return hashlib.sha256(content_of(path)).hexdigest()


def read_fields(path: Path) -> ScatteredFields:
    """Read fields at points.

    Raises ValueError when the file can't be read or is too large, lacks a column, or holds too few
    points, a point twice, or anything but numbers.
    """
    from sphrom.scenes.scattered_fields import ScatteredFields  # few cases need it

    content = content_of(path)
    try:
        text = content.decode("utf-8-sig")
        rows = list(islice(_rows(text), MOST_POINTS + 1))
        if len(rows) > MOST_POINTS:
            raise ValueError(f"holds more than {MOST_POINTS} points; keep fewer")
        values = np.array(rows).reshape(-1, 5)
        _require_different(values[:, :2])
        return ScatteredFields(values[:, :2], values[:, 2:], hashlib.sha256(content).hexdigest())
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name}: is not UTF-8 text") from error
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{path.name}: {error}") from error


def content_of(path: Path) -> bytes:
    """Return what a file holds. Raises ValueError when it can't be read or is too large."""
    try:
        return read_whole(path, MOST_BYTES)
    except OSError as error:
        raise ValueError(f"{visible(str(path))}: can't be read: {error.strerror}") from error
    except ValueError as error:
        raise ValueError(f"{visible(str(path))}: {error}") from error


def _rows(text: str) -> Iterator[list[float]]:
    """Yield x, y, u, v and p of each point."""
    reader = csv.reader(io.StringIO(text))
    names = [name.strip() for name in next(reader, [])]
    if missing := [name for name in COLUMNS if name not in names]:
        raise ValueError(
            f"its first line must name the columns x, y, u, v and perhaps p; it lacks "
            f"{', '.join(missing)}"
        )
    if twice := [name for name in (*COLUMNS, PRESSURE) if names.count(name) > 1]:
        raise ValueError(f"column {twice[0]} appears twice")
    at = [names.index(name) for name in (*COLUMNS, PRESSURE) if name in names]
    for row in reader:
        if row:
            values = [_number(row, i, names[i], reader.line_num) for i in at]
            yield values if len(values) == 5 else [*values, 0.0]


def _number(row: list[str], i: int, name: str, line: int) -> float:
    text = row[i].strip() if i < len(row) else "nothing"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise ValueError(f"line {line}: {name} must be a number up to {LARGEST:g}; got {text[:40]}")
    return value


def _require_different(position: np.ndarray) -> None:
    unique, counts = np.unique(position, axis=0, return_counts=True)
    if (counts > 1).any():
        x, y = unique[counts > 1][0]
        raise ValueError(f"the point ({x:g}, {y:g}) m appears twice")
