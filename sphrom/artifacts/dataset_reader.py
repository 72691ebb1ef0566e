"""Read a dataset by slices, refusing what is damaged, or too large for the memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from types import EllipsisType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import Fault, explanation
from sphrom.artifacts.layout import Shape
from sphrom.artifacts.verification import Expectation, is_verified, verify
from sphrom.errors import ResourceError
from sphrom.machine import available_ram

# What is read by slices is verified in blocks of about this size [bytes].
BLOCK_BYTES = 2**23

ALWAYS_FITS = 2**16
"""What isn't asked after: reading it is quicker than the limits of all control groups [bytes]."""

Selection = int | slice | EllipsisType | tuple[int | slice | EllipsisType, ...]


class DatasetReader:
    """A dataset of an open artifact; indexing reads, and refuses damage.

    The first time that it is read, all its values are verified (`sphrom.artifacts.verification`).
    """

    def __init__(
        self,
        path: Path,
        name: str,
        dataset: h5py.Dataset,
        made_by: str,
        expected: Expectation,
    ) -> None:
        self._path = path
        self._name = name
        self._made_by = made_by
        self._dataset = dataset
        self._expected = expected
        self._verified = is_verified(name, expected)
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

        Raises ArtifactError when the dataset is damaged, ResourceError when memory is short.
        """
        self._refuse_large(selection)
        try:
            if selection is Ellipsis and not self._verified:
                return self._read_whole()
            self.verify()
            return self._read(selection)
        except Fault as fault:
            raise explanation(self._path, fault, self._made_by) from fault

    def verify(self) -> None:
        """Read all values, unless they were read before; raise Fault when they are damaged."""
        if not self._verified:
            verify(self._name, self._expected, self._blocks())
            self._verified = True

    def _read_whole(self) -> NDArray[Any]:
        """Return all values, verified without reading them twice. Raises Fault."""
        values = self._read(...)
        verify(self._name, self._expected, (values,))
        self._verified = True
        return values

    def _blocks(self) -> Iterator[NDArray[Any]]:
        """Read all values block by block. Raises Fault."""
        if not self.shape:
            yield self._read(...)
            return
        row_bytes = self.nbytes // max(1, len(self))
        step = max(1, BLOCK_BYTES // max(1, row_bytes))
        for start in range(0, len(self), step):
            yield self._read(slice(start, start + step))

    def _read(self, selection: Selection) -> NDArray[Any]:
        try:
            return np.asarray(self._dataset[selection])
        except (OSError, RuntimeError) as error:
            raise Fault(f"is damaged: {self._name} can't be read") from error

    def _refuse_large(self, selection: Selection) -> None:
        needed = _selected(self.shape, selection) * self.dtype.itemsize
        if needed <= ALWAYS_FITS:
            return
        available = available_ram()
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
