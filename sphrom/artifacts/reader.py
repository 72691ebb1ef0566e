"""Read an artifact: refuse one that is missing, damaged, foreign or made from another input."""

from __future__ import annotations

import contextlib
import hashlib
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.differences import case_differences
from sphrom.artifacts.identity import Identity, content_digest, dataset_line, text_digest
from sphrom.artifacts.inspection import CASE, Contents, Fault, damage, inspect
from sphrom.artifacts.layout import (
    Shape,
    Value,
    attributes_problem,
    find_field,
    layout_problem,
)
from sphrom.artifacts.memory import available_bytes
from sphrom.artifacts.schema import SCHEMA_VERSION, SCHEMAS
from sphrom.artifacts.writer import describe_index, index_not_finite
from sphrom.errors import ArtifactError, ResourceError

# Datasets up to this size are read and checked for NaN when an artifact is opened [bytes].
SMALL_BYTES = 2**20
# Verification reads blocks of about this size [bytes].
BLOCK_BYTES = 2**23


@contextlib.contextmanager
def open_artifact(
    path: str | Path,
    schema: str,
    *,
    made_by: str,
    inputs_digest: str | None = None,
    case_text: str | None = None,
    lineage: Mapping[str, Identity] | None = None,
) -> Iterator[Artifact]:
    """Open the artifact `path` of the kind `schema`, checked, for reading.

    `made_by` is the command that makes it, for the message. `inputs_digest` and `lineage` are what
    the artifact must have been made with and from; `case_text` serves to name what differs.

    Raises ArtifactError when the file is missing, damaged, of another kind, version or case, or
    made from another input.
    """
    path = Path(path)
    try:
        file = _open(path)
    except Fault as fault:
        raise ArtifactError(_message(path, fault, made_by)) from fault
    with file:
        try:
            contents = _checked(file, schema)
            artifact = Artifact(path, file, contents, made_by)
            artifact._refuse_damaged_small()
            _refuse_foreign(artifact, inputs_digest, case_text, lineage or {})
        except Fault as fault:
            raise ArtifactError(_message(path, fault, made_by)) from fault
        yield artifact


def probe(
    path: str | Path,
    schema: str,
    *,
    inputs_digest: str | None = None,
    case_text: str | None = None,
    lineage: Mapping[str, Identity] | None = None,
) -> str | None:
    """Return why the artifact `path` can't be used as it is, in words, or None when it can."""
    path = Path(path)
    try:
        with _open(path) as file:
            artifact = Artifact(path, file, _checked(file, schema), "")
            artifact._refuse_damaged_small()
            _refuse_foreign(artifact, inputs_digest, case_text, lineage or {})
    except Fault as fault:
        return str(fault)
    return None


class Artifact:
    """An open artifact; made by `open_artifact` only."""

    def __init__(self, path: Path, file: h5py.File, contents: Contents, made_by: str) -> None:
        self.path = path
        self._file = file
        self._contents = contents
        self._made_by = made_by

    @property
    def attributes(self) -> Mapping[str, Value]:
        """Every attribute by its path, such as `sound_speed` or `parameters/reynolds`."""
        return self._contents.attributes

    @property
    def uuid(self) -> str:
        """The identity of this very file."""
        return self.text("uuid")

    @property
    def content_sha256(self) -> str:
        """The digest of the datasets and attributes, as the writer computed it."""
        return self.text("content_sha256")

    @property
    def identity(self) -> Identity:
        """What an artifact made from this one remembers of it."""
        return Identity(self.path.name, self.uuid, self.content_sha256)

    @property
    def case_text(self) -> str:
        """The resolved case that the artifact was made with."""
        return _case_text(self._file)

    def number(self, name: str) -> float:
        """Return an attribute that is a number. Raises KeyError when there is none."""
        value = self.attributes[name]
        if isinstance(value, float | int):
            return float(value)
        raise TypeError(f"attribute {name} is no number")

    def text(self, name: str) -> str:
        """Return an attribute that is a text. Raises KeyError when there is none."""
        return str(self.attributes[name])

    def attributes_of(self, group: str) -> dict[str, Value]:
        """Return the attributes of a group by their own names, such as those of `parameters`."""
        return {
            name.rpartition("/")[2]: value
            for name, value in self.attributes.items()
            if name.rpartition("/")[0] == group
        }

    def groups(self, parent: str) -> list[str]:
        """Return the names of the groups in `parent`, such as the bases in `bases`."""
        prefix = f"{parent}/"
        inside = [name.removeprefix(prefix) for name in self._contents.datasets if name.startswith(prefix)]
        return sorted({name.partition("/")[0] for name in inside if "/" in name})

    def __contains__(self, name: object) -> bool:
        """Whether there is a dataset `name`."""
        return name in self._contents.datasets

    def read(self, name: str) -> NDArray[np.generic]:
        """Return a whole dataset.

        Raises ArtifactError when it is damaged or not finite, ResourceError when memory is short.
        """
        return self.dataset(name)[...]

    def dataset(self, name: str) -> DatasetReader:
        """Return a dataset that is read by slices. Raises KeyError when there is none."""
        if name not in self:
            raise KeyError(f"{self.path} has no dataset {name}")
        return DatasetReader(self, name, self._file[name])

    def verify_content(self) -> None:
        """Read everything and compare it with the digests that the writer stored.

        Raises ArtifactError naming the dataset that differs.
        """
        lines = {}
        for name, (shape, dtype) in self._contents.datasets.items():
            if "sha256" not in self._file[name].attrs or name == CASE:
                continue
            digest = self.dataset(name).digest()
            if digest != self._file[name].attrs["sha256"]:
                raise self.error(Fault(f"is damaged: {name} is not what was written"))
            lines[name] = dataset_line(dtype, shape, digest)
        found = content_digest(self.text("schema"), self._own_attributes(), lines)
        if found != self.content_sha256:
            raise self.error(Fault("is damaged: the attributes are not what was written"))

    def error(self, fault: Fault) -> ArtifactError:
        """Return the error that tells of `fault` and of how to make the artifact again."""
        return ArtifactError(_message(self.path, fault, self._made_by))

    def _own_attributes(self) -> dict[str, Value]:
        return {
            name: value
            for name, value in self.attributes.items()
            if not name.startswith("lineage/")
        }

    def _refuse_damaged_small(self) -> None:
        for name, (shape, dtype) in self._contents.datasets.items():
            if name != CASE and int(np.prod(shape, dtype=object)) * dtype.itemsize <= SMALL_BYTES:
                DatasetReader(self, name, self._file[name]).values(...)


class DatasetReader:
    """A dataset of an open artifact; indexing reads, and refuses damage and NaN."""

    def __init__(self, artifact: Artifact, name: str, dataset: h5py.Dataset) -> None:
        self._artifact = artifact
        self._name = name
        self._dataset = dataset
        self.shape: Shape = dataset.shape
        self.dtype: np.dtype[np.generic] = dataset.dtype

    def __len__(self) -> int:
        """Return the length of the first axis."""
        return self.shape[0]

    def __getitem__(self, selection: object) -> NDArray[np.generic]:
        """Return the selected values.

        Raises ArtifactError when they are damaged or not finite, ResourceError when memory is
        short.
        """
        try:
            return self.values(selection)
        except Fault as fault:
            raise self._artifact.error(fault) from fault

    def values(self, selection: object) -> NDArray[np.generic]:
        """Return the selected values. Raises Fault where indexing raises ArtifactError."""
        size = h5py._hl.selections.select(self.shape, selection).nselect
        self._refuse_large(size)
        try:
            values = np.asarray(self._dataset[selection])
        except OSError as error:
            raise Fault(f"is damaged: {self._name} can't be read") from error
        bad = index_not_finite(values)
        if bad is not None:
            raise Fault(f"is damaged: {self._name} holds {values[bad]}")
        return values

    def digest(self) -> str:
        """Return the digest of all values, read block by block."""
        digest = hashlib.sha256()
        if not self.shape:
            digest.update(self[...])
            return digest.hexdigest()
        row_bytes = self.dtype.itemsize * int(np.prod(self.shape[1:], dtype=np.int64))
        step = max(1, BLOCK_BYTES // max(1, row_bytes))
        for start in range(0, len(self), step):
            digest.update(self[start : start + step])
        return digest.hexdigest()
