"""Trajectories in space: three components, forces without torque, and the units of space."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from sphrom.artifacts import create_artifact, open_artifact
from sphrom.artifacts.labelled import open_labelled
from sphrom.artifacts.paraview import VIEW
from sphrom.metrics.measures import FieldMeasure, FlowAcross
from sphrom.sph.time_loop import Snapshot
from sphrom.store.trajectory import TrajectoryWriter, read_quantities

ENDS = np.array([[0.5, 0.0, 0.0], [0.5, 1.0, 1.0]])
LOADS = np.array([[1.0, 2.0, 3.0], [0.5, 0.25, 0.125]])


@pytest.fixture
def path(tmp_path: Path, arguments) -> Path:
    """A trajectory of eight particles with a force, a probe, and a flow rate."""
    measures = {"spot": FieldMeasure(ENDS[:1]), "flux": FlowAcross(ENDS, 1.0)}

    def measured(*_: np.ndarray) -> dict:
        places = {name: measure.position for name, measure in measures.items()}
        return {name: measures[name].of(x, x[:, 0]) for name, x in places.items()}

    fields = SimpleNamespace(measures=measures, at_rest=measured())
    recorder = type("Recorder", (), {"__call__": lambda self, *_: measured(), **vars(fields)})()
    forces = type("Forces", (), {"walls": ("lid",), "__call__": lambda *_: {"lid": LOADS}})()
    path = tmp_path / "fom.h5"
    position = np.random.default_rng(0).random((3, 8))
    arguments["origin"] = replace(arguments["origin"], n_dim=3)
    with create_artifact(path, "sphrom/trajectory", **arguments) as artifact:
        writer = TrajectoryWriter(artifact, 2, 8, 10.0, n_dim=3, forces=forces, fields=recorder)
        for step in range(2):
            writer.append(0.5 * step, step, Snapshot(position, np.ones(8), 2.0 * position))
        writer.finish(None, 1.0)
    return path


def test_forces_in_space_are_read_as_vectors_without_torque(path: Path) -> None:
    with open_artifact(path, "sphrom/trajectory", made_by="") as artifact:
        found = read_quantities(artifact, "lid")
        assert [*found] == ["force"]
        np.testing.assert_array_equal(found["force"], [LOADS.sum(axis=0)] * 2)
        view = artifact.dataset("position")
        assert view.shape == (2, 8, 3)


def test_datasets_in_space_have_three_components_and_their_units(path: Path) -> None:
    with open_labelled(path) as run:
        assert [*run.component.values] == ["x", "y", "z"]
        np.testing.assert_array_equal(run.lid_force[0], LOADS.sum(axis=0))
        assert (run.lid_force.units, run.flux_flow_rate.units) == ("N", "m3/s")
        assert "lid_torque" not in run
        assert run.spot_velocity.dims == ("snapshot", "component")
        assert run.flux_flow_rate.values == pytest.approx([0.5, 0.5])


def test_paraview_sees_the_third_component(path: Path) -> None:
    with h5py.File(path) as file:
        points = file[f"{VIEW}/Points"][...]
        np.testing.assert_array_equal(points, file["position"][...].reshape(-1, 3))


def test_file_itself_has_the_units_of_space(path: Path) -> None:
    with h5py.File(path) as file:
        assert file["force/lid/pressure"].attrs["units"] == b"N"
        assert file["measure/flux/flow_rate"].attrs["units"] == b"m3/s"
        assert file["measure/spot/velocity"].attrs["units"] == b"m/s"
