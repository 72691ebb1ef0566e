"""Read points and the fields on them, step by step, from VTK's HDF files.

PolyData and UnstructuredGrid, with steps or without. Datasets are looked at before they are read,
as those of artifacts are: none lies in another file, none is behind a filter that runs a plugin.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import (
    Contents,
    Fault,
    attribute_at,
    damage,
    inspect_dataset,
    open_file,
    require_snapshot_size,
)
from sphrom.artifacts.paraview import VIEW

Array = NDArray[Any]
KINDS = ("PolyData", "UnstructuredGrid")
MOST_STEPS = 100_000
"""Of one file."""
MOST_ITEMS = 10_000
"""Of one group."""


def read_times(path: Path) -> list[float]:
    """Return the times of a file's steps; none where it holds one instant. Raises Fault."""
    with open_file(path) as file:
        _require_kind(file)
        values = _dataset(file, "Steps/Values")
        if values is None:
            return []
        if len(values.shape) != 1 or len(values) > MOST_STEPS:
            raise Fault(f"is damaged: its times have the shape {values.shape}")
        times = _read(values, 0, len(values)).astype(np.float64)
        if not np.isfinite(times).all():
            raise Fault("is damaged: a time is no finite number")
        return [float(time) for time in times]


def read_step(path: Path, step: int) -> dict[str, Array]:
    """Return the arrays on the points at a step, the points as `Points`. Raises Fault."""
    with open_file(path) as file:
        _require_kind(file)
        found = {}
        begin = _number(file, "Steps/PointOffsets", step)
        n_points = _number(file, "NumberOfPoints", step)
        for name in ("Points", *_names(file, "PointData")):
            kind = "Points" if name == "Points" else f"PointData/{name}"
            rows = _dataset(file, kind)
            if rows is None:
                raise Fault("holds no particles")
            at = _number(file, f"Steps/PointDataOffsets/{name}", step, begin)
            found[name] = _read(rows, at, at + n_points)
        return found


def _require_kind(file: h5py.File) -> None:
    with damage(VIEW):
        is_view = isinstance(file.get(VIEW, getlink=True), h5py.HardLink)
        kind = attribute_at(file[VIEW], VIEW, "Type") if is_view else None
    if kind not in KINDS:
        has = "no VTKHDF group" if kind is None else f"VTKHDF of {kind}"
        raise Fault(f"holds {has}: points are read of {' and '.join(KINDS)}")


def _names(file: h5py.File, group: str) -> list[str]:
    item = _item(file, group)
    if item is None:
        return []
    if not isinstance(item, h5py.Group) or len(item) > MOST_ITEMS:
        raise Fault(f"is damaged: {VIEW}/{group} is no group, or holds more than any")
    with damage(f"{VIEW}/{group}"):
        return list(item)


def _item(file: h5py.File, path: str) -> h5py.HLObject | None:
    """Return a part of the view that no link out of the file leads to; None if there is none."""
    item = file[VIEW]
    with damage(f"{VIEW}/{path}"):
        for part in path.split("/"):
            if part not in item:
                return None
            if not isinstance(item.get(part, getlink=True), h5py.HardLink):
                raise Fault(f"is refused: {VIEW}/{path} is a link that may lead out of the file")
            item = item[part]
    return item


def _dataset(file: h5py.File, path: str) -> h5py.Dataset | None:
    """Return a dataset of the view that is safe to read; None where there is none."""
    item = _item(file, path)
    if item is None:
        return None
    if not isinstance(item, h5py.Dataset):
        raise Fault(f"is damaged: {VIEW}/{path} is no dataset")
    inspect_dataset(item, f"{VIEW}/{path}", Contents())
    if len(item.shape) not in (1, 2):
        raise Fault(f"is damaged: {VIEW}/{path} has the shape {item.shape}")
    return item


def _read(rows: h5py.Dataset, begin: int, end: int) -> Array:
    if not 0 <= begin <= end <= len(rows):
        raise Fault(f"is damaged: {rows.name} has {len(rows)} rows, not {begin} to {end}")
    require_snapshot_size((end - begin) * math.prod(rows.shape[1:]) * rows.dtype.itemsize)
    with damage(rows.name):
        values: Array = rows[begin:end]
        return values


def _number(file: h5py.File, path: str, index: int = 0, default: int = 0) -> int:
    """Return a whole number of a list of the view, of its only part."""
    numbers = _dataset(file, path)
    if numbers is None:
        return default
    if len(numbers.shape) != 1 or numbers.dtype.kind not in "iu":
        raise Fault(f"is damaged: {VIEW}/{path} is no list of whole numbers")
    # One part a step; what doesn't change is stored once.
    return int(_read(numbers, *((index, index + 1) if len(numbers) > 1 else (0, 1)))[0])
