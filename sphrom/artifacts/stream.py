"""A dataset in the making: written one item after the other, refusing what is not finite."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphrom.artifacts.finite import describe_index, index_not_finite
from sphrom.artifacts.identity import dataset_line
from sphrom.artifacts.layout import Shape
from sphrom.artifacts.schema import DatasetField
from sphrom.artifacts.text import fixed_text
from sphrom.errors import ArtifactError

# Size of a chunk of a dataset that is not a series of fields [bytes].
CHUNK_BYTES = 4 * 2**20


class Stream:
    """A dataset that takes items along its first axis; made by `ArtifactWriter.stream`."""

    def __init__(
        self,
        path: Path,
        name: str,
        field: DatasetField,
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
        if items.dtype != np.dtype(self.field.dtype):
            raise ValueError(f"{self._name} is of type {self.field.dtype}, not {items.dtype}")
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
        self._line = dataset_line(np.dtype(self.field.dtype), self.shape, digest)
        return self._line

    @property
    def _open(self) -> h5py.Dataset:
        if self._dataset is None:
            raise ValueError(f"{self._name} is complete")
        return self._dataset

    def _refuse_not_finite(self, items: NDArray[Any]) -> None:
        bad = index_not_finite(items)
        if bad is not None:
            where = describe_index(self.field.axes, (self.written + bad[0], *bad[1:]))
            raise ArtifactError(
                f"{self._path} was not written: {self._name} holds {items[bad]}{where}; "
                "the computation went wrong before this"
            )


def chunk_shape(field: DatasetField, shape: Shape) -> Shape | None:
    """Return one field a chunk for a series of fields, else rows of about `CHUNK_BYTES`.

    None when there is nothing to store.
    """
    if not all(shape):
        return None
    if field.per_snapshot:
        return (1, *shape[1:])
    row_bytes = np.dtype(field.dtype).itemsize * math.prod(shape[1:])
    return (min(shape[0], max(1, CHUNK_BYTES // row_bytes)), *shape[1:])
