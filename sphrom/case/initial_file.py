"""The start of a run from a CSV file: velocity and pressure at scattered points."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sphrom.arrays import Array
from sphrom.case.fields import LARGEST
from sphrom.errors import CaseError
from sphrom.text import shortened, visible
from sphrom.whole_files import read_whole

COLUMNS = ("x", "y", "u", "v", "p")
"""Of these the last may lack."""
MOST_BYTES = 16 * 1024 * 1024
"""The largest file that is read."""
MOST_POINTS = 200_000
"""Triangulating them takes seconds."""


_KNOWN: dict[str, Callable[[Array], Array]] = {}
"""Fields of files that were read, by their digests: copies of a case know no folder."""


def start_fields(name: str, digest: str, position: Array) -> Array:
    """Return u, v [m/s] and p [Pa] (n_points, 3) of a file that has a digest.

    Raises CaseError without it.
    """
    try:
        if digest not in _KNOWN and read_start(Path(name)) != digest:
            raise ValueError(f"{visible(name)} has changed since the case was read")
        return _KNOWN[digest](position)
    except ValueError as error:
        raise CaseError(f"scene.initial.file: {error}") from error


def read_start(path: Path) -> str:
    """Read u, v [m/s] and p [Pa] at points, keep them, and return the SHA-256 of their file.

    Fields are linear between the points, and beyond them those of the nearest point.

    Raises ValueError where the file can't be read, or holds no such fields.
    """
    # Few cases start from files.
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
    from scipy.spatial import QhullError

    name = visible(path.name)
    try:
        content = read_whole(path, MOST_BYTES)
        points = _points(content.decode("utf-8-sig"))
        between = LinearNDInterpolator(points[:, :2], points[:, 2:])
        nearest = NearestNDInterpolator(points[:, :2], points[:, 2:])
    except OSError as error:
        raise ValueError(f"{visible(str(path))}: can't be read: {error.strerror}") from error
    except QhullError as error:
        raise ValueError(f"{name}: all its points lie on a line") from error
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{name}: {shortened(str(error))}") from error

    def fields(position: Array) -> Array:
        values = np.asarray(between(position))
        beyond = np.isnan(values).any(axis=1)
        values[beyond] = nearest(position[beyond])
        return values

    digest = hashlib.sha256(content).hexdigest()
    _KNOWN[digest] = fields
    return digest


def _points(text: str) -> Array:
    """Return x, y, u, v and p of each point (n_points, 5)."""
    rows = [line for line in text.splitlines() if line.strip()]
    names = [name.strip() for name in next(csv.reader(rows), [])]
    if any(names.count(name) != 1 for name in COLUMNS[:4]):
        raise ValueError("its first line must name the columns x, y, u, v and perhaps p, once each")
    if not 3 <= len(rows) - 1 <= MOST_POINTS:
        raise ValueError(f"must hold 3 to {MOST_POINTS} points; got {len(rows) - 1}")
    columns = [names.index(name) for name in COLUMNS if name in names]
    values = np.loadtxt(rows, delimiter=",", usecols=columns, ndmin=2, skiprows=1, comments=None)
    values = np.pad(values, ((0, 0), (0, 5 - len(columns))))
    if not np.all(np.abs(values) <= LARGEST):  # NaN isn't either
        raise ValueError(f"values must be numbers up to {LARGEST:g}")
    if len(np.unique(values[:, :2], axis=0)) < len(values):
        raise ValueError("a point appears twice")
    return values
