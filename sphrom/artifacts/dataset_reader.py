"""Read a dataset by slices, refusing what is damaged, or too large for the memory.

HDF5's own checksums don't suffice: that of zeros is zero, and another program that changes a
dataset stores a new one. So the writer stores a digest of its own. Values are compared with it when
a dataset is first read, and again when the file has changed since.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import EllipsisType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import Fault, FileKey, explained_faults, is_settled
from sphrom.artifacts.layout import Range, Shape
from sphrom.errors import ResourceError
from sphrom.machine import available_ram

BLOCK_BYTES = 2**23
"""About the size of the blocks in which values are verified [bytes]."""
ALWAYS_FITS = 2**16
"""Size up to which memory is not asked after: reading is quicker than asking [bytes]."""

Selection = int | slice | EllipsisType | tuple[int | slice | EllipsisType, ...]

_verified: set[tuple[FileKey, str]] = set()
"""The datasets that this process has verified, by file."""


@dataclass(frozen=True)
class Expectation:
    """The digest and the range that the values of one dataset must have."""

    digest: str | None
    """None for a dataset that is not in the schema and has no digest."""
    rises: bool
    range: Range
    file: FileKey
    """A key of the file's content: it changes when the file does."""


def verify(name: str, expected: Expectation, blocks: Iterable[NDArray[Any]]) -> None:
    """Raise Fault unless a dataset, given block by block, has the expected digest and range."""
    digest = hashlib.sha256()
    last: NDArray[Any] | None = None
    for block in blocks:
        if problem := expected.range.problem(block):
            raise Fault(f"is damaged: {name} {problem}")
        if expected.rises and block.size:
            joined = block if last is None else np.concatenate((last, block))
            if not np.all(joined[1:] > joined[:-1]):
                raise Fault(f"is damaged: {name} does not rise from one snapshot to the next")
            last = block[-1:]
        digest.update(np.ascontiguousarray(block).data)
    if expected.digest is None:
        return
    if digest.hexdigest() != expected.digest:
        raise Fault(f"is damaged: {name} is not what was written")
    if is_settled(expected.file):
        _verified.add((expected.file, name))


class DatasetReader:
    """A dataset of an open artifact; indexing reads, and refuses damage.

    The first time that it is read, all its values are verified.
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
        self._verified = (expected.file, name) in _verified
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
        with explained_faults(self._path, self._made_by):
            if selection is Ellipsis and not self._verified:
                values = self._read(...)  # verified without reading them twice
                self._verify((values,))
                return values
            self.verify()
            return self._read(selection)

    def verify(self) -> None:
        """Read all values, unless they were read before; raise Fault when they are damaged."""
        if not self._verified:
            self._verify(self._blocks())

    def _verify(self, blocks: Iterable[NDArray[Any]]) -> None:
        verify(self._name, self._expected, blocks)
        self._verified = True

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
        available = available_ram() if needed > ALWAYS_FITS else None
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
