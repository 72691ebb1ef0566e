"""Tables as CSV and JSON, from rows that are instances of one frozen record.

A field of the record may carry `metadata={"unit": "%"}`; its CSV heading is then `name [%]`. One
with `metadata=columns(...)` maps the names of several columns to their figures.
A figure that a row does not have, such as the error of an unstable run, is None: an empty cell in
CSV, null in JSON. NaN and infinities are refused.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field, fields, make_dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

from sphrom.errors import ArtifactError
from sphrom.text import shortened, visible
from sphrom.version import __version__
from sphrom.whole_files import read_whole, write_whole

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MOST_BYTES = 64 * 1024 * 1024
"""The largest table that is read."""
MISSING = "–"
"""Shown for a figure that does not exist."""
UNKNOWN = "unknown"
"""Shown for a figure that is unknown."""
PLAIN_RANGE = (1e-3, 1e7)
"""Figures of a size in this range are written without an exponent."""


def columns(names: Iterable[str], unit: str | None = None) -> dict[str, dict[str, str | None]]:
    """Return the metadata of a field that maps names of columns to figures of one unit."""
    return {"columns": dict.fromkeys(names, unit)}


def rows_of_columns(
    units: Mapping[str, str | None], rows: Iterable[Mapping[str, Any]]
) -> list[DataclassInstance]:
    """Return rows of one record, of columns that a case has, from their cells by column."""
    cells = field(metadata={"columns": dict(units)})
    kind = make_dataclass("Row", [("cells", Mapping[str, Any], cells)], frozen=True)
    return [kind(row) for row in rows]


def _columns(record: type[DataclassInstance]) -> dict[str, dict[str, str | None]]:
    """Return the columns of each field of a record, with their units."""
    return {
        each.name: each.metadata.get("columns", {each.name: each.metadata.get("unit")})
        for each in fields(record)
    }


def headings(record: type[DataclassInstance]) -> list[str]:
    """Return the heading of every column of a record, with its unit where it has one."""
    found = [pair for each in _columns(record).values() for pair in each.items()]
    return [f"{name} [{unit}]" if unit else name for name, unit in found]


def flat(row: DataclassInstance) -> dict[str, Any]:
    """Return the values of a row, by column."""
    found: dict[str, Any] = {}
    for name, parts in _columns(type(row)).items():
        value = getattr(row, name)
        given = value if isinstance(value, Mapping) else {name: value}
        found |= {part: given[part] for part in parts}
    return found


def _rows_of(record: type[DataclassInstance], rows: Any) -> list[Any]:
    """Return rows as instances of their record. Raises ValueError for one of another type."""
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError("a table has no rows")
    types = get_type_hints(record)
    found = []
    for row in rows:
        values: dict[str, Any] = {}
        for name, parts in _columns(record).items():
            several = get_origin(types[name]) in (dict, Mapping)
            kind = get_args(types[name])[1] if several else types[name]
            allowed = kind | int if float in (kind, *get_args(kind)) else kind
            for part in parts:
                if part not in row or not isinstance(row[part], allowed):
                    raise ValueError(f"{part} of a row is {row.get(part, 'missing')!r}")
            values[name] = {part: row[part] for part in parts} if several else row[name]
        found.append(record(**values))
    return found


def write_csv(path: Path, rows: Sequence[DataclassInstance]) -> None:
    """Write rows of one record as CSV, a heading first, figures to full precision.

    Raises ValueError for no rows or a figure that is not finite, ArtifactError when the file can't
    be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings(type(rows[0])))
    writer.writerows([_cell(value) for value in flat(row).values()] for row in rows)
    write_whole(path, text.getvalue().encode())


def _cell(value: object) -> object:
    """Return a cell without control characters, which a terminal that shows the file obeys."""
    if isinstance(value, float):
        return value if math.isfinite(value) else _finite(repr(value))
    return visible(value) if isinstance(value, str) else value


def _finite(text: str) -> float:
    """Return a figure. Raises ValueError for one that isn't finite."""
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text} is no figure for a table; use None where there is none")
    return value


def write_json(
    path: Path,
    tables: Mapping[str, Sequence[DataclassInstance]],
    case: str,
    threads: int,
    **more: Any,
) -> None:
    """Write named tables as one JSON object, before them case, software, date, threads and `more`.

    Raises ValueError for a figure that is not finite, ArtifactError when the file can't be written.
    """
    document: dict[str, Any] = {name: [flat(row) for row in rows] for name, rows in tables.items()}
    date = datetime.now(UTC).isoformat(timespec="seconds")
    about = {"case": case, "software": f"sphrom {__version__}", "date": date, "threads": threads}
    text = json.dumps({"about": about | more, **document}, indent=2, allow_nan=False)
    write_whole(path, (text + "\n").encode())


def read_csv(
    path: Path, made_by: str, record: type[DataclassInstance] | None = None
) -> tuple[list[str], list[list[str]]]:
    """Return the headings and the rows of a table, of a record where that is known.

    Raises ArtifactError, naming the command that makes it, when it is missing or damaged.
    """
    with _explained(path, made_by):
        text = read_whole(path, MOST_BYTES).decode()
        head, *rows = csv.reader(io.StringIO(text, newline=""), strict=True)
        if not rows or {len(row) for row in rows} != {len(head)}:
            raise ValueError("its rows are not of one length, or there are none")
        if record is not None and head != headings(record):
            raise ValueError("its columns are not those of the table")
        for name, *column in zip(head, *rows, strict=True):
            if name.endswith("]"):
                _ = [_finite(cell) for cell in column if cell]
    return head, rows


def read_json(
    path: Path, made_by: str, records: Mapping[str, type[DataclassInstance]]
) -> dict[str, Any]:
    """Return the content of a file of `write_json`: `about`, and each table as a list of rows.

    Rows are instances of their `records`, by table.

    Raises ArtifactError, naming the command that makes it, when it is missing or damaged.
    """
    with _explained(path, made_by):
        text = read_whole(path, MOST_BYTES).decode()
        document = json.loads(text, parse_constant=_finite, parse_float=_finite)
        if not isinstance(document, dict) or not isinstance(document.get("about"), dict):
            raise ValueError("it does not say what it is about")
        for name, record in records.items():
            if name in document:
                document[name] = _rows_of(record, document[name])
    return document


@contextmanager
def _explained(path: Path, made_by: str) -> Iterator[None]:
    """Raise an ArtifactError for a table that is missing, damaged or foreign."""
    remedy = f"make it again with `{made_by} --force`"
    if not path.is_file():
        raise ArtifactError(f"{path} is missing, or not a file: {remedy}")
    try:
        yield
    except (OSError, ValueError, csv.Error, RecursionError) as error:
        reason = shortened((str(error) or type(error).__name__).splitlines()[0])
        raise ArtifactError(f"{path} is damaged ({reason}): {remedy}") from error


def format_figure(value: float | int | str | bool | None, digits: int = 3) -> str:
    """Return a figure as a table shows it: floats to so many significant digits.

    Whole numbers keep all of theirs, in groups of three; None is a dash.
    """
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:,}"
    rounded = _finite(f"{value:.{digits - 1}e}")
    if rounded == 0.0:
        return "0"
    if not PLAIN_RANGE[0] <= abs(rounded) < PLAIN_RANGE[1]:
        mantissa, exponent = f"{rounded:.{digits - 1}e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{rounded:,.{max(0, digits - 1 - math.floor(math.log10(abs(rounded))))}f}"
