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


class Scales:
    """The scales of an artifact in the making."""

    def __init__(self, schema: Schema, file: h5py.File) -> None:
        self._schema = schema
        self._file = file
        self._common = common_axes(schema)
        self._lengths: dict[str, int] = {}
        self._used: dict[str, tuple[str, int]] = {}
        """By scale, the dataset that it was made for, and the place of the axis in its shape."""

    def attach(self, name: str, field: DatasetField, dataset: h5py.Dataset) -> None:
        """Name the axes of a new dataset; scales are made where there are none yet."""
        for i, axis in enumerate(field.axes):
            dataset.dims[i].attach_scale(self._file[self._scale(name, field, i, dataset.shape[i])])
            beside = joined(name.rpartition("/")[0], COORDINATES.get(axis, ""))
            if axis in COORDINATES and beside != name and find_field(self._schema.datasets, beside):
                dataset.attrs["coordinates"] = fixed_text(COORDINATES[axis])

    def shorten(self, shapes: Mapping[str, Shape]) -> None:
        """Give axes the lengths that their datasets have ended with."""
        for path, (name, i) in self._used.items():
            if self._lengths[path] != shapes[name][i]:
                self._file[path].resize((shapes[name][i],))

    def _scale(self, name: str, field: DatasetField, i: int, length: int) -> str:
        """Return the path of an axis's scale, made if need be."""
        axis = field.axes[i]
        scope = scope_of(field, name, axis, self._common)
        scope = scope.rpartition("/")[0] if scope == name else scope
        if self._is_group(scope, axis):
            scope = joined(scope, axis)
        path = joined(scope, axis)
        if axis in field.axes[:i]:  # no two axes of a dataset have one name
            path = f"{path}_{field.axes[: i + 1].count(axis)}"
        if self._lengths.get(path, length) != length:
            path = f"{path}_{name.rpartition('/')[2]}"
        if path not in self._lengths:
            self._lengths[path], self._used[path] = length, (name, i)
            self._make(path, length)
        return path

    def _is_group(self, scope: str, axis: str) -> bool:
        """Whether an axis has the name of a group that holds datasets."""
        path = joined(scope, axis)
        depth = path.count("/") + 1
        groups = (field.name.split("/")[:-1][:depth] for field in self._schema.datasets)
        return any(matches("/".join(group), path) for group in groups)

    def _make(self, path: str, length: int) -> None:
        # In chunks, none of which is ever written, as it may be shortened.
        chunks = (length,) if length else None
        scale = self._file.create_dataset(path, (length,), "i1", maxshape=(length,), chunks=chunks)
        scale.make_scale(NOT_A_VARIABLE.format(length))
