"""The structure of an HDF5 file, listed before anything in it is used.

A file may be damaged or foreign. Only groups, plain numbers and, in `/case`, one text are allowed.
Objects that Python would construct, links that lead out of the file and data stored elsewhere are
refused. So are all filters except the checksum, because HDF5 would load and run a plugin for an
unknown filter.

Objects are those of HDF5 itself, because those of h5py take several times as long to make.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from sphrom.artifacts import layout
from sphrom.artifacts.paraview import VIEW
from sphrom.declaration import joined
from sphrom.errors import ArtifactError

CASE = "case"
DIGEST = "sha256"
"""The attribute with the digest of a dataset's values."""
MOST_NESTED = 32
"""Largest depth of nested groups: the time to follow a path grows with its length."""
LOCKINGS = (None, False, True)
"""Ways to lock a file. HDF5 refuses any other than the one with which this process has the file
open, so the default comes first. An artifact never changes, so it can be read without a lock."""
LEFT_OPEN = "already open for"
"""HDF5's message for a file whose superblock has the mark of a writer, which it sets since 1.10."""
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
def damage(part: str) -> Iterator[None]:
    """Turn exceptions of h5py for damaged structures into a Fault."""
    try:
        yield
    except DAMAGE as error:
        raise Fault(f"is damaged: {part} can't be read") from error


def open_file(path: Path) -> h5py.File:
    """Open a regular HDF5 file. Raises ArtifactError if it is marked as open, else Fault."""
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
            if LEFT_OPEN in str(error):
                raise ArtifactError(
                    f"{path} is marked as open for writing: another program writes it, or was "
                    f"killed; if none does, `h5clear -s {shlex.quote(str(path))}` removes the mark"
                ) from error
    raise Fault("is damaged, truncated, or not an HDF5 file") from fault


@dataclass
class Contents:
    """The contents of a file by path: shapes and types of datasets, and attributes of groups."""

    case_text: str = ""
    datasets: dict[str, layout.Form] = field(default_factory=dict)
    attributes: dict[str, layout.Value] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    """The stored digests of datasets."""
    verified: set[str] = field(default_factory=set)
    """The datasets whose values match their digests."""


def inspect(file: h5py.File) -> Contents:
    """Return the contents of the file. Raises Fault on anything that an artifact never contains."""
    contents = Contents(attributes=attributes_at(file.id, ""))
    # The view is for other programs; this one never uses it.
    for path, item in items(file, but=VIEW):
        if isinstance(item, h5py.h5g.GroupID):
            contents.attributes |= attributes_at(item, path)
        elif isinstance(item, h5py.h5d.DatasetID):
            with damage(f"dataset {path}"):
                contents.datasets[path] = _plain_form(item, path)
                if h5py.h5a.exists(item, DIGEST.encode()):
                    contents.digests[path] = str(_value(h5py.h5a.open(item, DIGEST.encode())))
    return contents


def items(file: h5py.File, but: str = "") -> Iterator[tuple[str, h5py.h5g.GroupID]]:
    """Yield every group, dataset and type by its path, except those in the group `but`.

    Raises Fault if a link or a dataset may lead out of the file, a name is not UTF-8, or groups
    are nested too deep.
    """
    links: list[tuple[bytes, int]] = []

    def is_deep(name: bytes, link: h5py.h5l.LinkInfo) -> bool | None:
        links.append((name, link.type))
        return name.count(b"/") >= MOST_NESTED or None

    with damage("its structure"):  # each link once, however many names a group has
        if file.id.links.visit(is_deep, info=True):
            raise Fault(f"is refused: its groups are nested more than {MOST_NESTED} deep")
    for name, kind in links:
        path = name.decode(errors="backslashreplace")
        if path.encode() != name:
            raise Fault(f"is refused: the name /{path} is not UTF-8")
        if path.partition("/")[0] == but:
            continue
        if kind != h5py.h5l.TYPE_HARD:
            raise Fault(f"is refused: /{path} is a link that may lead out of the file")
        with damage(f"/{path}"):
            item = h5py.h5o.open(file.id, name)
            if isinstance(item, h5py.h5d.DatasetID) and _lies_elsewhere(item.get_create_plist()):
                raise Fault(f"is refused: the data of {path} lie in another file")
        yield path, item


def _lies_elsewhere(properties: h5py.h5p.PropDCID) -> bool:
    """Return whether a dataset with some properties may have data in another file."""
    if properties.get_layout() != h5py.h5d.VIRTUAL:
        return bool(properties.get_external_count())
    sources = range(properties.get_virtual_count())
    return any(properties.get_virtual_filename(i) != "." for i in sources)


def _plain_form(dataset: h5py.h5d.DatasetID, path: str) -> layout.Form:
    """Return the shape and type of a dataset.

    Raises Fault unless it holds plain numbers, or the case, with checksums at most.
    """
    shape = dataset.shape
    dtype = dataset.dtype
    if dtype.kind not in ("S" if path == CASE else "fiu") or shape is None:
        raise Fault(f"is refused: {path} is empty, or of type {dtype}, not plain numbers")
    properties = dataset.get_create_plist()
    filters = {properties.get_filter(i)[0] for i in range(properties.get_nfilters())}
    if filters - {h5py.h5z.FILTER_FLETCHER32}:
        raise Fault(f"is refused: {path} is compressed or changed by a filter")
    return shape, dtype


def attributes_at(item: h5py.h5g.GroupID, path: str) -> dict[str, layout.Value]:
    """Return the attributes of a group by path, if they are numbers or texts of fixed length.

    Raises Fault if they are damaged.
    """
    values = {}
    with damage(f"an attribute of /{path}"):
        for index in range(h5py.h5a.get_num_attrs(item)):
            attribute = h5py.h5a.open(item, index=index)
            name = attribute.name.decode(errors="backslashreplace")
            values[joined(path, name)] = _value(attribute)
    return {name: value for name, value in values.items() if value is not None}


def _value(attribute: h5py.h5a.AttrID) -> layout.Value | None:
    shape = attribute.shape
    dtype = attribute.dtype
    if shape is None or dtype.kind not in "fiuS":
        return None
    stored = np.empty(shape, dtype)
    attribute.read(stored)
    if shape:
        return tuple(stored.ravel().tolist())
    value: layout.Value = stored.item()
    return plain_text(value) if isinstance(value, bytes) else value


def plain_text(value: bytes) -> str:
    """Return a stored text; bytes that are not UTF-8 become escapes."""
    return value.decode("utf-8", "surrogateescape")
