"""Snapshots that other programs wrote: PySPH's HDF5 output, VTK files, plain NumPy archives.

A file holds one snapshot, but VTK's HDF files may hold many. Fields come back by name as one number
for each particle; those of a vector `velocity` are `velocity.x`, `velocity.y` and `velocity.z`.
Nothing in a file is run: archives with pickles are refused, and links out of an HDF5 file. VTK's
files are read by VTK itself, the extra `vtk`, in a process of its own: see `vtk_process`.
"""

from __future__ import annotations

import atexit
import importlib.util
import io
import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.inspection import (
    Contents,
    Fault,
    damage,
    inspect,
    open_file,
    require_own_data,
)
from sphrom.artifacts.layout import index_not_finite
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange import vtk_process
from sphrom.machine import available_ram
from sphrom.text import data_size, shortened
from sphrom.whole_files import Unreadable, read_whole, require_size

Array = NDArray[np.float64]

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
MOST_STEPS = 100_000
"""Of one file."""
VTK_SECONDS = (10.0, 1e-7)
"""Time that VTK is given for one snapshot, and in addition for each byte of the file."""
VTK_BYTES = (2 * 2**30, 8 * 2**30)
"""Memory that VTK is given at least, and at most."""
NPY = ".npy"
PYSPH, NUMPY, STEPPED = (".hdf5", ".h5"), ".npz", (".vtkhdf", ".hdf")
KINDS = (*PYSPH, NUMPY, ".vtu", ".vtp", ".vtk", *STEPPED)
"""The endings of files; those of `STEPPED` may hold many snapshots."""


@dataclass(frozen=True)
class ForeignSnapshot:
    """One snapshot as its file has it, in the file's units."""

    path: Path
    time: float | None
    """None where the file does not tell."""
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
        known = shortened(", ".join(self.fields)) or "none"
        raise ArtifactError(f"{self.path}: has no field {name} ({option}); it has {known}")


@dataclass(frozen=True)
class Stored:
    """Where a snapshot is."""

    path: Path
    time: float | None = None
    """None where nothing but the snapshot itself may tell."""
    step: int = 0
    """Of those that the file holds."""


def snapshots_in(path: Path) -> list[Stored]:
    """Return the snapshots that a file holds or lists.

    Raises ArtifactError when it is missing or damaged, or lists none.
    """
    suffix = path.suffix.lower()
    with _refused(path):
        _require_file(path)
    if suffix == COLLECTION:
        return [Stored(file, time) for time, file in read_collection(path)]
    if suffix in STEPPED:
        with _refused(path):
            times = _vtk(path, vtk_process.TIMES)[0]["times"]
            if len(times) > MOST_STEPS or not np.isfinite(times).all():
                raise Fault(f"is damaged: it has {len(times)} times, or one that is no number")
        return [Stored(path, time, step) for step, time in enumerate(times)] or [Stored(path)]
    return [Stored(path)]


def _require_file(path: Path) -> None:
    if not path.is_file():
        raise Fault("is missing, or not a file")


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Turn a Fault, or what reading raises, into an ArtifactError that names the file."""
    try:
        yield
    except (Fault, Unreadable) as fault:
        raise ArtifactError(f"{path} {shortened(str(fault))}") from fault
    except OSError as error:
        raise ArtifactError(f"{shortened(str(path))} can't be read ({error.strerror})") from error


def read_foreign(path: Path, array: str | None = None, step: int = 0) -> ForeignSnapshot:
    """Read a snapshot, of the set of particles `array` where a file holds several.

    `step` is its number in a file that holds many snapshots.

    Raises
    ------
    ArtifactError
        When the file is missing, damaged, of an unknown kind, unsafe, or holds numbers that are
        not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in KINDS:
        raise ArtifactError(f"{path}: is of no kind that can be read ({', '.join(KINDS)})")
    with _refused(path):
        _require_file(path)
        if suffix in PYSPH:
            time, values = _read_pysph(path, array)
        else:
            time, values = _read_numpy(path) if suffix == NUMPY else _read_vtk(path, step)
        require_snapshot_size(8 * sum(value.size for value in values.values()))
    return ForeignSnapshot(path, time, dict(_scalars(path, values)))


def require_snapshot_size(n_bytes: int) -> None:
    """Raise Fault where a snapshot is larger than any that is read."""
    if n_bytes > MOST_SNAPSHOT_BYTES:
        most = data_size(MOST_SNAPSHOT_BYTES)
        raise Fault(f"unpacks to {data_size(n_bytes)}; a snapshot has at most {most}")


def read_collection(path: Path) -> list[tuple[float, Path]]:
    """Return the times and files that a .pvd file lists.

    Raises ArtifactError when it can't be read, or lists none.
    """
    try:
        entries = list(ElementTree.fromstring(read_whole(path, MOST_BYTES)).iter("DataSet"))
        listed = [(float(e.attrib["timestep"]), path.parent / e.attrib["file"]) for e in entries]
    except (OSError, ElementTree.ParseError, LookupError, ValueError) as error:
        reason = shortened(str(error))
        raise ArtifactError(f"{path}: can't be read as a list of VTK files: {reason}") from error
    if not listed:
        raise ArtifactError(f"{path}: lists no files")
    for time, _ in listed:
        if not math.isfinite(time):
            raise ArtifactError(f"{path}: lists a file at the time {time}")
    return listed


def _scalars(path: Path, values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Array]]:
    """Yield fields of one number a particle, those of vectors by component."""
    n_particles = {len(array) for array in values.values()}
    if n_particles <= {0}:
        raise ArtifactError(f"{path}: holds no particles")
    if len(n_particles) > 1:
        counts = shortened(", ".join(f"{name} {len(array)}" for name, array in values.items()))
        raise ArtifactError(f"{path}: its fields are of different lengths: {counts}")
    for name, array in values.items():
        bad = index_not_finite(array)
        if bad is not None:
            named = shortened(name)
            raise ArtifactError(f"{path}: {named} of particle {bad[0]} is {array[bad]}")
        if array.size == len(array):
            yield name, array.astype(np.float64).ravel()
        elif array.ndim == 2 and array.shape[1] in (2, 3):
            for component, column in zip(COMPONENTS, array.T, strict=False):
                yield f"{name}.{component}", column.astype(np.float64)


Read = tuple[float | None, dict[str, NDArray[Any]]]


def _read_pysph(path: Path, array: str | None) -> Read:
    with open_file(path) as file:
        contents = inspect(file)
        chosen = _chosen(_pysph_arrays(contents), array)
        prefix = f"particles/{chosen}/arrays/"
        stored = [
            name
            for name, (shape, _) in contents.datasets.items()
            if name.startswith(prefix) and len(shape) == 1 and shape[0] > 0
        ]
        require_snapshot_size(8 * sum(contents.datasets[name][0][0] for name in stored))
        with damage(f"{prefix}..."):
            values = {name.removeprefix(prefix): file[name][...] for name in stored}
    n_particles = len(values.get("x", ()))
    # Properties of several numbers a particle are of no use here.
    same = {name: value for name, value in values.items() if len(value) == n_particles}
    if not same:
        raise Fault(f"holds no particles of {chosen}, or no field x of them")
    return _time_of({"t": contents.attributes.get("solver_data/t", ())}), same


def _pysph_arrays(contents: Contents) -> list[str]:
    """Return the names of the sets of particles that PySPH wrote."""
    parts = [name.split("/") for name in contents.datasets]
    names = {part[1] for part in parts if len(part) == 4 and part[::2] == ["particles", "arrays"]}
    if not names:
        raise Fault("holds no particles as PySPH writes them, in /particles/<name>/arrays")
    return sorted(names)


def _chosen(names: list[str], asked: str | None) -> str:
    if asked is None and len(names) == 1:
        return names[0]
    if asked in names:
        return str(asked)
    instead = f", not {asked}" if asked else ""
    raise Fault(f"holds {', '.join(names)}: name one with --array{instead}")


def _read_numpy(path: Path) -> Read:
    require_size(path, 2 * MOST_SNAPSHOT_BYTES)  # where nothing is compressed, headers add to it
    if not zipfile.is_zipfile(path):
        raise Fault("is not a NumPy archive as numpy.savez writes it, or is damaged")
    try:
        with zipfile.ZipFile(path) as archive:
            values = _archived(archive)
    except (Exception, MemoryError) as error:  # whatever a damaged archive makes of its parsers
        if isinstance(error, Fault):
            raise
        if "Object arrays" in str(error):
            raise Fault(
                "holds Python objects, which can run code when they are read: it is refused; PySPH "
                "writes plain HDF5 instead where h5py is installed"
            ) from error
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise Fault(f"is damaged: {reason}") from error
    numbers = {name: value for name, value in values.items() if value.dtype.kind in "fiu"}
    return _time_of(numbers), {name: value for name, value in numbers.items() if value.ndim > 0}


def _archived(archive: zipfile.ZipFile) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive by name; its sizes are looked at before it is unpacked."""
    members = [m for m in archive.infolist() if m.filename.endswith(NPY)]
    if len(members) > MOST_ARRAYS:
        raise Fault(f"holds {len(members)} arrays; a snapshot has at most {MOST_ARRAYS}")
    require_snapshot_size(sum(member.file_size for member in members))
    values = {}
    for member in members:
        with archive.open(member) as stream:
            name = member.filename.removesuffix(NPY)
            values[name] = np.lib.format.read_array(stream, allow_pickle=False)
    return values


def _read_vtk(path: Path, step: int) -> Read:
    about, fields = _vtk(path, step)
    if (points := fields.pop("Points", None)) is None:
        raise Fault("holds no particles")
    return _time_of(about["numbers"]), {**fields, **dict(zip(COMPONENTS, points.T, strict=True))}


class _Vtk:
    """VTK in a process of its own, which ends where a file is too much for it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        atexit.register(self._stop)

    def __call__(self, path: Path, step: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return what VTK tells of a file, and its arrays on points at a step.

        Raises Fault, or CaseError where VTK is not installed.
        """
        if path.suffix.lower() in STEPPED:
            with open_file(path) as file:
                require_own_data(file)
        else:
            require_size(path, MOST_SNAPSHOT_BYTES)
        seconds = VTK_SECONDS[0] + VTK_SECONDS[1] * path.stat().st_size
        try:
            if self._process is None:
                self._start(path)
            request = json.dumps([str(path.absolute()), step, seconds])
            self._connection.send_bytes(request.encode())
            answer = io.BytesIO(self._connection.recv_bytes(2 * MOST_SNAPSHOT_BYTES))
        except (EOFError, ConnectionError) as error:
            late = self._stop() == -signal.SIGALRM
            reason = f"takes more than {seconds:.0f} s" if late else "needs too much memory"
            raise Fault(f"is damaged, or {reason}: VTK ended at it") from error
        except BaseException:
            self._stop()
            raise
        arrays = dict(np.load(answer, allow_pickle=False))
        about = json.loads(arrays.pop("about").tobytes())
        if "fault" in about:
            raise Fault(f"is damaged, or no VTK file of points: {about['fault']}")
        return about, dict(zip(about["names"], arrays.values(), strict=True))

    def _start(self, path: Path) -> None:
        if importlib.util.find_spec("vtkmodules") is None:
            raise CaseError(f"{path}: VTK files are read by VTK: `pip install 'sphrom[vtk]'`")
        least, most = VTK_BYTES
        n_bytes = max(least, min(most, available_ram() or most))
        self._connection, theirs = multiprocessing.Pipe()
        place = str(theirs.fileno())
        self._process = subprocess.Popen(
            [sys.executable, "-P", vtk_process.__file__, place, str(n_bytes)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # an interrupt from the keyboard is for this process
            env={**os.environ, "HDF5_PLUGIN_PRELOAD": "::", "OPENBLAS_NUM_THREADS": "1"},
        )
        theirs.close()

    def _stop(self) -> int | None:
        """End the process, and return how it ended."""
        process, self._process = self._process, None
        if process is None:
            return None
        self._connection.close()
        process.kill()
        return process.wait()


_vtk = _Vtk()


def _time_of(values: Mapping[str, Any]) -> float | None:
    for name in TIME_NAMES:
        value = np.asarray(values.get(name, ()))
        if value.size == 1 and value.dtype.kind in "fiu" and np.isfinite(value).all():
            return float(value.ravel()[0])
    return None
