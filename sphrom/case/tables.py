"""Histories and initial fields of the scene of kind custom, which may come from tables."""

from __future__ import annotations

import csv
import hashlib
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from sphrom.arrays import Array
from sphrom.case.custom_sections import Value
from sphrom.case.fields import LARGEST, Coordinate, OneOf, Section, key
from sphrom.case.points import rising
from sphrom.errors import CaseError
from sphrom.scenes.expressions import Expression
from sphrom.scenes.histories import History, beyond_ends
from sphrom.text import shortened, table_rows, visible
from sphrom.whole_files import read_whole

MOST_BYTES = 16 * 1024 * 1024
"""Largest size of a table [bytes]."""
COLUMNS = ("x", "y", "u", "v", "p")
"""The columns of a file of points; the last is optional."""
MOST_POINTS = 200_000
"""Largest number of points, whose triangulation takes seconds."""
_TABLES: dict[tuple[str | None, ...], Any] = {}
"""Contents of tables by digests and chosen columns, because copies of a case have no folder."""


class TableSection(Section):
    """A section with a file, and its digest, so that the case identifies the content."""

    path: ClassVar[str]
    """The key in the case, for messages."""
    chosen: ClassVar[tuple[str, ...]] = ()
    """The keys that choose columns."""

    if TYPE_CHECKING:  # each section has these keys, in its order
        file: Any
        sha256: str | None

    @classmethod
    @abstractmethod
    def parsed(cls, text: str, *chosen: str | None) -> Any:
        """Return the content of a table from its text. Raises ValueError."""

    @model_validator(mode="before")
    @classmethod
    def _with_digest(cls, values: Any, info: ValidationInfo) -> Any:
        name = values.get("file") if isinstance(values, dict) else None
        folder = (info.context or {}).get("folder")
        # The case in an artifact is read without its files, and does not start runs.
        if not isinstance(name, str) or (folder is None and values.get("sha256") is not None):
            return values
        given = [values.get(key) for key in cls.chosen]
        chosen = [column if isinstance(column, str) else None for column in given]
        digest = cls._read(Path(folder or "") / name, chosen)
        if values.get("sha256") not in (None, digest):
            raise ValueError(f"{visible(name)} has changed since its sha256 was taken")
        return {**values, "sha256": digest}

    @classmethod
    def _read(cls, path: Path, chosen: Sequence[str | None]) -> str:
        """Read a file, cache its content, and return its SHA-256. Raises ValueError."""
        name = visible(path.name)
        try:
            content = read_whole(path, MOST_BYTES)
            digest = hashlib.sha256(content).hexdigest()
            _TABLES[digest, *chosen] = cls.parsed(content.decode("utf-8-sig"), *chosen)
        except OSError as error:
            raise ValueError(f"{visible(str(path))}: can't be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ValueError(f"{name}: is not UTF-8 text") from error
        except (csv.Error, ValueError) as error:
            raise ValueError(f"{name}: {shortened(str(error))}") from error
        return digest

    @property
    def table(self) -> Any:
        """The content of the file. Raises CaseError when it is missing or has changed."""
        chosen = [getattr(self, key) for key in self.chosen]
        try:
            known = (self.sha256, *chosen) in _TABLES
            if not known and self._read(Path(self.file), chosen) != self.sha256:
                raise ValueError(f"{visible(self.file)} has changed since the case was read")
        except ValueError as error:
            raise CaseError(f"scene.{self.path}: {error}") from error
        return _TABLES[self.sha256, *chosen]


def remember(rows: Array, sha256: str, time: str | None, value: str | None) -> None:
    """Keep the rows (2, n_rows + 2) of a `MeasuredSection` whose file may be missing."""
    _TABLES[sha256, time, value] = rows


class HistorySection(Section):
    """A history: values over time, and how they change between the times given."""

    if TYPE_CHECKING:  # each section has this key, after its others
        interpolation: Literal["linear", "cubic"]

    @abstractmethod
    def at(self, constants: Mapping[str, float]) -> History:
        """Return the history at values of the scene's constants. Raises ValueError."""


INTERPOLATION = key(
    "linear", "between times: `linear`, or `cubic`, a spline with continuous curvature"
)


class MeasuredSection(TableSection, HistorySection):
    """A history from a column of a table over time."""

    path: ClassVar[str] = "histories"
    chosen: ClassVar[tuple[str, ...]] = ("time", "value")

    file: str = key(..., "a CSV file: the names of its columns, then one row for each time")
    time: str | None = key(None, "column of the times in seconds; null is the first column")
    value: str | None = key(None, "column of the values; null is the other one of two columns")
    scale: Coordinate = key(1.0, "factor of the values, such as 9.81 for accelerations in g")
    sha256: str | None = key(None, "digest of that file; computed if it is missing")
    interpolation: Literal["linear", "cubic"] = INTERPOLATION

    @classmethod
    def parsed(cls, text: str, *chosen: str | None) -> Array:
        names, lines = _cells(text)
        time, value = chosen
        time = time or next(iter(names), "")
        others = [name for name in names if name != time]
        value = value or (others[0] if len(others) == 1 else "")
        if time == value or not names.count(time) == names.count(value) == 1:
            raise ValueError(
                "its first line must name a column of times and one of values, which the keys "
                f"`time` and `value` choose; it names {', '.join(names)}"
            )
        rows = _numbers(lines, [names.index(name) for name in (time, value)]).T
        if rows.shape[1] < 2:
            raise ValueError("must hold two rows or more")
        for late in np.flatnonzero(np.diff(rows[0]) <= 0.0):
            before, after = rows[0, late : late + 2]
            raise ValueError(f"times must increase from row to row; {after:g} follows {before:g}")
        return beyond_ends(rows)

    @property
    def rows(self) -> Array:
        """Times [s] and values (2, n_rows + 2) of the table; see `beyond_ends`."""
        return self.table

    @cached_property
    def _history(self) -> History:
        return History(visible(self.file), self.rows, self.scale, self.interpolation == "cubic")

    def at(self, constants: Mapping[str, float]) -> History:
        return self._history


class KnotsSection(HistorySection):
    """A history through knots, whose values may depend on constants, and so on parameters."""

    times: Annotated[tuple[Coordinate, ...], Field(min_length=2), AfterValidator(rising)] = key(
        ..., "times of the knots, which increase", unit="s"
    )
    values: tuple[Value, ...] = key(
        ..., "values at these times, numbers or expressions of constants, such as [0, f1, f2]"
    )
    interpolation: Literal["linear", "cubic"] = INTERPOLATION

    @model_validator(mode="after")
    def _of_one_length(self) -> KnotsSection:
        if len(self.values) != len(self.times):
            got = f"{len(self.values)} values and {len(self.times)} times"
            raise ValueError(f"values: must be as many as times; got {got}")
        return self

    def at(self, constants: Mapping[str, float]) -> History:
        values = tuple(Expression(str(value), (), constants) for value in self.values)
        rows = np.array([self.times, [value.fixed for value in values]])
        return History("the history", beyond_ends(rows), 1.0, self.interpolation == "cubic", values)


Histories = Annotated[HistorySection, OneOf(file=MeasuredSection, times=KnotsSection)]


class InitialSection(TableSection):
    """The initial fields of runs: numbers or expressions in x, y (and z), or a file of points."""

    path: ClassVar[str] = "initial.file"

    u: Value = key(0.0, "velocity along x", unit="m/s")
    v: Value = key(0.0, "velocity along y", unit="m/s")
    w: Value = key(0.0, "velocity along z, in three dimensions", unit="m/s")
    p: Value = key(0.0, "pressure", unit="Pa")
    file: str | None = key(
        None,
        "a CSV file with columns x, y, u, v and optionally p, instead of expressions; fields are "
        "linear between its points, and beyond them those of the nearest point",
    )
    sha256: str | None = key(None, "digest of that file; computed if it is missing")

    @model_validator(mode="after")
    def _file_alone(self) -> InitialSection:
        if self.file is not None and any(
            value != 0.0 for value in (self.u, self.v, self.w, self.p)
        ):
            raise ValueError("file can't be combined with u, v, w and p; give one or the other")
        return self

    @classmethod
    def parsed(cls, text: str, *chosen: str | None) -> Callable[[Array], Array]:
        """Return a function for u, v [m/s] and p [Pa] (n_points, 3) at positions (n_points, 2)."""
        # Imported late, because few cases start from files.
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
        from scipy.spatial import QhullError

        points = _points(text)
        try:
            between = LinearNDInterpolator(points[:, :2], points[:, 2:])
        except QhullError as error:
            raise ValueError("all points lie on one line") from error
        nearest = NearestNDInterpolator(points[:, :2], points[:, 2:])

        def fields(position: Array) -> Array:
            values = between(position)
            beyond = np.isnan(values).any(axis=1)
            values[beyond] = nearest(position[beyond])
            return values

        return fields


def _points(text: str) -> Array:
    """Return x, y, u, v and p of each point (n_points, 5)."""
    names, rows = _cells(text)
    if any(names.count(name) != 1 for name in COLUMNS[:4]):
        raise ValueError("its first line must name the columns x, y, u, v and perhaps p, once each")
    if not 3 <= len(rows) <= MOST_POINTS:
        raise ValueError(f"must hold 3 to {MOST_POINTS} points; got {len(rows)}")
    columns = [names.index(name) for name in COLUMNS if name in names]
    values = np.pad(_numbers(rows, columns), ((0, 0), (0, 5 - len(columns))))
    if len(np.unique(values[:, :2], axis=0)) < len(values):
        raise ValueError("a point appears twice")
    return values


def _cells(text: str) -> tuple[list[str], list[list[str]]]:
    """Return the names of the columns of a table, and the cells of its rows."""
    (_, names), *rows = table_rows(text) or [(0, [])]
    return names, [cells for _, cells in rows]


def _numbers(rows: list[list[str]], columns: list[int]) -> Array:
    """Return some columns (n_rows, n_columns) of a table. Raises ValueError."""
    cells = [[row[column] for column in columns] for row in rows]
    values = np.array(cells, dtype=np.float64).reshape(-1, len(columns))
    if not np.all(np.abs(values) <= LARGEST):  # also refuses NaN
        raise ValueError(f"values must be numbers up to {LARGEST:g}")
    return values
