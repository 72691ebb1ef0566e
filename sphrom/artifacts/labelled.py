"""Artifacts as xarray sees them: datasets with named axes, units and times, read when needed.

Values are verified like all others that are read from artifacts. This module is not imported with
the others: xarray takes longer to load than a reduced run.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from sphrom.artifacts.layout import COORDINATES, Axes
from sphrom.artifacts.reader import Artifact, open_artifact
from sphrom.artifacts.records import SCHEMAS
from sphrom.declaration import Field
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
    with _opened(path) as (artifact, stack):
        groups = _Groups(artifact)
        labelled = groups.labelled(group.strip("/"))
        if groups.names:
            labelled.attrs["groups"] = groups.names
        labelled.set_close(stack.pop_all().close)
    return labelled


def open_labelled_tree(path: str | Path) -> xarray.DataTree:
    """Open an artifact with all of its groups; what belongs to all of them is at the root.

    Raises ArtifactError when the file is missing, damaged or no artifact.
    """
    with _opened(path) as (artifact, stack):
        groups = _Groups(artifact)
        nodes = {name: groups.labelled(name, alone=True) for name in groups.names}
        tree = xarray.DataTree.from_dict({"/": groups.labelled(), **nodes})
        tree.set_close(stack.pop_all().close)
    return tree


@contextlib.contextmanager
def _opened(path: str | Path) -> Iterator[tuple[Artifact, contextlib.ExitStack]]:
    """Open an artifact of any kind, and close it unless who closes it later takes the stack."""
    with contextlib.ExitStack() as stack:
        opened = open_artifact(path, None, made_by="sphrom run CASE")
        yield stack.enter_context(opened), stack


class _Groups:
    """The datasets of an artifact, by the group that they are in."""

    def __init__(self, artifact: Artifact) -> None:
        self._artifact = artifact
        self._schema = SCHEMAS[artifact.schema]
        self._datasets: dict[str, dict[str, Field]] = {}
        for name in artifact.datasets:
            if (field := self._schema.dataset(name)) is not None:
                self._datasets.setdefault(_home(field, name), {})[name] = field
        self.names = sorted(filter(None, self._datasets))

    def labelled(self, group: str = "", *, alone: bool = False) -> xarray.Dataset:
        """Return a group, with what belongs to all groups unless it is to be `alone`."""
        if group and group not in self.names:
            there = ", ".join(self.names) or "none"
            raise CaseError(f"{self._artifact.path} has no group {group}; there are: {there}")
        axes, variables = Axes(self._schema), {}
        for home in {group} if alone else {"": None, group: None}:
            for name, field in self._datasets.get(home, {}).items():
                paths = axes.paths(name, field, self._artifact.form(name)[0])
                dims = [path.rpartition("/")[2] for path in paths]
                labels = {key: text for key, text in field.labels.items() if text}
                lazy = indexing.LazilyIndexedArray(_Lazy(self._artifact, name))
                variables[_short(name, home)] = xarray.Variable(dims, lazy, labels)
        found = xarray.Dataset(variables, attrs=self._attributes(group, alone))
        for axis, coordinate in COORDINATES.items():
            if coordinate in found and found[coordinate].dims == (axis,):
                found = found.set_coords(coordinate).set_xindex(coordinate)
        return found

    def _attributes(self, group: str, alone: bool) -> dict[str, Any]:
        """Return the attributes of a group, and of the artifact but for those of its inputs."""
        own = f"{group}/" if alone else ""
        others = tuple(f"{other}/" for other in (*self.names, "lineage") if other != group)
        return {
            _short(name, group): value
            for name, value in self._artifact.attributes.items()
            if name.startswith(own) and not name.startswith(others)
        }


def _home(field: Field, name: str) -> str:
    """Return the innermost group of several of a kind that a dataset is in, `""` for none."""
    above = field.name.rpartition("/")[0]
    depth = above.rpartition("*")[0].count("/") + 1 if "*" in above else 0
    return "/".join(name.split("/")[:depth])


def _short(name: str, home: str) -> str:
    return name.removeprefix(f"{home}/").replace("/", "_")


class _Lazy(BackendArray):
    """A dataset that xarray reads by slices."""

    def __init__(self, artifact: Artifact, name: str) -> None:
        self._artifact, self._name = artifact, name
        self.shape, self.dtype = artifact.form(name)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> NDArray[Any]:
        return np.asarray(
            indexing.explicit_indexing_adapter(
                key, self.shape, indexing.IndexingSupport.BASIC, self._read
            )
        )

    def _read(self, selection: Any) -> NDArray[Any]:
        return np.asarray(self._artifact.dataset(self._name)[selection])
