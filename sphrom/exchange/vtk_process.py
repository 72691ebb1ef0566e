"""Read VTK's files, in a process of its own: `python vtk_process.py DESCRIPTOR BYTES`.

A damaged file may make VTK crash, wait for ever, or ask for any amount of memory: this process has
a limit of memory, and ends by itself when the time for a file is over. It takes requests from a
connection, each a path, a step and the time [s] as JSON, and answers with a NumPy archive: `about`
is JSON, the others are arrays.
"""

from __future__ import annotations

import io
import json
import os
import re
import resource
import signal
import sys
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

TIMES = -1
"""The step that asks for the times of all steps."""


def main() -> None:
    """Answer until the connection is closed."""
    connection, n_bytes = Connection(int(sys.argv[1])), int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_AS, (n_bytes, n_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # it ends the process, whatever VTK does
    while True:
        try:
            path, step, seconds = json.loads(connection.recv_bytes())
        except EOFError:
            return
        signal.setitimer(signal.ITIMER_REAL, seconds)
        try:
            about, arrays = read(path, step)
        except (MemoryError, OSError, TypeError, ValueError) as error:
            about, arrays = {"fault": str(error) or type(error).__name__}, {}
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        answer = io.BytesIO()
        text = json.dumps({**about, "names": list(arrays)}).encode()
        np.savez(answer, *arrays.values(), about=np.frombuffer(text, np.uint8))
        connection.send_bytes(answer.getbuffer())


def read(path: str, step: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the single numbers of a file, or the times of its steps, and its arrays on points.

    Raises ValueError where VTK finds a fault, or no points.
    """
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    said = vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(said)
    reader = reader_of(path)
    reader.UpdateInformation()
    require_sound(reader, said.GetOutput())
    if step == TIMES:
        from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

        return {"times": list(reader.GetOutputInformation(0).Get(Pipeline.TIME_STEPS()) or ())}, {}
    if hasattr(reader, "SetStep"):
        reader.SetStep(step)
    reader.Update()
    require_sound(reader, said.GetOutput())
    grid = reader.GetOutputDataObject(0)
    if not hasattr(grid, "GetPoints"):
        raise ValueError(f"{grid.GetClassName().removeprefix('vtk')} has no points of its own")
    if not grid.GetNumberOfPoints():
        return {}, {}
    from vtkmodules.util.numpy_support import vtk_to_numpy

    whole = arrays_of(grid.GetFieldData())
    numbers = {name: float(values.ravel()[0]) for name, values in whole if values.size == 1}
    arrays = dict(arrays_of(grid.GetPointData()))
    return {"numbers": numbers}, {**arrays, "Points": vtk_to_numpy(grid.GetPoints().GetData())}


def reader_of(path: str) -> Any:
    """Return VTK's reader of a file, by how its name ends."""
    ending = path.rpartition(".")[2].lower()
    if ending in ("vtu", "vtp"):
        from vtkmodules import vtkIOXML

        kind = "UnstructuredGrid" if ending == "vtu" else "PolyData"
        reader = getattr(vtkIOXML, f"vtkXML{kind}Reader")()
    elif ending == "vtk":
        require_last_line(path)
        from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader

        reader = vtkGenericDataObjectReader()
        for kind in ("Scalars", "Vectors", "Normals", "Tensors", "TCoords", "Fields"):
            getattr(reader, f"ReadAll{kind}On")()
    else:
        from vtkmodules.vtkIOHDF import vtkHDFReader

        reader = vtkHDFReader()
    reader.SetFileName(path)
    return reader


def require_last_line(path: str) -> None:
    """Raise ValueError where a text ends within a line: VTK makes up the numbers that are cut."""
    with open(path, "rb") as file:
        is_text = b"\nASCII" in file.read(1000).upper()
        file.seek(-1, os.SEEK_END)
        if is_text and not file.read(1).isspace():
            raise ValueError("it ends within a line, and may have been cut")


def require_sound(reader: Any, said: str) -> None:
    """Raise ValueError where VTK complains: of a cut file it may only warn."""
    if said or reader.GetErrorCode():
        first = re.split(r"(?:ERROR|[Ww]arning): In [^\n]*\n", said)[1:2]
        text = " ".join(first).partition("): ")
        raise ValueError(" ".join((text[2] or text[0] or "VTK can't read it").split()))


def arrays_of(data: Any) -> list[tuple[str, np.ndarray]]:
    """Return the names and values of VTK's arrays of numbers."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    found = [(data.GetArrayName(i), data.GetArray(i)) for i in range(data.GetNumberOfArrays())]
    return [(name, vtk_to_numpy(array)) for name, array in found if name and array is not None]


if __name__ == "__main__":
    main()
