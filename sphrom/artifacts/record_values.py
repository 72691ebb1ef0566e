"""Read and write what an artifact holds, or a group of it, as a record."""

from __future__ import annotations

from typing import Any, TypeVar

from sphrom.artifacts.declaration import Record, Slot, joined, slots
from sphrom.artifacts.layout import matches
from sphrom.artifacts.reader import Artifact
from sphrom.artifacts.writer import ArtifactWriter
from sphrom.errors import ArtifactError

R = TypeVar("R", bound=Record)


def write_record(artifact: ArtifactWriter, record: Record, group: str = "") -> None:
    """Write a record into a group of an artifact, or into its root.

    Raises ArtifactError when it can't be written or isn't finite, ValueError when an array is not
    of the type and the axes that are declared.
    """
    for slot in slots(type(record)):
        value, path = getattr(record, slot.name), joined(group, slot.path)
        if slot.is_mapping:
            for key, one in value.items():
                _write(artifact, slot, one, _filled(path, key))
        elif value is not None:
            _write(artifact, slot, value, path)


def _write(artifact: ArtifactWriter, slot: Slot, value: Any, path: str) -> None:
    if slot.record is not None:
        write_record(artifact, value, path)
    elif slot.is_attribute:
        artifact.annotate(path, value)
    elif slot.is_tensors:
        for name, tensor in zip(slot.told.names or (), value, strict=True):
            artifact.write(joined(path, name), tensor)
    else:
        artifact.write(path, value)


def read_record(artifact: Artifact, record: type[R], group: str = "") -> R:
    """Read a group of an artifact, or its root, as a record.

    Raises ArtifactError when it is damaged, or lacks what older versions didn't write.
    """
    found: dict[str, Any] = {}
    for slot in slots(record):
        path = joined(group, slot.path)
        if slot.is_mapping:
            found[slot.name] = _mapping(artifact, record, slot, path)
        elif not slot.optional or _holds(artifact, path):
            found[slot.name] = _read(artifact, slot, path)
    return record(**found)


def _read(artifact: Artifact, slot: Slot, path: str) -> Any:
    if slot.record is not None:
        return read_record(artifact, slot.record, path)
    if slot.is_tensors:
        return tuple(_stored(artifact, joined(path, name)) for name in slot.told.names or ())
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


def _mapping(artifact: Artifact, record: type[Record], slot: Slot, path: str) -> dict[str, Any]:
    """Read what a mapping has, but for what has a name of its own in the record."""
    depth = path.count("/") + 1
    names = artifact.attributes if slot.is_attribute and not slot.record else artifact.datasets
    heads = {"/".join(name.split("/")[:depth]) for name in names}
    parent = path.rpartition("/")[0]
    named = {joined(parent, other.path) for other in slots(record)} - {path}
    if slot.told.names is not None:
        heads &= slot.paths(path).keys()
    chosen = sorted(head for head in heads - named if matches(path, head))
    return {_key(path, head): _read(artifact, slot, head) for head in chosen}


def _holds(artifact: Artifact, path: str) -> bool:
    """Whether there is a dataset, an attribute or a group."""
    if path in artifact or path in artifact.attributes:
        return True
    names = (*artifact.datasets, *artifact.attributes)
    return any(name.startswith(f"{path}/") for name in names)


def _filled(pattern: str, key: str) -> str:
    """Return a path with what stands for its `*`."""
    for segment in key.split("/"):
        pattern = pattern.replace("*", segment, 1)
    return pattern


def _key(pattern: str, path: str) -> str:
    """Return what stands for the `*` of a path."""
    pairs = zip(pattern.split("/"), path.split("/"), strict=True)
    return "/".join(given for expected, given in pairs if expected == "*")
