"""Read an artifact: refuse it if it is missing, damaged, foreign or made from another input.

Symbolic links to an artifact are followed, since large runs are often kept on another disk.

HDF5's own checksums are not sufficient: the checksum of zeros is zero, and another program that
changes a dataset stores a new one. The writer therefore stores a digest of its own. Values are
compared with it when a dataset is first read, and again if the file has changed since.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import re
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
import yaml
from numpy.typing import NDArray

from sphrom.artifacts import layout
from sphrom.artifacts.contents import (
    CASE,
    Contents,
    Fault,
    attributes_at,
    damage,
    explained_faults,
    inspect,
    open_file,
    plain_text,
)
from sphrom.artifacts.records import SCHEMAS
from sphrom.declaration import (
    PROVENANCE,
    SCHEMA_VERSION,
    Field,
    Record,
    fields_of_record,
    joined,
    matches,
)
from sphrom.errors import ArtifactError, ResourceError
from sphrom.machine import available_ram
from sphrom.text import data_size, shortened

SMALL_BYTES = 2**20
"""Datasets up to this size are verified when an artifact is opened, and read without checking the
available memory, because the check takes longer [bytes]."""
MOST_KNOWN = 256
"""Number of files whose contents are remembered; the last ones opened are kept."""
Value = str | tuple[str, ...]
"""A value of a case as text, or a list of such values."""
BLOCK_BYTES = 2**23
"""Approximate size of the blocks in which values are verified [bytes]."""
SHOWN_KEYS = 4
"""Number of differing keys of two cases that a message names."""
MOST_CHARACTERS = 60
"""Longest value shown in a message: a foreign file may contain any text."""

SETTLED = 2.0
"""Age [s] from which timestamps reliably show a change of a file: their resolution is coarse."""

R = TypeVar("R", bound=Record)

_known: dict[tuple[int, ...], Contents] = {}
"""The contents of files by their status, in the order of opening."""


@contextlib.contextmanager
def open_artifact(
    path: str | Path, schema: str | None, *, made_by: str, origin: layout.Origin | None = None
) -> Iterator[Artifact]:
    """Open the artifact `path` of the kind `schema`, or of any kind, for reading, and check it.

    `made_by` is the command that makes it, for error messages.

    Raises ArtifactError if the file is missing, damaged, of another kind or version, or was not
    made with the case and inputs of `origin`.
    """
    path = Path(path)
    with explained_faults(path, made_by), _opened(path, schema, made_by, origin) as artifact:
        yield artifact


def probe(
    path: str | Path,
    schema: str,
    origin: layout.Origin | None = None,
    at_least: Mapping[str, int] | None = None,
) -> str | None:
    """Return why the artifact `path` cannot be used as it is, in words, or None if it can.

    `at_least` gives the minimum length of the first axis of datasets.
    """
    try:
        with _opened(Path(path), schema, "", origin) as artifact:
            for name, needed in (at_least or {}).items():
                if (held := artifact.length(name)) < needed:
                    return f"holds {held} of the {needed} {name} that are needed"
            return None
    except Fault as fault:
        return str(fault)


@contextlib.contextmanager
def _opened(
    path: Path, schema: str | None, made_by: str, origin: layout.Origin | None
) -> Iterator[Artifact]:
    """Open and check an artifact. Raises Fault."""
    with open_file(path) as file:
        contents = _contents(file)
        artifact = Artifact(path, file, contents, made_by)
        if schema not in (None, artifact.schema):
            raise Fault(f"holds {artifact.schema!r}, not {schema!r}")
        if origin is not None:
            _check_origin(contents, origin)
        artifact.verify_datasets(SMALL_BYTES)
        yield artifact


class Artifact:
    """An open artifact; made by `open_artifact` only.

    Attributes
    ----------
    schema : the kind of artifact, such as `sphrom/basis`.
    attributes : every attribute by its path, such as `sound_speed` or `parameters/reynolds`.
    datasets : the names of the datasets, sorted.
    content_sha256 : the digest of the datasets and attributes, as the writer computed it.
    identity : identifies this artifact in artifacts made from it.
    case_text : the resolved case that the artifact was made with.
    """

    def __init__(self, path: Path, file: h5py.File, contents: Contents, made_by: str) -> None:
        self.path = path
        self.made_by = made_by
        self._file = file
        self._contents = contents
        self.case_text = contents.case_text
        self.attributes: Mapping[str, layout.Value] = contents.attributes
        self.datasets = sorted(name for name in contents.datasets if name != CASE)
        self.schema = self.text("schema")
        self.content_sha256 = self.text("content_sha256")
        self.identity = layout.Identity(path.name, self.text("uuid"), self.content_sha256)

    def number(self, name: str) -> float:
        """Return a numeric attribute. Raises KeyError if there is none."""
        return float(self.attributes[name])  # type: ignore[arg-type]

    def text(self, name: str) -> str:
        """Return a text attribute. Raises KeyError if there is none."""
        return str(self.attributes[name])

    def __contains__(self, name: object) -> bool:
        """Whether there is a dataset `name`."""
        return name in self._contents.datasets

    def read(self, name: str) -> NDArray[Any]:
        """Return a whole dataset.

        Raises ArtifactError if damaged, ResourceError without memory for it, KeyError if absent.
        """
        needed = self._size(name)
        available = available_ram() if needed > SMALL_BYTES else None
        if available is not None and needed > available:
            raise ResourceError(
                f"{name} of {self.path} needs {data_size(needed)} of memory, "
                f"{data_size(available)} are available; use fewer snapshots or particles"
            )
        with explained_faults(self.path, self.made_by), damage(name):
            return self._read(name)

    def _size(self, name: str) -> int:
        shape, dtype = self.form(name)
        return dtype.itemsize * math.prod(shape)

    def _read(self, name: str) -> NDArray[Any]:
        """Return a whole dataset, verified. Raises Fault."""
        values = np.empty(*self.form(name))
        dataset = h5py.h5d.open(self._file.id, name.encode())
        dataset.read(h5py.h5s.ALL, h5py.h5s.ALL, values)
        self._verify(name, (values,))
        return values

    def dataset(self, name: str) -> h5py.Dataset:
        """Return a verified dataset, to be read by slices.

        Raises ArtifactError if it is damaged, KeyError if there is none.
        """
        with explained_faults(self.path, self.made_by):
            return self._verified(name)

    def _verified(self, name: str) -> h5py.Dataset:
        """Return a dataset after verifying it block by block. Raises Fault."""
        dataset = self._file[name]
        step = max(1, BLOCK_BYTES * len(dataset) // max(1, dataset.nbytes))
        starts = range(0, len(dataset), step)
        with damage(name):
            self._verify(name, (dataset[start : start + step] for start in starts))
        return dataset

    def _verify(self, name: str, blocks: Iterable[NDArray[Any]]) -> None:
        """Raise Fault unless a dataset matches its digest; a verified one is not read again."""
        if name in self._contents.verified:
            return
        digest = hashlib.sha256()
        for block in blocks:
            digest.update(np.ascontiguousarray(block).data)
        if self._contents.digests.get(name, digest.hexdigest()) != digest.hexdigest():
            raise Fault(f"is damaged: {name} has changed since it was written")
        self._contents.verified.add(name)

    def form(self, name: str) -> layout.Form:
        """Return the shape and the type of a dataset. Raises KeyError if there is none."""
        return self._contents.datasets[name]

    def length(self, name: str) -> int:
        """Return the length of a dataset's first axis, or 0 if there is no such dataset."""
        return self.form(name)[0][0] if name in self else 0

    def verify_content(self) -> None:
        """Read every dataset and compare it with its stored digest.

        Raises ArtifactError that names the first dataset that differs.
        """
        with explained_faults(self.path, self.made_by):
            self.verify_datasets()

    def verify_datasets(self, up_to_bytes: float = math.inf) -> None:
        """Verify the datasets up to a size [bytes]; raise Fault if one is damaged."""
        for name in self._contents.digests.keys() - self._contents.verified:
            if self._size(name) <= min(up_to_bytes, SMALL_BYTES):
                with damage(name):
                    self._read(name)
            elif self._size(name) <= up_to_bytes:
                self._verified(name)


def _contents(file: h5py.File) -> Contents:
    """Return the contents of the file after checking that it is whole. Raises Fault.

    A process checks a file once, and again if it has changed since.
    """
    status = os.fstat(file.id.get_vfd_handle())
    changed = status.st_mtime_ns, status.st_ctime_ns
    key = status.st_dev, status.st_ino, status.st_size, *changed
    contents = _known.pop(key, None) or _looked_through(file)
    if time.time() - 1e-9 * status.st_ctime_ns > SETTLED:
        _known[key] = contents
        if len(_known) > MOST_KNOWN:
            del _known[next(iter(_known))]
    return contents


def _looked_through(file: h5py.File) -> Contents:
    """Read the structure of a file and check it against its kind of artifact. Raises Fault."""
    root = attributes_at(file.id, "")
    kind = str(root.get("schema"))
    version = str(root.get("schema_version"))
    if kind not in SCHEMAS:
        raise Fault("is not an artifact of sphrom")
    if version.partition(".")[0] != SCHEMA_VERSION.partition(".")[0]:
        raise Fault(f"has schema version {version!r}; this program reads {SCHEMA_VERSION}")
    contents = inspect(file)
    for attribute in PROVENANCE:  # not covered by a digest
        if attribute.name not in contents.attributes:
            raise Fault(f"is damaged: attribute {attribute.name} is missing")
    with damage("the case"):
        contents.case_text = plain_text(file[CASE][()])
    if contents.digests.pop(CASE, "") != layout.text_digest(contents.case_text):
        raise Fault("is damaged: the stored case has changed since it was written")
    for name in contents.datasets.keys() - contents.digests.keys() - {CASE}:
        if SCHEMAS[kind].dataset(name) is not None:
            raise Fault(f"is damaged: {name} has changed since it was written")
    digest = layout.content_digest(kind, contents.attributes, contents.datasets, contents.digests)
    if digest != contents.attributes["content_sha256"]:
        raise Fault("is damaged: its digest does not match its contents")
    return contents


def _check_origin(contents: Contents, origin: layout.Origin) -> None:
    """Raise Fault if the artifact was made with another case or from other inputs."""
    if contents.attributes["inputs_sha256"] != origin.inputs_digest:
        text = contents.case_text
        keys = case_differences(text, origin.case_text, origin.sections)
        if differences := keys or origin.consequences(text):
            raise Fault(f"was made with another case ({differences})")
        raise Fault("was made with other points, or by another version of this program")
    for role, identity in origin.lineage.items():
        stored = contents.attributes.get(f"lineage/{role}/content_sha256")
        if stored is None:
            raise Fault(f"was made without the input {role} ({identity.path})")
        # The content decides: an input that was made again with the same bits is the same.
        if stored != identity.content_sha256:
            raise Fault(f"was made from another input: {identity.path} ({role}) has changed since")


def case_differences(made_with: str, asked: str, sections: Collection[str]) -> str:
    """Return, in words, the first keys in some sections that differ between two cases in YAML."""
    # The base loader keeps every value as text and constructs no objects.
    cases = [yaml.load(text, yaml.BaseLoader) or {} for text in (made_with, asked)]
    there, here = (
        dict(_values({section: value for section, value in case.items() if section in sections}))
        for case in cases
    )
    # Keys that only one case has, or only one as a list, come last: another version of the program
    # may have added them.
    keys = sorted(
        (key for key in here | there if here.get(key) != there.get(key)),
        key=lambda key: type(here.get(key)) is not type(there.get(key)),
    )
    differences = []
    for key in keys[:SHOWN_KEYS]:
        made, wanted = _shown(there.get(key, "absent"), here.get(key, "absent"))
        differences.append(f"{shortened(key)} is {made} there, {wanted} here")
    return "; ".join(differences)


def _shown(made: Value, wanted: Value) -> tuple[str, str]:
    """Return two values as texts; of long lists, the items before and after their differences."""
    first = last = 0
    most = 0
    if isinstance(made, tuple) and isinstance(wanted, tuple):
        if max(len(", ".join(one)) for one in (made, wanted)) > MOST_CHARACTERS:
            most = min(len(made), len(wanted))
        while first < most and made[first] == wanted[first]:
            first += 1
        while last < most - first and made[-1 - last] == wanted[-1 - last]:
            last += 1

    def text(value: Value) -> str:
        if isinstance(value, str):
            return shortened(_number(value), MOST_CHARACTERS)
        items = [*map(_number, value[first : len(value) - last])]
        items = ["..."] * (first > 0) + items + ["..."] * (last > 0)
        return f"[{shortened(', '.join(items), MOST_CHARACTERS)}]"

    return text(made), text(wanted)


def _number(text: str) -> str:
    """Return a value without the decimals of a whole number."""
    return text.removesuffix(".0") if re.fullmatch(r"-?\d+\.0", text) else text


def _values(value: Any, path: str = "") -> Iterator[tuple[str, Value]]:
    """Yield `a.b[0]` and its value for every value, and list of values, that contains no others."""
    if isinstance(value, dict) and value:
        for key, one in value.items():
            # The contents of a file stand in other keys; its name makes no difference.
            yield from _values(one, f"{path}.{key}" if path else key) if key != "file" else ()
    elif isinstance(value, list) and any(isinstance(one, (dict, list)) for one in value):
        for i, one in enumerate(value):
            yield from _values(one, f"{path}[{i}]")
    elif path:
        yield path, tuple(value) if isinstance(value, list) else str(value)


def read_record(artifact: Artifact, record: type[R], group: str = "", **others: Any) -> R:
    """Read a group of an artifact, or its root, as a record; `others` are fields not stored.

    Raises ArtifactError if it is damaged, or lacks a field because an older version wrote it.
    """
    values: dict[str, Any] = {}
    paths = [f"{path}/" for path in (*artifact.datasets, *artifact.attributes)]
    for name, stored in fields_of_record(record).items():
        path = joined(group, stored.name)
        if stored.is_mapping:
            values[name] = _mapping(artifact, record, stored, path)
        elif stored.required or any(stored_path.startswith(f"{path}/") for stored_path in paths):
            values[name] = _read(artifact, stored, path)
    return record(**values, **others)


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
        f"{artifact.path} has no {path}, because an older version made it; "
        f"make it again with `{artifact.made_by} --force`"
    )


def _mapping(artifact: Artifact, record: type[Record], field: Field, path: str) -> dict[str, Any]:
    """Read the items of a mapping, except those that are other fields of the record."""
    names = [] if field.axes else [*artifact.attributes]
    if field.axes or field.record:
        names += artifact.datasets
    if field.names is not None:
        begin = path.removesuffix("*")
        existing = [name for name in field.names if begin + name in names]
        return {name: _read(artifact, field, begin + name) for name in existing}
    depth = path.count("/") + 1
    heads = {"/".join(name.split("/")[:depth]) for name in names}
    parent = path.rpartition("/")[0]
    heads -= {joined(parent, other.name) for other in fields_of_record(record).values()} - {path}
    items = {}
    for head in sorted(head for head in heads if matches(path, head)):
        pairs = zip(path.split("/"), head.split("/"), strict=True)
        key = "/".join(segment for expected, segment in pairs if expected == "*")
        items[key] = _read(artifact, field, head)
    return items
