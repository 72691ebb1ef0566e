"""Declare a kind of artifact once, as a class: its schema, documentation and types follow.

    class Basis(Record, kind="sphrom/basis"):
        \"\"\"Trial bases.\"\"\"

        volume: Array = dataset("particle", "m2", "area that each point stands for", "V")
        bases: Mapping[str, Modes] = part(at_least_one=True)
        inner_product: str = attribute("", "inner product of the modes")

A field's type says how it is stored: an array as a dataset, a number or text as an attribute,
another record as a group, and a mapping as so many of them, each under its key. What has a default
is optional. A record is read and written as a whole, or group by group
(`sphrom.artifacts.record_values`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass
from types import NoneType, UnionType
from typing import (
    Any,
    Literal,
    Self,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.schema import AttributeField, DatasetField, Schema

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

DEGREES = ("constant", "linear", "quadratic", "cubic")
"""Names of the tensors of a polynomial."""
_KINDS = {float: "float", int: "int", str: "text", Literal: "text", tuple: "floats"}


@dataclass(frozen=True)
class Description:
    """What a declaration says of a field beside its type."""

    meaning: str = ""
    units: str = ""
    axes: tuple[str, ...] = ()
    symbol: str = ""
    equation: str = ""
    at: str | None = None
    """Its path in the group of the record, where that isn't its name."""
    names: Mapping[str, str] | None = None
    """What stands for `*` in its path, and for `%s` in its meaning."""
    at_least_one: bool = False


def dataset(
    axes: str,
    units: str,
    meaning: str,
    symbol: str = "",
    equation: str = "",
    *,
    at: str | None = None,
    names: Mapping[str, str] | None = None,
    default: Any = MISSING,
    default_factory: Any = MISSING,
) -> Any:
    """Declare a dataset with axes such as `snapshot particle`; `names` those of a mapping."""
    told = Description(meaning, units, tuple(axes.split()), symbol, equation, at, names)
    return _field(told, default, default_factory)


def tensors(
    degree: int,
    units: str,
    meaning: str,
    equation: str = "",
    *,
    by: str = "",
    symbols: str = "    ",
    at: str | None = None,
    default: Any = MISSING,
) -> Any:
    """Declare the tensors of a polynomial in the modes' coordinates, `by` an axis before them."""
    axes = (*by.split(), *("mode",) * (degree + 1))
    names = dict.fromkeys(DEGREES[: degree + 1], "")
    return _field(Description(meaning, units, axes, symbols, equation, at, names), default)


def attribute(
    units: str,
    meaning: str,
    *,
    at: str | None = None,
    default: Any = MISSING,
    default_factory: Any = MISSING,
) -> Any:
    """Declare an attribute."""
    return _field(Description(meaning, units, at=at), default, default_factory)


def part(
    *,
    at: str | None = None,
    at_least_one: bool = False,
    default: Any = MISSING,
    default_factory: Any = MISSING,
) -> Any:
    """Declare a group that is a record of its own; `at` may be `""`, for one in the same group."""
    return _field(Description(at=at, at_least_one=at_least_one), default, default_factory)


def _field(told: Description, default: Any, default_factory: Any = MISSING) -> Any:
    given = {"default": default, "default_factory": default_factory}
    return dataclasses.field(metadata={"told": told}, **given)


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(dataset, tensors, attribute, part),
)
class Record:
    """What an artifact, or a group of one, holds; a subclass is a frozen dataclass."""

    def __init_subclass__(cls, kind: str = "") -> None:
        super().__init_subclass__()
        dataclass(frozen=True, kw_only=True, eq=False)(cls)
        if kind:
            DECLARED[kind] = cls

    @classmethod
    def of(cls, source: object, **others: Any) -> Self:
        """Return a record of what an object has under the same names, and of others."""
        names = {
            slot.name for slot in slots(cls) if not slot.optional or hasattr(source, slot.name)
        }
        return cls(**{name: getattr(source, name) for name in names - others.keys()}, **others)


DECLARED: dict[str, type[Record]] = {}
"""The kinds of artifacts."""


@dataclass(frozen=True)
class Slot:
    """A field of a record, as it is stored."""

    name: str
    path: str
    """In the group of the record; with `*` for what a mapping's keys stand for."""
    told: Description
    optional: bool
    is_mapping: bool
    item: Any
    """Its type, or that of a mapping's values."""

    @property
    def record(self) -> type[Record] | None:
        """The record that it is, if it is one."""
        is_record = isinstance(self.item, type) and issubclass(self.item, Record)
        return self.item if is_record else None

    @property
    def is_attribute(self) -> bool:
        """Whether it is a number, text or vector."""
        return not self.told.axes

    @property
    def is_tensors(self) -> bool:
        """Whether it is the tensors of a polynomial."""
        return get_origin(self.item) is tuple and not self.is_attribute

    def fields(self, group: str, optional: bool) -> Iterator[DatasetField | AttributeField]:
        """Yield what is stored of it, where a record in `group` has it."""
        path, told, required = joined(group, self.path), self.told, not (optional or self.optional)
        if self.is_attribute:
            kind = _KINDS[get_origin(self.item) or self.item]
            allowed = get_args(self.item) if get_origin(self.item) is Literal else ()
            yield AttributeField(path, kind, told.units, told.meaning, required, allowed)
        elif self.is_tensors:
            rest = len(told.axes) - len(told.names or ())
            for degree, name in enumerate(told.names or ()):
                yield DatasetField(
                    joined(path, name), told.axes[: rest + degree + 1], told.units,
                    told.symbol[degree].strip(), told.equation, f"{name} {told.meaning}", required,
                )  # fmt: skip
        else:
            dtype = np.dtype(get_args(get_args(self.item)[1])[0]).name
            for one, meaning in self.paths(path).items():
                yield DatasetField(
                    one, told.axes, told.units, told.symbol, told.equation,
                    told.meaning.replace("%s", meaning), required, dtype,
                )  # fmt: skip

    def paths(self, path: str) -> dict[str, str]:
        """Return the paths that a path stands for, where names are told, and their meanings."""
        if self.told.names is None:
            return {path: ""}
        head = path.removesuffix("*")
        return {f"{head}{name}": meaning for name, meaning in self.told.names.items()}


_SLOTS: dict[type[Record], tuple[Slot, ...]] = {}
"""The fields of records, which take long to look up."""


def joined(group: str, name: str) -> str:
    """Return the path of a name in a group, either of which may be empty."""
    return f"{group}/{name}" if group and name else group or name


def slots(record: type[Record]) -> tuple[Slot, ...]:
    """Return the fields of a record, as they are stored."""
    if record not in _SLOTS:
        hints = get_type_hints(record)
        fields = dataclasses.fields(record)  # type: ignore[arg-type]
        _SLOTS[record] = tuple(_slot(field, hints[field.name]) for field in fields)
    return _SLOTS[record]


def _slot(field: dataclasses.Field[Any], hint: Any) -> Slot:
    told: Description = field.metadata["told"]
    if get_origin(hint) in (UnionType, Union):
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    is_mapping = get_origin(hint) is Mapping
    path = field.name if told.at is None else told.at
    if is_mapping:
        path = path if "*" in path else joined(path, "*")
        hint = get_args(hint)[1]
    optional = field.default is not MISSING or field.default_factory is not MISSING
    return Slot(field.name, path, told, optional, is_mapping, hint)


def fields_of(
    record: type[Record], group: str = "", optional: bool = False
) -> Iterator[DatasetField | AttributeField]:
    """Yield every dataset and attribute of a record, and of the records in it."""
    for slot in slots(record):
        if slot.record is None:
            yield from slot.fields(group, optional)
        else:
            # There may be none of several, but each is whole.
            may_lack = not slot.is_mapping and (optional or slot.optional)
            yield from fields_of(slot.record, joined(group, slot.path), may_lack)


def schema_of_record(kind: str, record: type[Record]) -> Schema:
    """Return the schema of a kind of artifact."""
    found = tuple(fields_of(record))
    return Schema(
        kind,
        (record.__doc__ or "").partition("\n")[0].removesuffix("."),
        tuple(field for field in found if isinstance(field, DatasetField)),
        tuple(field for field in found if isinstance(field, AttributeField)),
        tuple(slot.path for slot in slots(record) if slot.told.at_least_one),
    )


def stored_bytes(record: type[Record], *names: str, **lengths: int) -> int:
    """Return the size [bytes] of datasets of a record: of those named, or whose axes are given.

    Those of which there may be several, in a mapping, don't count.
    """
    found = {field.name: field for field in fields_of(record) if isinstance(field, DatasetField)}
    known = [n for n, f in found.items() if "*" not in n and lengths.keys() >= {*f.axes}]
    return sum(found[name].nbytes(**lengths) for name in names or known)
