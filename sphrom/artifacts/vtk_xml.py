"""Read points and the fields on them from VTK's XML files, .vtu and .vtp, without their cells.

Data may be text, base64 or appended, and compressed by zlib or lzma. No size that a file claims is
allocated before its bytes are there.
"""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import MOST_SNAPSHOT_BYTES, Fault, require_snapshot_size

Array = NDArray[np.generic]
KINDS = ("UnstructuredGrid", "PolyData")
_TYPES = {
    "Int8": "i1", "Int16": "i2", "Int32": "i4", "Int64": "i8", "Float32": "f4",
    "UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8", "Float64": "f8",
}  # fmt: skip
_ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
_ENCODING = re.compile(rb"encoding\s*=\s*[\"'](raw|base64)[\"']")
_DAMAGE = (
    ElementTree.ParseError, LookupError, ValueError, OverflowError, zlib.error, lzma.LZMAError,
)  # fmt: skip
_BASE64 = re.compile(rb"[A-Za-z0-9+/]+={0,2}")


def read_vtk_xml(content: bytes) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the arrays on points, `Points` among them, and those of the whole grid.

    Raises Fault when the file is damaged, of another kind, or its compression is not known.
    """
    try:
        return _read(content)
    except Fault:
        raise
    except _DAMAGE as error:
        raise Fault(f"is damaged, or no VTK file: {' '.join(str(error).split())}") from error


def _read(content: bytes) -> tuple[dict[str, Array], dict[str, Array]]:
    tag = content.find(b"<AppendedData")
    after = content.find(b">", tag) + 1
    found = None if tag < 0 else _ENCODING.search(content, tag, after)
    root = ElementTree.fromstring(content if found is None else content[:tag] + b"</VTKFile>")
    kind = root.get("type", "of no type")
    if root.tag != "VTKFile" or kind not in KINDS:
        raise Fault(f"is a VTK file of {kind}: points are read of {' and '.join(KINDS)}")
    grid = root.find(kind)
    if grid is None:
        raise ValueError(f"it has no {kind}")
    elements = [e for e in grid.iter("DataArray") if e.get("type") in _TYPES]
    appended = {} if found is None else _appended(content, after, elements)
    decode = _Decoder.of(root, appended, found is not None and found[1] == b"raw")
    pieces = [dict(_arrays(piece, decode)) for piece in grid.findall("Piece")]
    shared = set.intersection(*(set(piece) for piece in pieces)) if pieces else set()
    on_points = {
        name: np.concatenate([piece[name] for piece in pieces])
        for name in (pieces[0] if pieces else ())
        if name in shared
    }
    if "Points" not in on_points:
        raise Fault("holds no particles")
    field = grid.find("FieldData")
    return on_points, {} if field is None else dict(_named(field, decode))


def _appended(content: bytes, after: int, elements: list[ElementTree.Element]) -> dict[int, bytes]:
    """Return the bytes behind each offset, up to the next one; `_` after the tag begins them."""
    start, end = content.find(b"_", after) + 1, content.rfind(b"</AppendedData")
    if content[after : start - 1].strip() or not 0 < start <= end:
        raise ValueError("its appended data have no beginning or no end")
    offsets = sorted({int(e.get("offset", 0)) for e in elements if e.get("format") == "appended"})
    if offsets and offsets[0] < 0:
        raise ValueError("an offset is below zero")
    ends = (*offsets, end - start)
    return {first: content[start + first : start + last] for first, last in pairwise(ends)}


@dataclass
class _Decoder:
    """How the numbers of arrays are stored."""

    order: str
    header: np.dtype[np.unsignedinteger]
    decompress: Callable[[bytes, int], bytes] | None
    appended: Mapping[int, bytes]
    raw: bool
    held: int = 0
    """What was unpacked so far [bytes]: many arrays may be of the same data."""

    @classmethod
    def of(cls, root: ElementTree.Element, appended: Mapping[int, bytes], raw: bool) -> _Decoder:
        order = _ORDERS[root.get("byte_order", "LittleEndian")]
        header = np.dtype(order + _TYPES[root.get("header_type", "UInt32")])
        name = root.get("compressor")
        if name is not None and name not in _COMPRESSORS:
            raise Fault(f"is compressed by {name}; write it with zlib, lzma or not compressed")
        return cls(order, header, None if name is None else _COMPRESSORS[name], appended, raw)

    def __call__(self, element: ElementTree.Element) -> Array:
        """Return an array (n,), or (n, components)."""
        dtype = np.dtype(self.order + _TYPES[element.attrib["type"]])
        where = element.get("format", "ascii")
        if where == "ascii":
            values = np.array((element.text or "").split(), dtype=dtype)
        else:
            values = np.frombuffer(self._bytes(element, where), dtype)
        self.held += values.nbytes
        require_snapshot_size(self.held)
        components = int(element.get("NumberOfComponents", 1))
        if components < 1 or values.size % components:
            raise ValueError(f"{element.get('Name')} has {values.size} numbers")
        return values if components == 1 else values.reshape(-1, components)

    def _bytes(self, element: ElementTree.Element, where: str) -> bytes:
        if where == "appended":
            stored = self.appended[int(element.attrib["offset"])]
        else:
            stored = (element.text or "").encode()
        if where != "appended" or not self.raw:
            # The header may be encoded apart from what follows: each part ends with its padding.
            stored = b"".join(base64.b64decode(part) for part in _BASE64.findall(stored))
        numbers = np.frombuffer(stored, self.header, len(stored) // self.header.itemsize)
        if self.decompress is None:
            start, size = self.header.itemsize, int(numbers[0])
            if start + size > len(stored):
                raise ValueError(f"{element.get('Name')} ends too early")
            return stored[start : start + size]
        return b"".join(self._blocks(stored, [int(n) for n in numbers[:3]], numbers))

    def _blocks(self, stored: bytes, about: list[int], numbers: Array) -> Iterator[bytes]:
        """Yield the parts that were compressed one by one."""
        n_blocks, size, last = (*about, 0, 0)[:3] if about[0] else (0, 0, 0)
        if n_blocks + 3 > len(numbers) and n_blocks:
            raise ValueError("its compressed data end too early")
        require_snapshot_size(self.held + n_blocks * max(size, last))
        start = (3 + n_blocks) * self.header.itemsize
        for block in range(n_blocks):
            end = start + int(numbers[3 + block])
            wanted = last if last and block == n_blocks - 1 else size
            unpacked = self.decompress(stored[start:end], wanted) if self.decompress else b""
            if len(unpacked) != wanted:
                raise ValueError("its compressed data end too early")
            yield unpacked
            start = end


def _zlib(data: bytes, size: int) -> bytes:
    return zlib.decompressobj().decompress(data, size + 1)


def _lzma(data: bytes, size: int) -> bytes:
    return lzma.LZMADecompressor(memlimit=MOST_SNAPSHOT_BYTES).decompress(data, size + 1)


_COMPRESSORS = {"vtkZLibDataCompressor": _zlib, "vtkLZMADataCompressor": _lzma}


def _arrays(piece: ElementTree.Element, decode: _Decoder) -> Iterator[tuple[str, Array]]:
    """Yield the arrays on the points of a piece by name, the points as `Points`."""
    n_points = int(piece.attrib["NumberOfPoints"])
    points = piece.findall("Points/DataArray")
    data = piece.find("PointData")
    named = () if data is None else _named(data, decode)
    for name, values in (*named, *(("Points", decode(element)) for element in points)):
        if len(values) != n_points:
            raise Fault(f"is damaged: {name} has {len(values)} values, of {n_points} points")
        yield name, values


def _named(parent: ElementTree.Element, decode: _Decoder) -> Iterator[tuple[str, Array]]:
    for element in parent.findall("DataArray"):
        if element.get("type") in _TYPES and (name := element.get("Name")):
            yield name, decode(element)
