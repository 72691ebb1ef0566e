"""The kinds of shapes in a case file, one class each: keys, and the polygons that they mean.

`SHAPES` lists all kinds. A shape may be scaled about the origin, rotated about its centroid and
translated, in this order.
"""

from __future__ import annotations

import json
import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
from pydantic import ConfigDict, Field, ValidationInfo, create_model, model_validator
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from sphrom.case.fields import LARGEST, Coordinate, Number, OneOf, Place, Positive, Section, key
from sphrom.sph.polygons import disc, require_few_crossings
from sphrom.text import quoted, shortened, visible
from sphrom.whole_files import read_whole

MOST_BYTES = 4 * 1024 * 1024
"""Largest size of an outline's file [bytes]."""
MOST_CORNERS = 20_000
"""Largest number of corners of an outline; more are finer than any particles."""
QUADRANT_CORNERS = 64
"""Corners of the polygon that rounds a right angle."""
MOST_BRACKETS = 8
"""Largest number of nested brackets of well-known text; several polygons with holes have three."""


class ShapeSection(Section):
    """A shape, with its scale, rotation and translation; the base class of all kinds."""

    # Built when a case first has one.
    model_config = ConfigDict(defer_build=True)

    scale: Positive = key(1.0, "factor on all coordinates, such as 1e-3 for millimetres")
    rotate: Annotated[Number, Field(ge=-360.0, le=360.0)] = key(
        0.0, "angle of rotation about the centroid, anticlockwise", unit="deg"
    )
    translate: Place = key((0.0, 0.0), "translation", unit="m")

    @abstractmethod
    def outline(self) -> BaseGeometry:
        """Return the polygon, or polygons, before scaling, rotation and translation [m].

        Raises ValueError if there is none.
        """

    def geometry(self) -> BaseGeometry:
        """Return the polygon, or polygons, of the shape [m].

        Raises ValueError when it is empty, crosses itself, or has no area.
        """
        try:
            outline = checked(self.outline())
        except shapely.errors.ShapelyError as error:
            raise ValueError(f"is not a polygon: {error}") from error
        shape = affinity.scale(outline, self.scale, self.scale, origin=(0.0, 0.0))
        shape = affinity.rotate(shape, self.rotate, origin="centroid")
        shape = affinity.translate(shape, self.translate[0], self.translate[1])
        return checked(shape)


class CircleSection(Section):
    """The place and size of a circle."""

    centre: Place = key(..., "centre", unit="m")
    radius: Positive = key(..., "radius", unit="m")


class CircleShape(ShapeSection):
    """A circle."""

    circle: CircleSection = key(..., "a circle")

    def outline(self) -> BaseGeometry:
        x, y = self.circle.centre
        return disc((x, y), self.circle.radius)


class RectangleSection(Section):
    """The corners of a rectangle."""

    lower: Place = key(..., "lower left corner", unit="m")
    upper: Place = key(..., "upper right corner", unit="m")


class RectangleShape(ShapeSection):
    """A rectangle along the axes."""

    rectangle: RectangleSection = key(..., "a rectangle along the axes")

    def outline(self) -> BaseGeometry:
        lower = self.rectangle.lower
        upper = self.rectangle.upper
        if not all(low < high for low, high in zip(lower, upper, strict=True)):
            raise ValueError("upper must be above lower along both axes")
        return shapely.box(*lower, *upper)


class PolygonShape(ShapeSection):
    """A polygon."""

    polygon: Annotated[tuple[Place, ...], Field(min_length=3)] = key(
        ..., "corners in order; the last is joined to the first", unit="m"
    )

    def outline(self) -> BaseGeometry:
        return shapely.Polygon(self.polygon)


class WktShape(ShapeSection):
    """Polygons as text."""

    wkt: str = key(..., "polygons as well-known text")

    def outline(self) -> BaseGeometry:
        return _parsed(self.wkt)


class FileShape(WktShape):
    """Polygons from a file."""

    file: str = key(
        ..., "a file with polygons, .geojson, .json or .wkt; its content becomes the key wkt"
    )

    @model_validator(mode="before")
    @classmethod
    def _with_outline(cls, values: Any, info: ValidationInfo) -> Any:
        """Read the outline of the file into `wkt`, so that the case contains it."""
        name = values.get("file") if isinstance(values, dict) else None
        if not isinstance(name, str) or values.get("wkt") is not None:
            return values
        folder = (info.context or {}).get("folder", Path())
        return {**values, "wkt": read_outline(Path(folder) / name).wkt}


class UnionShape(ShapeSection):
    """The union of shapes."""

    union: Shapes = key(..., "the union of shapes")

    def outline(self) -> BaseGeometry:
        return shapely.union_all(_combinable(shape.geometry() for shape in self.union))


class IntersectionShape(ShapeSection):
    """The intersection of shapes."""

    intersection: Shapes = key(..., "the intersection of shapes")

    def outline(self) -> BaseGeometry:
        shapes = _combinable(shape.geometry() for shape in self.intersection)
        return shapely.intersection_all(shapes)


class DifferenceShape(ShapeSection):
    """A shape minus others."""

    difference: Shapes = key(..., "the first shape without the others")

    def outline(self) -> BaseGeometry:
        first, *others = _combinable(shape.geometry() for shape in self.difference)
        return shapely.difference(first, shapely.union_all(others))


class BufferSection(Section):
    """A shape and its growth."""

    shape: Shape = key(..., "the shape")
    distance: Coordinate = key(..., "distance by which it grows", unit="m")


class BufferShape(ShapeSection):
    """A shape that grows, or shrinks by a negative distance, with rounded corners."""

    buffer: BufferSection = key(..., "a shape that grows or shrinks")

    def outline(self) -> BaseGeometry:
        shape = self.buffer.shape.geometry()
        distance = self.buffer.distance
        if (corners := _rounding_corners(shape, distance)) > MOST_CORNERS:
            raise ValueError(f"rounding would make {corners:.0f} corners; simplify the shape")
        return shapely.buffer(shape, distance, quad_segs=QUADRANT_CORNERS)


SHAPES: dict[str, type[ShapeSection]] = {
    "circle": CircleShape,
    "rectangle": RectangleShape,
    "polygon": PolygonShape,
    "file": FileShape,
    "wkt": WktShape,
    "union": UnionShape,
    "intersection": IntersectionShape,
    "difference": DifferenceShape,
    "buffer": BufferShape,
}
"""All kinds of shapes, by the key that each one has alone."""
Shape = Annotated[ShapeSection, OneOf(**SHAPES)]
Shapes = Annotated[tuple[Shape, ...], Field(min_length=1)]


def shapes_with(keys: type[ShapeSection], *names: str) -> dict[str, type[Section]]:
    """Return kinds of shapes, by default all, that also have the keys of a section."""
    begin = keys.__name__.removesuffix("Section")
    return {
        name: create_model(
            begin + SHAPES[name].__name__,
            __base__=(keys, SHAPES[name]),
            __doc__=SHAPES[name].__doc__,
        )
        for name in names or SHAPES
    }


def checked(shape: BaseGeometry) -> BaseGeometry:
    """Return a shape of one or more polygons, unchanged.

    Raises ValueError when it is empty, crosses itself, has no area, or a coordinate is too large.
    """
    if (corners := shapely.get_num_coordinates(shape)) > MOST_CORNERS:
        raise ValueError(f"an outline of {corners} corners; at most {MOST_CORNERS}: simplify it")
    if not np.all(np.abs(shapely.get_coordinates(shape)) <= LARGEST):  # also refuses NaN
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
    return shape


def _combinable(shapes: Iterable[BaseGeometry]) -> list[BaseGeometry]:
    """Return the shapes. Raises ValueError when it would take long to combine them."""
    listed = list(shapes)
    if np.sum(shapely.get_num_coordinates(listed)) > MOST_CORNERS:
        raise ValueError(f"shapes of more than {MOST_CORNERS} corners together: simplify them")
    require_few_crossings(listed)
    return listed


def _rounding_corners(shape: BaseGeometry, distance: float) -> float:
    """Return the number of corners that rounding adds to a shape."""
    turned = 0.0
    for ring in shapely.get_rings(shapely.orient_polygons(shapely.get_parts(shape))):
        side = np.diff(shapely.get_coordinates(ring), axis=0)
        angle = np.arctan2(side[:, 1], side[:, 0])
        turn = (np.diff(angle, append=angle[0]) + math.pi) % (2.0 * math.pi) - math.pi
        turned += np.sum(np.maximum(turn if distance > 0.0 else -turn, 0.0))
    return QUADRANT_CORNERS * turned / (0.5 * math.pi)


def read_outline(path: Path) -> BaseGeometry:
    """Read polygons from a file.

    Raises ValueError when it can't be read, is too large, or has other content than polygons.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path.name}: must end in {', '.join(_READERS)}")
    try:
        content = read_whole(path, MOST_BYTES)
        with np.errstate(all="ignore"):
            return checked(reader(content))
    except (OSError, UnicodeDecodeError) as error:
        reason = f"can't be read: {getattr(error, 'strerror', None) or error}"
    except json.JSONDecodeError as error:
        reason = f"is not valid JSON: {error}"
    except (shapely.errors.ShapelyError, RecursionError, LookupError) as error:
        reason = f"has no polygon: {error}"
    except (ValueError, TypeError) as error:
        reason = str(error)
    raise ValueError(f"{visible(path.name)}: {shortened(reason)}")


def _geojson(content: bytes) -> BaseGeometry:
    geometries = list(_geometries(json.loads(content.decode("utf-8-sig"))))
    return shapely.union_all(_combinable(geometries)) if len(geometries) != 1 else geometries[0]


def _geometries(document: Any) -> Iterator[BaseGeometry]:
    """Yield the geometries of a GeoJSON document with one or more features."""
    kind = document.get("type") if isinstance(document, dict) else None
    if kind == "FeatureCollection":
        for feature in document["features"]:
            yield from _geometries(feature)
    elif kind == "Feature":
        yield from _geometries(document["geometry"])
    elif kind in ("Polygon", "MultiPolygon"):
        try:
            shape = shapely.geometry.shape(document)
        except (TypeError, ValueError, LookupError, ArithmeticError) as error:
            raise ValueError("has no polygon; give rings of points [x, y]") from error
        yield checked(shape)
    else:
        raise ValueError(f"must contain polygons; got {kind or quoted(document)}")


def _parsed(text: str) -> BaseGeometry:
    """Return the geometry of well-known text.

    Raises ValueError when its kind is unknown, or it nests so deeply that parsing could crash.
    """
    depth = np.cumsum([(letter == "(") - (letter == ")") for letter in text])
    if depth.max(initial=0) > MOST_BRACKETS:
        raise ValueError(f"has more than {MOST_BRACKETS} nested brackets")
    try:
        with np.errstate(all="ignore"):
            return shapely.from_wkt(text)
    except (shapely.errors.ShapelyError, NotImplementedError) as error:
        fault = str(error).removeprefix("ParseException: ") if text.strip() else "it is empty"
        fault += "; name a file with `file:`" * (Path(text).suffix.lower() in _READERS)
        raise ValueError(f"is not WKT of polygons with straight sides: {fault}") from error


_READERS = {
    ".geojson": _geojson,
    ".json": _geojson,
    ".wkt": lambda content: _parsed(content.decode("utf-8-sig")),
}
