"""Files for ParaView hold what the artifact does, step by step."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from sphrom.artifacts import open_artifact
from sphrom.artifacts.paraview import views
from sphrom.artifacts.vtk_files import write_vtkhdf, write_vtu
from sphrom.artifacts.vtk_xml import read_vtk_xml

SCHEMA = "sphrom/trajectory"


@pytest.fixture
def write_steps(write_trajectory):
    """Write a trajectory of some snapshots of five particles."""

    def write(n: int) -> tuple[Path, dict[str, np.ndarray]]:
        random = np.random.default_rng(n)
        series = {
            "time": np.arange(float(n)),
            "step": np.arange(n),
            "position": random.random((n, 5, 2)),
            "velocity": random.random((n, 5, 2)),
            "density_fluctuation": random.random((n, 5)),
            "pressure": random.random((n, 5)),
        }
        return write_trajectory(changed=series), series

    return write


def shown(artifact):
    found = {
        name: (artifact.dataset(name).shape, artifact.dataset(name).dtype)
        for name in artifact.datasets
    }
    return views(SCHEMA, found)[""]


@pytest.mark.parametrize(("n", "digits"), [(1, 1), (10, 1), (11, 2)])
def test_steps_have_names_of_one_length(write_steps, tmp_path, n, digits) -> None:
    path, series = write_steps(n)
    with open_artifact(path, SCHEMA, made_by="") as artifact:
        write_vtu(tmp_path / "a.pvd", artifact, shown(artifact), force=False)
    names = [f"a-{step:0{digits}}.vtu" for step in range(n)]
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == sorted(names)
    collection = (tmp_path / "a.pvd").read_text()
    assert all(f'file="a/{name}"' in collection for name in names)
    last, whole = read_vtk_xml((tmp_path / "a" / names[-1]).read_bytes())
    assert np.array_equal(last["Points"][:, :2], series["position"][-1])
    assert np.array_equal(last["velocity"][:, :2], series["velocity"][-1])
    assert whole["TimeValue"].tolist() == [n - 1]


def test_rows_of_all_steps_follow_one_another(write_steps, tmp_path) -> None:
    path, series = write_steps(4)
    with open_artifact(path, SCHEMA, made_by="") as artifact:
        write_vtkhdf(tmp_path / "a.vtkhdf", artifact, shown(artifact), force=False)
    with h5py.File(tmp_path / "a.vtkhdf") as file:
        group = file["VTKHDF"]
        velocity, pressure = group["PointData/velocity"], group["PointData/pressure"]
        assert np.array_equal(velocity[:, :2], series["velocity"].reshape(20, 2))
        assert np.array_equal(pressure, series["pressure"].ravel())
        assert (velocity.chunks, pressure.chunks) == ((5, 3), (5,))
        assert np.array_equal(group["Points"][:, :2], series["position"].reshape(20, 2))
        assert np.array_equal(group["Steps/Values"], series["time"])
