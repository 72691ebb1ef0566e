"""Files that VTK itself wrote give the numbers that it was given."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.foreign_files import Source, read_foreign, snapshots_in

N = 5


def points_of(kind: str, fields: dict[str, np.ndarray]) -> Any:
    """Return VTK's grid of points along a line, with fields on them and single numbers on it."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid

    grid = vtkPolyData() if kind == "PolyData" else vtkUnstructuredGrid()
    points = vtkPoints()
    points.SetDataTypeToDouble()
    for i in range(N):
        points.InsertNextPoint(0.1 * i, 0.7, 0.0)
    grid.SetPoints(points)
    cells = vtkCellArray()
    for i in range(N):
        cells.InsertNextCell(1, [i])
    if kind == "PolyData":
        grid.SetVerts(cells)
    else:
        grid.SetCells(1, cells)
    for name, values in fields.items():
        array = numpy_to_vtk(values, deep=1)
        array.SetName(name)
        (grid.GetFieldData() if values.size == 1 else grid.GetPointData()).AddArray(array)
    return grid


def given_fields() -> dict[str, np.ndarray]:
    """Return fields of several types, and the time."""
    random = np.random.default_rng(0)
    velocity = random.standard_normal((N, 3)).astype(np.float32)
    numbers = {"vel": velocity, "rho": random.random(N), "id": np.arange(N, dtype=np.int32)}
    return {**numbers, "TimeValue": np.array([0.25])}


def write_vtk(path: Path, kind: str, *settings: str, version: int | None = None) -> None:
    """Write such a grid by VTK's writer of a kind."""
    module = {"vtk": "IOLegacy", "vtkhdf": "IOHDF"}.get(path.suffix[1:], "IOXML")
    writers = pytest.importorskip(f"vtkmodules.vtk{module}", reason="VTK is not installed")
    writer = getattr(writers, f"vtk{kind}Writer")()
    writer.SetFileName(str(path))
    grid = points_of("PolyData" if "Poly" in kind else "UnstructuredGrid", given_fields())
    grid.GetPointData().SetActiveScalars("rho")
    grid.GetPointData().SetActiveVectors("vel")
    writer.SetInputData(grid)
    for setting in settings:
        getattr(writer, setting)()
    if version is not None:
        writer.SetFileVersion(version)
    writer.Write()


@pytest.mark.parametrize(
    ("name", "kind", "settings", "version"),
    [
        ("a.vtp", "XMLPolyData", ("SetDataModeToAscii",), None),
        ("a.vtu", "XMLUnstructuredGrid", ("SetCompressorTypeToLZ4",), None),
        ("a.vtk", "PolyData", ("SetFileTypeToASCII",), 42),
        ("a.vtk", "UnstructuredGrid", ("SetFileTypeToBinary",), 51),
        ("a.vtkhdf", "HDF", (), None),
    ],
)
def test_vtk_files_are_read(tmp_path: Path, name, kind, settings, version) -> None:
    write_vtk(tmp_path / name, kind, *settings, version=version)
    (source,) = snapshots_in(tmp_path / name)
    read, given = read_foreign(source), given_fields()
    digits = 1e-5 if "SetFileTypeToASCII" in settings else 0.0
    assert read.time == 0.25
    np.testing.assert_allclose(read.fields["x"], 0.1 * np.arange(N), rtol=digits)
    np.testing.assert_allclose(read.fields["vel.y"], given["vel"][:, 1], rtol=digits)
    np.testing.assert_allclose(read.fields["rho"], given["rho"], rtol=digits)
    np.testing.assert_array_equal(read.fields["id"], np.arange(N))
    one = read_foreign(source, "id=2")
    assert {field: values.tolist() for field, values in one.fields.items()} == {
        field: [values[2]] for field, values in read.fields.items()
    }
    with pytest.raises(ArtifactError, match=r"has no particles of --array id=-1; .*id=0, id=1"):
        read_foreign(source, "id=-1")


HEAD = "# vtk DataFile Version 3.0\n\nASCII\nDATASET "


def broken_archive() -> bytes:
    stored = io.BytesIO()
    np.savez_compressed(stored, x=np.arange(999.0))
    content = bytearray(stored.getvalue())
    content[60:100] = bytes(range(60, 100))
    return bytes(content)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.vtu", '<VTKFile type="ImageData"/>'),
        ("a.vtp", '<VTKFile type="PolyData"'),
        ("a.vtk", HEAD + "POLYDATA\nPOINTS -1 float\n"),
        ("a.vtk", HEAD + "POLYDATA\nPOINTS 2 float\n0 0 0 0 0"),
        ("a.vtk", ""),
        ("a.npz", ""),
        ("a.npz", broken_archive()),
        ("a.pvd", '<VTKFile><DataSet timestep="nan" file="a.vtu"/></VTKFile>'),
        ("a.pvd", '<VTKFile><DataSet timestep="1"/></VTKFile>'),
        ("a.pvd", b"<VTKFile>\xff</VTKFile>"),
    ],
)
def test_file_that_can_not_be_read_is_refused_on_one_line(tmp_path, name, content) -> None:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ArtifactError) as caught:
        read_foreign(snapshots_in(path)[0])
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("mode", ["ASCII", "Binary"])
def test_cut_legacy_file_never_gives_other_numbers(tmp_path: Path, mode: str) -> None:
    """VTK reads past the end of such files, in silence or with a warning only."""
    path = tmp_path / "a.vtk"
    write_vtk(path, "PolyData", f"SetFileTypeTo{mode}")
    content, whole = path.read_bytes(), read_foreign(Source(path)).fields
    refused = 0
    for cut in range(0, len(content) - 3, 7):
        path.write_bytes(content[:cut])
        try:
            found = read_foreign(Source(path)).fields
        except ArtifactError:
            refused += 1
        else:  # cut between two sections
            assert all(np.array_equal(values, whole[name]) for name, values in found.items())
    assert refused > 0.8 * len(content) / 7


def test_vtk_that_crashes_or_hangs_is_a_fault_of_the_file(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("vtkmodules", reason="VTK is not installed")
    sound = tmp_path / "sound.vtk"
    sound.write_text(HEAD + "POLYDATA\nPOINTS 1 float\n0 0 0\n")
    greedy = tmp_path / "greedy.vtk"
    greedy.write_text(HEAD + f"POLYDATA\nPOINTS {10**12} double\n0 0 0\n")
    with pytest.raises(ArtifactError, match="is damaged"):
        read_foreign(Source(greedy))
    assert read_foreign(Source(sound)).n_particles == 1
    monkeypatch.setattr("sphrom.exchange.foreign_files.VTK_SECONDS", (1e-6, 0.0))
    with pytest.raises(ArtifactError, match="takes more than 0 s"):
        read_foreign(Source(sound))
    monkeypatch.undo()
    assert read_foreign(Source(sound)).n_particles == 1


def test_without_vtk_its_files_say_what_to_install(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "a.vtu").touch()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(CaseError, match=r"pip install 'sphrom\[vtk\]'"):
        read_foreign(Source(tmp_path / "a.vtu"))


def test_links_out_of_a_vtk_hdf_file_are_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "secret.vtkhdf", "w") as file:
        file["points"] = np.zeros((N, 3))
    with h5py.File(tmp_path / "a.vtkhdf", "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs["Type"] = np.bytes_("PolyData")
        group["NumberOfPoints"] = np.array([N])
        group["Points"] = h5py.ExternalLink("secret.vtkhdf", "points")
    with pytest.raises(ArtifactError, match="Points is a link that may lead out of the file"):
        read_foreign(Source(tmp_path / "a.vtkhdf"))


def test_archive_is_judged_by_its_size_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez_compressed(tmp_path / "a.npz", x=np.zeros(2**17))
    monkeypatch.setattr("sphrom.exchange.foreign_files.MOST_SNAPSHOT_BYTES", 2**20)
    with pytest.raises(ArtifactError, match=r"unpacks to 1 MiB; a snapshot has at most"):
        read_foreign(Source(tmp_path / "a.npz"))
    np.savez(tmp_path / "many.npz", **{f"x{i}": 0 for i in range(1001)})
    with pytest.raises(ArtifactError, match="has 1001 arrays; a snapshot has at most 1000"):
        read_foreign(Source(tmp_path / "many.npz"))


X = np.linspace(0.0, 1.0, N)


def write_pysph(path: Path) -> h5py.File:
    """Write a snapshot as PySPH does, and return the open file."""
    file = h5py.File(path, "w", libver="latest")
    file.create_group("solver_data").attrs["t"] = 0.25
    file["particles/fluid/arrays/x"] = X
    return file


def test_file_of_a_killed_program_is_read_when_its_mark_is_removed(tmp_path, monkeypatch) -> None:
    """The page has a way without HDF5's own tools."""
    path = tmp_path / "their run.hdf5"
    with write_pysph(path) as file:
        file.flush()
        marked = path.read_bytes()
    path.write_bytes(marked)
    with pytest.raises(ArtifactError, match="is marked as open for writing: another ") as e:
        read_foreign(Source(path))
    assert f"`h5clear -s '{path}'`" in str(e.value)
    page = (Path(__file__).parents[2] / "docs/other-programs.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import ctypes.*?)```", page, re.DOTALL)
    monkeypatch.setattr("sys.argv", ["clear.py", str(path)])
    exec(code, {})
    read = read_foreign(Source(path))
    assert read.time == 0.25
    np.testing.assert_array_equal(read.fields["x"], X)


@pytest.mark.parametrize("where", ["/", "/particles", "/particles/fluid/arrays"])
def test_name_that_is_not_utf_8_is_refused(tmp_path: Path, where: str) -> None:
    path = tmp_path / "a.hdf5"
    with write_pysph(path) as file:
        h5py.h5g.create(file[where].id, b"\xff")
    with pytest.raises(ArtifactError, match=rf"the name {where}\S*\\x\S* is not UTF-8"):
        read_foreign(Source(path))
