"""A dataset in the making: written one item after the other, refusing what is not finite.

Its axes have names, HDF5's dimension scales, which xarray and netCDF know axes by. A scale is a
dataset without values that has an axis's name and length. It stands in the group within which the
axis has one length, holds nothing, and is no part of the content's digest: reading an artifact
never looks at it.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphrom.artifacts.layout import COORDINATES, Axes, Shape, dataset_line, index_not_finite
from sphrom.declaration import Field, Schema, joined
from sphrom.errors import ArtifactError

CHUNK_BYTES = 4 * 2**20
"""Size of a chunk of a dataset that is not a series of fields [bytes]."""
NOT_A_VARIABLE = "This is a netCDF dimension but not a netCDF variable.{:10d}"
"""What netCDF calls a scale that has no values of its own."""


def fixed_text(text: str) -> NDArray[Any]:
    """Return a text as a scalar that HDF5 stores with its length.

    HDF5 keeps texts of variable length in a heap without checksums, and one flipped bit there was
    seen to send it into an endless loop. Of fixed length they lie where a checksum covers them.
    """
    encoded = text.encode()
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


class Stream:
    """A dataset that takes items along its first axis; made by `ArtifactWriter.stream`."""

    def __init__(
        self,
        path: Path,
        name: str,
        field: Field,
        dataset: h5py.Dataset,
        guarded: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self.field = field
        self.written = 0
        self.shape: Shape = dataset.shape
        self._path = path
        self._name = name
        self._dataset: h5py.Dataset | None = dataset
        self._line: str | None = None
        self._guarded = guarded
        self._digest = hashlib.sha256()

    def append(self, item: ArrayLike) -> None:
        """Write the next item, of the dataset's type and shape.

        Raises ArtifactError when it is not finite, ValueError when it does not fit.
        """
        self.extend(np.asarray(item)[np.newaxis])

    def extend(self, items: NDArray[Any]) -> None:
        """Write the next items (n_items, ...), as `append` does."""
        end = self.written + len(items)
        if items.dtype != np.dtype(self.field.kind):
            raise ValueError(f"{self._name} is of type {self.field.kind}, not {items.dtype}")
        if items.shape[1:] != self.shape[1:] or end > self.shape[0]:
            raise ValueError(
                f"{self._name} {self.shape} can't take {items.shape} after {self.written}"
            )
        self._refuse_not_finite(items)
        contiguous = np.ascontiguousarray(items)
        with self._guarded():
            self._open[self.written : end] = contiguous
        self._digest.update(contiguous.data)
        self.written = end
        if end == self.shape[0]:
            self.seal()

    def shorten(self) -> None:
        """Give up the items that were never written."""
        if self.written < self.shape[0]:
            self.shape = (self.written, *self.shape[1:])
            with self._guarded():
                self._open.resize(self.shape)

    def seal(self) -> str:
        """Store the digest of what was written, and return the dataset's line in the content's.

        The dataset is closed: with a thousand of them open HDF5 fails on the next one.

        Raises ValueError when items are missing.
        """
        if self._line is not None:
            return self._line
        if self.written != self.shape[0]:
            raise ValueError(f"{self._name} has {self.written} of {self.shape[0]} items")
        digest = self._digest.hexdigest()
        with self._guarded():
            self._open.attrs["sha256"] = fixed_text(digest)
            self._dataset = None
        self._line = dataset_line(np.dtype(self.field.kind), self.shape, digest)
        return self._line

    @property
    def _open(self) -> h5py.Dataset:
        if self._dataset is None:
            raise ValueError(f"{self._name} is complete")
        return self._dataset

    def _refuse_not_finite(self, items: NDArray[Any]) -> None:
        bad = index_not_finite(items)
        if bad is not None:
            index = (self.written + bad[0], *bad[1:])
            where = (f"{axis} {at}" for axis, at in zip(self.field.axes, index, strict=True))
            raise ArtifactError(
                f"{self._path} was not written: {self._name} holds {items[bad]} at "
                f"{', '.join(where)}; the computation went wrong before this"
            )


def chunk_shape(field: Field, shape: Shape) -> Shape | None:
    """Return one field a chunk for a series of fields, else rows of about `CHUNK_BYTES`.

    None when there is nothing to store.
    """
    if not all(shape):
        return None
    if field.axes[0] in ("snapshot", "mode") and "particle" in field.axes:
        return (1, *shape[1:])
    row_bytes = np.dtype(field.kind).itemsize * math.prod(shape[1:])
    return (min(shape[0], max(1, CHUNK_BYTES // row_bytes)), *shape[1:])


class Scales:
    """The scales of an artifact in the making."""

    def __init__(self, schema: Schema, file: h5py.File) -> None:
        self._schema = schema
        self._file = file
        self._axes = Axes(schema)
        self._made_for: dict[str, tuple[str, int]] = {}
        """By scale, a dataset, and the place of the axis in its shape."""

    def attach(self, name: str, field: Field, dataset: h5py.Dataset) -> None:
        """Name the axes of a new dataset; scales are made where there are none yet."""
        for i, path in enumerate(self._axes.paths(name, field, dataset.shape)):
            if path not in self._made_for:
                self._made_for[path] = name, i
                self._make(path, dataset.shape[i])
            dataset.dims[i].attach_scale(self._file[path])
        group = name.rpartition("/")[0]
        paths = {one: joined(group, one) for one in map(COORDINATES.get, field.axes) if one}
        told = [one for one, path in paths.items() if path != name and self._schema.dataset(path)]
        if told:
            dataset.attrs["coordinates"] = fixed_text(" ".join(told))

    def shorten(self, shapes: Mapping[str, Shape]) -> None:
        """Give axes the lengths that their datasets have ended with."""
        for path, (name, i) in self._made_for.items():
            if self._axes.lengths[path] != shapes[name][i]:
                self._file[path].resize((shapes[name][i],))

    def _make(self, path: str, length: int) -> None:
        # In chunks, none of which is ever written, as it may be shortened.
        chunks = (length,) if length else None
        scale = self._file.create_dataset(path, (length,), "i1", maxshape=(length,), chunks=chunks)
        scale.make_scale(NOT_A_VARIABLE.format(length))
