"""The axes of an artifact as HDF5's dimension scales, which xarray and netCDF know axes by.

A scale is a dataset without values that has an axis's name and length. It stands in the group
within which the axis has one length, holds nothing, and is no part of the content's digest:
reading an artifact never looks at it.
"""

from __future__ import annotations

from collections.abc import Mapping

import h5py

from sphrom.artifacts.declaration import joined
from sphrom.artifacts.layout import Shape, common_axes, find_field, matches, scope_of
from sphrom.artifacts.schema import DatasetField, Schema
from sphrom.artifacts.text import fixed_text

NOT_A_VARIABLE = "This is a netCDF dimension but not a netCDF variable.{:10d}"
"""What netCDF calls a scale that has no values of its own."""
COORDINATES = {"snapshot": "time"}
"""Datasets that tell where along an axis its entries are."""


class Axes:
    """The names of the axes of an artifact's datasets, by path: each path has one length."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        self._common = common_axes(schema)
        self.lengths: dict[str, int] = {}

    def paths(self, name: str, field: DatasetField, shape: Shape) -> list[str]:
        """Return where the axes of a dataset are named."""
        return [self._path(name, field, i, length) for i, length in enumerate(shape)]

    def _path(self, name: str, field: DatasetField, i: int, length: int) -> str:
        axis = field.axes[i]
        scope = scope_of(field, name, axis, self._common)
        scope = scope.rpartition("/")[0] if scope == name else scope
        path = joined(scope, axis)
        if self._is_group(path):
            path = f"{path}/{axis}"
        if axis in field.axes[:i]:  # no two axes of a dataset have one name
            path = f"{path}_{field.axes[: i + 1].count(axis)}"
        if self.lengths.get(path, length) != length:
            path = f"{path}_{name.rpartition('/')[2]}"
        self.lengths[path] = length
        return path

    def _is_group(self, path: str) -> bool:
        """Whether a group that holds datasets has this path."""
        depth = path.count("/") + 1
        groups = (field.name.split("/")[:-1][:depth] for field in self._schema.datasets)
        return any(matches("/".join(group), path) for group in groups)


class Scales:
    """The scales of an artifact in the making."""

    def __init__(self, schema: Schema, file: h5py.File) -> None:
        self._schema = schema
        self._file = file
        self._axes = Axes(schema)
        self._made_for: dict[str, tuple[str, int]] = {}
        """By scale, a dataset, and the place of the axis in its shape."""

    def attach(self, name: str, field: DatasetField, dataset: h5py.Dataset) -> None:
        """Name the axes of a new dataset; scales are made where there are none yet."""
        for i, path in enumerate(self._axes.paths(name, field, dataset.shape)):
            if path not in self._made_for:
                self._made_for[path] = name, i
                self._make(path, dataset.shape[i])
            dataset.dims[i].attach_scale(self._file[path])
        coordinates = self._coordinates(name, field)
        if coordinates:
            dataset.attrs["coordinates"] = fixed_text(" ".join(coordinates))

    def shorten(self, shapes: Mapping[str, Shape]) -> None:
        """Give axes the lengths that their datasets have ended with."""
        for path, (name, i) in self._made_for.items():
            if self._axes.lengths[path] != shapes[name][i]:
                self._file[path].resize((shapes[name][i],))

    def _coordinates(self, name: str, field: DatasetField) -> list[str]:
        """Return what tells, in the same group, where along its axes the entries of one are."""
        group = name.rpartition("/")[0]
        told = [COORDINATES[axis] for axis in field.axes if axis in COORDINATES]
        return [
            one
            for one in told
            if joined(group, one) != name and find_field(self._schema.datasets, joined(group, one))
        ]

    def _make(self, path: str, length: int) -> None:
        # In chunks, none of which is ever written, as it may be shortened.
        chunks = (length,) if length else None
        scale = self._file.create_dataset(path, (length,), "i1", maxshape=(length,), chunks=chunks)
        scale.make_scale(NOT_A_VARIABLE.format(length))
