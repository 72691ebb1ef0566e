"""Compare what an artifact holds with its schema: names, types, shapes, axes and attributes.

The writer asks before it publishes a file, the reader before it hands one out. Nothing here opens
a file: `found` maps a dataset's name to its shape and type.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import TypeVar

import numpy as np

from sphrom.artifacts.ranges import length_problem, range_of
from sphrom.artifacts.schema import PROVENANCE, TIMING, AttributeField, DatasetField, Schema

Shape = tuple[int, ...]
Found = Mapping[str, tuple[Shape, "np.dtype[np.generic]"]]
Value = str | int | float | tuple[float, ...]
Field = TypeVar("Field", DatasetField, AttributeField)

_SEGMENT = re.compile(r"[A-Za-z0-9_+=-][A-Za-z0-9_.+=,-]*")


def valid_name(name: str) -> bool:
    """Whether `name` is a path of groups that no tool will misread."""
    return all(_SEGMENT.fullmatch(segment) for segment in name.split("/"))


def matches(pattern: str, name: str) -> bool:
    """Whether `name` is `pattern`, each `*` standing for one group or attribute."""
    if "*" not in pattern:
        return pattern == name
    expected, given = pattern.split("/"), name.split("/")
    return len(expected) == len(given) and all(
        one in ("*", other) for one, other in zip(expected, given, strict=True)
    )


def find_field(fields: Iterable[Field], name: str) -> Field | None:
    """Return the field that describes `name`; one without `*` comes before one with."""
    fitting = [field for field in fields if matches(field.name, name)]
    return min(fitting, key=lambda field: field.name.count("*"), default=None)


def attribute_fields(schema: Schema) -> tuple[AttributeField, ...]:
    """Return the attributes that a stage may set on an artifact of this schema."""
    return (*schema.attributes, TIMING)


def attribute_value(field: AttributeField, value: object) -> Value:
    """Return `value` as the plain Python value that its field asks for.

    Raises ValueError when it is of another kind, or one that it can't be.
    """
    plain = _of_kind(field, value)
    problem = None if isinstance(plain, str) else range_of(field).problem(plain)
    if problem:
        raise ValueError(f"{field.name} {problem}")
    return plain


def _of_kind(field: AttributeField, value: object) -> Value:
    if isinstance(value, np.generic):
        value = value.item()
    if field.kind == "text" and isinstance(value, str):
        if field.allowed and value not in field.allowed:
            raise ValueError(f"{field.name} is {value!r}, none of {', '.join(field.allowed)}")
        return value
    if field.kind == "int" and isinstance(value, int) and not isinstance(value, bool):
        return value
    if field.kind in ("float", "floats"):
        return _numbers(field, value)
    raise ValueError(f"{field.name} is {value!r}, not of kind {field.kind}")


def _numbers(field: AttributeField, value: object) -> float | tuple[float, ...]:
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "fiu" or numbers.ndim != (field.kind == "floats"):
        raise ValueError(f"{field.name} is {value!r}, not of kind {field.kind}")
    if field.kind == "floats":
        return tuple(float(number) for number in numbers)
    return float(numbers)


def layout_problem(schema: Schema, found: Found) -> str | None:
    """Return what is wrong with the datasets `found`, in words, or None."""
    return next(_dataset_problems(schema, found), None)


def attributes_problem(
    schema: Schema, values: Mapping[str, object], datasets: Iterable[str]
) -> str | None:
    """Return what is wrong with attributes by path, their datasets' groups given, or None."""
    names = [*values, *datasets]
    for field in (*PROVENANCE, *schema.attributes):
        if field.required:
            for name in _instances(field.name, names):
                if name not in values:
                    return f"attribute {name} is missing"
    for name, value in values.items():
        known = find_field((*PROVENANCE, *attribute_fields(schema)), name)
        if known is not None:
            try:
                attribute_value(known, value)
            except ValueError as error:
                return f"attribute {error}"
    return None


def _dataset_problems(schema: Schema, found: Found) -> Iterator[str]:
    for field in schema.datasets:
        if field.required:
            for name in _instances(field.name, found):
                if name not in found:
                    yield f"dataset {name} is missing"
    for group in schema.at_least_one:
        if not any(_instances(f"{group}/", found)):
            yield f"group {group} is missing: there must be at least one"
    yield from _shape_problems(schema, found)


def _instances(pattern: str, names: Iterable[str]) -> list[str]:
    """Fill in `*` with each group that is there; a pattern without `*` is its own instance."""
    head, star, tail = pattern.rpartition("*/")
    if not star:
        return [] if pattern.endswith("*") else [pattern]
    depth = head.count("/") + 1
    groups = {"/".join(name.split("/")[:depth]) for name in names if name.count("/") >= depth}
    return sorted(f"{group}/{tail}" for group in groups if matches(f"{head}*", group))


def _shape_problems(schema: Schema, found: Found) -> Iterator[str]:
    lengths: dict[tuple[str, str], tuple[int, str]] = {}
    common = common_axes(schema)
    for name, (shape, dtype) in sorted(found.items()):
        field = find_field(schema.datasets, name)
        if field is None:
            continue
        if dtype != np.dtype(field.dtype):
            yield f"dataset {name} is of type {dtype}, not {field.dtype}"
        if len(shape) != len(field.axes):
            yield f"dataset {name} has {len(shape)} axes, not {len(field.axes)}: {field.axes}"
            continue
        for axis, length in zip(field.axes, shape, strict=True):
            scope = scope_of(field, name, axis, common)
            first, other = lengths.setdefault((scope, axis), (length, name))
            if first != length:
                yield f"{name} has {length} along {axis}, but {other} has {first}"
    groups: dict[str, dict[str, int]] = defaultdict(dict)
    for (scope, axis), (length, _) in lengths.items():
        groups[scope][axis] = length
    for scope, own in groups.items():
        if problem := length_problem(own):
            yield f"{scope or 'it'} {problem}"


def common_axes(schema: Schema) -> set[str]:
    """Return the axes that have one length in the whole artifact."""
    return {axis for field in schema.datasets if "*" not in field.name for axis in field.axes}


def scope_of(field: DatasetField, name: str, axis: str, common: set[str]) -> str:
    """Return the group within which an axis of a dataset has one length; `""` for the root.

    A dataset that itself stands for a `*` is alone with its axes.
    """
    if axis in common or "*" not in field.name:
        return ""
    return "/".join(name.split("/")[: field.name.rpartition("*")[0].count("/") + 1])
