"""Read an artifact: refuse one that is missing, damaged, foreign or made from another input.

A symbolic link to an artifact is followed, since large runs are often kept on another disk.

HDF5's own checksums don't suffice: that of zeros is zero, and another program that changes a
dataset stores a new one. So the writer stores a digest of its own. Values are compared with it when
a dataset is first read, and again when the file has changed since.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import EllipsisType
from typing import Any, TypeVar

import h5py
import numpy as np
import yaml
from numpy.typing import NDArray

from sphrom.artifacts.inspection import (
    CASE,
    DIGEST,
    Contents,
    Fault,
    FileKey,
    attribute_at,
    attributes_at,
    damage,
    explained_faults,
    explanation,
    file_key,
    inspect,
    is_settled,
    open_file,
    plain_text,
)
from sphrom.artifacts.layout import (
    Identity,
    Shape,
    Value,
    content_digest,
    dataset_line,
    layout_problem,
    text_digest,
)
from sphrom.artifacts.records import SCHEMAS
from sphrom.declaration import (
    PROVENANCE,
    SCHEMA_VERSION,
    Field,
    Record,
    Schema,
    fields_of_record,
    joined,
    matches,
)
from sphrom.errors import ArtifactError, ResourceError
from sphrom.machine import available_ram

SMALL_BYTES = 2**20
"""Size up to which datasets are verified when an artifact is opened [bytes]."""
MOST_CHECKED = 256
"""Files whose contents are remembered: those that were opened last."""
BLOCK_BYTES = 2**23
"""About the size of the blocks in which values are verified [bytes]."""
ALWAYS_FITS = 2**16
"""Size up to which memory is not asked after: reading is quicker than asking [bytes]."""
SHOWN_KEYS = 4
"""Keys of a case that are named where two differ."""
MOST_CHARACTERS = 60
"""Of a value that is shown: whoever wrote the file may have written anything."""

Selection = int | slice | EllipsisType | tuple[int | slice | EllipsisType, ...]
R = TypeVar("R", bound=Record)

_checked: dict[tuple[FileKey, str], Contents] = {}
"""What files of a schema hold, the one opened last at the end."""
_verified: set[tuple[FileKey, str]] = set()
"""The datasets that this process has verified, by file."""


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
    opened = _opened(path, schema, made_by, inputs_digest, case_text, lineage or {})
    with explained_faults(path, made_by), opened as artifact:
        yield artifact


def probe(
    path: str | Path,
    schema: str,
    *,
    inputs_digest: str | None = None,
    case_text: str | None = None,
    lineage: Mapping[str, Identity] | None = None,
    at_least: Mapping[str, int] | None = None,
) -> str | None:
    """Return why the artifact `path` can't be used as it is, in words, or None when it can.

    `at_least` has the length that the first axis of a dataset needs.
    """
    try:
        with _opened(Path(path), schema, "", inputs_digest, case_text, lineage or {}) as artifact:
            for name, needed in (at_least or {}).items():
                held, field = artifact.length(name), SCHEMAS[schema].dataset(name)
                if held < needed:
                    axis = "row" if field is None else field.axes[0]
                    return f"holds {held} {axis}s of the {needed} that are needed ({name})"
            return None
    except Fault as fault:
        return str(fault)


@contextlib.contextmanager
def _opened(
    path: Path,
    schema: str,
    made_by: str,
    inputs_digest: str | None,
    case_text: str | None,
    lineage: Mapping[str, Identity],
) -> Iterator[Artifact]:
    """Open and check an artifact. Raises Fault."""
    with open_file(path) as file:
        contents = _contents(file, schema)
        _check_origin(contents, inputs_digest, case_text, lineage)
        artifact = Artifact(path, file, contents, made_by)
        artifact.verify_datasets(SMALL_BYTES)
        yield artifact


def schema_of(path: str | Path) -> str:
    """Return what kind of artifact a file is, such as `sphrom/basis`.

    Raises ArtifactError when it is missing, damaged, or no artifact.
    """
    try:
        with open_file(Path(path)) as file:
            kind = attributes_at(file, "").get("schema")
            if isinstance(kind, str) and kind in SCHEMAS:
                return kind
            raise Fault("is not an artifact of sphrom")
    except Fault as fault:
        raise ArtifactError(f"{path} {fault}; `sphrom run CASE` makes artifacts") from fault


class Artifact:
    """An open artifact; made by `open_artifact` only."""

    def __init__(self, path: Path, file: h5py.File, contents: Contents, made_by: str) -> None:
        self.path = path
        self.made_by = made_by
        self._file = file
        self._key = file_key(file)
        self._contents = contents
        self._schema = SCHEMAS[self.text("schema")]
        self._readers: dict[str, DatasetReader] = {}  # each remembers that it was verified

    @property
    def attributes(self) -> Mapping[str, Value]:
        """Every attribute by its path, such as `sound_speed` or `parameters/reynolds`."""
        return self._contents.attributes

    @property
    def datasets(self) -> list[str]:
        """The names of the datasets, sorted."""
        return sorted(name for name in self._contents.datasets if name != CASE)

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
        return self._contents.case_text

    def number(self, name: str) -> float:
        """Return an attribute that is a number. Raises KeyError when there is none."""
        value = self.attributes[name]
        if not isinstance(value, float | int):
            raise TypeError(f"attribute {name} of {self.path} is no number")
        return float(value)

    def text(self, name: str) -> str:
        """Return an attribute that is a text. Raises KeyError when there is none."""
        value = self.attributes[name]
        if not isinstance(value, str):
            raise TypeError(f"attribute {name} of {self.path} is no text")
        return value

    def __contains__(self, name: object) -> bool:
        """Whether there is a dataset `name`."""
        return name in self._contents.datasets

    def read(self, name: str) -> NDArray[Any]:
        """Return a whole dataset.

        Raises ArtifactError when it is damaged, ResourceError when memory is short, KeyError when
        there is none.
        """
        return self.dataset(name)[...]

    def dataset(self, name: str) -> DatasetReader:
        """Return a dataset that is read by slices. Raises KeyError when there is none."""
        if name not in self:
            raise KeyError(f"{self.path} has no dataset {name}")
        if name not in self._readers:
            digest = self._contents.digests.get(name)
            self._readers[name] = DatasetReader(self, self._key, name, self._file[name], digest)
        return self._readers[name]

    def length(self, name: str) -> int:
        """Return how long the first axis of a dataset is, 0 where there is none of the name."""
        shape, _ = self._contents.datasets.get(name, ((0,), ""))
        return shape[0]

    def require(self, group: str = "", **lengths: int) -> None:
        """Raise ArtifactError unless axes have the lengths that others give them, in a group."""
        for name, (shape, _) in self._contents.datasets.items():
            field = self._schema.dataset(name)
            axes = field.axes if field is not None and name.startswith(group) else ()
            for axis, length in zip(axes, shape, strict=False):
                if lengths.get(axis, length) != length:
                    reason = f"is damaged: {name} has {length} along {axis}, not {lengths[axis]}"
                    raise explanation(self.path, Fault(reason), self.made_by)

    @contextlib.contextmanager
    def refused_where_it_does_not_fit(self) -> Iterator[None]:
        """Turn the ValueError of a record that what was read can't make into an ArtifactError."""
        try:
            yield
        except ValueError as error:
            raise explanation(self.path, Fault(f"is damaged: {error}"), self.made_by) from error

    def verify_content(self) -> None:
        """Read every dataset, and compare it with the digest that the writer stored.

        Raises ArtifactError naming the dataset that differs.
        """
        with explained_faults(self.path, self.made_by):
            self.verify_datasets()

    def verify_datasets(self, up_to_bytes: float = math.inf) -> None:
        """Verify the datasets up to a size [bytes]; raise Fault when one is damaged."""
        for name in self._contents.digests:
            reader = self.dataset(name)
            if reader.nbytes <= up_to_bytes:
                reader.verify()


class DatasetReader:
    """A dataset of an open artifact; indexing reads, and refuses damage.

    The first time that it is read, all its values are verified.
    """

    def __init__(
        self, artifact: Artifact, key: FileKey, name: str, dataset: h5py.Dataset, digest: str | None
    ) -> None:
        """Read a dataset; one that is not in the schema has no digest."""
        self._artifact = artifact
        self._key = key
        self._name = name
        self._dataset = dataset
        self._digest = digest
        self._is_verified = (key, name) in _verified
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
        needed = _n_selected(self.shape, selection) * self.dtype.itemsize
        available = available_ram() if needed > ALWAYS_FITS else None
        if available is not None and needed > available:
            raise ResourceError(
                f"{self._name} of {self._artifact.path} needs {needed / 2**30:.1f} GiB of memory, "
                f"{available / 2**30:.1f} GiB are available; use fewer snapshots or particles"
            )
        with explained_faults(self._artifact.path, self._artifact.made_by):
            if selection is Ellipsis and not self._is_verified:
                values = self._read(...)  # verified without reading them twice
                self._verify((values,))
                return values
            self.verify()
            return self._read(selection)

    def verify(self) -> None:
        """Read all values, unless they were read before; raise Fault when they are damaged."""
        if not self._is_verified:
            self._verify(self._blocks())

    def _verify(self, blocks: Iterable[NDArray[Any]]) -> None:
        verify(self._name, self._digest, blocks)
        self._is_verified = True
        if self._digest is not None and is_settled(self._key):
            _verified.add((self._key, self._name))

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


def verify(name: str, expected: str | None, blocks: Iterable[NDArray[Any]]) -> None:
    """Raise Fault unless a dataset, given block by block, has the expected digest, if any."""
    digest = hashlib.sha256()
    for block in blocks:
        digest.update(np.ascontiguousarray(block).data)
    if expected is not None and digest.hexdigest() != expected:
        raise Fault(f"is damaged: {name} is not what was written")


def _n_selected(shape: Shape, selection: Selection) -> int:
    """Return how many values a selection reads."""
    return int(np.broadcast_to(np.int8(0), shape)[selection].size)


def _contents(file: h5py.File, schema: str) -> Contents:
    """Return what the file holds, once it fits the schema. Raises Fault.

    A process looks through a file once, and again when it has changed since.
    """
    key = file_key(file)
    contents = _checked.pop((key, schema), None) or _looked_through(file, SCHEMAS[schema])
    if is_settled(key):
        _checked[key, schema] = contents
        if len(_checked) > MOST_CHECKED:
            del _checked[next(iter(_checked))]
    return contents


def _looked_through(file: h5py.File, schema: Schema) -> Contents:
    """Look through a file, and compare what it holds with a schema. Raises Fault."""
    root = attributes_at(file, "")
    kind, version = root.get("schema"), root.get("schema_version")
    if not isinstance(kind, str) or not isinstance(version, str):
        raise Fault("is not an artifact of sphrom")
    if kind != schema.name:
        raise Fault(f"holds {kind!r}, not {schema.name!r}")
    if version.partition(".")[0] != SCHEMA_VERSION.partition(".")[0]:
        raise Fault(f"has schema version {version!r}; this program reads {SCHEMA_VERSION}")
    contents = inspect(file)
    values, datasets = contents.attributes, contents.datasets
    for own in PROVENANCE:  # no digest covers it
        if not isinstance(values.get(own.name), str if own.kind == "text" else int | float):
            raise Fault(f"is damaged: attribute {own.name} is missing, or no {own.kind}")
    with damage("the case"):
        contents.case_text = plain_text(file[CASE][()])
    if attribute_at(file[CASE], CASE, DIGEST) != text_digest(contents.case_text):
        raise Fault("is damaged: the case in it is not what was written")
    lines = {}
    for name, (shape, dtype) in datasets.items():
        digest, known = attribute_at(file[name], name, DIGEST), schema.dataset(name)
        if isinstance(digest, str) and name != CASE:
            contents.digests[name] = digest
            lines[name] = dataset_line(dtype, shape, digest)
        elif known is not None:
            raise Fault(f"is damaged: {name} is not what was written")
    if content_digest(schema.name, values, lines) != values["content_sha256"]:
        raise Fault("is damaged: its digest is not that of what it holds")
    if problem := layout_problem(schema, datasets, values):
        raise Fault(f"is not as this version writes it: {problem}")
    return contents


def _check_origin(
    contents: Contents,
    inputs_digest: str | None,
    case_text: str | None,
    lineage: Mapping[str, Identity],
) -> None:
    """Raise Fault when the artifact was made with another case or from other inputs."""
    if inputs_digest is not None and contents.attributes["inputs_sha256"] != inputs_digest:
        keys = case_differences(contents.case_text, case_text) if case_text else ""
        raise Fault("was made with another case" + (f" ({keys})" if keys else ""))
    for role, identity in lineage.items():
        stored = contents.attributes.get(f"lineage/{role}/content_sha256")
        if stored is None:
            raise Fault(f"was made without the input {role} ({identity.path})")
        # The content decides: an input that was made again, bit for bit the same, is the same.
        if stored != identity.content_sha256:
            raise Fault(f"was made from another input: {identity.path} ({role}) has changed since")


def case_differences(made_with: str, asked: str) -> str:
    """Return, in words, the keys that differ between two texts of YAML.

    Of the text that something was made with, only the sections count that the other has.
    """
    try:
        # The base loader leaves every value a text as it was written, and builds nothing.
        there, here = (yaml.load(text, yaml.BaseLoader) or {} for text in (made_with, asked))
        there = {key: value for key, value in there.items() if key in here}
        there, here = dict(_values(there)), dict(_values(here))
    except (yaml.YAMLError, AttributeError, TypeError, RecursionError):
        return ""
    # What only one of them has may be newer than the other, and is then no difference.
    keys = sorted(
        (key for key in here | there if here.get(key) != there.get(key)),
        key=lambda key: key not in here or key not in there,
    )
    shown = [
        f"{_cut(key)} is {_cut(there.get(key, 'absent'))} there, "
        f"{_cut(here.get(key, 'absent'))} here"
        for key in keys[:SHOWN_KEYS]
    ]
    more = f", and {len(keys) - SHOWN_KEYS} more" if len(keys) > SHOWN_KEYS else ""
    return "; ".join(shown) + more


def _values(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield `a.b[0]` and its value for every value that holds no others."""
    if isinstance(value, dict) and value:
        for key, one in value.items():
            yield from _values(one, f"{path}.{key}" if path else key)
    elif isinstance(value, list) and value:
        for i, one in enumerate(value):
            yield from _values(one, f"{path}[{i}]")
    elif path:
        yield path, str(value)


def _cut(text: str) -> str:
    return text if len(text) <= MOST_CHARACTERS else f"{text[: MOST_CHARACTERS - 3]}..."


def read_record(artifact: Artifact, record: type[R], group: str = "", **others: Any) -> R:
    """Read a group of an artifact, or its root, as a record; `others` are fields not stored.

    Raises ArtifactError when it is damaged, or lacks what older versions didn't write.
    """
    found: dict[str, Any] = {}
    for name, field in fields_of_record(record).items():
        path = joined(group, field.name)
        if field.is_mapping:
            found[name] = _mapping(artifact, record, field, path)
        elif field.required or _holds(artifact, path):
            found[name] = _read(artifact, field, path)
    return record(**found, **others)


def _read(artifact: Artifact, field: Field, path: str) -> Any:
    if field.record is not None:
        return read_record(artifact, field.record, path)
    if field.kind == "tensors":
        return tuple(_stored(artifact, joined(path, name)) for name in field.names or ())
    return _stored(artifact, path)


def _stored(artifact: Artifact, path: str) -> Any:
    if path in artifact:
        return artifact.read(path)
    if path in artifact.attributes:
        return artifact.attributes[path]
    raise ArtifactError(
        f"{artifact.path} has no {path}, as an older version made it; "
        f"make it again with `{artifact.made_by} --force`"
    )


def _mapping(artifact: Artifact, record: type[Record], field: Field, path: str) -> dict[str, Any]:
    """Read what a mapping has, but for what has a name of its own in the record."""
    depth = path.count("/") + 1
    names = artifact.datasets if field.axes or field.record else artifact.attributes
    heads = {"/".join(name.split("/")[:depth]) for name in names}
    parent = path.rpartition("/")[0]
    heads -= {joined(parent, other.name) for other in fields_of_record(record).values()} - {path}
    if field.names is not None:
        heads &= {path.removesuffix("*") + name for name in field.names}
    found = {}
    for head in sorted(head for head in heads if matches(path, head)):
        pairs = zip(path.split("/"), head.split("/"), strict=True)
        key = "/".join(given for expected, given in pairs if expected == "*")
        found[key] = _read(artifact, field, head)
    return found


def _holds(artifact: Artifact, path: str) -> bool:
    """Whether there is a dataset, an attribute or a group."""
    names = (*artifact.datasets, *artifact.attributes)
    return any(name == path or name.startswith(f"{path}/") for name in names)
