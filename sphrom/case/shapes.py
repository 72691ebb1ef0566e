"""The shapes of solids in a case file, and the polygons that they mean.

A shape is one of circle, rectangle, polygon, file, wkt, union, intersection, difference or buffer;
it may be scaled about the origin, turned about its centroid and moved, in this order.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
from pydantic import Field, ValidationInfo, model_validator
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from sphrom.case.fields import LARGEST, Coordinate, Number, Positive, Section, key

MOST_BYTES = 4 * 1024 * 1024
"""The largest file of an outline that is read."""
MOST_CORNERS = 20_000
"""Corners of an outline; more are finer than any particles."""
QUADRANT_CORNERS = 64
"""Corners of a rounded corner of a right angle."""

MOST_BRACKETS = 8
"""Brackets within each other in well-known text; several polygons with holes have three."""

Point = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=2)]


class CircleSection(Section):
    """A circle."""

    centre: Point = key(..., "its centre", unit="m")
    radius: Positive = key(..., "its radius", unit="m")


class RectangleSection(Section):
    """A rectangle along the axes."""

    lower: Point = key(..., "its lower left corner", unit="m")
    upper: Point = key(..., "its upper right corner", unit="m")


class BufferSection(Section):
    """A shape that is grown, or shrunk by a negative distance; corners are rounded."""

    shape: ShapeSection = key(..., "the shape")
    distance: Coordinate = key(..., "how far it grows", unit="m")


class ShapeSection(Section):
    """A shape: exactly one kind, and how it is scaled, turned and moved."""

    circle: CircleSection | None = key(None, "a circle")
    rectangle: RectangleSection | None = key(None, "a rectangle along the axes")
    polygon: Annotated[tuple[Point, ...], Field(min_length=3)] | None = key(
        None, "corners in their order; the last is joined to the first", unit="m"
    )
    file: str | None = key(
        None, "a file with polygons: GeoJSON, WKT or DXF, by how its name ends; read into wkt"
    )
    wkt: str | None = key(None, "polygons as well-known text")
    union: Annotated[tuple[ShapeSection, ...], Field(min_length=1)] | None = key(
        None, "shapes taken together"
    )
    intersection: Annotated[tuple[ShapeSection, ...], Field(min_length=1)] | None = key(
        None, "what shapes share"
    )
    difference: Annotated[tuple[ShapeSection, ...], Field(min_length=1)] | None = key(
        None, "the first shape without the others"
    )
    buffer: BufferSection | None = key(None, "a shape that is grown or shrunk")
    scale: Positive = key(1.0, "factor on all coordinates, such as 1e-3 from millimetres")
    rotate: Annotated[Number, Field(ge=-360.0, le=360.0)] = key(
        0.0, "angle about the centroid, anticlockwise", unit="deg"
    )
    translate: Point = key((0.0, 0.0), "how far it is moved", unit="m")

    @model_validator(mode="before")
    @classmethod
    def _with_outline(cls, values: Any, info: ValidationInfo) -> Any:
        """Read the outline of a file, so that the case says what it held."""
        name = values.get("file") if isinstance(values, dict) else None
        if not isinstance(name, str) or values.get("wkt") is not None:
            return values
        folder = (info.context or {}).get("folder", Path())
        return {**values, "wkt": read_outline(Path(folder) / name).wkt}

    @model_validator(mode="after")
    def _one_kind(self) -> ShapeSection:
        given = [name for name in _BUILDERS if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise ValueError(f"must be exactly one of {', '.join(_BUILDERS)}; got {found}")
        return self

    def geometry(self) -> BaseGeometry:
        """Return the polygon, or polygons, of the shape [m].

        Raises
        ------
        ValueError
            When it is empty, crosses itself, or is no area.
        """
        (build,) = (build for name, build in _BUILDERS.items() if getattr(self, name) is not None)
        try:
            shape = build(self)
        except shapely.errors.ShapelyError as error:
            raise ValueError(f"is no polygon: {error}") from error
        shape = affinity.scale(checked(shape), self.scale, self.scale, origin=(0.0, 0.0))
        shape = affinity.rotate(shape, self.rotate, origin="centroid")
        shape = affinity.translate(shape, self.translate[0], self.translate[1])
        return checked(shape)


def checked(shape: BaseGeometry) -> BaseGeometry:
    """Return a shape that is one or more polygons.

    Raises ValueError when it is empty, crosses itself, is no area, or lies beyond all numbers.
    """
    if not np.all(np.abs(shapely.get_coordinates(shape)) <= LARGEST):  # NaN isn't either
        raise ValueError(f"a coordinate must be a number from -{LARGEST:g} to {LARGEST:g}")
    if shape.is_empty:
        raise ValueError("the shape is empty")
    if shape.has_z:
        raise ValueError("the shape has a third coordinate; give x and y only")
    if shape.geom_type not in ("Polygon", "MultiPolygon"):
        raise ValueError(f"the shape must be a polygon, or several; got a {shape.geom_type}")
    if not shape.is_valid:
        raise ValueError(f"the outline is not valid: {shapely.is_valid_reason(shape)}")
    if not shape.area > 0.0:
        raise ValueError("the shape has no area")
    if (corners := shapely.get_num_coordinates(shape)) > MOST_CORNERS:
        raise ValueError(f"an outline of {corners} corners; at most {MOST_CORNERS}: simplify it")
    return shape


def _circle(section: ShapeSection) -> BaseGeometry:
    circle = section.circle
    assert circle is not None
    # It loads the kernels that other scenes' fast runs don't need.
    from sphrom.sph.polygons import disc

    return disc((circle.centre[0], circle.centre[1]), circle.radius)


def _rectangle(section: ShapeSection) -> BaseGeometry:
    rectangle = section.rectangle
    assert rectangle is not None
    if not all(low < high for low, high in zip(rectangle.lower, rectangle.upper, strict=True)):
        raise ValueError("upper must be above lower along both axes")
    return shapely.box(*rectangle.lower, *rectangle.upper)


def _together(combine: Callable[[list[BaseGeometry]], BaseGeometry], name: str) -> Any:
    def build(section: ShapeSection) -> BaseGeometry:
        return combine([shape.geometry() for shape in getattr(section, name)])

    return build


def _difference(shapes: list[BaseGeometry]) -> BaseGeometry:
    return shapely.difference(shapes[0], shapely.union_all(shapes[1:]))


def _buffer(section: ShapeSection) -> BaseGeometry:
    buffer = section.buffer
    assert buffer is not None
    return shapely.buffer(buffer.shape.geometry(), buffer.distance, quad_segs=QUADRANT_CORNERS)


_BUILDERS: dict[str, Callable[[ShapeSection], BaseGeometry]] = {
    "circle": _circle,
    "rectangle": _rectangle,
    "polygon": lambda section: shapely.Polygon(section.polygon),
    "wkt": lambda section: _parsed(section.wkt or ""),
    "union": _together(shapely.union_all, "union"),
    "intersection": _together(shapely.intersection_all, "intersection"),
    "difference": _together(_difference, "difference"),
    "buffer": _buffer,
}


def read_outline(path: Path) -> BaseGeometry:
    """Read polygons from a file.

    Raises
    ------
    ValueError
        When it can't be read, is too large, or holds anything but polygons.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path.name}: must end in {', '.join(_READERS)}")
    try:
        size = path.stat().st_size
        if path.exists() and not path.is_file():
            raise ValueError("is not a file")
        if size > MOST_BYTES:
            most = MOST_BYTES // 1024**2
            raise ValueError(f"has {size / 1e6:.3g} MB; at most {most} MiB are read")
        return checked(reader(path))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: can't be read: {error}") from error
    except (shapely.errors.ShapelyError, RecursionError, LookupError) as error:
        raise ValueError(f"{path.name}: holds no polygon: {error}") from error
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path.name}: {error}") from error


def _geojson(path: Path) -> BaseGeometry:
    geometries = list(_geometries(json.loads(path.read_text(encoding="utf-8-sig"))))
    return shapely.union_all(geometries) if len(geometries) > 1 else geometries[0]


def _geometries(document: Any) -> Iterator[BaseGeometry]:
    """Yield the geometries of a GeoJSON document, which may be a feature or several."""
    kind = document.get("type") if isinstance(document, dict) else None
    if kind == "FeatureCollection":
        if not document["features"]:
            raise ValueError("it holds no feature")
        for feature in document["features"]:
            yield from _geometries(feature)
    elif kind == "Feature":
        yield from _geometries(document["geometry"])
    elif kind in ("Polygon", "MultiPolygon"):
        try:
            shape = shapely.geometry.shape(document)
        except (TypeError, ValueError, LookupError, ArithmeticError) as error:
            raise ValueError("holds no polygon: give rings of points [x, y]") from error
        yield checked(shape)
    else:
        raise ValueError(f"must hold polygons; got {kind}")


def _wkt(path: Path) -> BaseGeometry:
    return _parsed(path.read_text(encoding="utf-8-sig"))


def _parsed(text: str) -> BaseGeometry:
    """Return the geometry of well-known text.

    Raises ValueError when it is of no kind that is known, or so deep that to parse it could crash.
    """
    depth = np.cumsum([(letter == "(") - (letter == ")") for letter in text])
    if depth.max(initial=0) > MOST_BRACKETS:
        raise ValueError(f"has more than {MOST_BRACKETS} brackets within each other")
    try:
        with np.errstate(all="ignore"):
            return shapely.from_wkt(text)
    except NotImplementedError as error:
        raise ValueError(f"is no polygon with straight sides: {error}") from error


def _dxf(path: Path) -> BaseGeometry:
    """Read the closed polylines and circles of a drawing."""
    try:
        import ezdxf
    except ImportError as error:
        raise ValueError("DXF needs ezdxf: `pip install 'sphrom[dxf]'`") from error
    try:
        drawing: Any = ezdxf.readfile(path)
    except ezdxf.DXFError as error:
        raise ValueError(f"is no DXF drawing: {error}") from error
    shapes = []
    for entity in drawing.modelspace():
        if entity.dxftype() == "CIRCLE":
            shapes.append(shapely.Point(*entity.dxf.center.vec2).buffer(entity.dxf.radius, 64))
        elif entity.dxftype() in ("LWPOLYLINE", "POLYLINE"):
            if not entity.is_closed:
                raise ValueError(f"a polyline that is open (handle {entity.dxf.handle})")
            from ezdxf.path import make_path

            line = make_path(entity).flattening(1e-3)
            shapes.append(checked(shapely.Polygon([(point.x, point.y) for point in line])))
    if not shapes:
        raise ValueError("it holds no closed polyline and no circle")
    return shapely.union_all(shapes)


_READERS = {".geojson": _geojson, ".json": _geojson, ".wkt": _wkt, ".dxf": _dxf}
