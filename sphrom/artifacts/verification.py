"""Check that the values of a dataset are those that were written, and in their field's range.

HDF5's own checksums don't suffice: that of zeros is zero, and another program that changes a
dataset stores a new one. So the writer stores a digest of its own. Values are compared with it when
a dataset is first read, and again when the file has changed since.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import Contents, Fault, FileKey, file_key, is_settled
from sphrom.artifacts.layout import find_field
from sphrom.artifacts.ranges import COUNTED, FAR, Range, range_of
from sphrom.artifacts.schema import DatasetField, Schema

ANY_NUMBER = Range(-np.inf, np.inf)
"""The range of a dataset that is not in the schema."""

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


def expectations(file: h5py.File, contents: Contents, schema: Schema) -> dict[str, Expectation]:
    """Return the digest and the range that each dataset must have."""
    key = file_key(file)
    fields = {name: find_field(schema.datasets, name) for name in contents.datasets}
    return {
        name: Expectation(
            contents.digests.get(name),
            field is not None and field.rises,
            ANY_NUMBER if field is None else _range(name, field, fields, contents),
            key,
        )
        for name, field in fields.items()
    }


def _range(
    name: str,
    field: DatasetField,
    fields: Mapping[str, DatasetField | None],
    contents: Contents,
) -> Range:
    """Return the range of a dataset's values: of positions by the box, of counts by an axis."""
    box = contents.attributes.get("box_length")
    if field.is_place and isinstance(box, tuple) and box:
        farthest = FAR * max(box)
        return Range(-farthest, farthest, "far outside of the domain")
    counted = COUNTED.get(name.rpartition("/")[2])
    for other, known in fields.items() if counted else ():
        if known is not None and counted in known.axes and _is_around(other, name):
            return Range(0, contents.datasets[other][0][known.axes.index(counted)])
    return range_of(field)


def _is_around(other: str, name: str) -> bool:
    """Return whether a dataset lies in the group of another one, or in one around it."""
    parent = other.rpartition("/")[0]
    return not parent or name.startswith(f"{parent}/")


def is_verified(name: str, expected: Expectation) -> bool:
    """Whether this process has verified a dataset, and its file has not changed since."""
    return (expected.file, name) in _verified


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
