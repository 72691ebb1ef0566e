"""What is said of each dataset and attribute of an artifact, from which files are checked.

A schema lists the datasets and attributes of one kind of artifact. In a name, `*` stands for one
group that the writer names, such as a basis or a parameter. Axes are named: within one artifact an
axis has one length, and within a `*` group its own axes have theirs. Schemas are made from records
(`sphrom.artifacts.declaration`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# Another major version is refused; a newer minor version only adds.
SCHEMA_VERSION = "1.1"


@dataclass(frozen=True)
class DatasetField:
    """One dataset of a schema: what it holds, along which axes, in which units."""

    name: str
    axes: tuple[str, ...]
    units: str
    symbol: str
    equation: str
    meaning: str
    required: bool = True
    dtype: str = "float64"

    @property
    def per_snapshot(self) -> bool:
        """Whether each entry of the first axis is a whole field, and so a chunk of its own."""
        return self.axes[:1] in (("snapshot",), ("mode",)) and "particle" in self.axes

    @property
    def rises(self) -> bool:
        """Whether it counts the times or steps of snapshots, each above the one before."""
        return self.axes == ("snapshot",) and self.symbol in ("t", "n")

    @property
    def is_place(self) -> bool:
        """Whether it holds positions in the domain."""
        return self.units == "m" and self.axes[-1:] == ("component",)

    @property
    def labels(self) -> dict[str, str]:
        """What tells of its values; units and the long name are netCDF's."""
        return {
            "units": self.units,
            "long_name": self.meaning,
            "symbol": self.symbol,
            "equation": self.equation,
        }

    def nbytes(self, **lengths: int) -> int:
        """Return its size [bytes] with axes of some lengths."""
        return np.dtype(self.dtype).itemsize * math.prod(lengths[axis] for axis in self.axes)


@dataclass(frozen=True)
class AttributeField:
    """One attribute of a schema: `kind` is `float`, `floats` (a vector), `int` or `text`."""

    name: str
    kind: str
    units: str
    meaning: str
    required: bool = True
    allowed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Schema:
    """One kind of artifact: its datasets, attributes, and groups of which there is at least one."""

    name: str
    meaning: str
    datasets: tuple[DatasetField, ...]
    attributes: tuple[AttributeField, ...] = ()
    at_least_one: tuple[str, ...] = ()


# Written at the root of every artifact by the writer itself; no part of the content's digest.
PROVENANCE = (
    AttributeField("schema", "text", "", "kind of artifact"),
    AttributeField("schema_version", "text", "", "version of the kind; another major is refused"),
    AttributeField("stage", "text", "", "command that wrote the artifact"),
    AttributeField("uuid", "text", "", "identity of this very file"),
    AttributeField("software", "text", "", "program that wrote the artifact"),
    AttributeField("softwareVersion", "text", "", "its version"),
    AttributeField("date", "text", "", "when writing began, UTC"),
    AttributeField("machine", "text", "", "number of cores of the machine"),
    AttributeField("case_sha256", "text", "", "digest of the resolved case"),
    AttributeField("inputs_sha256", "text", "", "digest of the part of the case that matters here"),
    AttributeField("wall_seconds", "float", "s", "time from opening to closing the artifact"),
    AttributeField("threads", "int", "", "threads that the stage used"),
    AttributeField("content_sha256", "text", "", "digest of the datasets and attributes"),
)

# Wall-clock of the parts of a stage; no part of the content's digest.
TIMING = AttributeField("timing/*", "float", "s", "time spent in a part of the stage", False)
