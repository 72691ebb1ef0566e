"""Write an artifact: completely or not at all, checked against its schema, without NaN."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import math
import os
import time
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphrom.artifacts import layout
from sphrom.artifacts.paraview import add_view
from sphrom.artifacts.records import SCHEMAS
from sphrom.declaration import SCHEMA_VERSION, Field, Record, fields_of_record, joined
from sphrom.errors import ArtifactError
from sphrom.machine import computing_seconds
from sphrom.version import __version__
from sphrom.whole_files import GarbageCollectionPaused, TemporaryFile, explained, replacement

# The newest format that VTK's reader is known to read; its metadata have checksums.
LIBVER = ("v110", "v110")
CHUNK_BYTES = 4 * 2**20
"""Size of a chunk of a dataset that is not a series of fields [bytes]."""


@contextlib.contextmanager
def create_artifact(
    path: str | Path,
    schema: str,
    *,
    stage: str,
    origin: layout.Origin,
    threads: int = 1,
    force: bool = False,
    attributes: Mapping[str, object] | None = None,
) -> Iterator[ArtifactWriter]:
    """Write the artifact `path`; it appears under its name when the block ends without an error.

    `schema` is a name such as `sphrom/basis`; `attributes` are by path, as `parameters/reynolds`.

    Raises ArtifactError if the target cannot be written or a value is not finite, ValueError if the
    data do not match the schema.
    """
    provenance: dict[str, layout.Value] = {
        "schema": schema,
        "schema_version": SCHEMA_VERSION,
        "stage": stage,
        "uuid": str(uuid.uuid4()),
        "software": "sphrom",
        "softwareVersion": __version__,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "machine": f"{os.cpu_count()} cores",
        "case_sha256": layout.text_digest(origin.case_text),
        "inputs_sha256": origin.inputs_digest,
        "threads": threads,
    }
    for role, identity in origin.lineage.items():
        provenance |= {f"lineage/{role}/{name}": value for name, value in vars(identity).items()}
    with replacement(Path(path), force=force) as file:
        writer = ArtifactWriter(Path(path), file, schema, origin.n_dim)
        try:
            writer._begin(origin.case_text, provenance)
            for name, value in (attributes or {}).items():
                writer.annotate(name, value)
            yield writer
            writer._finish()
        except BaseException:
            file.discard()
            raise
        finally:
            with GarbageCollectionPaused():
                writer._streams.clear()
                writer._hdf5.close()


class ArtifactWriter:
    """An artifact that is being written; made by `create_artifact` only."""

    def __init__(self, path: Path, file: TemporaryFile, schema: str, n_dim: int) -> None:
        self._path = path
        self._file = file
        self._guard = _Guard(path, file)
        self._schema = SCHEMAS[schema]
        self._n_dim = n_dim
        self._started = time.monotonic()
        self._computing = computing_seconds()
        self._streams: dict[str, Stream] = {}
        self._attributes: dict[str, layout.Value] = {}
        with GarbageCollectionPaused():
            self._hdf5 = h5py.File(file, "w", libver=LIBVER)

    def add_time(self, seconds: float) -> None:
        """Add time [s] that a process spent on the artifact before it was stopped."""
        self._started -= seconds

    @property
    def age(self) -> float:
        """Time spent on the artifact so far [s]."""
        return time.monotonic() - self._started

    @property
    def removed(self) -> bool:
        """Whether the file that is being written was removed, for example with its folder."""
        return not self._file.is_named

    def write(self, name: str, array: ArrayLike) -> None:
        """Write a whole dataset, with the type and the axes of the schema."""
        values = np.asarray(array)
        self.stream(name, values.shape[1:], len(values)).extend(values)

    def stream(self, name: str, item_shape: layout.Shape, n_items: int) -> Stream:
        """Start a dataset (n_items, *item_shape) that is written item by item.

        If `status` is set to a value other than `complete`, there may be fewer items.
        """
        shape = (n_items, *item_shape)
        field = self._schema.dataset(name)
        if field is None or not layout.valid_name(name) or name in self._streams:
            raise ValueError(f"{name} is no dataset of {self._schema.name}, or written already")
        if len(shape) != len(field.axes):
            raise ValueError(f"{name} has the axes {field.axes}, not the shape {shape}")
        chunks = chunk_shape(field, shape)
        with self._guard:
            dataset = self._hdf5.create_dataset(
                name, shape, field.kind, maxshape=shape, chunks=chunks, fletcher32=bool(chunks)
            )
            dataset.attrs["axes"] = fixed_text(",".join(field.axes))
            for key, text in field.labels(self._n_dim).items():
                dataset.attrs[key] = fixed_text(text)
        self._streams[name] = Stream(self, name, field, dataset)
        return self._streams[name]

    def annotate(self, name: str, value: object) -> None:
        """Set an attribute by its path, such as `status` or `bases/all/gram_error`."""
        field = self._schema.attribute(name)
        if field is None or not layout.valid_name(name):
            raise ValueError(f"{name} is no attribute of {self._schema.name}")
        self._set(name, layout.attribute_value(field, value))

    def _begin(self, case_text: str, provenance: Mapping[str, layout.Value]) -> None:
        for name, value in provenance.items():
            self._set(name, value)
        with self._guard:
            case = self._hdf5.create_dataset("case", data=fixed_text(case_text))
            case.attrs["sha256"] = fixed_text(layout.text_digest(case_text))

    def _finish(self) -> None:
        if self._attributes.get("status", "complete") != "complete":
            for stream in self._streams.values():
                stream.shorten()
        for stream in self._streams.values():
            stream.seal()
        shapes = {name: stream.shape for name, stream in self._streams.items()}
        digest = layout.content_digest(
            self._schema.name,
            self._attributes,
            forms={n: (stream.shape, stream.kind) for n, stream in self._streams.items()},
            digests={n: stream.digest for n, stream in self._streams.items()},
        )
        self._set("content_sha256", digest)
        self._set("wall_seconds", self.age)
        self._set("timing/processor", computing_seconds() - self._computing)
        there = {*self._attributes, *self._streams}
        for field in (*self._schema.datasets, *self._schema.attributes):
            if field.required and "*" not in field.name and field.name not in there:
                raise ValueError(f"{self._path}: {field.name} is missing")
        with self._guard:
            add_view(self._hdf5, self._schema.name, shapes)
            self._hdf5.flush()

    def _set(self, name: str, value: layout.Value) -> None:
        group, _, key = name.rpartition("/")
        stored = fixed_text(value) if isinstance(value, str) else value
        with self._guard:
            self._hdf5.require_group(group or "/").attrs[key] = stored
        self._attributes[name] = value


class Stream:
    """A dataset that is written along its first axis; made by `ArtifactWriter.stream`."""

    def __init__(
        self, writer: ArtifactWriter, name: str, field: Field, dataset: h5py.Dataset
    ) -> None:
        self.field = field
        self.kind = np.dtype(field.kind)
        self.written = 0
        self.shape: layout.Shape = dataset.shape
        self.digest = ""
        self._writer = writer
        self._name = name
        self._dataset = dataset
        self._data = hashlib.sha256()

    def append(self, item: ArrayLike) -> None:
        """Write the next item, which must have the dataset's type and shape.

        Raises ArtifactError if it is not finite, ValueError if it does not fit.
        """
        self.extend(np.asarray(item)[np.newaxis])

    def extend(self, items: NDArray[Any]) -> None:
        """Write the next items (n_items, ...), as `append` does."""
        end = self.written + len(items)
        if items.dtype != self.kind:
            raise ValueError(f"{self._name} is of type {self.kind}, not {items.dtype}")
        if items.shape[1:] != self.shape[1:] or end > self.shape[0]:
            raise ValueError(
                f"{self._name} {self.shape} can't take {items.shape} after {self.written}"
            )
        if (bad := layout.index_not_finite(items)) is not None:
            index = (self.written + bad[0], *bad[1:])
            where = (f"{axis} {at}" for axis, at in zip(self.field.axes, index, strict=True))
            raise ArtifactError(
                f"{self._writer._path} was not written: {self._name} holds {items[bad]} at "
                f"{', '.join(where)}; the computation went wrong before this"
            )
        contiguous = np.ascontiguousarray(items)
        with self._writer._guard:
            self._dataset[self.written : end] = contiguous
        self._data.update(contiguous.data)
        self.written = end
        if end == self.shape[0]:
            self.seal()

    def shorten(self) -> None:
        """Drop the items that were never written."""
        if self.written < self.shape[0]:
            self.shape = (self.written, *self.shape[1:])
            with self._writer._guard:
                self._dataset.resize(self.shape)

    def seal(self) -> None:
        """Store the digest of the written data.

        The dataset is closed, because HDF5 fails with a thousand of them open.

        Raises ValueError if items are missing.
        """
        if self.digest:
            return
        if self.written != self.shape[0]:
            raise ValueError(f"{self._name} has {self.written} of {self.shape[0]} items")
        self.digest = self._data.hexdigest()
        with self._writer._guard:
            self._dataset.attrs["sha256"] = fixed_text(self.digest)
            self._dataset = None


def chunk_shape(field: Field, shape: layout.Shape) -> layout.Shape | None:
    """Return one field per chunk for a series of fields, else rows of about `CHUNK_BYTES`.

    Return None if there is nothing to store.
    """
    if not all(shape):
        return None
    if field.axes[0] in ("snapshot", "mode") and "particle" in field.axes:
        return (1, *shape[1:])
    row_bytes = np.dtype(field.kind).itemsize * math.prod(shape[1:])
    return (min(shape[0], max(1, CHUNK_BYTES // row_bytes)), *shape[1:])


class _Guard(GarbageCollectionPaused):
    """Raises an error of the file beneath HDF5 as an ArtifactError.

    It is a class, because an interrupt before it is entered would make a generator raise too.
    """

    def __init__(self, path: Path, file: TemporaryFile) -> None:
        self._path = path
        self._file = file

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        super().__exit__(_, error, __)
        with explained(self._path):
            self._file.check()
            if isinstance(error, OSError):
                raise error


def fixed_text(text: str) -> NDArray[Any]:
    """Return a text as a scalar that HDF5 stores with a fixed length.

    HDF5 keeps texts of variable length in a heap without checksums, where one flipped bit sent it
    into an endless loop. Texts of fixed length are covered by a checksum.
    """
    encoded = text.encode()
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(1, len(encoded))))


def write_record(artifact: ArtifactWriter, record: Record, group: str = "") -> None:
    """Write a record into a group of an artifact, or into its root.

    Raises ArtifactError if it cannot be written or is not finite, ValueError for other types.
    """
    for name, field in fields_of_record(type(record)).items():
        value = getattr(record, name)
        path = joined(group, field.name)
        if field.is_mapping:
            for key, one in value.items():
                filled = path
                for segment in key.split("/"):
                    filled = filled.replace("*", segment, 1)
                _write(artifact, field, one, filled)
        elif value is not None:
            _write(artifact, field, value, path)


def _write(artifact: ArtifactWriter, field: Field, value: Any, path: str) -> None:
    if field.record is not None:
        write_record(artifact, value, path)
    elif field.kind == "tensors":
        for name, tensor in zip(field.names or (), value, strict=True):
            artifact.write(joined(path, name), tensor)
    elif field.axes:
        artifact.write(path, value)
    else:
        artifact.annotate(path, value)
