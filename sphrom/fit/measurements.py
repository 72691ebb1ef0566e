"""Measured histories from a CSV file, with one header row and one row per time.

    time [s], wake_velocity_x [m/s], wake_velocity_x_noise, drag_force_x [N/m]
    0.1,      0.213,                 0.002,                 1.31
    0.2,      0.215,                 0.002,

Except for `time`, the name of a column consists of the measurement in the case, the quantity, and
its component, if any. In a table with columns `x` and `y`, and `z` in three dimensions, the columns
velocity_x, velocity_y and pressure are values at that place and time, as in tables of
`sphrom export --to csv`. Units, in
brackets, are optional. Columns whose names end in `_noise` have standard deviations. Empty cells
and NaN are missing values, lines that begin with # are comments, and other cells are numbers. With
semicolons or tabs between cells, numbers may have decimal commas (`sphrom.text.table_rows`).
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from sphrom.arrays import Array
from sphrom.case.fields import LARGEST
from sphrom.case.measure_sections import outside_fluid
from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.metrics.quantities import AXES, PLACED, Column
from sphrom.metrics.series import OSCILLATION
from sphrom.sph.time_loop import TimeSteps
from sphrom.text import nearest, place_text, quoted, repeated, shortened, table_rows, visible
from sphrom.whole_files import read_whole

Place = tuple[float, ...]

MOST_BYTES = 16 * 1024 * 1024
"""Largest size of a file [bytes]."""
NOISE = "_noise"
"""Suffix of the names of columns with standard deviations."""
UNNAMED = ""
"""Name of the measurement for fields at the places of rows."""
MOST_VALUES = 100_000
"""Largest number of values of one file; each one is a row of the Jacobian."""
LEAST_NOISE = 1e-24
"""Least standard deviation, so that squares of quotients by it stay finite."""
MOST_LINES = 2 * MOST_VALUES
"""Largest number of lines of one file, including those without values."""
TIME_TOLERANCE = 1e-6
"""Tolerance for times beyond the snapshots, relative to the time between snapshots."""


def at_place(case: Case) -> dict[str, Column]:
    """Return the columns of values at the places of rows."""
    return Column.named(UNNAMED, PLACED, case.scene.domain.n_dim)


def axes_of(case: Case) -> dict[str, str]:
    """Return the columns of times and places, with their units."""
    return {"time": "s", **dict.fromkeys(AXES[: case.scene.domain.n_dim], "m")}


@dataclass(frozen=True)
class History(Column):
    """One measured quantity over time."""

    name: str
    """Name of the column, with the place if the case does not name it."""
    place: Place | None
    """Place [m] that the case does not name, or None."""
    time: Array
    """(n_values,) [s]."""
    value: Array
    """(n_values,)."""
    noise: Array
    """(n_values,) standard deviations."""


@dataclass(frozen=True)
class Measurements:
    """The histories of a file or of columns."""

    source: str
    """Name of the file."""
    digest: str
    """SHA-256 of its content."""
    histories: tuple[History, ...]

    @property
    def values(self) -> Array:
        """The values (n_values,) of all histories, one after the other."""
        return np.concatenate([history.value for history in self.histories])

    @property
    def noise(self) -> Array:
        """The standard deviations (n_values,) of the values."""
        return np.concatenate([history.noise for history in self.histories])


Source = Path | Mapping[str, ArrayLike]
"""A CSV file, or its columns by name."""


def read_measurements(
    source: Source, case: Case, plan: TimeSteps, noise: float | None
) -> Measurements:
    """Read measured histories.

    Parameters
    ----------
    plan : the time steps of the model.
    noise : standard deviation over each history's range [%], for columns without one.

    Raises CaseError when the file can't be read or is not such a table, when the case does not
    measure the quantity of a column, a unit is wrong, a time is beyond those of the model, a place
    is outside of the fluid, or the noise is unknown.
    """
    name, text = _text(source)
    try:
        rows = _entries(text, case)
        histories = [_history(key, entries, noise) for key, entries in rows.items()]
        if not histories:
            raise ValueError("has no values")
        _require_times(histories, plan)
    except (csv.Error, ValueError) as error:
        raise CaseError(f"{name}: {error}") from error
    return Measurements(name, hashlib.sha256(text.encode()).hexdigest(), tuple(histories))


def _text(source: Source) -> tuple[str, str]:
    """Return the name and the content of a table."""
    if isinstance(source, Path):
        try:
            return source.name, read_whole(source, MOST_BYTES).decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise CaseError(f"{source.name}: is not UTF-8 text") from error
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise CaseError(f"{visible(str(source))}: can't be read: {reason}") from error
    try:
        columns = {str(name): np.atleast_1d(values) for name, values in source.items()}
    except ValueError as error:
        raise CaseError(f"measurements: columns must be lists of numbers; {error}") from error
    if len({values.shape for values in columns.values()}) > 1:
        raise CaseError("measurements: columns must have equal lengths")
    rows = io.StringIO()
    writer = csv.writer(rows, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
    return "measurements", rows.getvalue()


Entry = tuple[float, float, float]
"""Time, value and noise; the noise is NaN if unknown."""
Key = tuple[str, Column, Place | None]


def _entries(text: str, case: Case) -> dict[Key, list[Entry]]:
    """Return the entries of each history of a table."""
    if (n_lines := len(text.splitlines())) > MOST_LINES:
        raise ValueError(f"has {n_lines} lines; at most {MOST_LINES} are allowed")
    (_, head), *rows = table_rows(text) or [(0, [])]
    names = list(_names(head, case))
    time, *axes = axes_of(case)
    given = (n for n in names if n not in (time, *axes) and not n.endswith(NOISE))
    columns = {n: column_of(case, n) for n in given}
    entries: dict[Key, list[Entry]] = {}
    for line, row in rows:
        cells = {n: _number(cell, n, line) for n, cell in zip(names, row, strict=True)}
        for name, column in columns.items():
            if math.isnan(value := cells[name]):
                continue
            place = None if column.measure else tuple(cells[axis] for axis in axes)
            if any(map(math.isnan, (cells[time], *(place or ())))):
                raise ValueError(f"line {line}: has a value but no time, or no place")
            entry = cells[time], value, cells.get(f"{name}{NOISE}", math.nan)
            entries.setdefault((name, column, place), []).append(entry)
    if sum(map(len, entries.values())) > MOST_VALUES:
        raise ValueError(f"has more than {MOST_VALUES} values; keep fewer times")
    places = list(dict.fromkeys(place for _, _, place in entries if place is not None))
    spacing = case.plan.particle_spacing
    problem = outside_fluid(case.scene.domain, np.array(places).reshape(-1, len(axes)), spacing)
    if problem is not None:
        raise ValueError(problem.partition(";")[0])
    return entries


def _names(head: Sequence[str], case: Case) -> Iterator[str]:
    """Yield the names of columns, and check their units."""
    pairs = [_name_and_unit(cell) for cell in head]
    names = [name for name, _ in pairs]
    time, *axes = units = axes_of(case)
    n_axes = sum(axis in names for axis in axes)
    if time not in names or n_axes not in (0, len(axes)) or repeated(names):
        raise ValueError(
            "its first row must name the columns, each once: time, measurements such as "
            f"drag_force_x, and {' and '.join(axes)} where rows have places"
        )
    for name, stated in pairs:
        base = name.removesuffix(NOISE)
        unit = units.get(name) or column_of(case, base).units
        if base not in names:
            raise ValueError(f"column {quoted(name)} has no column {quoted(base)} of values")
        if base in at_place(case) and not n_axes:
            raise ValueError(f"column {base} needs a place: columns {' and '.join(axes)}")
        if stated not in (None, unit):
            raise ValueError(f"column {name} must be in {unit}; got [{shortened(stated, 60)}]")
        yield name


def _name_and_unit(cell: str) -> tuple[str, str | None]:
    """Return the name and the unit, or None, of a column's head such as `wake_pressure [Pa]`."""
    match = re.fullmatch(r"(.*?)\[(.*)\]", cell.strip())
    return (match[1].strip(), match[2].strip()) if match else (cell.strip(), None)


def column_of(case: Case, name: str) -> Column:
    """Return the column with a name. Raises ValueError if the case has no such measurement."""
    known = at_place(case) | case.scene.columns
    for measured, oscillating in case.plan.oscillations.items():
        for figure in OSCILLATION[:3]:
            units = oscillating.units_of(figure)
            known[f"{measured}_{figure}"] = Column(measured, figure, None, units)
    if name not in known:
        raise ValueError(
            f"column {quoted(name)} is not a measurement of the case over time; "
            f"{nearest(name, known)}; {', '.join(at_place(case))} need columns "
            f"{' and '.join([*axes_of(case)][1:])} for the place"
        )
    return known[name]


def _number(text: str, name: str, line: int) -> float:
    """Return the number of a cell, NaN for a missing value."""
    try:
        value = float(text or "nan")
    except ValueError:
        value = math.inf
    if abs(value) > LARGEST:
        raise ValueError(
            f"line {line}: {name} must be a number up to {LARGEST:g}; got {quoted(text[:40])}"
        )
    return value


def _history(key: Key, entries: Sequence[Entry], noise: float | None) -> History:
    """Return a history in order of time, with its noise."""
    column_name, column, place = key
    name = column_name if place is None else f"{column_name} at {place_text(place)}"
    time, value, deviation = np.array(sorted(entries)).T
    unknown = np.isnan(deviation)
    if unknown.any():
        share = math.nan if noise is None else 0.01 * noise * float(np.ptp(value))
        deviation = np.where(unknown, share, deviation)
    if not (deviation >= LEAST_NOISE).all():
        raise ValueError(
            f"{name} has no noise, or too little; give a column {column_name}{NOISE}, or a share "
            "of the history's range, --noise 1% (in Python, noise='1%')"
        )
    return History(**vars(column), name=name, place=place, time=time, value=value, noise=deviation)


def _require_times(histories: Sequence[History], plan: TimeSteps) -> None:
    """Raise ValueError for times that a run does not reach."""
    slack = TIME_TOLERANCE * plan.snapshot_interval
    for history in histories:
        for instant in (history.time[0], history.time[-1]):
            if not plan.start_time - slack <= instant <= plan.end_time + slack:
                raise ValueError(
                    f"{history.name} at {instant:g} s is outside of the model's times, "
                    f"{plan.start_time:g} to {plan.end_time:g} s"
                )
