"""Snapshots that other programs wrote: PySPH's HDF5 output, VTK files, plain NumPy archives.

A file holds one snapshot, but VTK's HDF files may hold many. Fields come back by name as one number
for each particle; those of a vector `velocity` are `velocity.x`, `velocity.y` and `velocity.z`.
Nothing in a file is run: archives with pickles are refused, and links out of an HDF5 file. VTK's
files are read by VTK itself, the extra `vtk`, in a process of its own: see `vtk_process`.
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
from sphrom.artifacts.layout import index_not_finite
from sphrom.artifacts.reader import Fault, damage, inspect, items, open_file
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange import vtk_process
from sphrom.machine import available_ram
from sphrom.text import data_size, shortened
from sphrom.whole_files import Unreadable, read_whole, require_size

COMPONENTS = ("x", "y", "z")
TIME_NAMES = ("TimeValue", "time", "t", "TIME")
"""What files call the time of their snapshot."""
COLLECTION = ".pvd"
MOST_BYTES = 16 * 1024 * 1024
"""The largest list of files that is read."""
MOST_SNAPSHOT_BYTES = 2**30
"""Of a snapshot: some six million particles with twenty fields."""
MOST_ARRAYS = 1000
"""Of one NumPy archive."""
MOST_KINDS = 20
"""Of particles, which a field tells apart."""
MOST_STEPS = 100_000
"""Of one file."""
VTK_SECONDS = (10.0, 1e-7)
"""Time that VTK is given for one snapshot, and in addition for each byte of the file."""
VTK_BYTES = (2 * 2**30, 8 * 2**30)
"""Memory that VTK is given at least, and at most."""
PYSPH, NUMPY, STEPPED = (".hdf5", ".h5"), ".npz", (".vtkhdf", ".hdf")
KINDS = (*PYSPH, NUMPY, ".vtu", ".vtp", ".vtk", *STEPPED)
"""The endings of files; those of `STEPPED` may hold many snapshots."""
Read = tuple[float, dict[str, NDArray[Any]]]
"""The time, nan where a file does not tell it, and the fields."""


@dataclass(frozen=True)
class Source:
    """Where a snapshot is, and its time."""

    path: Path
    time: float = math.nan
    """Not a number where nothing but the snapshot itself may tell."""
    step: int = 0
    """Of those that the file holds."""


@dataclass(frozen=True)
class ForeignSnapshot:
    """One snapshot as its file has it, in the file's units."""

    path: Path
    time: float
    """Not a number where the file does not tell."""
    fields: Mapping[str, Array]
    """By name, each (n_particles,)."""

    @property
    def n_particles(self) -> int:
        """The number of particles."""
        return len(next(iter(self.fields.values()), ()))

    def field(self, name: str, option: str) -> Array:
        """Return a field. Raises ArtifactError, naming the option that asked for it."""
        if name in self.fields:
            return self.fields[name]
        known = shortened(", ".join(self.fields))
        raise ArtifactError(f"{self.path}: has no field {name} ({option}); it has {known}")


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Turn a Fault into an ArtifactError that names the file, which has to be there."""
    try:
        if not path.is_file():
            raise Fault("is missing, or not a file")
        yield
    except (Fault, Unreadable) as fault:
        raise ArtifactError(f"{path} {shortened(str(fault))}") from fault


def snapshots_in(path: Path) -> list[Source]:
    """Return the snapshots that a file holds or lists.

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
            raise Fault(f"is damaged: it has {len(times)} times, or one that is no number")
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
        raise Fault("lists no files, or one at a time that is no number")
    return listed


def read_foreign(source: Source, array: str | None = None) -> ForeignSnapshot:
    """Read a snapshot, of the set of particles `array` where a file holds several.

    In files that aren't PySPH's `array` is a field and its value, such as `Type=3`.

    Raises ArtifactError when the file is missing, damaged, of an unknown kind, unsafe, or holds
    numbers that are not finite.
    """
    path, suffix = source.path, source.path.suffix.lower()
    if suffix not in KINDS:
        raise ArtifactError(f"{path}: is of no kind that can be read ({', '.join(KINDS)})")
    with _refused(path):
        if suffix in PYSPH:
            time, values = _read_pysph(path, array)
        else:
            time, values = _read_numpy(path) if suffix == NUMPY else _read_vtk(path, source.step)
            values = values if array is None else _chosen(values, array)
        require_snapshot_size(8 * sum(value.size for value in values.values()))
        return ForeignSnapshot(path, time, dict(_scalars(values)))


def _chosen(values: Mapping[str, NDArray[Any]], chosen: str) -> dict[str, NDArray[Any]]:
    """Return the fields of the particles that have a value of a field, such as `Type=3`."""
    few = {name: np.unique(v) for name, v in values.items() if v.ndim == 1}
    kinds = {f"{n}={one:g}": (n, one) for n, v in few.items() if len(v) <= MOST_KINDS for one in v}
    if chosen not in kinds:
        raise Fault(f"has no particles of --array {chosen}; there are {', '.join(kinds) or 'none'}")
    name, value = kinds[chosen]
    return {n: v[values[name] == value] for n, v in values.items()}


def require_snapshot_size(n_bytes: int) -> None:
    """Raise Fault where a snapshot is larger than any that is read."""
    if n_bytes > MOST_SNAPSHOT_BYTES:
        most = data_size(MOST_SNAPSHOT_BYTES)
        raise Fault(f"unpacks to {data_size(n_bytes)}; a snapshot has at most {most}")


def _scalars(values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Array]]:
    """Yield fields of one number a particle, those of vectors by component."""
    lengths = {name: len(array) for name, array in values.items()}
    if not any(lengths.values()):
        raise Fault("holds no particles")
    if len(set(lengths.values())) > 1:
        raise Fault(f"is damaged: its fields are of different lengths: {lengths}")
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
            held = ", ".join(sorted(sets)) or "none, as there is no /particles/<name>/arrays"
            raise Fault(f"needs the name of one of its sets of particles as --array: {held}")
        prefix = f"particles/{array}/arrays/"
        shapes = {n: shape for n, (shape, _) in contents.datasets.items() if n.startswith(prefix)}
        # Properties of several numbers a particle are of no use here.
        stored = [name for name, shape in shapes.items() if shape == shapes.get(f"{prefix}x")]
        if not stored or len(shapes[stored[0]]) != 1:
            raise Fault(f"holds no particles of {array}, or no field x of them")
        require_snapshot_size(8 * len(stored) * shapes[stored[0]][0])
        with damage(f"{prefix}..."):
            values = {name.removeprefix(prefix): file[name][...] for name in stored}
    return _time_of({"t": contents.attributes.get("solver_data/t", ())}), values


def _read_numpy(path: Path) -> Read:
    require_size(path, 2 * MOST_SNAPSHOT_BYTES)  # where nothing is compressed, headers add to it
    try:
        with np.load(path, allow_pickle=False) as archive:
            members = archive.zip.infolist()
            if len(members) > MOST_ARRAYS:
                raise Fault(f"holds {len(members)} arrays; a snapshot has at most {MOST_ARRAYS}")
            require_snapshot_size(sum(member.file_size for member in members))
            values = {name: np.asarray(archive[name]) for name in archive.files}
    except (Exception, MemoryError) as error:  # whatever a damaged archive makes of its parsers
        if isinstance(error, Fault):
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise Fault(
            "is damaged, no archive of numpy.savez, or holds Python objects, which could run code "
            "and are refused (where h5py is installed, PySPH writes .hdf5, which is read): "
            f"{reason}"
        ) from error
    numbers = {name: value for name, value in values.items() if value.dtype.kind in "fiu"}
    return _time_of(numbers), {name: value for name, value in numbers.items() if value.ndim > 0}


def _read_vtk(path: Path, step: int) -> Read:
    numbers, fields = _vtk(path, step)
    if (points := fields.pop("Points", None)) is None:
        raise Fault("holds no particles")
    return _time_of(numbers), {**fields, **dict(zip(COMPONENTS, points.T, strict=True))}


def _vtk(path: Path, step: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the single numbers of a file, and its arrays on points at a step."""
    if importlib.util.find_spec("vtkmodules") is None:
        raise CaseError(f"{path}: VTK files are read by VTK: `pip install 'sphrom[vtk]'`")
    if path.suffix.lower() in STEPPED:
        with open_file(path) as file:
            list(items(file))  # all of which has to lie in the file itself
    else:
        require_size(path, MOST_SNAPSHOT_BYTES)
    seconds = VTK_SECONDS[0] + VTK_SECONDS[1] * path.stat().st_size
    request = str(path.absolute()), step, seconds
    try:
        return _vtk_process().submit(vtk_process.read, *request).result()
    except (MemoryError, OSError, TypeError, ValueError) as error:
        reason = str(error) or type(error).__name__
        raise Fault(f"is damaged, or no VTK file of points: {reason}") from error
    except BaseException as error:
        _vtk_process.cache_clear()
        for process in multiprocessing.active_children():
            process.kill()
        if isinstance(error, BrokenExecutor):
            limits = f"takes more than {seconds:.0f} s, or needs too much memory"
            raise Fault(f"is damaged, {limits}: VTK ended at it") from error
        raise


@cache
def _vtk_process() -> ProcessPoolExecutor:
    """Start a process for VTK, which ends where a file is too much for it."""
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
