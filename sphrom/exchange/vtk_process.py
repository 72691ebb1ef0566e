"""Read VTK files in a separate process.

A damaged file may make VTK crash, hang, or allocate any amount of memory. Therefore the process has
a memory limit, and ends when a file exceeds its time limit.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import resource
import signal
import threading
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

READERS = {
    "vtu": ("IOXML", "XMLUnstructuredGrid"),
    "vtp": ("IOXML", "XMLPolyData"),
    "vtk": ("IOLegacy", "GenericDataObject"),
}
"""Modules and names of VTK's readers by suffix; all other suffixes mean its HDF5 format."""
TIMES = -1
"""Value of `step` to read the times of all steps."""


def begin(n_bytes: int) -> None:
    """Limit the further memory of a new process [bytes], and silence its output."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + n_bytes, taken + n_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process even within VTK
    os.environ["HDF5_PLUGIN_PRELOAD"] = "::"  # no plugins
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
    os._exit(1)


def read(path: str, step: int, seconds: float) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the single numbers of a file, or the times of its steps, and its arrays on points.

    Ends the process after a time limit [s]. Raises ValueError for errors of VTK and missing points.
    """
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        return _read(path, step)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _read(path: str, step: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

    said = vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(said)
    reader = _reader_of(path)
    reader.UpdateInformation()
    _require_sound(reader, said.GetOutput())
    if step == TIMES:
        return {"times": list(reader.GetOutputInformation(0).Get(Pipeline.TIME_STEPS()) or ())}, {}
    if hasattr(reader, "SetStep"):
        reader.SetStep(step)
    reader.Update()
    _require_sound(reader, said.GetOutput())
    grid = reader.GetOutputDataObject(0)
    if not hasattr(grid, "GetPoints"):
        raise ValueError(f"{grid.GetClassName().removeprefix('vtk')} has no points of its own")
    if not grid.GetNumberOfPoints():
        return {}, {}
    of_file = _arrays_of(grid.GetFieldData()).items()
    numbers = {name: float(values.ravel()[0]) for name, values in of_file if values.size == 1}
    points = vtk_to_numpy(grid.GetPoints().GetData())
    return numbers, {**_arrays_of(grid.GetPointData()), "Points": points}


def _reader_of(path: str) -> Any:
    """Return VTK's reader for the suffix of a file."""
    ending = path.rpartition(".")[2].lower()
    module, kind = READERS.get(ending, ("IOHDF", "HDF"))
    reader = getattr(import_module(f"vtkmodules.vtk{module}"), f"vtk{kind}Reader")()
    if ending == "vtk":
        _require_last_line(path)
        for of in ("Scalars", "Vectors", "Normals", "Tensors", "TCoords", "Fields"):
            getattr(reader, f"ReadAll{of}On")()
    reader.SetFileName(path)
    return reader


def _require_last_line(path: str) -> None:
    """Raise ValueError if a text ends within a line, because VTK would invent missing numbers."""
    with open(path, "rb") as file:
        is_text = b"\nASCII" in file.read(1000).upper()
        file.seek(-1, os.SEEK_END)
        if is_text and not file.read(1).isspace():
            raise ValueError("it ends within a line, and may be incomplete")


def _require_sound(reader: Any, said: str) -> None:
    """Raise ValueError for errors and warnings of VTK; for a truncated file it may only warn."""
    if said or reader.GetErrorCode():
        first = re.split(r"(?:ERROR|[Ww]arning): In [^\n]*\n", said)[1:2]
        text = " ".join(first).partition("): ")
        raise ValueError(" ".join((text[2] or text[0] or "VTK can't read it").split()))


def _arrays_of(data: Any) -> dict[str, np.ndarray]:
    """Return VTK's numeric arrays by name."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    pairs = [(data.GetArrayName(i), data.GetArray(i)) for i in range(data.GetNumberOfArrays())]
    return {name: vtk_to_numpy(array) for name, array in pairs if name and array is not None}
