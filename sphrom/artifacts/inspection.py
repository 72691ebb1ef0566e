"""Look through an HDF5 file that may be damaged or hostile, before anything in it is used.

Only groups, plain numbers and, in `/case`, one text are let through: no objects that Python would
build, no links that lead out of the file, no data that lie elsewhere or were never written, no
filter but the checksum, as HDF5 would load and run a plugin for one that it doesn't know. What a
file claims to hold is compared with its size before anything is read.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sphrom.artifacts.layout import Shape, Value
from sphrom.artifacts.paraview import VIEW
from sphrom.artifacts.text import plain_text
from sphrom.errors import ArtifactError
from sphrom.text import data_size

CASE = "case"
MOST_ITEMS = 10_000
"""Groups and datasets of one file; looking through so many takes seconds."""
MOST_ATTRIBUTES = 100_000
"""Of one group; a sweep has one for each run that failed."""
MOST_LEVELS = 20
"""Groups within groups."""
MOST_TEXT_BYTES = 2**20
"""Of the case, or of one attribute."""
MOST_SNAPSHOT_BYTES = 2**30
"""Of another program's snapshot: some six million particles with twenty fields."""
SETTLED = 2.0
"""Age [s] from which a file's times tell whether it changes: clocks of file systems are coarse."""
FileKey = tuple[int, ...]
"""What changes when a file does."""
# What h5py raises when the file's own structures are damaged, depending on which.
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError)


class Fault(Exception):
    """Why an artifact can't be used, in words that continue `FILE ...`."""


class Missing(Fault):
    """There is no file to speak of."""


def explanation(path: Path, fault: Fault, made_by: str) -> ArtifactError:
    """Return the error that tells of `fault` and of the command that makes the artifact."""
    if isinstance(fault, Missing):
        return ArtifactError(f"{path} {fault}; make it with `{made_by}`")
    return ArtifactError(f"{path} {fault}; make it again with `{made_by} --force`")


@dataclass
class Contents:
    """What a file holds, by path: shapes and types of the datasets, attributes of the groups."""

    case_text: str = ""
    datasets: dict[str, tuple[Shape, np.dtype[np.generic]]] = field(default_factory=dict)
    views: set[str] = field(default_factory=set)
    """The datasets that are put together from others."""
    claimed: int = 0
    """What the others claim to hold [bytes]."""
    places: dict[int, str] = field(default_factory=dict)
    """The groups and datasets by where in the file they are."""
    attributes: dict[str, Value] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    """What the writer stored of the values of datasets."""


@contextlib.contextmanager
def damage(what: str) -> Iterator[None]:
    """Turn what h5py raises on damaged structures into a Fault."""
    try:
        yield
    except DAMAGE as error:
        raise Fault(f"is damaged: {what} can't be read") from error


def inspect(file: h5py.File) -> Contents:
    """Return what the file holds. Raises Fault on anything that an artifact never holds."""
    contents = Contents()
    _inspect_group(file, "", contents)
    _refuse_claims(file, contents)
    return contents


def _refuse_claims(file: h5py.File, contents: Contents) -> None:
    """Refuse data that together are larger than the file: nothing in it is compressed."""
    size = file_size(file)
    if contents.claimed > size:
        raise Fault(f"is damaged: it claims to hold {contents.claimed} bytes, and has {size}")


def require_snapshot_size(n_bytes: int) -> None:
    """Raise Fault where another program's snapshot is larger than any that is read."""
    if n_bytes > MOST_SNAPSHOT_BYTES:
        most = data_size(MOST_SNAPSHOT_BYTES)
        raise Fault(f"unpacks to {data_size(n_bytes)}; a snapshot has at most {most}")


def file_size(file: h5py.File) -> int:
    """Return the size of a file [bytes]. Raises Fault."""
    with damage("the file's size"):
        return int(file.id.get_filesize())


def file_key(file: h5py.File) -> FileKey:
    """Return what changes when an open file does."""
    status = os.fstat(file.id.get_vfd_handle())
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def is_settled(key: FileKey) -> bool:
    """Whether a file is so old that its key tells whether it changes."""
    return time.time() - 1e-9 * key[-1] > SETTLED


def _inspect_group(group: h5py.Group, path: str, contents: Contents) -> None:
    with damage(f"group /{path}"):
        n_items = len(group)
        if path.count("/") >= MOST_LEVELS or n_items + len(contents.places) > MOST_ITEMS:
            raise Fault(f"is refused: group /{path} holds more than any artifact")
        names = list(group)
    _note_place(group, path, contents)
    contents.attributes |= attributes_at(group, path)
    for name in names:
        child = f"{path}/{name}" if path else name
        if child == VIEW:
            continue  # other programs' view of the same data: never opened, never used
        with damage(f"/{child}"):
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise Fault(f"is refused: /{child} is a link that may lead out of the file")
            item = group[name]
        if isinstance(item, h5py.Group):
            _inspect_group(item, child, contents)
        elif isinstance(item, h5py.Dataset):
            _note_place(item, child, contents)
            if not is_scale(item):  # another program's name for an axis: never read
                inspect_dataset(item, child, contents)
        else:
            raise Fault(f"is refused: /{child} is neither a group nor a dataset")


def is_scale(dataset: h5py.Dataset) -> bool:
    """Whether a dataset is the name and the length of an axis."""
    with damage("an axis"):
        return bool(h5py.h5ds.is_scale(dataset.id))


def _note_place(item: h5py.HLObject, path: str, contents: Contents) -> None:
    """Refuse what was met before: names that lead to the same things may go on without end."""
    with damage(f"/{path}"):
        address = h5py.h5o.get_info(item.id).addr
    if address in contents.places:
        raise Fault(f"is refused: /{path} is another name of /{contents.places[address]}")
    contents.places[address] = path


def attributes_at(item: h5py.HLObject, path: str) -> dict[str, Value]:
    """Return the attributes of `item` by path; those that are no numbers or fixed texts are left.

    Raises Fault when they are damaged.
    """
    values = {}
    with damage(f"an attribute of /{path}"):
        if len(item.attrs) > MOST_ATTRIBUTES:
            raise Fault(f"is refused: /{path} has more attributes than any artifact")
        for key in item.attrs:
            value = attribute_at(item, path, key)
            if value is not None:
                values[f"{path}/{key}" if path else key] = value
    return values


def attribute_at(item: h5py.HLObject, path: str, key: str) -> Value | None:
    """Return one attribute; None where there is none, or it is no number or fixed text.

    Raises Fault when it is damaged.
    """
    with damage(f"an attribute of /{path}"):
        if not h5py.h5a.exists(item.id, key.encode()):
            return None
        attribute = h5py.h5a.open(item.id, key.encode())
        if attribute.get_storage_size() > MOST_TEXT_BYTES:
            raise Fault(f"is refused: attribute {key} of /{path} is larger than any is")
        if attribute.shape is None or attribute.dtype.kind not in "fiuS":
            return None
        stored = np.empty(attribute.shape, attribute.dtype)
        attribute.read(stored)
        return _plain(stored[()])


def _plain(value: np.generic | np.ndarray[Any, Any]) -> Value:
    if isinstance(value, np.ndarray):
        return tuple(value.ravel().tolist())
    plain: Value = plain_text(value) if isinstance(value, bytes) else value.item()
    return plain


def inspect_dataset(dataset: h5py.Dataset, path: str, contents: Contents) -> None:
    """Note what a dataset claims to hold. Raises Fault where no artifact holds such a one."""
    with damage(f"dataset {path}"):
        dtype, shape = dataset.dtype, dataset.shape
        if dtype.kind not in ("S" if path == CASE else "fiu") or shape is None:
            raise Fault(f"is refused: dataset {path} is of type {dtype}, which no artifact holds")
        if dataset.external or _leads_out(dataset):
            raise Fault(f"is refused: the data of {path} lie in another file")
        if path == CASE and math.prod(shape) * dtype.itemsize > MOST_TEXT_BYTES:
            raise Fault("is refused: the case in it is larger than any is")
        if _is_filtered(dataset):
            raise Fault(f"is refused: {path} is compressed or changed by a filter")
        if dataset.is_virtual:
            contents.views.add(path)
        elif not _is_written(dataset):
            raise Fault(f"is damaged: {path} is incomplete, part of it was never written")
        else:
            contents.claimed += math.prod(shape) * dtype.itemsize
        contents.datasets[path] = (shape, dtype)


def _leads_out(dataset: h5py.Dataset) -> bool:
    return dataset.is_virtual and any(
        source.file_name != "." for source in dataset.virtual_sources()
    )


def _is_filtered(dataset: h5py.Dataset) -> bool:
    """Whether reading runs anything but the checksum, or takes chunks larger than any file's."""
    properties = dataset.id.get_create_plist()
    filters = (properties.get_filter(i)[0] for i in range(properties.get_nfilters()))
    chunk = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize
    largest = max(MOST_TEXT_BYTES, file_size(dataset.file))
    return any(code != h5py.h5z.FILTER_FLETCHER32 for code in filters) or (
        dataset.chunks is not None and chunk > largest
    )


def _is_written(dataset: h5py.Dataset) -> bool:
    """Whether every part has its place in the file; HDF5 reads the missing ones as zeros."""
    if dataset.chunks is None:
        return bool(dataset.id.get_storage_size() >= dataset.nbytes)
    chunks = 1
    for length, step in zip(dataset.shape, dataset.chunks, strict=True):
        chunks *= -(-length // step)
    return bool(dataset.id.get_num_chunks() >= chunks)
