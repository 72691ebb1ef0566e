"""What an artifact can hold: names, values, and its digest.

No file is opened here.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.declaration import PROVENANCE, TIMING, Field, find_field

Shape = tuple[int, ...]
Value = str | int | float | tuple[float, ...]

LARGEST = 1e100
"""Magnitude that no value exceeds: sums of squares of larger ones may overflow."""

_SEGMENT = re.compile(r"[A-Za-z0-9_+=-][A-Za-z0-9_.+=,-]*")
_OF_KIND: Mapping[str, Callable[[Any], Value]] = {
    "text": str,
    "int": int,
    "float": float,
    "floats": lambda values: tuple(map(float, values)),
}


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

    Raises ValueError when it is none of those allowed, or not finite, TypeError when it is of
    another kind.
    """
    plain = _OF_KIND[field.kind](value)
    allowed = not field.allowed or plain in field.allowed
    if not allowed or index_not_finite(np.asarray(plain)) is not None:
        raise ValueError(f"{field.name} can't be {value!r}")
    return plain


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


@dataclass(frozen=True)
class Origin:
    """What an artifact is made with and from, and has to have been made with and from."""

    inputs_digest: str
    """The digest of those parts of the case that it depends on."""
    case_text: str
    """The whole case."""
    sections: Collection[str] = ()
    """The sections of the case that it depends on."""
    consequences: Callable[[str], str] = lambda text: ""
    """Tells in words what follows otherwise from another case, given its text."""
    lineage: Mapping[str, Identity] = dataclasses.field(default_factory=dict)
    """The artifacts that it is made from, by role."""


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
