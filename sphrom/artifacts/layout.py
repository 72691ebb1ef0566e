"""The allowed contents of an artifact: names, values, and its digest. No file is opened here."""

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
Form = tuple[Shape, np.dtype[np.generic]]
"""The shape and the type of a dataset."""
Value = str | int | float | tuple[float, ...]

LARGEST = 1e100
"""Largest allowed magnitude of a value: sums of squares of larger ones may overflow."""

_SEGMENT = re.compile(r"[A-Za-z0-9_+=-][A-Za-z0-9_.+=,-]*")
_OF_KIND: Mapping[str, Callable[[Any], Value]] = {
    "text": str,
    "int": int,
    "float": float,
    "floats": lambda values: tuple(map(float, values)),
}


def valid_name(name: str) -> bool:
    """Whether `name` is a path of groups that every tool reads alike."""
    return all(_SEGMENT.fullmatch(segment) for segment in name.split("/"))


def index_not_finite(values: NDArray[Any]) -> tuple[int, ...] | None:
    """Return the index of the first value that is NaN, infinite or too large, or None."""
    if values.dtype.kind != "f":
        return None
    most = min(LARGEST, float(np.finfo(values.dtype).max))
    finite = (values >= -most) & (values <= most)
    if finite.all():
        return None
    return tuple(int(index) for index in np.unravel_index(np.argmin(finite), values.shape))


def attribute_value(field: Field, value: object) -> Value:
    """Return `value` as a plain Python value of the field's kind.

    Raises ValueError if it is not allowed or not finite, TypeError if it is of another kind.
    """
    plain = _OF_KIND[field.kind](value)
    allowed = not field.allowed or plain in field.allowed
    if not allowed or index_not_finite(np.asarray(plain)) is not None:
        raise ValueError(f"{field.name} can't be {value!r}")
    return plain


@dataclass(frozen=True)
class Identity:
    """The identity of an artifact, as recorded in artifacts made from it.

    The digest covers the datasets, each in C order, and the attributes set by the stage, in the
    order of their names, but not when, where and how fast it was made: same bits, same digest.
    """

    path: str
    uuid: str
    content_sha256: str


@dataclass(frozen=True)
class Origin:
    """The case and the inputs of an artifact; a stored artifact is checked against them."""

    inputs_digest: str
    """The digest of the parts of the case that the artifact depends on."""
    case_text: str
    """The whole case."""
    sections: Collection[str] = ()
    """The sections of the case that the artifact depends on."""
    consequences: Callable[[str], str] = lambda text: ""
    """Return, in words, the derived values that differ for another case, given its text."""
    lineage: Mapping[str, Identity] = dataclasses.field(default_factory=dict)
    """The artifacts that it is made from, by role."""
    n_dim: int = 2
    """The number of dimensions of the case, from which units follow."""


def content_digest(
    schema: str,
    attributes: Mapping[str, Value],
    forms: Mapping[str, Form],
    digests: Mapping[str, str],
) -> str:
    """Return the digest of attributes (by path) and datasets (forms and digests by name)."""
    provenance = (*PROVENANCE, TIMING, Field("lineage/*/*", "text"))
    lines = [schema]
    for name, value in sorted(attributes.items()):
        if find_field(provenance, name) is None:
            text = value.hex() if isinstance(value, float) else repr(value)
            if isinstance(value, tuple):
                text = f"[{' '.join(number.hex() for number in value)}]"
            lines.append(f"{name} = {text}")
    for name, digest in sorted(digests.items()):
        shape, dtype = forms[name]
        lines.append(f"{name}: {dtype} {shape} {digest}")
    return text_digest("\n".join(lines))


def text_digest(text: str) -> str:
    """Return the digest of a text."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()
