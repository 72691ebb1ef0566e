"""Read an artifact: refuse one that is missing, damaged, foreign or made from another input.

A symbolic link to an artifact is followed, since large runs are often kept on another disk.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.dataset_reader import DatasetReader
from sphrom.artifacts.identity import Identity
from sphrom.artifacts.inspection import CASE, Contents, Fault, attributes_at, explanation
from sphrom.artifacts.layout import Value, find_field
from sphrom.artifacts.records import SCHEMAS
from sphrom.artifacts.validity import check_contents, check_origin, open_file
from sphrom.artifacts.verification import expectations
from sphrom.errors import ArtifactError

# Datasets up to this size are verified when an artifact is opened [bytes].
SMALL_BYTES = 2**20


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
    with contextlib.ExitStack() as stack:
        try:
            checked = _checked(path, schema, made_by, inputs_digest, case_text, lineage or {})
            artifact = stack.enter_context(checked)
        except Fault as fault:
            raise explanation(path, fault, made_by) from fault
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
        with _checked(Path(path), schema, "", inputs_digest, case_text, lineage or {}) as artifact:
            for name, needed in (at_least or {}).items():
                held = artifact.length(name)
                if held < needed:
                    axis = _first_axis(schema, name)
                    return f"holds {held} {axis}s of the {needed} that are needed ({name})"
            return None
    except Fault as fault:
        return str(fault)


def _first_axis(schema: str, name: str) -> str:
    """Return the name of a dataset's first axis."""
    field = find_field(SCHEMAS[schema].datasets, name)
    return field.axes[0] if field is not None else "row"


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
        self._file = file
        self._contents = contents
        self.made_by = made_by
        self._expected = expectations(file, contents, SCHEMAS[self.text("schema")])
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

    def attributes_of(self, group: str) -> dict[str, Value]:
        """Return the attributes of a group by their own names, such as those of `parameters`."""
        split = {name: name.rpartition("/") for name in self.attributes}
        return {
            key: self.attributes[name]
            for name, (parent, _, key) in split.items()
            if parent == group
        }

    def groups(self, parent: str) -> list[str]:
        """Return the names of the groups in `parent`, such as the bases in `bases`."""
        prefix = f"{parent}/"
        inside = [name.removeprefix(prefix) for name in self.datasets if name.startswith(prefix)]
        return sorted({name.partition("/")[0] for name in inside if "/" in name})

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
            self._readers[name] = DatasetReader(
                self.path, name, self._file[name], self.made_by, self._expected[name]
            )
        return self._readers[name]

    def length(self, name: str) -> int:
        """Return how long the first axis of a dataset is, 0 where there is none of the name."""
        shape, _ = self._contents.datasets.get(name, ((0,), ""))
        return shape[0]

    def require(self, group: str = "", **lengths: int) -> None:
        """Raise ArtifactError unless axes have the lengths that others give them, in a group."""
        schema = SCHEMAS[self.text("schema")]
        for name, (shape, _) in self._contents.datasets.items():
            field = find_field(schema.datasets, name)
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
        try:
            self.verify_datasets()
        except Fault as fault:
            raise explanation(self.path, fault, self.made_by) from fault

    def verify_datasets(self, up_to_bytes: float = math.inf) -> None:
        """Verify the datasets up to a size [bytes]; raise Fault when one is damaged."""
        for name in self._contents.digests:
            reader = self.dataset(name)
            if reader.nbytes <= up_to_bytes:
                reader.verify()


def read_density(artifact: Artifact, snapshot: int) -> NDArray[np.float64]:
    """Return the density (n_particles,) [kg/m3] of one snapshot, from its stored fluctuation."""
    return artifact.dataset("density_fluctuation")[snapshot] + artifact.number("reference_density")


@contextlib.contextmanager
def _checked(
    path: Path,
    schema: str,
    made_by: str,
    inputs_digest: str | None,
    case_text: str | None,
    lineage: Mapping[str, Identity],
) -> Iterator[Artifact]:
    """Open and check an artifact. Raises Fault."""
    with open_file(path) as file:
        contents = check_contents(file, schema)
        check_origin(contents, inputs_digest, case_text, lineage)
        artifact = Artifact(path, file, contents, made_by)
        artifact.verify_datasets(SMALL_BYTES)
        yield artifact
