"""What `export` writes opens elsewhere with the same numbers, and needs no artifact."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest

from sphrom.models.points.runs import CoordinateRun
from sphrom.scenes.flows import TaylorGreen


def flat(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2) with a third component of zero."""
    return np.pad(vectors, ((0, 0), (0, 1)))


@pytest.fixture
def vtu_of(vtk_arrays):
    """The points and fields of a VTU file."""
    xml = pytest.importorskip("vtkmodules.vtkIOXML", reason="VTK is not installed")

    def read(path) -> dict[str, np.ndarray]:
        reader = xml.vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(path))
        reader.Update()
        assert reader.GetOutput().GetNumberOfCells() == reader.GetOutput().GetNumberOfPoints()
        return vtk_arrays(reader.GetOutput())

    return read


def listed(path) -> dict[float, str]:
    """Return the files that a .pvd file lists, by time."""
    entries = ElementTree.parse(path).getroot().iter("DataSet")
    return {float(entry.attrib["timestep"]): entry.attrib["file"] for entry in entries}


def test_vtu_files_hold_the_same_numbers_and_their_times(place, sphrom, vtu_of) -> None:
    sphrom("export", "tiny.yaml", "--only", "galerkin", "--into", "vtu", code=0)
    assert {path.stem for path in Path("vtu").glob("*.pvd")} == {
        f"rom-galerkin-reynolds{value}" for value in (100, 150, 200)
    }
    with h5py.File(place / "rom-galerkin-reynolds150.h5") as file:
        stored = {name: file[name][...] for name in ("time", "position", "velocity", "pressure")}
    entries = listed("vtu/rom-galerkin-reynolds150.pvd")
    assert list(entries) == list(stored["time"])
    assert len({len(name) for name in entries.values()}) == 1
    for step in (0, len(entries) - 1):
        seen = vtu_of(f"vtu/{entries[stored['time'][step]]}")
        np.testing.assert_array_equal(seen["points"], flat(stored["position"][step]))
        np.testing.assert_array_equal(seen["velocity"], flat(stored["velocity"][step]))
        np.testing.assert_array_equal(seen["pressure"], stored["pressure"][step])


FAST = "rom=[{name: fast, evaluation: operators, n_modes: 3}]"
KEPT = "rom=[{name: fast, evaluation: operators, n_modes: 3, output: snapshots}]"


@pytest.fixture
def fast(place, sphrom) -> Path:
    """The artifact of a reduced run that stores coordinates alone."""
    for stage in ("operators", "rom"):
        sphrom(stage, "tiny.yaml", "--set", FAST, "--threads", 1, code=0)
    return place / "rom-fast-reynolds150.h5"


def test_runs_of_coordinates_alone_are_exported_with_the_fields_they_would_store(
    fast, sphrom, monkeypatch, vtu_of
) -> None:
    calls = []
    state = CoordinateRun.state
    monkeypatch.setattr(
        CoordinateRun, "state", lambda run, snapshot: calls.append(snapshot) or state(run, snapshot)
    )
    about = ("--only", "fast", "--only", "reynolds=150")
    sphrom("export", "tiny.yaml", "--set", FAST, *about, code=0)
    with h5py.File(fast) as file:
        assert "velocity" not in file
        assert calls == list(range(len(file["time"])))  # one at a time
    sphrom("rom", "tiny.yaml", "--set", KEPT, "--force", "--threads", 1, code=0)
    with h5py.File(fast) as file:
        names = ("time", "velocity", "pressure", "density_fluctuation", "reference_position")
        stored = {name: file[name][...] for name in names}
    files = listed(fast.parent / "export" / f"{fast.stem}.pvd")
    assert list(files) == list(stored["time"])
    for step in (len(files) - 1, 0):
        seen = vtu_of(fast.parent / "export" / files[stored["time"][step]])
        np.testing.assert_array_equal(seen["points"], flat(stored["reference_position"]))
        np.testing.assert_array_equal(seen["velocity"], flat(stored["velocity"][step]))
        for name in ("pressure", "density_fluctuation"):
            np.testing.assert_array_equal(seen[name], stored[name][step])


def test_fields_that_can_not_be_rebuilt_are_told_with_what_does(fast, sphrom) -> None:
    (fast.parent / "pod.h5").unlink()
    refused = sphrom("export", "tiny.yaml", "--set", FAST, "--only", "fast", code=3)
    assert "pod.h5 is missing; make it with `sphrom pod tiny.yaml --set " in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("--to", "stl"), 2, "--to: must be one of vtu, csv, model, fmu, page; got 'stl'"),
        (("--at", "0,0"), 2, "--at: needs --to csv"),
        (("--to", "csv", "--at", "1"), 2, "like 0.5,0.5; got '1'"),
        (("--to", "csv", "--at", "nan,0"), 2, "--at: must be two numbers"),
        (("--out", "elsewhere"), 3, "nothing to export"),
        (("--to", "model", "--only", "galerkin"), 2, "galerkin is evaluated on particles"),
        (("--to", "model"), 2, "none of the case's models can be exported"),
        (("--to", "model", "--only", "reynolds=100"), 2, "--only: --to model exports models"),
        (("--to", "page", "--columns", "3"), 2, "--columns: must be from 8 to 500; got 3"),
        (("--to", "page", "--columns", "501"), 2, "--columns: must be from 8 to 500; got 501"),
        (("--into", "tiny.yaml"), 3, "choose another folder with `--into`"),
    ],
)
def test_what_cannot_be_exported_is_said(place, sphrom, arguments, code, says) -> None:
    assert says in sphrom("export", "tiny.yaml", *arguments, code=code).stderr


def test_runs_are_tabled_at_points(place, sphrom) -> None:
    sphrom("export", "tiny.yaml", "--to", "csv", "--at", "0.25,0.5", "--at", "0.1,0.2", code=0)
    with (place / "export" / "fom-reynolds100.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    columns = ["velocity_x [m/s]", "velocity_y [m/s]"]
    assert list(rows[0]) == ["time [s]", "x [m]", "y [m]", *columns, "pressure [Pa]"]
    with h5py.File(place / "fom-reynolds100.h5") as file:
        times = file["time"][...]
    assert [float(row["time [s]"]) for row in rows] == list(np.repeat(times, 2))
    points = np.array([[0.25, 0.5], [0.1, 0.2]])
    flow = TaylorGreen(length=1.0, speed=1.0, reference_density=1000.0, kinematic_viscosity=0.01)
    for step in (0, len(times) - 1):
        pair = rows[2 * step : 2 * step + 2]
        found = [[float(row[name]) for name in columns] for row in pair]
        np.testing.assert_allclose(found, flow.velocity(points, times[step]), atol=0.02)
    tables = {path.stem for path in (place / "export").glob("*.csv")}
    assert tables == {
        f"{run}-reynolds{value}"
        for run in ("fom", "rom-galerkin", "rom-apg")
        for value in (100, 150, 200)
    }


def test_runs_are_tabled_along_the_line_unless_asked_otherwise(place, sphrom) -> None:
    sphrom("export", "tiny.yaml", "--to", "csv", "--only", "reynolds=150", code=0)
    with (place / "export" / "rom-apg-reynolds150.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["x [m]"] for row in rows} == {"0.5"}
    assert len({row["y [m]"] for row in rows}) == 21  # compare.line_points of the case
    again = sphrom("export", "tiny.yaml", "--to", "csv", "--only", "reynolds=150", code=3)
    assert "exists already; --force replaces it" in again.stderr


def test_trained_models_are_exported_as_files_of_their_own(fast, sphrom) -> None:
    done = sphrom("export", "tiny.yaml", "--set", FAST, "--to", "model", code=0)
    path = fast.parent / "export" / "model-fast.json"
    assert json.loads(path.read_text())["name"] == "fast"
    assert f"wrote {path}" in done.output
    again = sphrom("export", "tiny.yaml", "--set", FAST, "--to", "model", code=3)
    assert "exists already" in again.stderr
