"""Write an artifact: whole or not at all, checked against its schema, never with NaN inside."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import os
import time
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

import sphrom
from sphrom.artifacts.identity import Identity, content_digest, dataset_line, text_digest
from sphrom.artifacts.layout import (
    Shape,
    Value,
    attribute_fields,
    attribute_value,
    attributes_problem,
    find_field,
    layout_problem,
    valid_name,
)
from sphrom.artifacts.schema import SCHEMA_VERSION, SCHEMAS, DatasetField
from sphrom.artifacts.target import TemporaryFile, explained, replacement
from sphrom.errors import ArtifactError

# The newest format that VTK's reader was seen to read; its metadata carry checksums.
LIBVER = ("v110", "v110")
# Size of a chunk of a dataset that is not a series of fields [bytes].
CHUNK_BYTES = 4 * 2**20


@contextlib.contextmanager
def create_artifact(
    path: str | Path,
    schema: str,
    *,
    stage: str,
    case_text: str,
    case_digest: str,
    inputs_digest: str,
    lineage: Mapping[str, Identity] | None = None,
    threads: int = 1,
    force: bool = False,
    attributes: Mapping[str, object] | None = None,
) -> Iterator[ArtifactWriter]:
    """Write the artifact `path`, which appears under its name when the block ends well.

    `schema` is a name such as `sphrom/basis`; `lineage` has the identity of each input by role;
    `attributes` are by path, such as `sound_speed` or `parameters/reynolds`.

    Raises ArtifactError when the target can't be written or a value is not finite, ValueError when
    what is written is not what the schema says.
    """
    with replacement(Path(path), force=force) as file:
        writer = ArtifactWriter(Path(path), file, schema)
        try:
            writer._begin(stage, case_digest, inputs_digest, threads)
            writer._describe_origin(case_text, lineage or {})
            for name, value in (attributes or {}).items():
                writer.annotate(name, value)
            yield writer
            writer._finish()
        except BaseException:
            file.discard()
            raise
        finally:
            writer._close()


class ArtifactWriter:
    """An artifact in the making; made by `create_artifact` only."""

    def __init__(self, path: Path, file: TemporaryFile, schema: str) -> None:
        self._path = path
        self._file = file
        self._schema = SCHEMAS[schema]
        self._started = time.monotonic()
        self._streams: dict[str, Stream] = {}
        self._attributes: dict[str, Value] = {}
        self._hdf5 = h5py.File(file, "w", libver=LIBVER)

    def write(self, name: str, array: ArrayLike) -> None:
        """Write a whole dataset, of the type and the axes that the schema gives it."""
        values = np.asarray(array)
        if values.ndim and values.shape[0]:
            stream = self.stream(name, values.shape[1:], values.shape[0])
            stream.extend(values)
            return
        field = self._field(name, values.shape)
        self._refuse_type(field, name, values)
        self._refuse_not_finite(name, field, values, 0)
        with self._guarded():
            dataset = self._hdf5.create_dataset(name, data=values)
        self._register(name, field, Stream(self, name, field, dataset)).digest.update(values)

    def stream(self, name: str, item_shape: Shape, n_items: int) -> Stream:
        """Start a dataset (n_items, *item_shape) that is written one item after the other."""
        shape = (n_items, *item_shape)
        field = self._field(name, shape)
        with self._guarded():
            dataset = self._hdf5.create_dataset(
                name,
                shape,
                field.dtype,
                maxshape=shape,
                chunks=_chunk_shape(field, shape),
                fletcher32=True,
            )
        return self._register(name, field, Stream(self, name, field, dataset))

    def annotate(self, name: str, value: object) -> None:
        """Set an attribute by its path, such as `status` or `bases/all/gram_error`."""
        field = find_field(attribute_fields(self._schema), name)
        if field is None or not valid_name(name):
            raise ValueError(f"{name} is no attribute of {self._schema.name}")
        self._set(name, attribute_value(field, value))

    def _begin(self, stage: str, case_digest: str, inputs_digest: str, threads: int) -> None:
        now = datetime.datetime.now(datetime.UTC)
        self._set("schema", self._schema.name)
        self._set("schema_version", SCHEMA_VERSION)
        self._set("stage", stage)
        self._set("uuid", str(uuid.uuid4()))
        self._set("software", "sphrom")
        self._set("softwareVersion", sphrom.__version__)
        self._set("date", now.isoformat(timespec="seconds"))
        self._set("machine", f"{os.cpu_count()} cores")
        self._set("case_sha256", case_digest)
        self._set("inputs_sha256", inputs_digest)
        self._set("threads", threads)

    def _describe_origin(self, case_text: str, lineage: Mapping[str, Identity]) -> None:
        encoded = case_text.encode()
        with self._guarded():
            # Of fixed length, since HDF5 keeps no checksum of texts of variable length.
            text_type = h5py.string_dtype("utf-8", max(1, len(encoded)))
            case = self._hdf5.create_dataset("case", data=np.array(encoded, dtype=text_type))
            case.attrs["sha256"] = text_digest(case_text)
            for role, identity in lineage.items():
                if not valid_name(role) or "/" in role:
                    raise ValueError(f"{role!r} can't name an input")
                group = self._hdf5.require_group(f"lineage/{role}")
                group.attrs["path"] = Path(identity.path).name
                group.attrs["uuid"] = identity.uuid
                group.attrs["content_sha256"] = identity.content_sha256

    def _finish(self) -> None:
        cut_short = self._attributes.get("status", "complete") != "complete"
        for name, stream in self._streams.items():
            if cut_short:
                stream.shorten()
            if stream.written != stream.length:
                raise ValueError(f"{name} has {stream.written} of {stream.length} items")
        found = {name: (s.shape, np.dtype(s.field.dtype)) for name, s in self._streams.items()}
        self._set("wall_seconds", time.monotonic() - self._started)
        lines = {name: stream.seal() for name, stream in self._streams.items()}
        self._set("content_sha256", content_digest(self._schema.name, self._attributes, lines))
        problem = layout_problem(self._schema, found) or attributes_problem(
            self._schema, self._attributes, found
        )
        if problem:
            raise ValueError(f"{self._path}: {problem}")
        with self._guarded():
            self._hdf5.flush()

    def _close(self) -> None:
        self._hdf5.close()

    def _field(self, name: str, shape: Shape) -> DatasetField:
        field = find_field(self._schema.datasets, name)
        if field is None or not valid_name(name):
            raise ValueError(f"{name} is no dataset of {self._schema.name}")
        if len(shape) != len(field.axes):
            raise ValueError(f"{name} has the axes {field.axes}, not the shape {shape}")
        if name in self._streams:
            raise ValueError(f"{name} is written already")
        return field

    def _register(self, name: str, field: DatasetField, stream: Stream) -> Stream:
        with self._guarded():
            stream.dataset.attrs["axes"] = ",".join(field.axes)
            for key in ("units", "symbol", "equation"):
                stream.dataset.attrs[key] = getattr(field, key)
        self._streams[name] = stream
        return stream

    def _set(self, name: str, value: Value) -> None:
        group, _, key = name.rpartition("/")
        with self._guarded():
            self._hdf5.require_group(group or "/").attrs[key] = value
        self._attributes[name] = value

    def _refuse_type(self, field: DatasetField, name: str, values: NDArray[np.generic]) -> None:
        if values.dtype != np.dtype(field.dtype):
            raise ValueError(f"{name} is of type {field.dtype}, not {values.dtype}")

    def _refuse_not_finite(
        self, name: str, field: DatasetField, values: NDArray[np.generic], first: int
    ) -> None:
        """Refuse NaN and infinities; `values` starts at `first` along the first axis."""
        bad = index_not_finite(values)
        if bad is not None:
            where = describe_index(field.axes, (bad[0] + first, *bad[1:]) if bad else bad)
            raise ArtifactError(
                f"{self._path} was not written: {name} holds {values[bad]}{where}; "
                "the run that computed it went wrong"
            )

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Raise what went wrong beneath HDF5 as an ArtifactError."""
        with explained(self._path):
            try:
                yield
            finally:
                self._file.check()


class Stream:
    """A dataset that is written one item after the other; made by `ArtifactWriter.stream`."""

    def __init__(
        self, writer: ArtifactWriter, name: str, field: DatasetField, dataset: h5py.Dataset
    ) -> None:
        self._writer = writer
        self._name = name
        self.field = field
        self.dataset = dataset
        self.digest = hashlib.sha256()
        self.written = 0
        self.shape: Shape = dataset.shape

    @property
    def length(self) -> int:
        """The number of items that the dataset is to hold."""
        return self.shape[0] if self.shape else 0

    def append(self, item: ArrayLike) -> None:
        """Write the next item, of the dataset's type and shape."""
        self.extend(np.asarray(item)[np.newaxis])

    def extend(self, items: NDArray[np.generic]) -> None:
        """Write the next items (n_items, ...)."""
        end = self.written + len(items)
        self._writer._refuse_type(self.field, self._name, items)
        if items.shape[1:] != self.shape[1:] or end > self.length:
            raise ValueError(f"{self._name} {self.shape} can't take {items.shape} at {self.written}")
        self._writer._refuse_not_finite(self._name, self.field, items, self.written)
        contiguous = np.ascontiguousarray(items)
        with self._writer._guarded():
            self.dataset[self.written : end] = contiguous
        self.digest.update(contiguous)
        self.written = end

    def shorten(self) -> None:
        """Give up the items that were never written."""
        if self.written < self.length:
            self.shape = (self.written, *self.shape[1:])
            with self._writer._guarded():
                self.dataset.resize(self.shape)

    def seal(self) -> str:
        """Store the digest of what was written, and return the dataset's line in the content's."""
        digest = self.digest.hexdigest()
        with self._writer._guarded():
            self.dataset.attrs["sha256"] = digest
        return dataset_line(np.dtype(self.field.dtype), self.shape, digest)


def index_not_finite(values: NDArray[np.generic]) -> tuple[int, ...] | None:
    """Return the index of the first value that is NaN or infinite, if there is one."""
    if values.dtype.kind != "f" or np.isfinite(values).all():
        return None
    return tuple(int(index) for index in np.argwhere(~np.isfinite(values))[0])


def describe_index(axes: tuple[str, ...], index: tuple[int, ...]) -> str:
    """Return an index in words: ` at snapshot 3, particle 17`."""
    words = ", ".join(f"{axis} {at}" for axis, at in zip(axes, index, strict=True))
    return f" at {words}" if words else ""


def _chunk_shape(field: DatasetField, shape: Shape) -> Shape | None:
    """Return one field a chunk for a series of fields, else rows of about `CHUNK_BYTES`."""
    if not all(shape):
        return None
    if field.per_snapshot:
        return (1, *shape[1:])
    row_bytes = np.dtype(field.dtype).itemsize * int(np.prod(shape[1:], dtype=np.int64))
    return (min(shape[0], max(1, CHUNK_BYTES // row_bytes)), *shape[1:])
