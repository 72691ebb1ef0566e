"""Files that VTK itself wrote give the numbers that it was given."""

from __future__ import annotations

import io
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sphrom.artifacts.foreign_files import read_collection, read_foreign
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


def npy(values: object) -> bytes:
    """Return what NumPy stores of an array."""
    stored = io.BytesIO()
    np.save(stored, values)
    return stored.getvalue()


def archive(path: Path, members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members.items():
            file.writestr(name, content)


def patched(path: Path, patch: Callable[[bytearray, int], None]) -> None:
    """Change the headers of an archive's only member, both of them."""
    content = bytearray(path.read_bytes())
    for signature, shift in ((b"PK\x03\x04", 0), (b"PK\x01\x02", 2)):
        patch(content, content.index(signature) + shift)
    path.write_bytes(content)


def encrypted(path: Path) -> None:
    archive(path, {"x.npy": npy(np.zeros(3))})

    def patch(content: bytearray, at: int) -> None:
        content[at + 6] |= 1

    patched(path, patch)


def unknown_compression(path: Path) -> None:
    archive(path, {"x.npy": npy(np.zeros(3))})

    def patch(content: bytearray, at: int) -> None:
        content[at + 8] = 97

    patched(path, patch)


def broken(compression: int) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        archive(path, {"x.npy": npy(np.arange(999.0))}, compression)
        content = bytearray(path.read_bytes())
        content[60:100] = bytes(range(60, 100))
        path.write_bytes(content)

    return write


def header(text: str) -> bytes:
    encoded = text.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(encoded).to_bytes(2, "little") + encoded


def text_member(path: Path) -> None:
    archive(path, {"x.npy": b"1.0\n2.0\n"})


def array_file(path: Path) -> None:
    path.write_bytes(npy(np.zeros(3)))


def plain_text(path: Path) -> None:
    path.write_text("x,y\n")


def empty_file(path: Path) -> None:
    path.touch()


def brackets(path: Path) -> None:
    archive(path, {"x.npy": header("[" * 9000)})


def long_header(path: Path) -> None:
    archive(path, {"x.npy": header("{" + " " * 30_000 + "}")})


def claim(path: Path) -> None:
    about = "{'descr': '<f8', 'fortran_order': False, 'shape': (10**9, 10**9), }"
    archive(path, {"x.npy": header(about.replace("10**9", "1000000000"))})


@pytest.mark.parametrize(
    "write",
    [
        text_member,
        array_file,
        plain_text,
        empty_file,
        encrypted,
        unknown_compression,
        broken(zipfile.ZIP_DEFLATED),
        broken(zipfile.ZIP_BZIP2),
        broken(zipfile.ZIP_LZMA),
        brackets,
        long_header,
        claim,
    ],
)
def test_archive_that_can_not_be_read_is_refused_on_one_line(tmp_path: Path, write) -> None:
    path = tmp_path / "a.npz"
    write(path)
    with pytest.raises(ArtifactError) as caught:
        read_foreign(path)
    assert str(caught.value).startswith(f"{path} is ")
    assert "is damaged" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert not str(caught.value).rstrip().endswith(":")


def test_members_that_are_no_arrays_are_left(tmp_path: Path) -> None:
    archive(tmp_path / "a.npz", {"x.npy": npy(np.arange(3.0)), "readme.txt": b"of a run"})
    assert list(read_foreign(tmp_path / "a.npz").fields) == ["x"]


def test_archive_is_judged_by_its_size_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez_compressed(tmp_path / "a.npz", x=np.zeros(2**17))
    monkeypatch.setattr("sphrom.artifacts.numpy_files.MOST_BYTES", 2**20)
    monkeypatch.setattr("sphrom.artifacts.numpy_files._read", None)  # would raise
    with pytest.raises(ArtifactError, match=r"unpacks to 0\.0 GiB; a snapshot has at most"):
        read_foreign(tmp_path / "a.npz")
    np.savez(tmp_path / "many.npz", **{f"x{i}": 0 for i in range(1001)})
    with pytest.raises(ArtifactError, match="holds 1001 arrays; a snapshot has at most 1000"):
        read_foreign(tmp_path / "many.npz")


@pytest.mark.parametrize(
    "content",
    [
        b'<?xml version="1.0" encoding="klingon"?><VTKFile/>',
        b'<?xml version="1.0" encoding="utf-7"?><VTKFile/>',
        b'<?xml version="1.0" encoding="shift_jis"?><VTKFile/>',
        b'<VTKFile><DataSet timestep="nan" file="a.vtu"/></VTKFile>',
        b'<VTKFile><DataSet timestep="inf" file="a.vtu"/></VTKFile>',
        b'<VTKFile><DataSet timestep="x" file="a.vtu"/></VTKFile>',
        b'<VTKFile><DataSet timestep="1"/></VTKFile>',
        b"<VTKFile>\xff</VTKFile>",
        b"<a>" * 100_000,
        b"",
        b"\0",
    ],
)
def test_collection_that_can_not_be_read_is_refused_on_one_line(tmp_path, content) -> None:
    path = tmp_path / "a.pvd"
    path.write_bytes(content)
    with pytest.raises(ArtifactError) as caught:
        read_collection(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value).splitlines()) == 1
