"""Read points and the fields on them from VTK's legacy files (.vtk), text or binary.

Datasets are POLYDATA and UNSTRUCTURED_GRID, of versions 1 to 5; their cells are passed over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import Fault

Array = NDArray[np.generic]
KINDS = ("POLYDATA", "UNSTRUCTURED_GRID")
_TYPES = {
    "unsigned_char": "u1", "char": "i1", "unsigned_short": "u2", "short": "i2",
    "unsigned_int": "u4", "int": "i4", "unsigned_long": "u8", "long": "i8",
    "unsigned_long_long": "u8", "long_long": "i8", "vtkidtype": "i4", "float": "f4",
    "double": "f8", "vtktypeint64": "i8", "vtktypeuint64": "u8", "vtktypeint32": "i4",
    "vtktypeuint32": "u4",
}  # fmt: skip
"""Of numbers; binary ones have their most significant byte first."""
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")
_WORD = 32
"""Characters of a text that one number takes with what is around it, as a rule."""
_LINE = 1000
"""Characters of a line of words that are read."""
_VECTORS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}


def read_vtk_legacy(content: bytes) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the arrays on points, `Points` among them, and those of the whole dataset.

    Raises Fault when the file is damaged, or of another kind.
    """
    try:
        reader = _Reader(content)
        reader.read()
    except Fault:
        raise
    except (LookupError, ValueError, OverflowError) as error:
        raise Fault(f"is damaged, or no VTK file: {' '.join(str(error).split())}") from error
    if not len(reader.points.get("Points", ())):
        raise Fault("holds no particles")
    return reader.points, reader.whole


class _Reader:
    """Goes through a file from section to section."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0
        self.points: dict[str, Array] = {}
        self.whole: dict[str, Array] = {}
        cells: dict[str, Array] = {}
        self._into = {"": self.whole, "POINT_DATA": self.points, "CELL_DATA": cells}
        self._section = ""
        self._n = 0

    def read(self) -> None:
        """Read the whole file. Raises Fault, ValueError or LookupError."""
        if not self._line().startswith("# vtk DataFile"):
            raise Fault("is no VTK file: it does not begin with `# vtk DataFile`")
        self._line()
        how = self._line().strip().upper()
        if how not in ("ASCII", "BINARY"):
            raise ValueError("it is neither ASCII nor BINARY")
        self._binary = how == "BINARY"
        while (words := self._words()) is not None:
            self._read_section(words)

    def _read_section(self, words: list[str]) -> None:
        name, *rest = words
        name = name.upper()
        if name in _HANDLERS:
            _HANDLERS[name](self, rest)
        elif name in _CELLS:
            self._pass_cells(rest)
        elif name in _VECTORS:
            self._put(rest[0], self._numbers(rest[1], self._n, _VECTORS[name]))
        else:
            raise ValueError(f"it has {name} where a section was expected")

    def _dataset(self, rest: list[str]) -> None:
        if rest[0].upper() not in KINDS:
            raise Fault(f"is a VTK file of {rest[0]}: points are read of {' and '.join(KINDS)}")

    def _points(self, rest: list[str]) -> None:
        self.points["Points"] = self._numbers(rest[1], _count(rest[0]), 3)

    def _pass_cells(self, rest: list[str]) -> None:
        """Pass over cells: sizes and points in one list, or two arrays since version 5."""
        n, size = _count(rest[0]), _count(rest[1])
        before = self._at
        words = self._words() if n or size else None
        if words is not None and words[0].upper() == "OFFSETS":
            self._numbers(words[1], n, 1)
            self._numbers((self._words() or [""])[1], size, 1)
            return
        self._at = before
        self._numbers("int", size, 1)

    def _cell_types(self, rest: list[str]) -> None:
        self._numbers("int", _count(rest[0]), 1)

    def _point_data(self, rest: list[str]) -> None:
        self._section, self._n = "POINT_DATA", _count(rest[0])
        if self._n != len(self.points.get("Points", ())):
            raise ValueError(f"it has fields of {self._n} points, and other points")

    def _cell_data(self, rest: list[str]) -> None:
        self._section, self._n = "CELL_DATA", _count(rest[0])

    def _scalars(self, rest: list[str]) -> None:
        components = _count(rest[2]) if len(rest) > 2 else 1
        before = self._at
        words = self._words()
        if words is None or words[0].upper() != "LOOKUP_TABLE":
            self._at = before
        self._put(rest[0], self._numbers(rest[1], self._n, components))

    def _lookup_table(self, rest: list[str]) -> None:
        self._numbers("unsigned_char" if self._binary else "float", _count(rest[1]), 4)

    def _texture(self, rest: list[str]) -> None:
        self._put(rest[0], self._numbers(rest[2], self._n, _count(rest[1])))

    def _colours(self, rest: list[str]) -> None:
        kind = "unsigned_char" if self._binary else "float"
        self._put(rest[0], self._numbers(kind, self._n, _count(rest[1])))

    def _field(self, rest: list[str]) -> None:
        for _ in range(_count(rest[1])):
            name, components, n, kind = self._words() or []
            if name.upper() == "METADATA":
                raise ValueError("it has METADATA where a field was expected")
            if kind.lower() == "string":
                raise Fault(f"holds text ({name}), which is not read")
            self._put(name, self._numbers(kind, _count(n), _count(components)))
            self._pass_metadata()

    def _metadata(self, rest: list[str]) -> None:
        """Pass over what VTK tells of components: it ends with an empty line."""
        while self._at < len(self._content) and self._line().strip():
            pass

    def _pass_metadata(self) -> None:
        before = self._at
        words = self._words()
        if words is not None and words[0].upper() == "METADATA":
            self._metadata([])
        else:
            self._at = before

    def _put(self, name: str, values: Array) -> None:
        self._into[self._section][unquote(name)] = values

    def _numbers(self, kind: str, n: int, components: int) -> Array:
        """Read numbers (n,), or (n, components)."""
        dtype, count = np.dtype(">" + _TYPES[kind.lower()]), n * components
        if count * (dtype.itemsize if self._binary else 1) > max(0, len(self._content) - self._at):
            raise ValueError("it ends too early")
        if self._binary:
            end = self._at + count * dtype.itemsize
            values = np.frombuffer(self._content[self._at : end], dtype)
            self._at = end
        else:
            values = np.array(self._split(count), dtype=dtype)
        return values if components == 1 else values.reshape(n, components)

    def _split(self, count: int) -> list[bytes]:
        """Return the next words of a text, from no more of it than they take."""
        length, left = _WORD * (count + 1), max(0, len(self._content) - self._at)
        words = self._content[self._at : self._at + length].split(None, count)
        while len(words) <= count and length < left:
            length *= 2
            words = self._content[self._at : self._at + length].split(None, count)
        if len(words) < count:
            raise ValueError("it ends too early")
        rest = words[count] if len(words) > count else b""
        self._at += min(length, left) - len(rest)
        return words[:count]

    def _line(self) -> str:
        end = self._content.find(b"\n", self._at)
        end = len(self._content) if end < 0 else end
        line = self._content[self._at : min(end, self._at + _LINE)]
        self._at = end + 1
        return line.decode("utf-8", "replace")

    def _words(self) -> list[str] | None:
        """Return the words of the next line that has any, None at the end."""
        while self._at < len(self._content):
            if words := self._line().split():
                return words
        return None


def _count(text: str) -> int:
    count = int(text)
    if count < 0:
        raise ValueError(f"it has a length of {count}")
    return count


_HANDLERS: Mapping[str, Callable[[_Reader, list[str]], None]] = {
    "DATASET": _Reader._dataset,
    "POINTS": _Reader._points,
    "CELL_TYPES": _Reader._cell_types,
    "POINT_DATA": _Reader._point_data,
    "CELL_DATA": _Reader._cell_data,
    "SCALARS": _Reader._scalars,
    "LOOKUP_TABLE": _Reader._lookup_table,
    "TEXTURE_COORDINATES": _Reader._texture,
    "COLOR_SCALARS": _Reader._colours,
    "FIELD": _Reader._field,
    "METADATA": _Reader._metadata,
}
"""Sections of a file that are not cells, nor vectors of a fixed length."""
