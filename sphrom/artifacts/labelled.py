"""Artifacts as xarray sees them: datasets with named axes, units and times, read when needed.

Values are verified like all others that are read from artifacts. This module is not imported with
the others: xarray takes longer to load than a reduced run.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from sphrom.artifacts.dataset_reader import DatasetReader
from sphrom.artifacts.layout import find_field
from sphrom.artifacts.reader import Artifact, open_artifact, schema_of
from sphrom.artifacts.records import SCHEMAS
from sphrom.artifacts.scales import COORDINATES, Axes
from sphrom.artifacts.schema import Schema
from sphrom.errors import CaseError


def open_labelled(path: str | Path, group: str = "") -> xarray.Dataset:
    """Open an artifact, or a group of one such as `bases/all`, with what belongs to all groups.

    Variables have the names that `sphrom/artifacts.md` gives them, `_` for `/`, and their units,
    meanings and symbols as attributes; runs can be selected by time. Values are read when they are
    needed, so the file stays open until the dataset is closed. The attribute `groups` lists the
    groups that can be opened.

    Raises ArtifactError when the file is missing, damaged or no artifact, CaseError when it has no
    such group.
    """
    kind = schema_of(path)
    with contextlib.ExitStack() as stack:
        artifact = stack.enter_context(open_artifact(path, kind, made_by="sphrom run CASE"))
        labelled = _labelled(artifact, SCHEMAS[kind], group.strip("/"))
        labelled.set_close(stack.pop_all().close)
    return labelled


def _labelled(artifact: Artifact, schema: Schema, group: str) -> xarray.Dataset:
    homes = {name: _home(schema, name) for name in artifact.datasets}
    groups = sorted({home for home in homes.values() if home})
    if group and group not in groups:
        there = ", ".join(groups) or "none"
        raise CaseError(f"{artifact.path} has no group {group}; there are: {there}")
    axes, variables = Axes(schema), {}
    for name, home in homes.items():
        field = find_field(schema.datasets, name)
        if field is not None and home in ("", group):
            reader = artifact.dataset(name)
            paths = axes.paths(name, field, reader.shape)
            lazy = indexing.LazilyIndexedArray(_Lazy(reader))
            labels = {key: text for key, text in field.labels.items() if text}
            dims = [path.rpartition("/")[2] for path in paths]
            variables[_short(name, home)] = xarray.Variable(dims, lazy, labels)
    found = xarray.Dataset(variables, attrs=_attributes(artifact, group, groups))
    for axis, coordinate in COORDINATES.items():
        if coordinate in found and found[coordinate].dims == (axis,):
            found = found.set_coords(coordinate).set_xindex(coordinate)
    return found


def _home(schema: Schema, name: str) -> str:
    """Return the innermost group of several of a kind that a dataset is in, `""` for none."""
    field = find_field(schema.datasets, name)
    above = "" if field is None else field.name.rpartition("/")[0]
    depth = above.rpartition("*")[0].count("/") + 1 if "*" in above else 0
    return "/".join(name.split("/")[:depth])


def _short(name: str, home: str) -> str:
    return name.removeprefix(f"{home}/").replace("/", "_")


def _attributes(artifact: Artifact, group: str, groups: list[str]) -> dict[str, Any]:
    """Return the attributes of the artifact and of a group, but for those of its inputs."""
    others = (f"{other}/" for other in (*groups, "lineage") if other != group)
    left_out = tuple(others)
    found = {
        _short(name, group): value
        for name, value in artifact.attributes.items()
        if not name.startswith(left_out)
    }
    return found | ({"groups": groups} if groups else {})


class _Lazy(BackendArray):
    """A dataset that xarray reads by slices."""

    def __init__(self, reader: DatasetReader) -> None:
        self._reader = reader
        self.shape = reader.shape
        self.dtype = reader.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> NDArray[Any]:
        return np.asarray(
            indexing.explicit_indexing_adapter(
                key, self.shape, indexing.IndexingSupport.BASIC, self._reader.__getitem__
            )
        )
