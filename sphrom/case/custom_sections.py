"""The sections of a custom scene, and which of its constants can vary.

Walls and the force have to be affine in what varies: operators are projected once for all values,
and each parameter that drives the flow has a part of its own, which its value multiplies.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, model_validator

from sphrom.case.fields import LARGEST, Coordinate, Section, key
from sphrom.case.shapes import Point
from sphrom.errors import CaseError
from sphrom.expressions import MOST_QUOTED, Expression
from sphrom.text import shortened, visible
from sphrom.whole_files import read_whole

if TYPE_CHECKING:
    from sphrom.scenes.scattered_fields import ScatteredFields

Value = Coordinate | Annotated[str, Field(max_length=1000)]
"""A number, or an expression."""
Vector = Annotated[tuple[Value, ...], Field(min_length=2, max_length=2)]


class BoxSection(Section):
    """The box that the flow is in."""

    lower: Point = key((0.0, 0.0), "its lower left corner", unit="m")
    upper: Point = key((1.0, 1.0), "its upper right corner", unit="m")
    periodic: tuple[Literal["x", "y"], ...] = key((), "axes along which the flow repeats")


class MovingWallSection(Section):
    """How a wall slides along itself."""

    velocity: Vector | None = key(None, "its velocity, numbers or expressions in x, y", unit="m/s")
    rotation: Coordinate | None = key(
        None, "its rate of rotation about its centroid, anticlockwise", unit="rad/s"
    )


class InitialSection(Section):
    """The fields that a run starts with: numbers or expressions in x, y, or a file of points."""

    u: Value = key(0.0, "velocity along x", unit="m/s")
    v: Value = key(0.0, "velocity along y", unit="m/s")
    p: Value = key(0.0, "pressure", unit="Pa")
    file: str | None = key(
        None,
        "a CSV file with columns x, y, u, v and perhaps p, in place of expressions; linear between "
        "its points, the nearest one's values beyond",
    )
    sha256: str | None = key(None, "digest of that file; taken from it unless it is given")
    _fields: Any = PrivateAttr(None)

    _folder: Path = PrivateAttr(Path())

    @model_validator(mode="before")
    @classmethod
    def _with_digest(cls, values: Any, info: ValidationInfo) -> Any:
        """Read the file, and take its digest, so that the case says what it held."""
        name = values.get("file") if isinstance(values, dict) else None
        # A case that an artifact holds is read without its files; it starts no run.
        if not isinstance(name, str) or values.get("sha256") is not None:
            return values
        return {**values, "sha256": _read_fields(_folder(info) / name)}

    @model_validator(mode="after")
    def _file_alone(self, info: ValidationInfo) -> InitialSection:
        if self.file is not None:
            if any(value != 0.0 for value in (self.u, self.v, self.p)):
                raise ValueError("file takes the place of u, v and p; give one or the other")
            self._folder = _folder(info)
        return self

    @property
    def fields(self) -> ScatteredFields:
        """The fields of the file. Raises CaseError when it is gone, or holds something else."""
        name, digest = str(self.file), str(self.sha256)
        try:
            if digest not in _KNOWN_FIELDS and _read_fields(self._folder / name) != digest:
                raise ValueError(f"{name} has changed since the case was read")
        except ValueError as error:
            raise CaseError(f"scene.initial.file: {error}") from error
        return _KNOWN_FIELDS[digest]


_KNOWN_FIELDS: dict[str, ScatteredFields] = {}
"""Fields of files that were read, by their digests: copies of a case need not read them again."""


def _folder(info: ValidationInfo) -> Path:
    """Return the folder of the case file, if it is known."""
    return Path((info.context or {}).get("folder", Path()))


class DrivingExpression(NamedTuple):
    """An expression that drives the flow, as far as it varies in space."""

    where: str
    """Its key in the scene."""
    factor: str
    """The parameter that multiplies it; empty where none does."""
    expression: Expression


def parameter_problems(
    names: Collection[str],
    constants: Collection[str],
    others: Collection[str],
    drives: Sequence[DrivingExpression],
) -> Iterator[tuple[str, str]]:
    """Yield those of some parameters that can't vary, and why.

    `others` are names of parameters that aren't constants.
    """
    varied = [name for name in names if name in constants]
    for name in varied:
        if name in others:
            yield name, "is a constant's name and a wall's or the force's; rename the constant"
    for where, factor, expression in drives:
        found = [one for one in varied if expression.degree_in([one]) > 0.0]
        degree = expression.degree_in(varied) + (factor in names)
        if found and degree > 1.0 and factor in names:
            yield found[0], f"multiplies {factor}, which varies too, in {where}; vary one of them"
        elif degree > 1.0:
            together = "" if len(found) == 1 else f", together with {', '.join(found[1:])}"
            yield (
                found[0],
                f"{where} must be a constant part plus {found[0]} times another{together}, for "
                "operators are projected once for all values; got "
                f"'{shortened(expression.text, MOST_QUOTED)}'",
            )


def driving(
    names: Collection[str], walls: Collection[str], drives: Sequence[DrivingExpression]
) -> tuple[str, ...]:
    """Return those of some parameters that walls' velocities or the force's field depend on."""

    def drives_flow(name: str) -> bool:
        return name in walls or any(each.expression.degree_in([name]) > 0.0 for each in drives)

    return tuple(name for name in names if drives_flow(name))


MOST_BYTES = 16 * 1024 * 1024
"""The largest file that is read."""
LEAST_POINTS, MOST_POINTS = 3, 200_000
"""Of one file; to join them takes seconds."""
COLUMNS = ("x", "y", "u", "v")
PRESSURE = "p"


def _read_fields(path: Path) -> str:
    """Read fields at points, keep them, and return the SHA-256 of their file.

    Raises ValueError when the file can't be read or is too large, lacks a column, or holds too few
    points, a point twice, or anything but numbers.
    """
    from sphrom.scenes.scattered_fields import ScatteredFields  # few cases need it

    content = content_of(path)
    try:
        values = _points(content.decode("utf-8-sig"))
        fields = ScatteredFields(values[:, :2], values[:, 2:])
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name}: is not UTF-8 text") from error
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{visible(path.name)}: {shortened(str(error))}") from error
    digest = hashlib.sha256(content).hexdigest()
    _KNOWN_FIELDS[digest] = fields
    return digest


def content_of(path: Path) -> bytes:
    """Return what a file holds. Raises ValueError when it can't be read or is too large."""
    try:
        return read_whole(path, MOST_BYTES)
    except OSError as error:
        raise ValueError(f"{visible(str(path))}: can't be read: {error.strerror}") from error
    except ValueError as error:
        raise ValueError(f"{visible(str(path))}: {error}") from error


def _points(text: str) -> np.ndarray:
    """Return x, y, u, v and p of each point (n_points, 5)."""
    rows = [line for line in text.splitlines() if line.strip()]
    names = [name.strip() for name in next(csv.reader(rows), [])]
    if missing := [name for name in COLUMNS if names.count(name) != 1]:
        raise ValueError(
            f"its first line must name the columns x, y, u, v and perhaps p, once each; see "
            f"{', '.join(missing)}"
        )
    if not LEAST_POINTS <= len(rows) - 1 <= MOST_POINTS:
        raise ValueError(f"must hold {LEAST_POINTS} to {MOST_POINTS} points; got {len(rows) - 1}")
    columns = [names.index(name) for name in (*COLUMNS, PRESSURE) if name in names]
    values = np.loadtxt(rows, delimiter=",", usecols=columns, ndmin=2, skiprows=1, comments=None)
    values = np.pad(values, ((0, 0), (0, 5 - len(columns))))
    if not np.all(np.abs(values) <= LARGEST):  # NaN isn't either
        raise ValueError(f"values must be numbers up to {LARGEST:g}")
    unique, counts = np.unique(values[:, :2], axis=0, return_counts=True)
    if (counts > 1).any():
        x, y = unique[counts > 1][0]
        raise ValueError(f"the point ({x:g}, {y:g}) m appears twice")
    return values
