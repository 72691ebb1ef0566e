"""Look through an HDF5 file that may be damaged or foreign, before anything in it is used.

Only groups, plain numbers and, in `/case`, one text are let through: no objects that Python would
build, no links that lead out of the file, no data that lie elsewhere, no filter but the checksum,
as HDF5 would load and run a plugin for one that it doesn't know. What a file claims to hold is
compared with its size before anything is read.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from sphrom.artifacts.layout import Shape, Value
from sphrom.artifacts.paraview import VIEW
from sphrom.errors import ArtifactError

CASE = "case"
DIGEST = "sha256"
"""The attribute with the digest of a dataset's values."""
MOST_TEXT_BYTES = 2**20
"""Of one attribute."""
MOST_LEVELS = 20
"""Groups within groups: HDF5 takes long for many."""
SETTLED = 2.0
"""Age [s] from which a file's times tell whether it changes: clocks of file systems are coarse."""
LOCKINGS = (None, False, True)
"""How a file is locked. HDF5 refuses another way than that in which this process has it open, and
so the default comes first. An artifact never changes: it needs no lock where none can be had."""
FileKey = tuple[int, ...]
"""What changes when a file does."""
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
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


@contextlib.contextmanager
def explained_faults(path: Path, made_by: str) -> Iterator[None]:
    """Turn a Fault into the error that a user sees."""
    try:
        yield
    except Fault as fault:
        raise explanation(path, fault, made_by) from fault


@contextlib.contextmanager
def damage(what: str) -> Iterator[None]:
    """Turn what h5py raises on damaged structures into a Fault."""
    try:
        yield
    except DAMAGE as error:
        raise Fault(f"is damaged: {what} can't be read") from error


def open_file(path: Path) -> h5py.File:
    """Open a regular HDF5 file for reading. Raises Fault."""
    try:
        # Asked before opening: opening a pipe would wait for ever.
        if not path.is_file():
            there = "is not a file" if path.exists() else "is missing"
            raise Missing("is a symbolic link to nothing" if path.is_symlink() else there)
        with path.open("rb") as stream:
            start = stream.read(len(_SIGNATURE))
    except OSError as error:
        raise Fault(f"can't be read ({error.strerror})") from error
    if start != _SIGNATURE:
        raise Fault("is not an HDF5 file" if start else "is empty")
    for locking in LOCKINGS:
        try:
            return h5py.File(path, "r", locking=locking)
        except (OSError, RuntimeError, ValueError) as error:
            fault = error
    kind = "truncated" if "truncated" in str(fault) else "damaged"
    raise Fault(f"is {kind}: HDF5 can't open it") from fault


def file_size(file: h5py.File) -> int:
    """Return the size of a file [bytes]."""
    return int(file.id.get_filesize())


def file_key(file: h5py.File) -> FileKey:
    """Return what changes when an open file does."""
    status = os.fstat(file.id.get_vfd_handle())
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def is_settled(key: FileKey) -> bool:
    """Whether a file is so old that its key tells whether it changes."""
    return time.time() - 1e-9 * key[-1] > SETTLED


@dataclass
class Contents:
    """What a file holds, by path: shapes and types of the datasets, attributes of the groups."""

    case_text: str = ""
    datasets: dict[str, tuple[Shape, np.dtype[np.generic]]] = field(default_factory=dict)
    attributes: dict[str, Value] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    """What the writer stored of the values of datasets."""
    claimed: int = 0
    """What the datasets claim to hold [bytes]."""


def inspect(file: h5py.File) -> Contents:
    """Return what the file holds. Raises Fault on anything that an artifact never holds."""
    contents = Contents(attributes=attributes_at(file, ""))
    for path in hard_links(file, but=VIEW):  # another program's: never opened, never used
        with damage(f"/{path}"):
            item = file[path]
            # A scale is another program's name for an axis: never read.
            is_data = isinstance(item, h5py.Dataset) and not h5py.h5ds.is_scale(item.id)
        if is_data:
            inspect_dataset(item, path, contents)
        elif isinstance(item, h5py.Group):
            contents.attributes |= attributes_at(item, path)
    return contents


def hard_links(file: h5py.File, but: str = "") -> Iterator[str]:
    """Yield the path of every group and dataset, but of those in one group.

    Raises Fault where a link may lead out of the file.
    """
    links: dict[str, object] = {}

    def note(path: str, link: object) -> bool | None:
        links[path] = link
        return path.count("/") > MOST_LEVELS or None  # anything but None ends the walk

    with damage("its structure"):  # each link once, however many names lead to a group
        too_deep = file.visititems_links(note)
    if too_deep:
        raise Fault("is refused: it holds groups within groups without end")
    for path, link in links.items():
        if path.partition("/")[0] == but:
            continue
        if not isinstance(link, h5py.HardLink):
            raise Fault(f"is refused: /{path} is a link that may lead out of the file")
        yield path


def require_own_data(file: h5py.File) -> None:
    """Raise Fault where a link or a dataset leads out of the file."""
    for path in hard_links(file):
        with damage(f"/{path}"):
            item = file[path]
            if isinstance(item, h5py.Dataset):
                _refuse_other_files(item, path)


def _refuse_other_files(dataset: h5py.Dataset, path: str) -> None:
    sources = dataset.virtual_sources() if dataset.is_virtual else ()
    if dataset.external or any(source.file_name != "." for source in sources):
        raise Fault(f"is refused: the data of {path} lie in another file")


def inspect_dataset(dataset: h5py.Dataset, path: str, contents: Contents) -> None:
    """Note what a dataset claims to hold. Raises Fault where no artifact holds such a one."""
    with damage(f"dataset {path}"):
        dtype, shape, chunks = dataset.dtype, dataset.shape, dataset.chunks or ()
        if dtype.kind not in ("S" if path == CASE else "fiu") or shape is None:
            raise Fault(f"is refused: dataset {path} is of type {dtype}, which no artifact holds")
        _refuse_other_files(dataset, path)
        properties = dataset.id.get_create_plist()
        filters = {properties.get_filter(i)[0] for i in range(properties.get_nfilters())}
        if filters - {h5py.h5z.FILTER_FLETCHER32}:
            raise Fault(f"is refused: {path} is compressed or changed by a filter")
        if not dataset.is_virtual:
            n_values = math.prod(shape)
            contents.claimed += dtype.itemsize * (n_values and max(n_values, math.prod(chunks)))
        size = file_size(dataset.file)
        if contents.claimed > size:
            raise Fault(f"is damaged: it claims to hold {contents.claimed} bytes, and has {size}")
        contents.datasets[path] = (shape, dtype)


def attributes_at(item: h5py.HLObject, path: str) -> dict[str, Value]:
    """Return the attributes of `item` by path; those that are no numbers or fixed texts are left.

    Raises Fault when they are damaged.
    """
    with damage(f"an attribute of /{path}"):
        keys = list(item.attrs)
    found = {f"{path}/{key}" if path else key: attribute_at(item, path, key) for key in keys}
    return {name: value for name, value in found.items() if value is not None}


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
        if attribute.shape:
            return tuple(stored.ravel().tolist())
        value: Value = stored.item()
        return plain_text(value) if isinstance(value, bytes) else value


def plain_text(value: bytes) -> str:
    """Return a stored text; bytes that are none survive as escapes."""
    return bytes(value).decode("utf-8", "surrogateescape")
