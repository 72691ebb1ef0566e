"""Read a dataset by slices, refusing what is damaged, not finite, or too large for the memory."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from pathlib import Path
from types import EllipsisType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.finite import index_not_finite
from sphrom.artifacts.inspection import Fault, explanation
from sphrom.artifacts.layout import Shape
from sphrom.errors import ResourceError
from sphrom.machine import available_memory

# Digests are computed on blocks of about this size [bytes].
BLOCK_BYTES = 2**23

ALWAYS_FITS = 2**16
"""What isn't asked after: reading it is quicker than the limits of all control groups [bytes]."""

Selection = int | slice | EllipsisType | tuple[int | slice | EllipsisType, ...]


class DatasetReader:
    """A dataset of an open artifact; indexing reads, and refuses damage and NaN."""

    def __init__(self, path: Path, name: str, dataset: h5py.Dataset, made_by: str) -> None:
        self._path = path
        self._name = name
        self._made_by = made_by
        self._dataset = dataset
        self.shape: Shape = dataset.shape
        self.dtype: np.dtype[np.generic] = dataset.dtype

    @property
    def nbytes(self) -> int:
        """The size of all values [bytes]."""
        return math.prod(self.shape) * self.dtype.itemsize

    def __len__(self) -> int:
        """Return the length of the first axis."""
        return self.shape[0]

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """Read item after item along the first axis."""
        return (self[item] for item in range(len(self)))

    def __getitem__(self, selection: Selection) -> NDArray[Any]:
        """Return the selected values, read from the file.

        Raises ArtifactError when they are damaged or not finite, ResourceError when memory is
        short.
        """
        try:
            return self.values(selection)
        except Fault as fault:
            raise explanation(self._path, fault, self._made_by) from fault

    def values(self, selection: Selection) -> NDArray[Any]:
        """Return the selected values; raise Fault where indexing raises ArtifactError."""
        self._refuse_large(selection)
        try:
            values = np.asarray(self._dataset[selection])
        except (OSError, RuntimeError) as error:
            raise Fault(f"is damaged: {self._name}{_in_words(selection)} can't be read") from error
        bad = index_not_finite(values)
        if bad is not None:
            raise Fault(f"is damaged: {self._name}{_in_words(selection)} holds {values[bad]}")
        return values

    def digest(self) -> str:
        """Return the digest of all values, read block by block."""
        digest = hashlib.sha256()
        row_bytes = self.nbytes // max(1, len(self))
        step = max(1, BLOCK_BYTES // max(1, row_bytes))
        for start in range(0, len(self), step):
            digest.update(np.ascontiguousarray(self.values(slice(start, start + step))).data)
        return digest.hexdigest()

    def _refuse_large(self, selection: Selection) -> None:
        needed = _selected(self.shape, selection) * self.dtype.itemsize
        if needed <= ALWAYS_FITS:
            return
        available = available_memory()
        if available is not None and needed > available:
            raise ResourceError(
                f"{self._name} of {self._path} needs {needed / 2**30:.1f} GiB of memory, "
                f"{available / 2**30:.1f} GiB are available; use fewer snapshots or particles"
            )


def _selected(shape: Shape, selection: Selection) -> int:
    """Return how many values a selection reads."""
    chosen = list(selection) if isinstance(selection, tuple) else [selection]
    places = [i for i, index in enumerate(chosen) if index is Ellipsis] or [len(chosen)]
    left_out = [slice(None)] * (len(shape) - len(chosen) + (Ellipsis in chosen))
    chosen[places[0] : places[0] + 1] = left_out
    return math.prod(
        len(range(*index.indices(length))) if isinstance(index, slice) else 1
        for length, index in zip(shape, chosen, strict=False)
    )


def _in_words(selection: Selection) -> str:
    return f"[{selection}]" if isinstance(selection, int) else ""
