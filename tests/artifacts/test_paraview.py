"""What VTK's own reader makes of artifacts: the same numbers, bit for bit, at every step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from sphrom.artifacts import open_artifact
from sphrom.artifacts.records.reduced_models import Basis
from sphrom.artifacts.records.runs import Coordinates, Packing, ReferenceSnapshots, Trajectory
from sphrom.declaration import Record

pytest.importorskip("vtkmodules", reason="VTK is not installed")


class Reader:
    """VTK's reader on a file."""

    def __init__(self, path: Path, arrays_of: Callable[[Any], dict[str, Any]]) -> None:
        from vtkmodules.vtkIOHDF import vtkHDFReader

        self._arrays_of = arrays_of
        self._reader = vtkHDFReader()
        self._reader.SetFileName(str(path))
        self._reader.UpdateInformation()
        self.n_steps = self._reader.GetNumberOfSteps()

    def times(self) -> list[float]:
        """Return the times of all steps."""
        from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

        information = self._reader.GetOutputInformation(0)
        return list(information.Get(Pipeline.TIME_STEPS()))

    def step(self, step: int = 0) -> dict[str, Any]:
        """Return the points and fields of a step, and how many cells of each kind it has."""
        self._reader.SetStep(step)
        self._reader.Update()
        data = self._reader.GetOutputDataObject(0)
        kinds = (data.GetVerts(), data.GetLines(), data.GetPolys(), data.GetStrips())
        return {**self._arrays_of(data), "cells": tuple(k.GetNumberOfCells() for k in kinds)}


@pytest.fixture
def opened(written, vtk_arrays) -> Callable[[Record], Reader]:
    """Open a record that is written as an artifact."""
    return lambda record: Reader(written(record), vtk_arrays)


def flat(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., 2) with a third component of zero."""
    return np.concatenate((vectors, np.zeros((*vectors.shape[:-1], 1))), axis=-1)


def test_trajectory_opens_with_the_same_numbers_at_every_step(opened, invented) -> None:
    run = invented(Trajectory)
    reader = opened(run)
    assert reader.n_steps == 4
    assert reader.times() == list(run.time)
    for step in (0, 3, 1, 2):
        seen = reader.step(step)
        assert seen["cells"] == (7, 0, 0, 0)
        np.testing.assert_array_equal(seen["points"], flat(run.position[step]))
        np.testing.assert_array_equal(seen["velocity"], flat(run.velocity[step]))
        for name in ("density_fluctuation", "pressure"):
            np.testing.assert_array_equal(seen[name], getattr(run, name)[step])


def test_packings_open(opened, invented) -> None:
    record = invented(Packing)
    seen = opened(record).step()
    np.testing.assert_array_equal(seen["points"], flat(record.position))


def test_reference_snapshots_open_on_points_that_are_stored_once(opened, invented) -> None:
    mapped = invented(ReferenceSnapshots)
    reader = opened(mapped)
    assert reader.times() == list(mapped.time)
    for step in (2, 0, 1):
        seen = reader.step(step)
        np.testing.assert_array_equal(seen["points"], flat(mapped.reference_position))
        np.testing.assert_array_equal(seen["velocity"], flat(mapped.velocity[step]))
        np.testing.assert_array_equal(seen["density_fluctuation"], mapped.density_fluctuation[step])


def test_modes_open_as_steps_counted_from_one(opened, invented) -> None:
    """A basis of fewer modes than another shows zeros beyond its last one."""
    basis = invented(Basis)
    b, c, runs = basis.bases["b0"], basis.bases["c0"], basis.train["b0"]
    low = replace(c, density_modes=c.density_modes[:2], velocity_modes=c.velocity_modes[:2])
    basis = replace(basis, bases={"all": b, "low": low}, train={"all": runs, "low": runs})
    reader = opened(basis)
    assert reader.times() == [1.0, 2.0, 3.0]
    for mode in (2, 0, 1):
        seen = reader.step(mode)
        np.testing.assert_array_equal(seen["points"], flat(basis.reference_position))
        np.testing.assert_array_equal(seen["volume"], basis.volume)
        np.testing.assert_array_equal(seen["all_density"], b.density_modes[mode])
        np.testing.assert_array_equal(seen["all_velocity"], flat(b.velocity_modes[mode]))
        expected = low.density_modes[mode] if mode < 2 else np.zeros(7)
        np.testing.assert_array_equal(seen["low_density"], expected)


def test_reduced_runs_open_with_their_fields(written, opened, invented) -> None:
    with h5py.File(written(invented(Coordinates, whole=False))) as file:
        assert "VTKHDF" not in file
    run = invented(Coordinates)
    seen = opened(run).step(1)
    np.testing.assert_array_equal(seen["points"], flat(run.reference_position))
    np.testing.assert_array_equal(seen["velocity"], flat(run.velocity[1]))
    np.testing.assert_array_equal(seen["pressure"], run.pressure[1])


def test_view_is_no_part_of_the_content(written, invented) -> None:
    path = written(invented(Trajectory))
    with open_artifact(path, "sphrom/trajectory", made_by="fom") as artifact:
        artifact.verify_content()
        names = [*artifact.datasets, *artifact.attributes]
        assert not any(name.startswith("VTKHDF") for name in names)
    with h5py.File(path, "r+") as file:
        assert b"pyvista.read(path, force_ext='.vtkhdf')" in file["VTKHDF"].attrs["HowToOpen"]
        del file["VTKHDF"]
    with open_artifact(path, "sphrom/trajectory", made_by="fom") as artifact:
        artifact.verify_content()
