"""What tells one artifact from another: its uuid and the digest of its content.

The digest covers the datasets, each in C order, and the attributes that a stage set, in the order
of their names; not when, where or how fast the artifact was made. Two runs that compute the same
bits have the same digest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from sphrom.artifacts.layout import Value, matches
from sphrom.artifacts.schema import PROVENANCE, TIMING


@dataclass(frozen=True)
class Identity:
    """One artifact, as those made from it remember it."""

    path: str
    uuid: str
    content_sha256: str


def content_digest(
    schema: str, attributes: Mapping[str, Value], datasets: Mapping[str, str]
) -> str:
    """Return the digest of the attributes by path and of `dataset_line`s by dataset."""
    lines = [schema]
    for name, value in sorted(attributes.items()):
        if not _is_provenance(name):
            lines.append(f"{name} = {_canonical(value)}")
    lines += [f"{name}: {line}" for name, line in sorted(datasets.items())]
    return hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest()


def dataset_line(dtype: object, shape: tuple[int, ...], digest: str) -> str:
    """Return what `content_digest` needs of one dataset."""
    return f"{dtype} {shape} {digest}"


def text_digest(text: str) -> str:
    """Return the digest of a text."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _is_provenance(name: str) -> bool:
    return any(matches(field.name, name) for field in (*PROVENANCE, TIMING))


def _canonical(value: Value) -> str:
    if isinstance(value, tuple):
        return f"[{' '.join(number.hex() for number in value)}]"
    return value.hex() if isinstance(value, float) else repr(value)
