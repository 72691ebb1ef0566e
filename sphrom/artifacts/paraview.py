"""The view of an artifact that ParaView opens: the same data in the layout of VTK's HDF files.

A view is a group of virtual datasets. It shows the particles or reference points as PolyData, once
per snapshot, or once per mode if the artifact holds modes. Vectors (snapshot, particle, 2) appear
as (snapshot times particle, 3) with a zero third component. Cells are stored once for all steps.

A view follows from the axes in the schema. It holds no data of its own and is not part of the
content digest; reading an artifact never uses it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.layout import Shape
from sphrom.artifacts.records import SCHEMAS
from sphrom.declaration import matches

VIEW = "VTKHDF"
"""The group that VTK looks for."""
STEP_AXES = ("snapshot", "mode")
"""Axes along which ParaView steps."""
HOW_TO_OPEN = (
    "ParaView 5.12, VTK 9.3 and later open this file; so does pyvista.read(path, "
    "force_ext='.vtkhdf'). `sphrom export` writes files for any version."
)
_NO_CELLS = ("Lines", "Polygons", "Strips")


@dataclass(frozen=True)
class View:
    """The content of a view: points, fields on them, and steps."""

    points: str
    """The dataset of the points."""
    fields: Mapping[str, str]
    """The datasets on the points, by their names in ParaView."""
    times: str | None
    """The dataset of the steps' times; if None, steps are numbered from one."""
    n_points: int
    n_steps: int
    """Zero if nothing depends on a snapshot or a mode."""
    stepped: frozenset[str]
    """The datasets that differ from step to step."""


def views(schema: str, given: Mapping[str, Shape]) -> dict[str, View]:
    """Return the views of an artifact with the datasets `given`, by name; the principal one is "".

    The others, such as a trajectory's ghosts, have points of their own.
    """
    plain = {name: name for name in ("velocity", "density_fluctuation", "pressure")}
    arranged: dict[str, tuple[str, Mapping[str, str]]] = {}
    if schema in ("sphrom/trajectory", "sphrom/state", "sphrom/packing"):
        ghosts = {"wall_velocity": "ghost/wall_velocity"}
        arranged = {"": ("position", plain), "ghosts": ("ghost/position", ghosts)}
    elif schema in ("sphrom/reference-snapshots", "sphrom/coordinates"):
        arranged = {"": ("reference_position", plain)}
    elif schema == "sphrom/basis":
        modes = {"volume": "volume", **_modes("bases", given)}
        lagrangian = "lagrangian_position", _modes("lagrangian", given)
        arranged = {"": ("reference_position", modes), "lagrangian": lagrangian}
    return {
        name: _view(schema, given, points, fields)
        for name, (points, fields) in arranged.items()
        if 0 not in given.get(points, (0,))  # an unstable run may have no snapshot
    }


def _modes(group: str, given: Iterable[str]) -> dict[str, str]:
    """Return the modes in a group of bases, by names such as `all_velocity`."""
    paths = {name: name.split("/") for name in given if matches(f"{group}/*/modes/*", name)}
    return {f"{basis}_{part}": name for name, (_, basis, _, part) in paths.items()}


def _view(schema: str, given: Mapping[str, Shape], points: str, fields: Mapping[str, str]) -> View:
    there = {name: dataset for name, dataset in fields.items() if dataset in given}
    known = {name: SCHEMAS[schema].dataset(name) for name in (points, *there.values())}
    first = {name: "" if field is None else field.axes[0] for name, field in known.items()}
    stepped = frozenset(name for name, axis in first.items() if axis in STEP_AXES)
    return View(
        points=points,
        fields=there,
        times="time" if "snapshot" in first.values() else None,
        n_points=given[points][-2],
        n_steps=max((given[name][0] for name in stepped), default=0),
        stepped=stepped,
    )


def add_view(file: h5py.File, schema: str, given: Mapping[str, Shape]) -> None:
    """Add the principal view to an artifact that is being written, if it has one."""
    view = views(schema, given).get("")
    if view is None:
        return
    group = file.create_group(VIEW)
    group.attrs["Version"] = np.array((2, 0))
    group.attrs["Type"] = np.bytes_("PolyData")
    group.attrs["HowToOpen"] = np.bytes_(HOW_TO_OPEN)
    group["NumberOfPoints"] = np.array([view.n_points])
    _map(group, "Points", view, view.points)
    for name, source in view.fields.items():
        _map(group.require_group("PointData"), name, view, source)
    _write_cells(group, "Vertices", view.n_points)
    for kind in _NO_CELLS:
        _write_cells(group, kind, 0)
    if view.n_steps:
        _write_steps(group, view)


def _write_cells(group: h5py.Group, kind: str, n_cells: int) -> None:
    """Make each of the first `n_cells` points a cell of its own."""
    cells = group.create_group(kind)
    cells["NumberOfCells"] = np.array([n_cells])
    cells["NumberOfConnectivityIds"] = np.array([n_cells])
    # Consecutive integers compress to almost nothing.
    packed = {"compression": "gzip", "shuffle": True} if n_cells else {}
    cells.create_dataset("Offsets", data=np.arange(n_cells + 1), **packed)
    cells.create_dataset("Connectivity", data=np.arange(n_cells), **packed)


def _write_steps(group: h5py.Group, view: View) -> None:
    steps = group.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(view.n_steps)
    if view.times is None:
        steps["Values"] = np.arange(1.0, view.n_steps + 1.0)
    else:
        _map(steps, "Values", view, view.times)
    nothing = np.zeros(view.n_steps, dtype=np.int64)
    by_kind = np.zeros((view.n_steps, 1 + len(_NO_CELLS)), dtype=np.int64)
    steps["NumberOfParts"] = nothing + 1
    steps["PartOffsets"] = nothing
    steps["CellOffsets"] = by_kind
    steps["ConnectivityIdOffsets"] = by_kind
    steps["PointOffsets"] = _offsets(view, view.points)
    for name, source in view.fields.items():
        steps.require_group("PointDataOffsets")[name] = _offsets(view, source)


def _offsets(view: View, source: str) -> NDArray[np.int64]:
    """Return the index at which each step begins in a dataset."""
    return np.arange(view.n_steps) * (view.n_points if source in view.stepped else 0)


def _map(group: h5py.Group, name: str, view: View, source: str) -> None:
    """Show a dataset of the same file under another name, with its steps concatenated.

    Missing rows are zeros, for example if a basis has fewer modes than another.
    """
    stored = group.file[source]
    n_rows = view.n_points * (view.n_steps if source in view.stepped else 1)
    n_rows = view.n_steps if source == view.times else n_rows
    shown = h5py.VirtualSource(".", stored.name, stored.shape)
    if bytes(stored.attrs["axes"]).endswith(b"component"):
        layout = h5py.VirtualLayout((n_rows, 3), stored.dtype)
        layout[: stored.size // stored.shape[-1], : stored.shape[-1]] = shown
    else:
        layout = h5py.VirtualLayout((n_rows,), stored.dtype)
        layout[: stored.size] = shown
    group.create_virtual_dataset(name, layout, fillvalue=0)
