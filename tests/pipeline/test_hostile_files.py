"""Files of others that are damaged or made to do harm end quickly, in one short line."""

from __future__ import annotations

import json
import math
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

LONGEST = 500
"""Characters of a line about a fault."""
SECONDS = 60.0
"""After which a command hangs, on a busy machine too; most take less than one."""
TAYLOR_GREEN: dict[str, Any] = {
    "name": "theirs",
    "scene": {"kind": "taylor-green"},
    "discretization": {"resolution": 10, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.1, "step": 2.5e-3},
    "snapshots": {"every": 20},
    "parameters": {"train": {"reynolds": [100]}},
}
LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity", "measure": {"wake": {"probe": [0.5, 0.8]}}},
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [50, 200]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3, "integrated_modes": 3}],
}
OWN: dict[str, Any] = {
    "name": "own",
    "scene": {"kind": "custom", "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]}},
    "discretization": {"resolution": 60},
}

Content = str | bytes | Callable[[Path], object]


# Texts of files.


def vtp(numbers: str = "0", kind: str = "Float64", n: object = 1) -> str:
    """PolyData of points and one field."""
    return (
        f'<VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="{n}">'
        '<Points><DataArray type="Float64" NumberOfComponents="3">0 0 0</DataArray></Points>'
        f'<PointData><DataArray type="{kind}" Name="id">{numbers}</DataArray></PointData>'
        "</Piece></PolyData></VTKFile>"
    )


def laughs() -> str:
    """Entities that name ten of the one before."""
    entities = '<!ENTITY a "1 1 1 1 1 1 1 1 1 1">'
    for before, name in zip("abcdefgh", "bcdefghi", strict=True):
        entities += f'<!ENTITY {name} "{10 * f"&{before};"}">'
    return f'<?xml version="1.0"?><!DOCTYPE VTKFile [{entities}]>{vtp("&i;")}'


def npz(**arrays: object) -> Callable[[Path], None]:
    return lambda path: np.savez(path, **arrays)  # type: ignore[arg-type]


def particles(**changed: object) -> Callable[[Path], None]:
    """Particles that fit the case, at one time."""
    x, y = np.meshgrid(*[(np.arange(10) + 0.5) / 10.0] * 2)
    one = np.ones(100)
    given = {"x": x.ravel(), "y": y.ravel(), "u": 0.0 * one, "v": 0.0 * one, "rho": one, "t": 0.0}
    return npz(**{**given, **changed})


def member(name: str, stored: bytes, compression: int = zipfile.ZIP_DEFLATED) -> Any:
    """A NumPy archive with one member."""

    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", compression) as archive:
            archive.writestr(name, stored)

    return write


def npy(about: str, data: bytes = b"") -> bytes:
    text = about.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


def pysph(**shapes: tuple[int, ...]) -> Callable[[Path], None]:
    """A file of PySPH whose datasets have their place in it, and take no space on disk."""

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, shape in shapes.items():
                sparse(file, f"particles/fluid/arrays/{name}", shape)

    return write


def sparse(file: h5py.Group, name: str, shape: tuple[int, ...], kind: str = "<f8") -> None:
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    links.set_create_intermediate_group(True)
    space = h5py.h5s.create_simple(shape)
    type_ = h5py.h5t.py_create(np.dtype(kind))
    h5py.h5d.create(file.id, name.encode(), type_, space, properties, links)


def sparse_points(path: Path) -> None:
    """VTK's HDF format, with points that take no space on disk."""
    with h5py.File(path, "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs["Type"] = np.bytes_("PolyData")
        group.attrs["Version"] = np.array([2, 0])
        group["NumberOfPoints"] = np.array([4 * 10**9])
        sparse(group, "Points", (4 * 10**9, 3))


def pvd(file: str, *times: object) -> str:
    entries = (f'<DataSet timestep="{time}" file="{file}"/>' for time in times or (0, 0.05, 0.1))
    return f'<VTKFile type="Collection"><Collection>{"".join(entries)}</Collection></VTKFile>'


def huge(start: bytes = b"") -> Callable[[Path], None]:
    """A file of 100 GB that takes no space on disk."""

    def write(path: Path) -> None:
        with path.open("wb") as file:
            file.write(start)
            file.truncate(10**11)

    return write


def wkt(corners: np.ndarray) -> str:
    inner = ",".join(f"{x!r} {y!r}" for x, y in np.vstack((corners, corners[:1])).tolist())
    return f"POLYGON(({inner}))"


def ring(n: int) -> np.ndarray:
    """Corners of a circle around (3, 2)."""
    turn = np.arange(n) * 2.0 * math.pi / n
    return np.stack((3.0 + np.cos(turn), 2.0 + np.sin(turn)), axis=1)


# Each with its exit code.

IMPORTED: list[tuple[str, int, str, Content]] = [
    ("integer-of-5000-digits", 3, "a.vtp", vtp("9" * 5000, "Int64")),
    ("huge-number-of-points", 3, "a.vtp", vtp(n=10**30)),
    ("entities", 3, "a.vtp", laughs()),
    ("deep-elements", 3, "a.vtu", "<VTKFile>" + "<a>" * 200_000),
    ("long-section", 3, "a.vtk", "# vtk DataFile Version 3.0\n\nASCII\n" + "x" * 100_000),
    ("members-name", 3, "a.npz", member("x" * 5000 + ".npy", b"no")),
    (
        "claim-of-an-array",
        3,
        "a.npz",
        member("x.npy", npy("{'descr':'<f8','fortran_order':False,'shape':(1000000000000,)}")),
    ),
    ("bytes-that-become-floats", 3, "a.npz", npz(x=np.zeros(5 * 10**8, np.int8))),
    ("infinite-speed", 3, "a.npz", particles(u=np.full(100, 1e308), v=np.full(100, 1e308))),
    ("far-away", 2, "a.npz", particles(x=np.full(100, 1e99))),
    ("late", 2, "a.npz", particles(t=1e308)),
    ("sparse-datasets", 3, "a.h5", pysph(x=(10**10,), y=(10**10,))),
    ("sparse-points", 3, "a.vtkhdf", sparse_points),
    ("lists-itself", 3, "a.pvd", pvd("a.pvd")),
    ("lists-one-file-100000-times", 3, "a.pvd", pvd("x" * 10_000 + ".vtp", *(100_000 * (0,)))),
    *(
        (f"100-gigabytes-{name}", 3, name, huge(start))
        for name, start in (
            ("a.vtp", b"<VTKFile"), ("a.npz", b"PK\3\4"), ("a.pvd", b"<VTKFile"),
            ("a.h5", b"\x89HDF\r\n\x1a\n"),
        )
    ),
]  # fmt: skip


OUTLINES: list[tuple[str, Content]] = [
    ("half.geojson", '{"type": "\\ud800"}'),
    ("long-number.geojson", '{"type": "Polygon", "coordinates": ' + "9" * 10_000 + "}"),
    ("deep.geojson", '{"type": "Polygon", "coordinates": ' + "[" * 50_000 + "]" * 50_000 + "}"),
    ("corners.wkt", wkt(ring(100_000))),
    ("crossing.wkt", wkt(np.random.default_rng(0).random((60_000, 2)))),
    ("holes.wkt", "POLYGON((0 0,9 0,9 9,0 9,0 0)" + ",(1 1,2 1,2 2,1 1)" * 100_000 + ")"),
    ("brackets.wkt", "POLYGON" + "(" * 1_000_000),
    *((f"100-gigabytes{suffix}", huge()) for suffix in (".geojson", ".wkt")),
]
MEASURED: list[tuple[str, Content]] = [
    ("long-head.csv", "time," + "x" * 100_000),
    ("spaces.csv", "time," + "a" + " " * 5000 + "b" + " " * 5000 + "[m/s\n0,1\n"),
    ("rows.csv", "time,wake_u\n" + "0\n" * 8_000_000),
    ("halves.csv", b"time,wake_u\xed\xa0\x80\n0,1\n"),
    ("100-gigabytes.csv", huge(b"time,wake_u\n")),
]
CASES: list[tuple[str, Content]] = [
    ("half.yaml", 'name: "\\ud800"\nscene: {kind: taylor-green}\n'),
    ("100-gigabytes.yaml", huge(b"name: a\n")),
]


def given(
    rows: list[tuple[str, Content]], case: dict[str, Any], *place: str
) -> list[tuple[str, int, str, Content, dict[str, Any], tuple[str, ...]]]:
    """Return rows of files that a case names, whose fault is the case's."""
    return [(Path(name).stem, 2, name, content, case, place) for name, content in rows]


ROWS: list[Any] = [
    *((*row, TAYLOR_GREEN, ()) for row in IMPORTED),
    *given(OUTLINES, OWN, "scene", "solids", "part", "file"),
    *given(MEASURED, LID),
    *given(CASES, {}),
]


def arguments(
    folder: Path, name: str, content: Content, case: dict[str, Any], place: tuple[str, ...]
) -> tuple[object, ...]:
    """Write the file and a case, and return the command that reads it."""
    file, about = folder / name, folder / "case.yaml"
    if callable(content):
        content(file)
    else:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    if not case:
        return "case", "check", file
    if place:
        case = json.loads(json.dumps(case))
        section = case
        for key in place[:-1]:
            section = section.setdefault(key, {})
        section[place[-1]] = name
    about.write_text(yaml.safe_dump(case))
    if place:
        return "case", "check", about
    if case is LID:
        return "fit", about, file, "--noise", "1%"
    return "import", about, file


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "name", "content", "case", "place"),
    [pytest.param(*row[1:], id=f"{Path(row[2]).suffix[1:]}-{row[0]}") for row in ROWS],
)
def test_hostile_file_ends_quickly_in_one_short_line(
    sphrom, tmp_path, monkeypatch, code, name, content, case, place
) -> None:
    monkeypatch.chdir(tmp_path)
    command = arguments(Path(), name, content, case, place)
    began = time.perf_counter()
    result = sphrom(*command)
    assert time.perf_counter() - began < SECONDS
    assert result.exit_code == code, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert len(line) < LONGEST
