"""What VTK's own reader makes of artifacts: the same numbers, bit for bit, at every step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from sphrom.artifacts import create_artifact, open_artifact

pytest.importorskip("vtkmodules", reason="VTK is not installed")

RUN = {
    "reference_density": 1000.0,
    "sound_speed": 10.0,
    "kinematic_viscosity": 0.01,
    "particle_spacing": 0.1,
    "smoothing_length": 0.2,
    "time_step": 1e-3,
    "mass": 10.0,
    "box_length": (1.0, 1.0),
}
REFERENCE = {"reference_density": 1000.0, "sound_speed": 10.0}
N = 7


class Reader:
    """VTK's reader on a file."""

    def __init__(self, path: Path) -> None:
        from vtkmodules.vtkIOHDF import vtkHDFReader

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
        from vtkmodules.util.numpy_support import vtk_to_numpy

        self._reader.SetStep(step)
        self._reader.Update()
        data = self._reader.GetOutputDataObject(0)
        arrays = data.GetPointData()
        found = {
            arrays.GetArrayName(i): vtk_to_numpy(arrays.GetArray(i)).copy()
            for i in range(arrays.GetNumberOfArrays())
        }
        found["points"] = vtk_to_numpy(data.GetPoints().GetData()).copy()
        kinds = (data.GetVerts(), data.GetLines(), data.GetPolys(), data.GetStrips())
        found["cells"] = tuple(kind.GetNumberOfCells() for kind in kinds)
        return found


def flat(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., 2) with a third component of zero."""
    return np.concatenate((vectors, np.zeros((*vectors.shape[:-1], 1))), axis=-1)


Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write an artifact of some kind from its datasets and attributes."""

    def written(kind: str, data: dict[str, np.ndarray], attributes: dict[str, object]) -> Path:
        path = tmp_path / f"{kind}.h5"
        path.unlink(missing_ok=True)
        with create_artifact(
            path,
            f"sphrom/{kind}",
            stage="test",
            case_text="name: demo\n",
            case_digest="case",
            inputs_digest="inputs",
            attributes=attributes,
        ) as artifact:
            for name, array in data.items():
                artifact.write(name, array)
        return path

    return written


@pytest.fixture
def random() -> np.random.Generator:
    """Numbers that no bug gives by chance."""
    return np.random.default_rng(3)


def trajectory(random: np.random.Generator, n_steps: int = 4) -> dict[str, np.ndarray]:
    """Return the datasets of a trajectory with walls."""
    return {
        "time": np.sort(random.random(n_steps)),
        "step": np.arange(n_steps),
        "position": random.random((n_steps, N, 2)),
        "velocity": random.standard_normal((n_steps, N, 2)),
        "density_fluctuation": random.standard_normal((n_steps, N)),
        "pressure": random.standard_normal((n_steps, N)),
        "ghost/position": random.random((3, 2)),
        "ghost/wall_velocity": random.random((3, 2)),
    }


def test_trajectory_opens_with_the_same_numbers_at_every_step(write: Write, random) -> None:
    data = trajectory(random)
    reader = Reader(write("trajectory", data, {**RUN, "status": "complete"}))
    assert reader.n_steps == 4
    assert reader.times() == list(data["time"])
    for step in (0, 3, 1, 2):
        seen = reader.step(step)
        assert seen["cells"] == (N, 0, 0, 0)
        np.testing.assert_array_equal(seen["points"], flat(data["position"][step]))
        np.testing.assert_array_equal(seen["velocity"], flat(data["velocity"][step]))
        for name in ("density_fluctuation", "pressure"):
            np.testing.assert_array_equal(seen[name], data[name][step])


def test_run_that_became_unstable_opens_as_far_as_it_went(tmp_path: Path, random) -> None:
    data = trajectory(random)
    path = tmp_path / "unstable.h5"
    with create_artifact(
        path,
        "sphrom/trajectory",
        stage="fom",
        case_text="",
        case_digest="",
        inputs_digest="",
        attributes=RUN,
    ) as artifact:
        streams = {
            name: artifact.stream(name, array.shape[1:], len(array))
            for name, array in data.items()
            if not name.startswith("ghost")
        }
        for name, stream in streams.items():
            stream.extend(data[name][:2])
        artifact.annotate("status", "unstable")
    reader = Reader(path)
    assert reader.n_steps == 2
    np.testing.assert_array_equal(reader.step(1)["points"], flat(data["position"][1]))


def test_states_and_packings_open(write: Write, random) -> None:
    state = {
        "position": random.random((N, 2)),
        "velocity": random.random((N, 2)),
        "density_fluctuation": random.random(N),
    }
    seen = Reader(write("state", state, {**RUN, "time": 5.0})).step()
    np.testing.assert_array_equal(seen["points"], flat(state["position"]))
    np.testing.assert_array_equal(seen["velocity"], flat(state["velocity"]))
    np.testing.assert_array_equal(seen["density_fluctuation"], state["density_fluctuation"])
    sizes = {key: RUN[key] for key in ("particle_spacing", "smoothing_length", "box_length")}
    packing = {"position": state["position"], "residual": np.ones(2)}
    seen = Reader(write("packing", packing, sizes)).step()
    np.testing.assert_array_equal(seen["points"], flat(state["position"]))


def test_reference_snapshots_open_on_points_that_are_stored_once(write: Write, random) -> None:
    data = {
        "reference_position": random.random((N, 2)),
        "time": np.array([0.0, 0.1, 0.3]),
        "density_fluctuation": random.random((3, N)),
        "velocity": random.random((3, N, 2)),
    }
    reader = Reader(write("reference-snapshots", data, REFERENCE))
    assert reader.times() == [0.0, 0.1, 0.3]
    for step in (2, 0, 1):
        seen = reader.step(step)
        np.testing.assert_array_equal(seen["points"], flat(data["reference_position"]))
        np.testing.assert_array_equal(seen["velocity"], flat(data["velocity"][step]))
        np.testing.assert_array_equal(
            seen["density_fluctuation"], data["density_fluctuation"][step]
        )


def basis(random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the datasets of two bases of three and of two modes, the first with its mean."""
    data = {"reference_position": random.random((N, 2)), "volume": random.random(N)}
    for name, n_modes in (("all", 3), ("low", 2)):
        data[f"bases/{name}/modes/density"] = random.random((n_modes, N))
        data[f"bases/{name}/modes/velocity"] = random.random((n_modes, N, 2))
        data[f"bases/{name}/train"] = np.ones((1, 1))
    data["bases/all/offset/density"] = random.random(N)
    data["bases/all/offset/velocity"] = random.random((N, 2))
    return data


BASIS = {
    **REFERENCE,
    "inner_product": "acoustic",
    "bases/all/gram_error": 0.0,
    "bases/low/gram_error": 0.0,
}


def test_modes_open_as_steps_counted_from_one(write: Write, random) -> None:
    data = basis(random)
    reader = Reader(write("basis", data, BASIS))
    assert reader.times() == [1.0, 2.0, 3.0]
    for mode in (2, 0, 1):
        seen = reader.step(mode)
        np.testing.assert_array_equal(seen["points"], flat(data["reference_position"]))
        np.testing.assert_array_equal(seen["volume"], data["volume"])
        for name in ("all_density", "all_mean_density"):
            assert seen[name].shape == (N,)
        np.testing.assert_array_equal(seen["all_density"], data["bases/all/modes/density"][mode])
        np.testing.assert_array_equal(
            seen["all_velocity"], flat(data["bases/all/modes/velocity"][mode])
        )
        np.testing.assert_array_equal(
            seen["all_mean_velocity"], flat(data["bases/all/offset/velocity"])
        )
    np.testing.assert_array_equal(reader.step(1)["low_density"], data["bases/low/modes/density"][1])


def test_smaller_basis_shows_zeros_beyond_its_last_mode(write: Write, random) -> None:
    seen = Reader(write("basis", basis(random), BASIS)).step(2)
    np.testing.assert_array_equal(seen["low_density"], np.zeros(N))
    np.testing.assert_array_equal(seen["low_velocity"], np.zeros((N, 3)))


COORDINATES = {
    **RUN,
    "status": "complete",
    "mean_density_fluctuation": 0.0,
    "largest_real_part": -1.0,
}


def test_reduced_runs_open_with_their_fields_or_tracers(write: Write, random) -> None:
    data = {"time": np.array([0.0, 0.1]), "generalized_coordinates": random.random((2, 3))}
    with h5py.File(write("coordinates", data, COORDINATES)) as file:
        assert "VTKHDF" not in file
    data["position"] = random.random((2, 4, 2))
    seen = Reader(write("coordinates", data, COORDINATES)).step(1)
    np.testing.assert_array_equal(seen["points"], flat(data["position"][1]))
    data |= {
        "reference_position": random.random((N, 2)),
        "velocity": random.random((2, N, 2)),
        "density_fluctuation": random.random((2, N)),
        "pressure": random.random((2, N)),
    }
    seen = Reader(write("coordinates", data, COORDINATES)).step(1)
    np.testing.assert_array_equal(seen["points"], flat(data["reference_position"]))
    np.testing.assert_array_equal(seen["velocity"], flat(data["velocity"][1]))
    np.testing.assert_array_equal(seen["pressure"], data["pressure"][1])


def test_view_is_no_part_of_the_content(write: Write, random) -> None:
    path = write("trajectory", trajectory(random), {**RUN, "status": "complete"})
    with open_artifact(path, "sphrom/trajectory", made_by="fom") as artifact:
        artifact.verify_content()
        assert not any(name.startswith("VTKHDF") for name in artifact.datasets)
        assert not any(name.startswith("VTKHDF") for name in artifact.attributes)
    with h5py.File(path, "r+") as file:
        assert b"pyvista.read(path, force_ext='.vtkhdf')" in file["VTKHDF"].attrs["HowToOpen"]
        del file["VTKHDF"]
    with open_artifact(path, "sphrom/trajectory", made_by="fom") as artifact:
        artifact.verify_content()


def test_view_costs_little(write: Write) -> None:
    n = 20_000
    data = {
        "time": np.arange(2.0),
        "step": np.arange(2),
        "position": np.zeros((2, n, 2)),
        "velocity": np.zeros((2, n, 2)),
        "density_fluctuation": np.zeros((2, n)),
        "pressure": np.zeros((2, n)),
    }
    path = write("trajectory", data, {**RUN, "status": "complete"})
    stored = sum(array.nbytes for array in data.values())
    assert path.stat().st_size < stored + 64 * 1024
