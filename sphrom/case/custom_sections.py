"""Sections of the scene of kind custom: inflows, free surfaces, histories and initial fields."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import shapely
from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.case.expressions import Expression
from sphrom.case.fields import (
    LARGEST,
    SMALLEST,
    Coordinate,
    Duration,
    Place,
    Positive,
    Section,
    key,
    only_one,
)
from sphrom.case.shapes import CircleSection, RectangleSection, ShapeSection
from sphrom.errors import CaseError
from sphrom.scenes.flows import BodyForce
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import ROUNDING, Rates, Strip
from sphrom.text import shortened, table_rows, visible
from sphrom.whole_files import read_whole

Value = Coordinate | Annotated[str, Field(max_length=1000)]
"""A number, or an expression."""
Rate = Duration | Annotated[str, Field(max_length=1000)]
"""A non-negative number, or an expression."""
Table = TypeVar("Table")
NO_FLOW = 1e-6
"""Least mean speed of an inflow along the axis, over the largest speed."""


def _without_tables(value: Any) -> Any:
    """Refuse mappings, which are meant as tables."""
    if any(isinstance(part, Mapping) for part in (value if isinstance(value, list) else [value])):
        raise ValueError(
            "must be a list of 2 numbers or expressions; for a table, set scene.histories to "
            "{sway: {file: sway.csv}}, and write sway(t) in an expression"
        )
    return value


Vector = Annotated[
    tuple[Value, ...], Field(min_length=2, max_length=2), BeforeValidator(_without_tables)
]


class PorousSection(ShapeSection):
    """A porous body: fluid flows through its shape against Darcy's resistance nu/k."""

    permeability: Positive = key(..., "permeability k", unit="m2")


class StripSection(Section):
    """The place of a strip across the box along its periodic axis."""

    # `from` is a keyword of Python.
    model_config = ConfigDict(serialize_by_alias=True)

    start: Coordinate = key(..., "start of the strip", unit="m", alias="from")
    end: Coordinate = key(..., "end of the strip", unit="m", alias="to")


class InflowSection(Section):
    """An inflow: in a strip across a periodic box, the flow is forced to a given velocity."""

    strip: StripSection = key(..., "the strip, on the periodic axis along which the fluid flows")
    velocity: Vector = key(
        ...,
        "velocity of the fluid that leaves the strip, numbers or expressions in x, y, t",
        unit="m/s",
    )
    strength: Positive = key(
        200.0,
        "K, the integral of the rate of forcing over the strip, divided by the largest speed",
        unit="-",
    )
    ramp: Duration | None = key(
        None,
        "time in which the inflow reaches its speed; null means the length of the box over the "
        "largest speed, or 0 for runs that start with a velocity",
        unit="s",
    )

    def samples(self, domain: Domain, axis: int, number: int) -> Array:
        """Return points (n_points, 2) [m] of the fluid in the strip, on its edges too.

        Points on a solid that only touches the strip, such as one that ends at the edge of the box,
        do not count: there is no fluid of the strip beside them.
        """
        lower, upper = np.array(domain.lower), np.array(domain.upper)
        lower[axis] = self.strip.start
        upper[axis] = self.strip.end
        axes = [np.linspace(low, high, number) for low, high in zip(lower, upper, strict=True)]
        points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        if domain.fills_box:
            return points
        parts = shapely.get_parts(shapely.intersection(domain.fluid, shapely.box(*lower, *upper)))
        fluid = shapely.union_all(parts[shapely.area(parts) > 0.0])
        shapely.prepare(fluid)
        return points[shapely.intersects_xy(fluid, *points.T)]

    def strip_in(
        self, domain: Domain, number: int, velocities: Sequence[Callable[[Array], Array]]
    ) -> Strip:
        """Return the strip in a domain, with the largest speed of all velocities.

        Parameters
        ----------
        number : number of samples along each edge of the strip.
        velocities : of all runs, each (2, n_samples) [m/s] at positions (2, n_samples) [m].

        Raises ValueError unless the strip is part of the box and fluid flows through it.
        """
        start, end, inflows = self.strip.start, self.strip.end, dict[int, Array]()
        for axis in np.flatnonzero(domain.periodic).tolist():
            within = domain.lower[axis] <= start < end <= domain.upper[axis]
            if not within or end - start >= domain.lengths[axis]:
                continue
            places = self.samples(domain, axis, number)
            if len(places):
                fields = [velocity(places.T) for velocity in velocities]
                inflows[axis] = max(fields, key=lambda field: np.linalg.norm(field, axis=0).max())
        if not inflows:
            raise ValueError(
                "inflow.strip: must be part of the box, with `from` below `to`, on an axis that "
                "box.periodic names; fluid that leaves the box enters the strip"
            )
        means = {axis: float(inflow[axis].mean()) for axis, inflow in inflows.items()}
        axis = max(means, key=lambda each: abs(means[each]))
        speed = float(np.linalg.norm(inflows[axis], axis=0).max())
        if not SMALLEST <= speed <= LARGEST:
            raise ValueError(
                f"inflow.velocity: its largest speed must be {SMALLEST:g} to {LARGEST:g} m/s; got "
                f"{speed:g} m/s"
            )
        if not abs(means[axis]) > NO_FLOW * speed:
            raise ValueError("inflow.velocity: must have a mean along the periodic axis of the box")
        return Strip(axis, start, end, math.copysign(speed, means[axis]), self.strength)


def ramp_share(ramp: float, time: Array | float) -> Array | float:
    """Return the share of its speed that an inflow has reached at times [s], half a cosine."""
    if ramp == 0.0:
        return 1.0
    return 0.5 - 0.5 * np.cos(math.pi * np.clip(np.divide(time, ramp), 0.0, 1.0))


def inverse_permeability(bodies: Iterable[tuple[PorousSection, BaseGeometry]]) -> Rates | None:
    """Return a function for 1/k [1/m2] at positions (2, n_positions) [m]; None without bodies.

    It is zero outside of porous bodies.
    """
    inverses = [(shape, 1.0 / body.permeability) for body, shape in bodies]
    shapely.prepare([shape for shape, _ in inverses])

    def at(position: Array) -> Array:
        return sum(inverse * shapely.contains_xy(shape, *position) for shape, inverse in inverses)

    return at if inverses else None


def surface_defaults(slip_along_axes: bool) -> dict[str, Any]:
    """Return defaults of other sections for scenes with a free surface.

    A lattice under pressure resists shear like a solid, because the kernel's sums are inexact on a
    strained lattice: at h = 2 dx waves are 0.6 % too fast. Only viscous forces along pairs are
    consistent at the surface (Colagrossi et al., Phys. Rev. E 84, 2011). Walls that return the flux
    into them turn fluid that slides past their ghosts into noise. Other walls need a damper; it is
    weak, because sums over an incomplete support have a divergence at the surface.

    Parameters
    ----------
    slip_along_axes : whether fluid slips freely along all walls, and all follow the axes.
    """
    return {
        "discretization": {
            "smoothing_length_ratio": 2.5,
            "acoustic_damping": 0.1,
            "fixed_volume": False,
            "viscosity": "paper",
            "shifting": {"enabled": False},
            "walls": {"continuity": "normal" if slip_along_axes else "adjoint"},
        }
    }


SHAPES = "level", "circle", "rectangle", "polygon"
"""The keys for the shape of the fluid; a case has exactly one."""


class SurfaceFluidSection(Section):
    """Fluid that fills part of the box, below a level or within a shape."""

    level: Value | None = key(
        None, "height y of the surface at rest, a number or an expression of constants", unit="m"
    )
    circle: CircleSection | None = key(None, "a circle that fluid fills")
    rectangle: RectangleSection | None = key(None, "a rectangle along the axes that fluid fills")
    polygon: Annotated[tuple[Place, ...], Field(min_length=3)] | None = key(
        None, "corners of a polygon that fluid fills, in order", unit="m"
    )
    gravity: Duration = key(9.81, "acceleration along -y", unit="m/s2")

    @model_validator(mode="after")
    def _one_kind(self) -> SurfaceFluidSection:
        only_one(self, SHAPES)
        return self

    def geometry(self) -> BaseGeometry:
        """Return the polygon of a shape [m]. Raises ValueError if it is not a polygon."""
        kind = only_one(self, SHAPES)
        return ShapeSection.model_validate({kind: getattr(self, kind)}).geometry()

    def fill(self, domain: Domain, particle_spacing: float, level: float) -> Array:
        """Return the points (n_particles, 2) [m] of the domain's lattice in the fluid.

        Parameters
        ----------
        level : height of the surface at rest [m]; not used for a shape.
        """
        points = domain.fill(particle_spacing)
        if self.level is not None:
            filled = points[points[:, 1] < level]
            if domain.fills_box:
                return filled
            # Beside solids a lattice may not end at the level, or not along the sides.
            below, ends = domain.below(level), domain.row_end(level, particle_spacing) == level
            right = ends and len(filled) == below.n_particles(particle_spacing)
            return filled if right else below.fill(particle_spacing)
        return points[shapely.contains_xy(self.geometry(), *points.T)]


@dataclass(frozen=True)
class SurfaceForce(BodyForce):
    """Gravity and a body force whose components may change differently with time.

    `field` is its value at the start, and `amplitude` is one.
    """

    parts: tuple[Expression, ...] = ()
    """Components of the body force, in x, y and t."""
    gravity: float = 0.0
    """Acceleration along -y [m/s2]."""

    @classmethod
    def of(cls, parts: tuple[Expression, ...], gravity: float) -> SurfaceForce:
        """Return the acceleration by the components of a body force and by gravity [m/s2]."""
        force = cls(lambda at: force(at, 0.0), lambda time: 1.0, None, True, parts, gravity)
        return force

    def over(self, times: Array) -> Array:
        return self.uniform(times)

    def uniform(self, times: Array) -> Array:
        """Return a uniform body force at times (2, n_times) [m/s2], without gravity."""
        values = [part(x=0.0, y=0.0, t=times) for part in self.parts]
        return np.stack([np.broadcast_to(one, times.shape) for one in values])

    def __call__(self, position: Array, time: float) -> Array:
        out = np.empty_like(position)
        for row, part in zip(out, self.parts, strict=True):
            row[:] = part(x=position[0], y=position[1], t=time)
        out[1] -= self.gravity
        return out


def hydrostatic(
    start: Callable[[Array], Array], level: float, weight: float
) -> Callable[[Array], Array]:
    """Return initial conditions with the hydrostatic pressure below a level [m] added.

    Parameters
    ----------
    start : returns velocity and pressure (n_points, 3) at positions (n_points, 2) [m].
    weight : density times gravity [N/m3].
    """

    def at(position: Array) -> Array:
        fields = start(position)
        fields[:, 2] += weight * (level - position[:, 1])
        return fields

    return at


MOST_BYTES = 16 * 1024 * 1024
"""Largest size of a table [bytes]."""
FAR_BEYOND = 0.25
"""Share of a history's duration beyond which it has no values."""


def with_digest(values: Any, info: ValidationInfo, read: Callable[[Path], str]) -> Any:
    """Return the keys of a section with the digest of its file, so that it identifies the content.

    `read` reads a file and returns its digest. Raises ValueError when the file has changed.
    """
    name = values.get("file") if isinstance(values, dict) else None
    folder = (info.context or {}).get("folder")
    # The case in an artifact is read without its files, and does not start runs.
    if not isinstance(name, str) or (folder is None and values.get("sha256") is not None):
        return values
    digest = read(Path(folder or "") / name)
    if values.get("sha256") not in (None, digest):
        raise ValueError(f"{visible(name)} has changed since its sha256 was taken")
    return {**values, "sha256": digest}


class HistorySection(Section):
    """A measured history: a column of a table over time, linear between rows."""

    file: str = key(..., "a CSV file: the names of its columns, then one row for each time")
    time: str | None = key(None, "column of the times in seconds; null is the first column")
    value: str | None = key(None, "column of the values; null is the other one of two columns")
    scale: Coordinate = key(1.0, "factor of the values, such as 9.81 for accelerations in g")
    sha256: str | None = key(None, "digest of that file; computed if it is missing")

    @model_validator(mode="before")
    @classmethod
    def _with_digest(cls, values: Any, info: ValidationInfo) -> Any:
        given = values if isinstance(values, dict) else {}
        columns = (given.get(name) for name in ("time", "value"))
        time, value = (name if isinstance(name, str) else None for name in columns)
        return with_digest(values, info, lambda path: read_history(path, time, value))

    @property
    def rows(self) -> Array:
        """Times [s] and values (2, n_rows + 2), with a row before the first and after the last.

        The last step of a fast model may end beyond the last snapshot, and its table.

        Raises CaseError when the file is missing or has changed.
        """
        table = self.sha256, self.time, self.value
        try:
            if table not in _HISTORIES and read_history(Path(self.file), *table[1:]) != table[0]:
                raise ValueError(f"{visible(self.file)} has changed since the case was read")
        except ValueError as error:
            raise CaseError(f"scene.histories: {error}") from error
        return _HISTORIES[table]

    def lacks(self, times: Array, tolerated: float = ROUNDING) -> str | None:
        """Return a problem if times [s] are beyond the table by a share of its duration."""
        first, last = self.rows[0, [1, -2]]
        margin = tolerated * (last - first)
        for time in (times.min(), times.max()):
            if not first - margin <= time <= last + margin:
                name = visible(self.file)
                return f"{name} has times from {first:g} to {last:g} s, but {time:g} s is needed"
        return None

    def __call__(self, time: Array) -> Array:
        """Return the values at times [s]. Raises CaseError far beyond the table."""
        if (problem := self.lacks(time, FAR_BEYOND)) is not None:
            raise CaseError(f"scene.histories: {problem}")
        return self.scale * np.interp(time, *self.rows)


_HISTORIES: dict[tuple[str | None, ...], Array] = {}
"""A cache of tables by the digests of their files and the names of the columns."""


def read_history(path: Path, time: str | None, value: str | None) -> str:
    """Read two columns of a table over time, cache them, and return the SHA-256 of the file.

    Raises ValueError where the file can't be read, or is not such a table.
    """

    def parsed(text: str) -> Array:
        names, lines = _table(text)
        others = [name for name in names if name != (time or names[0])]
        chosen = time or names[0], value or (others[0] if len(others) == 1 else "")
        if chosen[0] == chosen[1] or not names.count(chosen[0]) == names.count(chosen[1]) == 1:
            raise ValueError(
                "its first line must name a column of times and one of values, which the keys "
                f"`time` and `value` choose; it names {', '.join(names)}"
            )
        rows = _numbers(lines, [names.index(name) for name in chosen]).T
        if rows.shape[1] < 2:
            raise ValueError("must hold two rows or more")
        for late in np.flatnonzero(np.diff(rows[0]) <= 0.0):
            before, after = rows[0, late : late + 2]
            raise ValueError(f"times must increase from row to row; {after:g} follows {before:g}")
        ends = 2.0 * rows[:, [0, -1]] - rows[:, [1, -2]]
        return np.concatenate((ends[:, :1], rows, ends[:, 1:]), axis=1)

    digest, rows = _read_table(path, parsed)
    _HISTORIES[digest, time, value] = rows
    return digest


COLUMNS = ("x", "y", "u", "v", "p")
"""The columns of a file; the last is optional."""
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

    def parsed(text: str) -> Callable[[Array], Array]:
        points = _points(text)
        try:
            between = LinearNDInterpolator(points[:, :2], points[:, 2:])
        except QhullError as error:
            raise ValueError("all points lie on one line") from error
        nearest = NearestNDInterpolator(points[:, :2], points[:, 2:])

        def fields(position: Array) -> Array:
            values = np.asarray(between(position))
            beyond = np.isnan(values).any(axis=1)
            values[beyond] = nearest(position[beyond])
            return values

        return fields

    digest, fields = _read_table(path, parsed)
    _FIELDS[digest] = fields
    return digest


def _read_table(path: Path, parsed: Callable[[str], Table]) -> tuple[str, Table]:
    """Return the SHA-256 of a file, and the table that a function parses from its text.

    Raises ValueError, with the file's name.
    """
    name = visible(path.name)
    try:
        content = read_whole(path, MOST_BYTES)
        return hashlib.sha256(content).hexdigest(), parsed(content.decode("utf-8-sig"))
    except OSError as error:
        raise ValueError(f"{visible(str(path))}: can't be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: is not UTF-8 text") from error
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{name}: {shortened(str(error))}") from error


def _table(text: str) -> tuple[list[str], list[list[str]]]:
    """Return the names of the columns of a table, and the cells of its rows."""
    (_, names), *rows = table_rows(text) or [(0, [""])]
    return names, [cells for _, cells in rows]


def _numbers(rows: list[list[str]], columns: list[int]) -> Array:
    """Return some columns (n_rows, n_columns) of a table. Raises ValueError."""
    cells = [[row[column] for column in columns] for row in rows]
    values = np.array(cells, dtype=np.float64).reshape(-1, len(columns))
    if not np.all(np.abs(values) <= LARGEST):  # also refuses NaN
        raise ValueError(f"values must be numbers up to {LARGEST:g}")
    return values


def _points(text: str) -> Array:
    """Return x, y, u, v and p of each point (n_points, 5)."""
    names, rows = _table(text)
    if any(names.count(name) != 1 for name in COLUMNS[:4]):
        raise ValueError("its first line must name the columns x, y, u, v and perhaps p, once each")
    if not 3 <= len(rows) <= MOST_POINTS:
        raise ValueError(f"must hold 3 to {MOST_POINTS} points; got {len(rows)}")
    columns = [names.index(name) for name in COLUMNS if name in names]
    values = np.pad(_numbers(rows, columns), ((0, 0), (0, 5 - len(columns))))
    if len(np.unique(values[:, :2], axis=0)) < len(values):
        raise ValueError("a point appears twice")
    return values
