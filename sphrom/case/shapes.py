"""The shapes of solids in a case file, and the polygons that they mean.

A shape is one of circle, rectangle, polygon, file, wkt, union, intersection, difference or buffer;
it may be scaled about the origin, turned about its centroid and moved, in this order.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationInfo, model_validator
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from sphrom.case.fields import LARGEST, Coordinate, Number, Positive, Section, key
from sphrom.text import shortened, visible
from sphrom.whole_files import read_whole

Array = NDArray[np.float64]

MOST_BYTES = 4 * 1024 * 1024
"""The largest file of an outline that is read."""
MOST_CORNERS = 20_000
"""Corners of an outline; more are finer than any particles."""
QUADRANT_CORNERS = 64
"""Corners of a rounded corner of a right angle."""
FLATNESS = 1e-5
"""How far the corners of a round polyline may be off it, over its size."""
MOST_ENTITIES, MOST_TAGS = 20_000, 200_000
"""Of a drawing, with all its tables and blocks; its parser takes seconds for so many."""
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
    if (corners := shapely.get_num_coordinates(shape)) > MOST_CORNERS:
        raise ValueError(f"an outline of {corners} corners; at most {MOST_CORNERS}: simplify it")
    _require_numbers(shapely.get_coordinates(shape))
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
    return shape


def _require_numbers(coordinates: ArrayLike) -> None:
    if not np.all(np.abs(coordinates) <= LARGEST):  # NaN isn't either
        raise ValueError(f"a coordinate must be a number from -{LARGEST:g} to {LARGEST:g}")


def _combinable(shapes: Iterable[BaseGeometry]) -> list[BaseGeometry]:
    """Return shapes that are combined within seconds. Raises ValueError where they are not."""
    # It loads the kernels that other scenes' fast runs don't need.
    from sphrom.sph.polygons import require_few_crossings

    found, corners = list[BaseGeometry](), 0
    for shape in shapes:
        found.append(shape)
        corners += shapely.get_num_coordinates(shape)
        if corners > MOST_CORNERS:
            raise ValueError(f"shapes of more than {MOST_CORNERS} corners together: simplify them")
    require_few_crossings(found)
    return found


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
        return combine(_combinable(shape.geometry() for shape in getattr(section, name)))

    return build


def _buffer(section: ShapeSection) -> BaseGeometry:
    buffer = section.buffer
    assert buffer is not None
    shape = buffer.shape.geometry()
    if (corners := _rounding_corners(shape, buffer.distance)) > MOST_CORNERS:
        raise ValueError(f"its rounded corners have {corners:.0f} corners: simplify it")
    return shapely.buffer(shape, buffer.distance, quad_segs=QUADRANT_CORNERS)


def _rounding_corners(shape: BaseGeometry, distance: float) -> float:
    """Return the number of corners that a shape gets where its own are rounded."""
    turned = 0.0
    for ring in shapely.get_rings(shapely.orient_polygons(shapely.get_parts(shape))):
        side = np.diff(shapely.get_coordinates(ring), axis=0)
        angle = np.arctan2(side[:, 1], side[:, 0])
        turn = (np.diff(angle, append=angle[0]) + math.pi) % (2.0 * math.pi) - math.pi
        turned += np.sum(np.maximum(turn if distance > 0.0 else -turn, 0.0))
    return QUADRANT_CORNERS * turned / (0.5 * math.pi)


_BUILDERS: dict[str, Callable[[ShapeSection], BaseGeometry]] = {
    "circle": _circle,
    "rectangle": _rectangle,
    "polygon": lambda section: shapely.Polygon(section.polygon),
    "wkt": lambda section: _parsed(section.wkt or ""),
    "union": _together(shapely.union_all, "union"),
    "intersection": _together(shapely.intersection_all, "intersection"),
    "difference": _together(
        lambda shapes: shapely.difference(shapes[0], shapely.union_all(shapes[1:])), "difference"
    ),
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
        content = read_whole(path, MOST_BYTES)
        with np.errstate(all="ignore"):
            return checked(reader(content))
    except (OSError, UnicodeDecodeError) as error:
        reason = f"can't be read: {error}"
    except (shapely.errors.ShapelyError, RecursionError, LookupError) as error:
        reason = f"holds no polygon: {error}"
    except (ValueError, TypeError) as error:
        reason = str(error)
    raise ValueError(f"{visible(path.name)}: {shortened(reason)}")


def _geojson(content: bytes) -> BaseGeometry:
    geometries = list(_geometries(json.loads(content.decode("utf-8-sig"))))
    return shapely.union_all(_combinable(geometries)) if len(geometries) > 1 else geometries[0]


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


def _dxf(content: bytes) -> BaseGeometry:
    """Read the closed polylines and circles of a drawing."""
    try:
        import ezdxf  # noqa: F401
    except ImportError as error:
        raise ValueError("DXF needs ezdxf: `pip install 'sphrom[dxf]'`") from error
    try:
        shapes = _combinable(_drawn(content))
    except ValueError:
        raise
    except Exception as error:  # whatever a damaged drawing makes of its parser
        raise ValueError(f"is no DXF drawing: {error or type(error).__name__}") from error
    if not shapes:
        raise ValueError("it holds no closed polyline and no circle")
    return shapely.union_all(shapes)


def _drawn(content: bytes) -> Iterator[BaseGeometry]:
    from ezdxf.document import Drawing
    from ezdxf.lldxf.tagger import ascii_tags_loader, binary_tags_loader

    if content.startswith(b"AutoCAD Binary DXF"):
        loader = binary_tags_loader(content)
    else:  # the encoding is of names, which mean nothing here
        loader = ascii_tags_loader(io.StringIO(content.decode("latin-1")))
    tags = list(islice(loader, MOST_TAGS + 1))
    if len(tags) > MOST_TAGS or sum(tag.code == 0 for tag in tags) > MOST_ENTITIES:
        raise ValueError(
            f"holds more than {MOST_ENTITIES} entities or {MOST_TAGS} values: leave out what is "
            "no outline"
        )
    drawing: Any = Drawing.load(iter(tags))
    for entity in drawing.modelspace():
        if entity.dxftype() == "CIRCLE":
            centre = shapely.Point(*entity.dxf.center.vec2)
            yield checked(centre.buffer(entity.dxf.radius, QUADRANT_CORNERS))
        elif entity.dxftype() in ("LWPOLYLINE", "POLYLINE"):
            if not entity.is_closed:
                raise ValueError(f"a polyline that is open (handle {entity.dxf.handle})")
            if len(entity) > MOST_CORNERS:
                raise ValueError(f"a polyline of {len(entity)} corners; at most {MOST_CORNERS}")
            yield checked(shapely.Polygon(_corners(entity)))


def _corners(polyline: Any) -> Array:
    """Return corners (n_corners, 2) of a polyline, more where it is round."""
    from ezdxf.path import make_path

    path = make_path(polyline)
    place = np.array([(point.x, point.y) for point in path.control_vertices()]).reshape(-1, 2)
    _require_numbers(place)
    size = max(np.ptp(place, axis=0)) if len(place) else 0.0
    if not size > 0.0:
        raise ValueError("a polyline without an area")
    way = path.flattening(FLATNESS * size)
    return np.array([(point.x, point.y) for point in islice(way, MOST_CORNERS + 1)])


_READERS = {
    ".geojson": _geojson,
    ".json": _geojson,
    ".wkt": lambda content: _parsed(content.decode("utf-8-sig")),
    ".dxf": _dxf,
}
