"""What `export` writes opens elsewhere with the same numbers, and needs no artifact."""

from __future__ import annotations

import csv
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest

from sphrom.scenes.taylor_green import TaylorGreen


def flat(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2) with a third component of zero."""
    return np.pad(vectors, ((0, 0), (0, 1)))


def opened(path):
    """Return VTK's reader of a file."""
    hdf = pytest.importorskip("vtkmodules.vtkIOHDF", reason="VTK is not installed")
    reader = hdf.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    return reader


def arrays_of(data) -> dict[str, np.ndarray]:
    """Return the points and fields of what VTK read."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    fields = data.GetPointData()
    found = {
        fields.GetArrayName(i): vtk_to_numpy(fields.GetArray(i)).copy()
        for i in range(fields.GetNumberOfArrays())
    }
    return {**found, "points": vtk_to_numpy(data.GetPoints().GetData()).copy()}


def step_of(reader, step: int) -> dict[str, np.ndarray]:
    """Return the points and fields of one step."""
    reader.SetStep(step)
    reader.Update()
    return arrays_of(reader.GetOutputDataObject(0))


def test_every_artifact_of_a_case_with_fields_opens_as_it_is(place, made_by) -> None:
    for name, (schema, _) in made_by.items():
        if schema in ("spline", "comparison"):
            continue
        with h5py.File(place / name) as file:
            has_points = "position" if "position" in file else "reference_position"
            stored = file[has_points][...]
        points = step_of(opened(place / name), 0)["points"]
        np.testing.assert_array_equal(points, flat(stored[0] if stored.ndim == 3 else stored))


def test_copies_need_no_artifact(place, sphrom) -> None:
    result = sphrom("export", "tiny.yaml")
    assert result.exit_code == 0, result.output
    with h5py.File(place / "fom-reynolds100.h5") as file:
        stored = {name: file[name][...] for name in ("time", "position", "velocity", "pressure")}
    with h5py.File(place / "pod.h5") as file:
        modes = file["bases/all/modes/velocity"][...]
    for path in place.glob("*.h5"):
        path.unlink()
    reader = opened(place / "export" / "fom-reynolds100.vtkhdf")
    assert reader.GetNumberOfSteps() == len(stored["time"])
    for step in (2, 0, len(stored["time"]) - 1):
        seen = step_of(reader, step)
        np.testing.assert_array_equal(seen["points"], flat(stored["position"][step]))
        np.testing.assert_array_equal(seen["velocity"], flat(stored["velocity"][step]))
        np.testing.assert_array_equal(seen["pressure"], stored["pressure"][step])
    seen = step_of(opened(place / "export" / "pod.vtkhdf"), 1)
    np.testing.assert_array_equal(seen["all_velocity"], flat(modes[1]))


def test_vtu_files_hold_the_same_numbers_and_their_times(place, sphrom) -> None:
    xml = pytest.importorskip("vtkmodules.vtkIOXML", reason="VTK is not installed")
    result = sphrom("export", place / "rom-galerkin-reynolds150.h5", "--to", "vtu", "--into", "vtu")
    assert result.exit_code == 0, result.output
    with h5py.File(place / "rom-galerkin-reynolds150.h5") as file:
        stored = {name: file[name][...] for name in ("time", "position", "velocity", "pressure")}
    listed = ElementTree.parse("vtu/rom-galerkin-reynolds150.pvd").getroot().iter("DataSet")
    entries = {float(entry.attrib["timestep"]): entry.attrib["file"] for entry in listed}
    assert list(entries) == list(stored["time"])
    for step in (0, len(entries) - 1):
        reader = xml.vtkXMLUnstructuredGridReader()
        reader.SetFileName(f"vtu/{entries[stored['time'][step]]}")
        reader.Update()
        seen = arrays_of(reader.GetOutput())
        np.testing.assert_array_equal(seen["points"], flat(stored["position"][step]))
        np.testing.assert_array_equal(seen["velocity"], flat(stored["velocity"][step]))
        np.testing.assert_array_equal(seen["pressure"], stored["pressure"][step])
        assert reader.GetOutput().GetNumberOfCells() == len(seen["points"])


def test_nothing_is_written_over_unasked(place, sphrom) -> None:
    assert sphrom("export", place / "pod.h5").exit_code == 0
    refused = sphrom("export", place / "pod.h5")
    assert refused.exit_code == 3
    assert "pod.vtkhdf exists already; --force replaces it" in refused.stderr
    assert sphrom("export", place / "pod.h5", "--force").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("runs/tiny/psi.h5",), 3, "psi.h5 (sphrom/spline) holds no fields to export"),
        (("runs/tiny/nothing.h5",), 3, "nothing.h5 is missing"),
        (
            ("runs/tiny/pod.h5", "--to", "stl"),
            2,
            "--to: must be one of vtkhdf, vtu, for a case csv; got 'stl'",
        ),
        (("runs/tiny/pod.h5", "--at", "0,0"), 2, "--at: goes with a case file"),
        (("tiny.yaml", "--at", "0,0"), 2, "--at: goes with --to csv"),
        (("tiny.yaml", "--to", "csv", "--at", "1"), 2, "--at: must be like 0.5,0.5; got '1'"),
        (("tiny.yaml", "--to", "csv", "--at", "nan,0"), 2, "--at: (nan, 0) m is not in the fluid"),
        (("runs/tiny/pod.h5", "--set", "name=x"), 2, "--set: goes with a case file"),
        (("tiny.yaml", "--out", "elsewhere"), 3, "there is no artifact with fields"),
    ],
)
def test_what_cannot_be_exported_is_said(place, sphrom, arguments, code, says) -> None:
    result = sphrom("export", *arguments)
    assert result.exit_code == code
    assert says in result.stderr


def test_artifact_of_another_case_is_refused(place, sphrom) -> None:
    result = sphrom("export", "tiny.yaml", "--set", "fluid.mach_number=0.2")
    assert result.exit_code == 3
    assert "was made with another case" in result.stderr


def test_runs_are_tabled_at_points(place, sphrom) -> None:
    result = sphrom("export", "tiny.yaml", "--to", "csv", "--at", "0.25,0.5", "--at", "0.1,0.2")
    assert result.exit_code == 0, result.output
    with (place / "export" / "fom-reynolds100.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time [s]", "x [m]", "y [m]", "u [m/s]", "v [m/s]", "pressure [Pa]"]
    with h5py.File(place / "fom-reynolds100.h5") as file:
        times = file["time"][...]
    assert [float(row["time [s]"]) for row in rows] == list(np.repeat(times, 2))
    points = np.array([[0.25, 0.5], [0.1, 0.2]])
    flow = TaylorGreen(length=1.0, speed=1.0, reference_density=1000.0, kinematic_viscosity=0.01)
    for step in (0, len(times) - 1):
        pair = rows[2 * step : 2 * step + 2]
        found = [[float(row["u [m/s]"]), float(row["v [m/s]"])] for row in pair]
        np.testing.assert_allclose(found, flow.velocity(points, times[step]), atol=0.02)
    tables = {path.stem for path in (place / "export").glob("*.csv")}
    assert tables == {
        f"{run}-reynolds{value}"
        for run in ("fom", "rom-galerkin", "rom-apg")
        for value in (100, 150, 200)
    }


def test_runs_are_tabled_along_the_line_unless_asked_otherwise(place, sphrom) -> None:
    assert sphrom("export", "tiny.yaml", "--to", "csv", "--only", "reynolds=150").exit_code == 0
    with (place / "export" / "rom-apg-reynolds150.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["x [m]"] for row in rows} == {"0.5"}
    assert len({row["y [m]"] for row in rows}) == 21  # compare.line_points of the case
    again = sphrom("export", "tiny.yaml", "--to", "csv", "--only", "reynolds=150")
    assert again.exit_code == 3
    assert "exists already; --force replaces it" in again.stderr
