"""Copies of an artifact's views, in files that need no artifact.

`write_vtkhdf` writes one file of VTK's HDF format. `write_vtu` writes a file for each step, which
older tools read too, and one that lists them with their times. Data are copied step by step.
"""

from __future__ import annotations

import base64
import sys
from collections.abc import Sequence
from pathlib import Path
from types import EllipsisType
from typing import Any, Protocol
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.layout import Shape
from sphrom.artifacts.paraview import View, views, write_group
from sphrom.artifacts.writer import LIBVER
from sphrom.whole_files import Uncollected, replacement

_VERTEX = 1
"""VTK's number of a cell that is a single point."""
_TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}


class Rows(Protocol):
    """A dataset that is read by slices."""

    @property
    def shape(self) -> Shape:
        """The lengths of the axes."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the values."""

    def __len__(self) -> int:
        """Return the length of the first axis."""

    def __getitem__(self, selection: int | EllipsisType) -> NDArray[Any]:
        """Return one item along the first axis, or all."""


class Fields(Protocol):
    """What files are written from: an open artifact, or what reads like one."""

    path: Path

    @property
    def datasets(self) -> Sequence[str]:
        """The names of the datasets."""

    def dataset(self, name: str) -> Rows:
        """Return a dataset that is read by slices."""

    def text(self, name: str) -> str:
        """Return an attribute that is a text."""


def artifact_views(artifact: Fields) -> dict[str, View]:
    """Return the views of an open artifact by name, the principal one under ``""``."""
    readers = {name: artifact.dataset(name) for name in artifact.datasets}
    found = {name: (reader.shape, reader.dtype) for name, reader in readers.items()}
    return views(artifact.text("schema"), found)


def write_vtkhdf(path: Path, artifact: Fields, view: View, *, force: bool) -> None:
    """Write a view with its data into one file.

    Raises ArtifactError when it is there and `force` is not set, or can't be written.
    """

    def put(group: h5py.Group, name: str, source: str, n_rows: int) -> None:
        if source == view.times:
            group[name] = artifact.dataset(source)[...]
            return
        first = _rows(artifact, view, source, 0)
        shape = (n_rows, *first.shape[1:])
        target = group.create_dataset(name, shape, first.dtype, chunks=first.shape)
        for step in range(n_rows // view.n_points):
            begin = step * view.n_points
            target[begin : begin + view.n_points] = _rows(artifact, view, source, step)

    with replacement(path, force=force) as file:
        try:
            with Uncollected(), h5py.File(file, "w", libver=LIBVER) as hdf5:
                write_group(hdf5, view, put)
        except BaseException:
            file.discard()
            raise


def write_vtu(path: Path, artifact: Fields, view: View, *, force: bool) -> None:
    """Write a view as `path`, a .pvd file, and a .vtu file for each step in a folder beside it.

    Raises ArtifactError when one of them is there and `force` is not set, or can't be written.
    """
    times = _times(artifact, view)
    width = len(str(len(times) - 1))
    entries = []
    for step, time in enumerate(times):
        name = f"{path.stem}/{path.stem}-{step:0{width}}.vtu"
        _write_xml(path.parent / name, "UnstructuredGrid", _grid(artifact, view, step, time), force)
        entries.append(_tag("DataSet", "", timestep=repr(time), part=0, file=name))
    _write_xml(path, "Collection", "".join(entries), force)


def _times(artifact: Fields, view: View) -> list[float]:
    """Return the times of the steps, or the modes' numbers; zero alone where nothing steps."""
    if view.times is not None:
        return [float(time) for time in artifact.dataset(view.times)[...]]
    return [float(step + 1) for step in range(view.n_steps)] or [0.0]


def _rows(artifact: Fields, view: View, source: str, step: int) -> NDArray[Any]:
    """Return a field at one step as VTK has it, (n_points,) or (n_points, 3)."""
    reader = artifact.dataset(source)
    if source not in view.stepped:
        values = reader[...]
    elif step < len(reader):
        values = reader[step]
    else:  # a basis of fewer modes than another
        values = np.zeros(reader.shape[1:], reader.dtype)
    if values.ndim == 1:
        return values
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _grid(artifact: Fields, view: View, step: int, time: float) -> str:
    """Return one step as an unstructured grid whose cells are the points."""
    n = view.n_points
    cells: dict[str, NDArray[Any]] = {
        "connectivity": np.arange(n),
        "offsets": np.arange(1, n + 1),
        "types": np.full(n, _VERTEX, dtype=np.uint8),
    }
    fields = {name: _rows(artifact, view, source, step) for name, source in view.fields.items()}
    piece = (
        _tag("PointData", "".join(_array(name, rows) for name, rows in fields.items()))
        + _tag("Points", _array("Points", _rows(artifact, view, view.points, step)))
        + _tag("Cells", "".join(_array(name, values) for name, values in cells.items()))
    )
    when = _array("TimeValue", np.array([time]))
    return _tag("FieldData", when) + _tag("Piece", piece, NumberOfPoints=n, NumberOfCells=n)


def _array(name: str, values: NDArray[Any]) -> str:
    """Return an array as its length [bytes] and its bytes, in letters that XML allows."""
    length = np.uint64(values.nbytes).tobytes()
    return _tag(
        "DataArray",
        base64.b64encode(length + np.ascontiguousarray(values).tobytes()).decode("ascii"),
        type=_TYPES[values.dtype.name],
        Name=name,
        NumberOfTuples=len(values),
        NumberOfComponents=1 if values.ndim == 1 else values.shape[1],
        format="binary",
    )


def _tag(name: str, body: str, **attributes: object) -> str:
    given = "".join(f" {key}={quoteattr(str(value))}" for key, value in attributes.items())
    return f"<{name}{given}>{body}</{name}>\n"


def _write_xml(path: Path, kind: str, body: str, force: bool) -> None:
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    document = _tag(
        "VTKFile",
        _tag(kind, body),
        type=kind,
        version="1.0",
        byte_order=order,
        header_type="UInt64",
    )
    with replacement(path, force=force) as file:
        file.write(f'<?xml version="1.0"?>\n{document}'.encode())
