"""List the contents of an HDF5 file that may be damaged or foreign, before using any of them.

Only groups, plain numbers and, in `/case`, one text are allowed. Refused are objects that Python
would construct, links that lead out of the file, data stored elsewhere, and all filters except the
checksum, because HDF5 would load and run a plugin for an unknown filter.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from sphrom.artifacts.layout import Shape, Value
from sphrom.artifacts.paraview import VIEW
from sphrom.declaration import joined
from sphrom.errors import ArtifactError

CASE = "case"
DIGEST = "sha256"
"""The attribute with the digest of a dataset's values."""
LOCKINGS = (None, False, True)
"""Ways to lock a file. HDF5 refuses any other than the one with which this process has the file
open, so the default comes first. An artifact never changes, so it can be read without a lock."""
# The exceptions that h5py raises for the various damaged structures of a file.
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError)


class Fault(Exception):
    """Why an artifact cannot be used; the text continues `FILE ...`."""


@contextlib.contextmanager
def explained_faults(path: Path, made_by: str) -> Iterator[None]:
    """Turn a Fault into the user's error, which names the command that makes the file."""
    try:
        yield
    except Fault as fault:
        command = f"again with `{made_by} --force`" if path.exists() else f"with `{made_by}`"
        raise ArtifactError(f"{path} {fault}; make it {command}") from fault


@contextlib.contextmanager
def damage(what: str) -> Iterator[None]:
    """Turn exceptions of h5py for damaged structures into a Fault."""
    try:
        yield
    except DAMAGE as error:
        raise Fault(f"is damaged: {what} can't be read") from error


def open_file(path: Path) -> h5py.File:
    """Open a regular HDF5 file for reading. Raises Fault."""
    try:
        if not path.is_file():  # opening a pipe would block
            raise Fault("is not a file" if path.exists() else "is missing")
        path.open("rb").close()
    except OSError as error:
        raise Fault(f"can't be read ({error.strerror})") from error
    for locking in LOCKINGS:
        try:
            return h5py.File(path, "r", locking=locking)
        except (OSError, RuntimeError, ValueError) as error:
            fault = error
    raise Fault("is damaged, truncated, or not an HDF5 file") from fault


@dataclass
class Contents:
    """The contents of a file by path: shapes and types of datasets, and attributes of groups."""

    case_text: str = ""
    datasets: dict[str, tuple[Shape, np.dtype[np.generic]]] = field(default_factory=dict)
    attributes: dict[str, Value] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    """The stored digests of datasets."""
    verified: set[str] = field(default_factory=set)
    """The datasets whose values match their digests."""


def inspect(file: h5py.File) -> Contents:
    """Return the contents of the file. Raises Fault on anything that an artifact never contains."""
    contents = Contents(attributes=attributes_at(file, ""))
    # The view is for other programs; this one never uses it.
    for path, item in items(file, but=VIEW):
        if isinstance(item, h5py.Group):
            contents.attributes |= attributes_at(item, path)
        elif isinstance(item, h5py.Dataset):
            with damage(f"dataset {path}"):
                _require_plain(item, path)
                contents.datasets[path] = item.shape, item.dtype
                if DIGEST in item.attrs:
                    contents.digests[path] = str(_value(item.attrs.get_id(DIGEST)))
    return contents


def items(file: h5py.File, but: str = "") -> Iterator[tuple[str, h5py.HLObject]]:
    """Yield every group and dataset by its path, except those in the group `but`.

    Raises Fault if a link or a dataset may lead out of the file.
    """
    links: dict[str, object] = {}
    with damage("its structure"):  # each link once, however many names a group has
        file.visititems_links(links.__setitem__)
    for path, link in links.items():
        if path.partition("/")[0] == but:
            continue
        if not isinstance(link, h5py.HardLink):
            raise Fault(f"is refused: /{path} is a link that may lead out of the file")
        with damage(f"/{path}"):
            item = file[path]
            if isinstance(item, h5py.Dataset):
                sources = item.virtual_sources() if item.is_virtual else ()
                if item.external or any(source.file_name != "." for source in sources):
                    raise Fault(f"is refused: the data of {path} lie in another file")
        yield path, item


def _require_plain(dataset: h5py.Dataset, path: str) -> None:
    """Raise Fault unless a dataset holds plain numbers, or the case, with checksums at most."""
    if dataset.dtype.kind not in ("S" if path == CASE else "fiu") or dataset.shape is None:
        raise Fault(f"is refused: {path} is of type {dataset.dtype}, which no artifact holds")
    properties = dataset.id.get_create_plist()
    filters = {properties.get_filter(i)[0] for i in range(properties.get_nfilters())}
    if filters - {h5py.h5z.FILTER_FLETCHER32}:
        raise Fault(f"is refused: {path} is compressed or changed by a filter")


def attributes_at(item: h5py.HLObject, path: str) -> dict[str, Value]:
    """Return the attributes of `item` by path, if they are numbers or texts of fixed length.

    Raises Fault if they are damaged.
    """
    with damage(f"an attribute of /{path}"):
        values = {joined(path, key): _value(item.attrs.get_id(key)) for key in item.attrs}
    return {name: value for name, value in values.items() if value is not None}


def _value(attribute: h5py.h5a.AttrID) -> Value | None:
    if attribute.shape is None or attribute.dtype.kind not in "fiuS":
        return None
    stored = np.empty(attribute.shape, attribute.dtype)
    attribute.read(stored)
    if attribute.shape:
        return tuple(stored.ravel().tolist())
    value: Value = stored.item()
    return plain_text(value) if isinstance(value, bytes) else value


def plain_text(value: bytes) -> str:
    """Return a stored text; bytes that are not UTF-8 become escapes."""
    return value.decode("utf-8", "surrogateescape")
