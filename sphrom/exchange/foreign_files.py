"""Read snapshots of other programs: PySPH's HDF5 output, VTK files, plain NumPy archives.

A file has one snapshot, except VTK's HDF files, which may have many. Fields are returned by name
with one number per particle; the components of a vector `velocity` are `velocity.x`, `velocity.y`
and `velocity.z`. No code from a file is run: archives with pickles and HDF5 files with external
links are refused. VTK reads its files (the extra `vtk`) in a process of its own, `vtk_process`.
"""

from __future__ import annotations

import importlib.util
import math
import multiprocessing
from collections.abc import Iterator, Mapping
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.artifacts.contents import Fault, damage, inspect, items, open_file
from sphrom.artifacts.layout import index_not_finite
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange import vtk_process
from sphrom.machine import available_ram
from sphrom.text import data_size, shortened
from sphrom.whole_files import Unreadable, read_whole, require_size

COMPONENTS = ("x", "y", "z")
TIME_NAMES = ("TimeValue", "time", "t", "TIME")
"""Names of the time in files."""
COLLECTION = ".pvd"
MOST_BYTES = 16 * 1024 * 1024
"""Largest size of a list of files [bytes]."""
MOST_SNAPSHOT_BYTES = 2**30
"""Largest size of a snapshot [bytes], about six million particles with twenty fields."""
MOST_ARRAYS = 1000
"""Largest number of arrays of one NumPy archive."""
MOST_KINDS = 20
"""Largest number of kinds of particles that the values of a field distinguish."""
MOST_STEPS = 100_000
"""Largest number of snapshots of one file."""
VTK_SECONDS = (10.0, 1e-7)
"""Time limit of VTK for one snapshot, constant and per byte of the file [s]."""
VTK_BYTES = (2 * 2**30, 8 * 2**30)
"""Least and greatest memory limit of VTK [bytes]."""
PYSPH, NUMPY, STEPPED = (".hdf5", ".h5"), ".npz", (".vtkhdf", ".hdf")
KINDS = (*PYSPH, NUMPY, ".vtu", ".vtp", ".vtk", *STEPPED)
"""The suffixes of files; those of `STEPPED` may have many snapshots."""
REMEDY = (
    "To write a snapshot with Python: numpy.savez('run_0.npz', t=time, x=x, y=y, u=u, v=v, p=p), "
    "with arrays of one number per particle; then import *.npz with --pressure p"
)
"""Advice on files of other layouts."""
Read = tuple[float, dict[str, NDArray[Any]]]
"""The time, NaN if the file does not have it, and the fields."""


@dataclass(frozen=True)
class Source:
    """The file and the time of a snapshot."""

    path: Path
    time: float = math.nan
    """NaN if only the snapshot itself may have it."""
    step: int = 0
    """Index among the snapshots of the file."""


@dataclass(frozen=True)
class ForeignSnapshot:
    """One snapshot with the names and units of its file."""

    path: Path
    time: float
    """NaN if the file does not have it."""
    fields: Mapping[str, Array]
    """Fields (n_particles,) by name."""

    @property
    def n_particles(self) -> int:
        """The number of particles."""
        return len(next(iter(self.fields.values()), ()))

    def field(self, name: str, option: str) -> Array:
        """Return a field. Raises ArtifactError, with the option that names it."""
        if name in self.fields:
            return self.fields[name]
        names = shortened(", ".join(self.fields))
        raise ArtifactError(f"{self.path}: has no field {name} ({option}); it has {names}")


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Require that a file exists, and turn a Fault into an ArtifactError with its path."""
    try:
        if not path.is_file():
            raise Fault("is missing, or not a file")
        yield
    except (Fault, Unreadable) as fault:
        raise ArtifactError(f"{path} {shortened(str(fault))}") from fault


def snapshots_in(path: Path) -> list[Source]:
    """Return the snapshots that a file contains or lists.

    Raises ArtifactError when it is missing or damaged, or lists none.
    """
    suffix = path.suffix.lower()
    with _refused(path):
        if suffix == COLLECTION:
            return _listed(path)
        if suffix not in STEPPED:
            return [Source(path)]
        times = _vtk(path, vtk_process.TIMES)[0]["times"]
        if len(times) > MOST_STEPS or not np.isfinite(times).all():
            raise Fault(f"is damaged: it has {len(times)} times, or one that is not a number")
        return [Source(path, time, step) for step, time in enumerate(times)] or [Source(path)]


def _listed(path: Path) -> list[Source]:
    """Return the snapshots that a .pvd file lists."""
    try:
        entries = list(ElementTree.fromstring(read_whole(path, MOST_BYTES)).iter("DataSet"))
        listed = [
            Source(path.parent / e.attrib["file"], float(e.attrib["timestep"])) for e in entries
        ]
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise Fault(f"can't be read as a list of VTK files: {error}") from error
    if not listed or not np.isfinite([source.time for source in listed]).all():
        raise Fault("lists no files, or one with a time that is not a number")
    return listed


def read_foreign(source: Source, array: str | None = None) -> ForeignSnapshot:
    """Read a snapshot; `array` selects a set of particles.

    In PySPH's files, `array` is a name. In others it is a field with a value, such as `Type=3`.

    Raises ArtifactError when the file is missing, damaged, unknown, unsafe, or not finite.
    """
    path = source.path
    suffix = source.path.suffix.lower()
    if suffix not in KINDS:
        kinds = ", ".join(KINDS)
        raise ArtifactError(f"{path}: can't be read; the suffix must be one of {kinds}. {REMEDY}")
    with _refused(path):
        if suffix in PYSPH:
            time, values = _read_pysph(path, array)
        else:
            time, values = _read_numpy(path) if suffix == NUMPY else _read_vtk(path, source.step)
            values = values if array is None else _chosen(values, array)
        require_snapshot_size(8 * sum(value.size for value in values.values()))
        return ForeignSnapshot(path, time, dict(_scalars(values)))


def _chosen(values: Mapping[str, NDArray[Any]], chosen: str) -> dict[str, NDArray[Any]]:
    """Return the fields of those particles where a field has a value, such as `Type=3`."""
    few = {name: np.unique(v) for name, v in values.items() if v.ndim == 1}
    kinds = {f"{n}={one:g}": (n, one) for n, v in few.items() if len(v) <= MOST_KINDS for one in v}
    if chosen not in kinds:
        raise Fault(f"has no particles of --array {chosen}; there are {', '.join(kinds) or 'none'}")
    name, value = kinds[chosen]
    return {n: v[values[name] == value] for n, v in values.items()}


def require_snapshot_size(n_bytes: int) -> None:
    """Raise Fault if a snapshot exceeds the largest size."""
    if n_bytes > MOST_SNAPSHOT_BYTES:
        most = data_size(MOST_SNAPSHOT_BYTES)
        raise Fault(f"unpacks to {data_size(n_bytes)}; a snapshot has at most {most}")


def _scalars(values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Array]]:
    """Yield fields with one number per particle, and the components of vectors."""
    lengths = {name: len(array) for name, array in values.items()}
    if not any(lengths.values()):
        raise Fault("has no particles")
    if len(set(lengths.values())) > 1:
        raise Fault(f"is damaged: its fields have different lengths: {lengths}")
    for name, array in values.items():
        if (bad := index_not_finite(array)) is not None:
            raise Fault(f"is damaged: {name} of particle {bad[0]} is {array[bad]}")
        if array.size == len(array):
            yield name, array.astype(np.float64).ravel()
        elif array.ndim == 2 and array.shape[1] in (2, 3):
            for component, column in zip(COMPONENTS, array.T, strict=False):
                yield f"{name}.{component}", column.astype(np.float64)


def _read_pysph(path: Path, array: str | None) -> Read:
    with open_file(path) as file:
        contents = inspect(file)
        parts = [name.split("/") for name in contents.datasets]
        sets = {p[1] for p in parts if len(p) == 4 and p[::2] == ["particles", "arrays"]}
        if array is None and len(sets) == 1:
            (array,) = sets
        if array not in sets:
            if not sets:
                raise Fault(f"has no /particles/NAME/arrays like PySPH's files. {REMEDY}")
            listed = ", ".join(sorted(sets))
            raise Fault(f"needs the name of one of its sets of particles as --array: {listed}")
        prefix = f"particles/{array}/arrays/"
        shapes = {n: shape for n, (shape, _) in contents.datasets.items() if n.startswith(prefix)}
        # Properties with several numbers per particle are ignored.
        stored = [name for name, shape in shapes.items() if shape == shapes.get(f"{prefix}x")]
        if not stored or len(shapes[stored[0]]) != 1:
            raise Fault(f"has no particles of {array}, or no field x for them")
        require_snapshot_size(8 * len(stored) * shapes[stored[0]][0])
        with damage(f"{prefix}..."):
            values = {name.removeprefix(prefix): file[name][...] for name in stored}
    return _time_of({"t": contents.attributes.get("solver_data/t", ())}), values


def _read_numpy(path: Path) -> Read:
    require_size(path, 2 * MOST_SNAPSHOT_BYTES)  # headers add to the size of uncompressed arrays
    try:
        with np.load(path, allow_pickle=False) as archive:
            members = archive.zip.infolist()
            if len(members) > MOST_ARRAYS:
                raise Fault(f"has {len(members)} arrays; a snapshot has at most {MOST_ARRAYS}")
            require_snapshot_size(sum(member.file_size for member in members))
            values = {name: np.asarray(archive[name]) for name in archive.files}
    except (Exception, MemoryError) as error:  # parsers raise all kinds for damaged archives
        if isinstance(error, Fault):
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise Fault(
            "is damaged, is not an archive of numpy.savez, or contains Python objects, which could "
            "run code and are refused (with h5py installed, PySPH writes .hdf5 instead): "
            f"{reason}"
        ) from error
    numbers = {name: value for name, value in values.items() if value.dtype.kind in "fiu"}
    return _time_of(numbers), {name: value for name, value in numbers.items() if value.ndim > 0}


def _read_vtk(path: Path, step: int) -> Read:
    numbers, fields = _vtk(path, step)
    if (points := fields.pop("Points", None)) is None:
        raise Fault("has no particles")
    return _time_of(numbers), {**fields, **dict(zip(COMPONENTS, points.T, strict=True))}


def _vtk(path: Path, step: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the single numbers of a file, and its arrays on points at a step."""
    if importlib.util.find_spec("vtkmodules") is None:
        raise CaseError(f"{path}: VTK files need VTK: `pip install 'sphrom[vtk]'`")
    if path.suffix.lower() in STEPPED:
        with open_file(path) as file:
            list(items(file))  # raises for links to other files
    else:
        require_size(path, MOST_SNAPSHOT_BYTES)
    seconds = VTK_SECONDS[0] + VTK_SECONDS[1] * path.stat().st_size
    try:
        asked = _vtk_process().submit(vtk_process.read, str(path.absolute()), step, seconds)
        return asked.result()
    except (MemoryError, OSError, TypeError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise Fault(f"is damaged, or not a VTK file with points: {reason}") from error
    except BaseException as error:
        _vtk_process.cache_clear()
        for process in multiprocessing.active_children():
            process.kill()
        if isinstance(error, BrokenExecutor):
            limits = f"takes more than {seconds:.0f} s, or needs too much memory"
            raise Fault(f"is damaged, {limits}: VTK was stopped") from error
        raise


@cache
def _vtk_process() -> ProcessPoolExecutor:
    """Start a process for VTK, which ends when a file exceeds its limits."""
    least, most = VTK_BYTES
    n_bytes = max(least, min(most, available_ram() or most))
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, context, vtk_process.begin, (n_bytes,))


def _time_of(values: Mapping[str, Any]) -> float:
    for name in TIME_NAMES:
        value = np.asarray(values.get(name, ()))
        if value.size == 1 and value.dtype.kind in "fiu" and np.isfinite(value).all():
            return float(value.ravel()[0])
    return math.nan
