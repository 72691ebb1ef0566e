"""Declare a kind of artifact as a class, from which its schema, documentation and types follow.

    class Basis(Record, kind="sphrom/basis"):
        \"\"\"Trial bases.\"\"\"

        volume: Array = dataset("particle", "m2", "area that each point stands for", "V")
        bases: Mapping[str, Modes] = part()
        inner_product: str = attribute("", "inner product of the modes")

The type of a field determines how it is stored: an array as a dataset, a number or text as an
attribute, a record as a group, and a mapping as one of these per key. A field with a default is
optional. Only fields that are declared by the functions of this module are stored. The module does
not deal with files, so dataclasses of the numerics can be records.

A schema lists the datasets and attributes of a kind of artifact. In a name, `*` stands for one
group that the writer names, such as a basis or a parameter. Axes have names. An axis has one length
within an artifact; axes of a `*` group have one length within each group.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, replace
from types import NoneType, UnionType
from typing import (
    Any,
    Literal,
    NamedTuple,
    Self,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from sphrom.arrays import Array, Indices

# Another major version is refused; a newer minor version only adds.
SCHEMA_VERSION = "1.1"

Tensors = tuple[Array, ...]
"""The tensors of a polynomial, by degree."""

DEGREES = ("constant", "linear", "quadratic", "cubic")
"""Names of the tensors of a polynomial."""
_KINDS = {
    Array: "float64", Indices: "int64", Tensors: "tensors",
    float: "float", int: "int", str: "text", tuple[float, ...]: "floats",
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """A dataset, an attribute or a group, as records declare and schemas list them."""

    name: str
    """Path in the group of its record, or in the file; `*` stands for a mapping's keys."""
    kind: str
    """`float64`, `int64` or `tensors` for datasets; `float`, `floats` (a vector), `int` or `text`
    for attributes; `group`."""
    units: str = ""
    """The unit in a plane, where extensive quantities are per metre of depth."""
    meaning: str = ""
    in_space: str = ""
    """The units in three dimensions, if they are others."""
    required: bool = True
    axes: tuple[str, ...] = ()
    """Axes of a dataset; for several tensors, those of the highest degree."""
    symbol: str = ""
    equation: str = ""
    allowed: tuple[str, ...] = ()
    """The allowed texts of an attribute; if empty, any."""
    names: Mapping[str, str | Mapping[str, Any]] | None = None
    """The texts that may replace `*` in its name, each with the text for `%s` in its meaning, or
    with the parts of its own declaration."""
    is_mapping: bool = False
    record: type[Record] | None = None
    """The record of a group."""

    def labels(self, n_dim: int) -> dict[str, str]:
        """Return a description of the values, with units and long name as in netCDF."""
        return {
            "units": (self.in_space if n_dim > 2 else "") or self.units,
            "long_name": self.meaning,
            "symbol": self.symbol,
            "equation": self.equation,
        }


def dataset(
    axes: str,
    units: str,
    meaning: str,
    symbol: str = "",
    equation: str = "",
    *,
    in_space: str = "",
    names: Mapping[str, str | Mapping[str, Any]] | None = None,
    **others: Any,
) -> Any:
    """Declare a dataset with axes such as `snapshot particle`; `names` lists a mapping's keys.

    As in all declarations, `others` may be a name, `at`, and a `default` or `default_factory`.
    """
    return _declared(
        others,
        axes=tuple(axes.split()),
        names=names,
        units=units,
        meaning=meaning,
        in_space=in_space,
        symbol=symbol,
        equation=equation,
    )


class Labels(NamedTuple):
    """Labels that datasets of several records share."""

    units: str
    meaning: str
    symbol: str = ""
    equation: str = ""


def labelled(axes: str, labels: Labels, **others: Any) -> Any:
    """Declare a dataset with shared labels."""
    return dataset(axes, **labels._asdict(), **others)


def tensors(
    degree: int,
    units: str,
    meaning: str,
    equation: str = "",
    *,
    by: str = "",
    symbols: str = "    ",
    **others: Any,
) -> Any:
    """Declare the tensors of a polynomial in the modal coordinates; `by` is a leading axis."""
    axes = " ".join((by, *("mode",) * (degree + 1)))
    names = dict.fromkeys(DEGREES[: degree + 1], "")
    return dataset(axes, units, meaning, symbols, equation, names=names, **others)


def attribute(
    units: str,
    meaning: str,
    *,
    in_space: str = "",
    names: Mapping[str, Mapping[str, Any]] | None = None,
    **others: Any,
) -> Any:
    """Declare an attribute."""
    return _declared(others, units=units, meaning=meaning, in_space=in_space, names=names)


def part(**others: Any) -> Any:
    """Declare a record within a record; `at=""` stores it in the same group."""
    return _declared(others)


def _declared(others: dict[str, Any], **declared: Any) -> Any:
    """Declare a field; its kind and its default name follow from the class."""
    metadata = {"at": others.pop("at", None), "declared": declared}
    return dataclasses.field(metadata=metadata, **others)


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(dataset, labelled, tensors, attribute, part, dataclasses.field),
)
class Record:
    """A frozen dataclass that can be stored in an artifact, or in a group of one."""

    def __init_subclass__(cls, kind: str = "") -> None:
        super().__init_subclass__()
        dataclass(frozen=True, kw_only=True, eq=False)(cls)
        if kind:
            DECLARED[kind] = cls

    @classmethod
    def of(cls, source: object, **others: Any) -> Self:
        """Return a record with values of an object's equally named attributes, and with others."""
        fields = fields_of_record(cls).items()
        names = {name for name, field in fields if field.required or hasattr(source, name)}
        return cls(**{name: getattr(source, name) for name in names - others.keys()}, **others)

    def mapped(self, change: Callable[[Array], Any]) -> Self:
        """Return the record with `change` applied to all stored arrays, also those of its parts."""
        names = fields_of_record(type(self))
        changed = {name: _mapped(getattr(self, name), change) for name in names}
        return replace(self, **changed)  # type: ignore[type-var]


def _mapped(value: Any, change: Callable[[Array], Any]) -> Any:
    if isinstance(value, np.ndarray):
        return change(value)
    if isinstance(value, tuple):
        return tuple(map(change, value))
    if isinstance(value, Record):
        return value.mapped(change)
    if isinstance(value, Mapping):
        return {name: _mapped(one, change) for name, one in value.items()}
    return value


DECLARED: dict[str, type[Record]] = {}
"""The records of all kinds of artifacts."""
_FIELDS: dict[type[Record], dict[str, Field]] = {}
"""A cache of the fields of records, because their look-up is slow."""


def fields_of_record(record: type[Record]) -> dict[str, Field]:
    """Return the stored fields of a record by attribute name."""
    if record not in _FIELDS:
        hints = get_type_hints(record)
        fields = dataclasses.fields(record)  # type: ignore[arg-type]
        stored = (field for field in fields if "declared" in field.metadata)
        _FIELDS[record] = {field.name: _field(field, hints[field.name]) for field in stored}
    return _FIELDS[record]


def _field(field: dataclasses.Field[Any], hint: Any) -> Field:
    name, declared = field.metadata["at"], field.metadata["declared"]
    name = field.name if name is None else name
    if get_origin(hint) in (UnionType, Union):
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    is_mapping = get_origin(hint) is Mapping
    if is_mapping:
        name = name if "*" in name else joined(name, "*")
        hint = get_args(hint)[1]
    required = field.default is MISSING and field.default_factory is MISSING
    if isinstance(hint, type) and issubclass(hint, Record):
        declared = declared | {"record": hint}
        return Field(name, "group", required=required, is_mapping=is_mapping, **declared)
    allowed = get_args(hint) if get_origin(hint) is Literal else ()
    kind = "text" if allowed else _KINDS[hint]
    return Field(name, kind, required=required, is_mapping=is_mapping, allowed=allowed, **declared)


def joined(group: str, name: str) -> str:
    """Return the path of a name in a group; either may be empty."""
    return f"{group}/{name}" if group and name else group or name


def fields_of(record: type[Record], group: str = "", optional: bool = False) -> Iterator[Field]:
    """Yield the datasets and attributes of a record and of its parts, named by their paths."""
    for field in fields_of_record(record).values():
        path = joined(group, field.name)
        required = field.required and not optional
        if field.record is not None:
            # A mapping may be empty, but each of its records is complete.
            yield from fields_of(field.record, path, not (field.is_mapping or required))
        elif field.kind == "tensors":
            names = tuple(field.names or ())
            for degree, name in enumerate(names):
                yield replace(
                    field, name=joined(path, name), kind="float64", required=required,
                    axes=field.axes[: len(field.axes) - len(names) + degree + 1],
                    symbol=field.symbol[degree].strip(), meaning=f"{name} {field.meaning}",
                )  # fmt: skip
        elif field.names is not None:
            for name, declared in field.names.items():
                if isinstance(declared, str):
                    declared = {"meaning": field.meaning.replace("%s", declared)}
                named = path.removesuffix("*") + name
                yield replace(field, name=named, required=required, **declared)
        else:
            yield replace(field, name=path, required=required)


@dataclass(frozen=True)
class Schema:
    """One kind of artifact: its datasets and attributes."""

    name: str
    meaning: str
    datasets: tuple[Field, ...]
    attributes: tuple[Field, ...] = ()

    @classmethod
    def of(cls, kind: str, record: type[Record]) -> Self:
        """Return the schema of a kind of artifact that is declared as a record."""
        fields = tuple(fields_of(record))
        return cls(
            kind,
            (record.__doc__ or "").partition("\n")[0].removesuffix("."),
            tuple(field for field in fields if field.axes),
            tuple(field for field in fields if not field.axes),
        )

    def dataset(self, name: str) -> Field | None:
        """Return the field of a dataset, if the schema has it."""
        return find_field(self.datasets, name)

    def attribute(self, name: str) -> Field | None:
        """Return the field of an attribute that a stage may set."""
        return find_field((*self.attributes, TIMING), name)


def matches(pattern: str, name: str) -> bool:
    """Return whether `name` matches `pattern`, where `*` stands for one group or attribute."""
    if "*" not in pattern:
        return pattern == name
    expected = pattern.split("/")
    actual = name.split("/")
    return len(expected) == len(actual) and all(
        one in ("*", other) for one, other in zip(expected, actual, strict=True)
    )


def find_field(fields: Iterable[Field], name: str) -> Field | None:
    """Return the field that describes `name`, preferring one without `*`."""
    fitting = [field for field in fields if matches(field.name, name)]
    return min(fitting, key=lambda field: field.name.count("*"), default=None)


# Attributes that the writer adds to every artifact; the digest of the content excludes them.
PROVENANCE = (
    Field("schema", "text", "", "kind of artifact"),
    Field("schema_version", "text", "", "version of the kind; another major is refused"),
    Field("stage", "text", "", "command that wrote the artifact"),
    Field("uuid", "text", "", "identity of this file"),
    Field("software", "text", "", "program that wrote the artifact"),
    Field("softwareVersion", "text", "", "its version"),
    Field("date", "text", "", "when writing began, UTC"),
    Field("machine", "text", "", "number of cores of the machine"),
    Field("case_sha256", "text", "", "digest of the resolved case"),
    Field("inputs_sha256", "text", "", "digest of the part of the case that affects this file"),
    Field("wall_seconds", "float", "s", "time from opening to closing the artifact"),
    Field("threads", "int", "", "threads that the stage used"),
    Field("content_sha256", "text", "", "digest of the datasets and attributes"),
)

# Wall-clock time of the parts of a stage; the digest of the content excludes it.
TIMING = Field("timing/*", "float", "s", "time spent in a part of the stage", required=False)
