"""Tables as CSV and JSON, from rows that are instances of one frozen record.

A field of the record may have `metadata={"unit": "%"}`; its CSV heading is then `name [%]`. A field
with `metadata=columns(...)` maps names of several columns to their figures. A missing figure is
None: an empty cell in CSV, null in JSON. NaN and infinities are refused.
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
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter

from sphrom.errors import ArtifactError
from sphrom.text import shortened, visible
from sphrom.version import __version__
from sphrom.whole_files import read_whole, write_whole

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MOST_BYTES = 64 * 1024 * 1024
"""Largest size of a table [bytes]."""
MISSING = "–"
"""Text for a figure that does not exist."""
UNKNOWN = "unknown"
"""Text for an unknown figure."""
PLAIN_RANGE = (1e-3, 1e7)
"""Range of absolute values that are written without an exponent."""


def columns(names: Iterable[str], unit: str | None = None) -> dict[str, dict[str, str | None]]:
    """Return the metadata of a field that maps names of columns to figures of one unit."""
    return {"columns": dict.fromkeys(names, unit)}


def rows_of_columns(
    units: Mapping[str, str | None], rows: Iterable[Mapping[str, Any]]
) -> list[DataclassInstance]:
    """Return rows with columns that depend on the case, from their cells by column."""
    cells = field(metadata={"columns": dict(units)})
    kind = make_dataclass("Row", [("cells", Mapping[str, Any], cells)], frozen=True)
    return [kind(row) for row in rows]


def _columns(record: type[DataclassInstance]) -> dict[str, dict[str, str | None]]:
    """Return the columns of each field of a record, with their units."""
    return {
        column.name: column.metadata.get("columns", {column.name: column.metadata.get("unit")})
        for column in fields(record)
    }


def headings(record: type[DataclassInstance]) -> list[str]:
    """Return the headings of all columns of a record, with their units, if any."""
    pairs = [pair for parts in _columns(record).values() for pair in parts.items()]
    return [f"{name} [{unit}]" if unit else name for name, unit in pairs]


def flat(row: DataclassInstance) -> dict[str, Any]:
    """Return the values of a row, by column."""
    cells: dict[str, Any] = {}
    for name, parts in _columns(type(row)).items():
        value = getattr(row, name)
        values = value if isinstance(value, Mapping) else {name: value}
        cells |= {part: values[part] for part in parts}
    return cells


def _rows_of(record: type[DataclassInstance], rows: Any) -> list[Any]:
    """Return rows as instances of their record.

    Raises KeyError, TypeError or ValueError for rows of another record.
    """
    nested = [
        {
            name: row[name] if name in parts else {part: row[part] for part in parts}
            for name, parts in _columns(record).items()
        }
        for row in rows
    ]
    return TypeAdapter(list[record]).validate_python(nested)  # type: ignore[valid-type]


def write_csv(path: Path, rows: Sequence[DataclassInstance]) -> None:
    """Write rows of one record as CSV, with a heading, and figures with full precision.

    Raises ValueError without rows and for figures that aren't finite, ArtifactError for the file.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings(type(rows[0])))
    writer.writerows([_cell(value) for value in flat(row).values()] for row in rows)
    write_whole(path, text.getvalue().encode())


def _cell(value: object) -> object:
    """Return a cell without control characters, which would affect a terminal."""
    if isinstance(value, float):
        return value if math.isfinite(value) else _finite(repr(value))
    return visible(value) if isinstance(value, str) else value


def _finite(text: str) -> float:
    """Return the number of a text. Raises ValueError unless it is finite."""
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text} is not allowed in a table; use None for a missing figure")
    return value


def write_json(
    path: Path,
    tables: Mapping[str, Sequence[DataclassInstance]],
    case: str,
    threads: int,
    **more: Any,
) -> None:
    """Write named tables as one JSON object, after an entry `about` with metadata and `more`.

    Raises ValueError for figures that aren't finite, ArtifactError when the file can't be written.
    """
    document: dict[str, Any] = {name: [flat(row) for row in rows] for name, rows in tables.items()}
    date = datetime.now(UTC).isoformat(timespec="seconds")
    metadata = {"case": case, "software": f"sphrom {__version__}", "date": date, "threads": threads}
    text = json.dumps({"about": metadata | more, **document}, indent=2, allow_nan=False)
    write_whole(path, (text + "\n").encode())


def read_csv(
    path: Path, made_by: str, record: type[DataclassInstance] | None = None
) -> tuple[list[str], list[list[str]]]:
    """Return the headings and the rows of a table, whose columns must be those of `record`.

    Raises ArtifactError, with the command that makes it, when it is missing or damaged.
    """
    with _explained(path, made_by):
        text = read_whole(path, MOST_BYTES).decode()
        head, *rows = csv.reader(io.StringIO(text, newline=""), strict=True)
        if not rows or {len(row) for row in rows} != {len(head)}:
            raise ValueError("its rows differ in length, or it has none")
        if record is not None and head != headings(record):
            raise ValueError("its columns are not those of this table")
        for name, *column in zip(head, *rows, strict=True):
            if name.endswith("]"):
                _ = [_finite(cell) for cell in column if cell]
    return head, rows


def read_json(
    path: Path, made_by: str, records: Mapping[str, type[DataclassInstance]]
) -> dict[str, Any]:
    """Return the content of a file of `write_json`: `about`, and each table as a list of rows.

    `records` are the records of the rows, by table.

    Raises ArtifactError, with the command that makes it, when it is missing or damaged.
    """
    with _explained(path, made_by):
        text = read_whole(path, MOST_BYTES).decode()
        document = json.loads(text, parse_constant=_finite, parse_float=_finite)
        if not isinstance(document, dict) or not isinstance(document.get("about"), dict):
            raise ValueError("it has no entry about")
        for name, record in records.items():
            if name in document:
                document[name] = _rows_of(record, document[name])
    return document


@contextmanager
def _explained(path: Path, made_by: str) -> Iterator[None]:
    """Raise ArtifactError for a missing, damaged or foreign table."""
    remedy = f"make it again with `{made_by} --force`"
    if not path.is_file():
        raise ArtifactError(f"{path} is missing, or not a file: {remedy}")
    try:
        yield
    except (OSError, KeyError, TypeError, ValueError, csv.Error, RecursionError) as error:
        reason = shortened(" ".join(str(error).split()) or type(error).__name__)
        raise ArtifactError(f"{path} is damaged ({reason}): {remedy}") from error


def format_figure(value: float | int | str | bool | None, digits: int = 3) -> str:
    """Format a figure for a table, floats with a number of significant digits.

    Integers have all digits, in groups of three, and None is a dash.
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
