"""What an artifact can hold: names, types, shapes and axes, and its digest.

The writer asks before it publishes a file; that a file holds what was written is for the digests.
Nothing here opens a file: `found` maps a dataset's name to its shape and type.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.declaration import (
    PROVENANCE,
    TIMING,
    Field,
    Schema,
    find_field,
    joined,
    matches,
)

Shape = tuple[int, ...]
Found = Mapping[str, tuple[Shape, "np.dtype[np.generic]"]]
Value = str | int | float | tuple[float, ...]

LARGEST = 1e100
"""Magnitude that no value exceeds: sums of squares of larger ones may overflow."""
COORDINATES = {"snapshot": "time"}
"""Datasets that tell where along an axis its entries are."""

_SEGMENT = re.compile(r"[A-Za-z0-9_+=-][A-Za-z0-9_.+=,-]*")


def valid_name(name: str) -> bool:
    """Whether `name` is a path of groups that no tool will misread."""
    return all(_SEGMENT.fullmatch(segment) for segment in name.split("/"))


def index_not_finite(values: NDArray[Any]) -> tuple[int, ...] | None:
    """Return the index of the first value that is NaN, infinite or too large, if there is one."""
    if values.dtype.kind != "f":
        return None
    most = min(LARGEST, float(np.finfo(values.dtype).max))
    finite = (values >= -most) & (values <= most)
    if finite.all():
        return None
    return tuple(int(index) for index in np.unravel_index(np.argmin(finite), values.shape))


def attribute_value(field: Field, value: object) -> Value:
    """Return `value` as the plain Python value that its field asks for.

    Raises ValueError when it is of another kind, none of those allowed, or not finite.
    """
    if field.kind == "text" and isinstance(value, str):
        if field.allowed and value not in field.allowed:
            raise ValueError(f"{field.name} is {value!r}, none of {', '.join(field.allowed)}")
        return str(value)
    numbers = np.asarray(value)
    kinds = {"int": "iu", "float": "fiu", "floats": "fiu"}.get(field.kind, "")
    if numbers.dtype.kind not in kinds or numbers.ndim != (field.kind == "floats"):
        raise ValueError(f"{field.name} is {value!r}, not of kind {field.kind}")
    if index_not_finite(numbers) is not None:
        raise ValueError(f"{field.name} is {value!r}, not finite")
    if field.kind == "int":
        return int(numbers)
    return tuple(map(float, numbers)) if field.kind == "floats" else float(numbers)


def layout_problem(schema: Schema, found: Found, attributes: Mapping[str, Value]) -> str | None:
    """Return what is missing, or does not fit, of datasets and attributes, in words, or None."""
    fields = (*PROVENANCE, TIMING, *schema.attributes)
    names = [*attributes, *found]
    missing = [*_missing(schema.datasets, found, found), *_missing(fields, attributes, names)]
    if missing:
        return f"{missing[0]} is missing"
    lengths: dict[tuple[str, str], tuple[str, int]] = {}
    common = common_axes(schema)
    for name, (shape, _) in sorted(found.items()):
        field = schema.dataset(name)
        if field is None:
            continue
        for axis, length in zip(field.axes, shape, strict=True):
            place = scope_of(field, name, axis, common), axis
            other, known = lengths.setdefault(place, (name, length))
            if known != length:
                return f"{name} has {length} along {axis}, but {other} has {known}"
    return None


def _missing(
    fields: Iterable[Field], there: Mapping[str, object], names: Iterable[str]
) -> Iterator[str]:
    """Yield the required datasets or attributes of those groups that are there."""
    for field in fields:
        if field.required:
            yield from (name for name in _instances(field.name, names) if name not in there)


def _instances(pattern: str, names: Iterable[str]) -> list[str]:
    """Fill in `*` with each group that is there; a pattern without `*` is its own instance."""
    head, star, tail = pattern.rpartition("*/")
    if not star:
        return [] if pattern.endswith("*") else [pattern]
    depth = head.count("/") + 1
    groups = {"/".join(name.split("/")[:depth]) for name in names if name.count("/") >= depth}
    return sorted(f"{group}/{tail}" for group in groups if matches(f"{head}*", group))


def common_axes(schema: Schema) -> set[str]:
    """Return the axes that have one length in the whole artifact."""
    return {axis for field in schema.datasets if "*" not in field.name for axis in field.axes}


def scope_of(field: Field, name: str, axis: str, common: set[str]) -> str:
    """Return the group within which an axis of a dataset has one length; `""` for the root.

    A dataset that itself stands for a `*` is alone with its axes.
    """
    if axis in common or "*" not in field.name:
        return ""
    return "/".join(name.split("/")[: field.name.rpartition("*")[0].count("/") + 1])


class Axes:
    """The names of the axes of an artifact's datasets, by path: each path has one length."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        self._common = common_axes(schema)
        self.lengths: dict[str, int] = {}

    def paths(self, name: str, field: Field, shape: Shape) -> list[str]:
        """Return where the axes of a dataset are named."""
        return [self._path(name, field, i, length) for i, length in enumerate(shape)]

    def _path(self, name: str, field: Field, i: int, length: int) -> str:
        axis = field.axes[i]
        scope = scope_of(field, name, axis, self._common)
        scope = scope.rpartition("/")[0] if scope == name else scope
        path = joined(scope, axis)
        if self._is_group(path):
            path = f"{path}/{axis}"
        if axis in field.axes[:i]:  # no two axes of a dataset have one name
            path = f"{path}_{field.axes[: i + 1].count(axis)}"
        if self.lengths.get(path, length) != length:
            path = f"{path}_{name.rpartition('/')[2]}"
        self.lengths[path] = length
        return path

    def _is_group(self, path: str) -> bool:
        """Whether a group that holds datasets has this path."""
        depth = path.count("/") + 1
        groups = (field.name.split("/")[:-1][:depth] for field in self._schema.datasets)
        return any(matches("/".join(group), path) for group in groups)


@dataclass(frozen=True)
class Identity:
    """What tells an artifact from another, as those made from it remember it.

    The digest covers the datasets, each in C order, and the attributes that a stage set, in the
    order of their names; not when, where or how fast the artifact was made. Two runs that compute
    the same bits have the same digest.
    """

    path: str
    uuid: str
    content_sha256: str


def content_digest(
    schema: str, attributes: Mapping[str, Value], datasets: Mapping[str, str]
) -> str:
    """Return the digest of the attributes by path and of `dataset_line`s by dataset."""
    provenance = (*PROVENANCE, TIMING, Field("lineage/*/*", "text"))
    own = {
        name: value for name, value in attributes.items() if find_field(provenance, name) is None
    }
    lines = [schema, *(f"{name} = {_canonical(value)}" for name, value in sorted(own.items()))]
    lines += [f"{name}: {line}" for name, line in sorted(datasets.items())]
    return text_digest("\n".join(lines))


def dataset_line(dtype: object, shape: Shape, digest: str) -> str:
    """Return what `content_digest` needs of one dataset."""
    return f"{dtype} {shape} {digest}"


def text_digest(text: str) -> str:
    """Return the digest of a text."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _canonical(value: Value) -> str:
    if isinstance(value, tuple):
        return f"[{' '.join(number.hex() for number in value)}]"
    return value.hex() if isinstance(value, float) else repr(value)
