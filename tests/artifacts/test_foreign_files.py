"""Files that VTK itself wrote give the numbers that it was given."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from sphrom.artifacts.foreign_files import read_foreign
from sphrom.errors import ArtifactError

N = 5


def written_by_vtk(path: Path, fields: dict[str, np.ndarray], mode: int) -> None:
    """Write points along a line and fields on them, as text, in line or appended."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    grid, points = vtkUnstructuredGrid(), vtkPoints()
    points.SetDataTypeToDouble()
    for i in range(N):
        points.InsertNextPoint(0.1 * i, 0.7, 0.0)
    grid.SetPoints(points)
    for i in range(N):
        grid.InsertNextCell(1, 1, [i])
    for name, values in fields.items():
        array = numpy_to_vtk(values, deep=1)
        array.SetName(name)
        (grid.GetFieldData() if values.size == 1 else grid.GetPointData()).AddArray(array)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    writer.SetDataMode(mode)
    writer.Write()


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_vtk_files_are_read(tmp_path: Path, mode: int) -> None:
    pytest.importorskip("meshio", reason="meshio is not installed")
    pytest.importorskip("vtkmodules", reason="VTK is not installed")
    random = np.random.default_rng(0)
    velocity = random.standard_normal((N, 3)).astype(np.float32)
    given = {"vel": velocity, "rho": random.random(N), "id": np.arange(N)}
    written_by_vtk(tmp_path / "a.vtu", {**given, "TimeValue": np.array([0.25])}, mode)
    read = read_foreign(tmp_path / "a.vtu")
    assert read.time == 0.25
    np.testing.assert_array_equal(read.fields["x"], 0.1 * np.arange(N))
    np.testing.assert_array_equal(read.fields["vel.y"], velocity[:, 1])
    np.testing.assert_array_equal(read.fields["rho"], given["rho"])
    np.testing.assert_array_equal(read.fields["id"], np.arange(N))


def test_missing_meshio_is_said_with_what_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "meshio", None)
    (tmp_path / "a.vtu").write_text("<VTKFile/>")
    with pytest.raises(ArtifactError, match=r"needs meshio: pip install 'sphrom\[import\]'"):
        read_foreign(tmp_path / "a.vtu")
