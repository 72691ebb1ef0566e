"""Artifacts as xarray datasets with named axes, units and times, read when needed.

Values are verified like all others. This module is separate: importing xarray takes long.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from sphrom.artifacts.reader import Artifact, open_artifact
from sphrom.artifacts.records import SCHEMAS
from sphrom.declaration import Field
from sphrom.errors import CaseError
from sphrom.metrics.quantities import AXES

_MEASURED = re.compile("((?:error_estimate|steady)/)?(measure|force)/([^/]+)/([^/]+)")
"""The path of a measured quantity: a prefix, the kind, the measurement and the quantity."""
COMPONENT = "component"
"""The axis of the components of vectors."""


def open_labelled(path: str | Path, group: str = "") -> xarray.Dataset:
    """Open an artifact, or a group of one such as `bases/all` with the data common to all groups.

    `sphrom.open` documents the names. The file stays open until the dataset is closed.

    Raises ArtifactError if the file is missing, damaged or foreign, CaseError for no such group.
    """
    group = group.strip("/")
    with contextlib.ExitStack() as stack:
        artifact = stack.enter_context(open_artifact(path, None, made_by="sphrom run CASE"))
        fields = {n: f for n in artifact.datasets if (f := SCHEMAS[artifact.schema].dataset(n))}
        groups = sorted({_home(field, name) for name, field in fields.items()} - {""})
        if group and group not in groups:
            there = ", ".join(groups) or "none"
            raise CaseError(f"{path} has no group {group}; there are: {there}")
        n_dim = next((_n_dim(artifact, n, f) for n, f in fields.items() if COMPONENT in f.axes), 2)
        variables = {
            _short(name, group): _variable(artifact, name, field, n_dim)
            for name, field in fields.items()
            if _home(field, name) in ("", group)
        }
        for wall in {name.split("/")[1] for name in fields if name.startswith("force/")}:
            for load in ("force", *["torque"] * (n_dim == 2)):
                one, other = (variables[f"{wall}_{p}_{load}"] for p in ("pressure", "viscous"))
                variables[f"{wall}_{load}"] = total = one + other
                total.attrs = {"units": one.attrs["units"], "long_name": f"{load} on the wall"}
        others = tuple(f"{other}/" for other in (*groups, "lineage") if other != group)
        attributes: dict[str, Any] = {
            _short(name, group): value
            for name, value in artifact.attributes.items()
            if not name.startswith(others)
        }
        if groups:
            attributes["groups"] = groups
        labelled = xarray.Dataset(variables, attrs=attributes)
        if "parameters" in labelled:  # of the runs of a sweep that have a result
            at = labelled["parameters"][labelled["complete"].values].values.T
            along = zip(artifact.text("parameter_names").split(","), at, strict=True)
            labelled = labelled.assign_coords({name: ("complete_run", row) for name, row in along})
        if COMPONENT in labelled.dims:
            labelled = labelled.assign_coords(component=list(AXES[:n_dim]))
        if "time" in labelled and labelled["time"].dims == ("snapshot",):
            labelled = labelled.set_coords("time").set_xindex("time")
        labelled.set_close(stack.pop_all().close)
        return labelled


def _n_dim(artifact: Artifact, name: str, field: Field) -> int:
    """Return the number of components in a dataset of vectors."""
    return int(artifact.form(name)[0][field.axes.index(COMPONENT)])


def _variable(artifact: Artifact, name: str, field: Field, n_dim: int) -> xarray.Variable:
    dims = [  # the axes of a dataset have different names
        f"{axis}_{again + 1}" if (again := field.axes[:i].count(axis)) else axis
        for i, axis in enumerate(field.axes)
    ]
    labels = {key: text for key, text in field.labels(n_dim).items() if text}
    if (measured := _MEASURED.fullmatch(name)) and measured[1]:
        labels["long_name"] = f"{measured[1][:-1].replace('_', ' ')}: {field.meaning}"
    variable = xarray.Variable(dims, indexing.LazilyIndexedArray(_Lazy(artifact, name)), labels)
    if measured is None or "place" not in dims:
        return variable
    if variable.sizes["place"] == 1:  # of a probe
        return variable.squeeze("place")
    return variable._replace(dims=[dim.replace("place", f"{measured[3]}_place") for dim in dims])


def _home(field: Field, name: str) -> str:
    """Return the innermost named group that contains a dataset, such as `bases/all`, or `""`."""
    if _MEASURED.fullmatch(name):
        return ""
    above = field.name.rpartition("/")[0]
    depth = above.rpartition("*")[0].count("/") + 1 if "*" in above else 0
    return "/".join(name.split("/")[:depth])


def _short(name: str, home: str) -> str:
    """Return the name of a variable: that of the measurement and quantity, or the dataset's."""
    if match := _MEASURED.fullmatch(name):
        begin, kind, measured, quantity = match.groups("")
        force = "_force" if kind == "force" and not quantity.endswith("_torque") else ""
        return f"{begin.replace('/', '_')}{measured}_{quantity}{force}"
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
