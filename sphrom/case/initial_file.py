"""Initial conditions from a CSV file with velocity and pressure at scattered points."""

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
"""The columns of a file; the last is optional."""
MOST_BYTES = 16 * 1024 * 1024
"""Largest size of a file [bytes]."""
MOST_POINTS = 200_000
"""Largest number of points, whose triangulation takes seconds."""


_FIELDS: dict[str, Callable[[Array], Array]] = {}
"""A cache of fields by the digests of their files, because copies of a case have no folder."""


def start_fields(name: str, digest: str, position: Array) -> Array:
    """Return u, v [m/s] and p [Pa] (n_points, 3) from the file with a digest.

    Raises CaseError when the file is missing or has changed.
    """
    try:
        if digest not in _FIELDS and read_start(Path(name)) != digest:
            raise ValueError(f"{visible(name)} has changed since the case was read")
        return _FIELDS[digest](position)
    except ValueError as error:
        raise CaseError(f"scene.initial.file: {error}") from error


def read_start(path: Path) -> str:
    """Read u, v [m/s] and p [Pa] at points, cache them, and return the SHA-256 of their file.

    Fields are linear between the points. Outside, they have the values of the nearest point.

    Raises ValueError where the file can't be read, or is not such a table.
    """
    # Imported late, because few cases start from files.
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
        raise ValueError(f"{name}: all points lie on one line") from error
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{name}: {shortened(str(error))}") from error

    def fields(position: Array) -> Array:
        values = np.asarray(between(position))
        beyond = np.isnan(values).any(axis=1)
        values[beyond] = nearest(position[beyond])
        return values

    digest = hashlib.sha256(content).hexdigest()
    _FIELDS[digest] = fields
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
    if not np.all(np.abs(values) <= LARGEST):  # also refuses NaN
        raise ValueError(f"values must be numbers up to {LARGEST:g}")
    if len(np.unique(values[:, :2], axis=0)) < len(values):
        raise ValueError("a point appears twice")
    return values
