"""Command `export`: the fields of artifacts, in files of their own for other programs.

Artifacts that hold fields open in ParaView from 5.12 on as they are. Exported files open in older
versions, need no artifact, and show more: the ghosts of walls, and the fields of runs that store
coordinates alone. These are computed one snapshot at a time, the same to the last bit as
`output: snapshots` stores.
"""

from __future__ import annotations

import base64
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.artifacts.layout import Shape
from sphrom.artifacts.paraview import View, views
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.import_options import place
from sphrom.plots.tables import rows_of_columns, write_csv
from sphrom.setup.context import StageContext
from sphrom.sph.fluid import pressure_of
from sphrom.store.sampling import probes_of
from sphrom.store.stored_run import StoredRun
from sphrom.store.workspace import Target, Workspace, make_folder
from sphrom.whole_files import replacement

FOLDER = "export"
"""Where files go unless another folder is named, beside the artifacts."""
FIELDS, PROBES = "vtu", "csv"
"""The formats: fields for ParaView, and tables of runs at some points."""
HEAD = {"time": "s", "x": "m", "y": "m", "velocity_x": "m/s", "velocity_y": "m/s", "pressure": "Pa"}
"""Columns of a table of a run, with their units: one row for each point and time."""
POINTS = "reference_position"
_VERTEX = 1
"""VTK's number of a cell that is a single point."""
_TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}


@dataclass(frozen=True)
class Item:
    """An artifact of a case: a run of a reduced model at a point, of the full one, or no run."""

    target: Target
    point: ParameterPoint | None = None
    model: ReducedModelSection | None = None


@dataclass(frozen=True)
class Source:
    """The fields of an artifact, stored or computed."""

    shapes: Mapping[str, Shape]
    """The lengths of the datasets' axes, by name."""
    read: Callable[[str, Any], NDArray[Any]]
    """Gives one item of a dataset along its first axis, or what else an index selects."""


def run(
    context: StageContext,
    to: str = FIELDS,
    into: Path | None = None,
    at: Sequence[str] | None = None,
) -> None:
    """Export every artifact of a case that is there and holds fields.

    As CSV the runs alone, at points `at`, each like `0.5,0.5`, or along the line of comparison.

    Raises ArtifactError when there is none, one does not belong to the case, or a file can't be
    written; CaseError when there is no such format, or a point is not in the fluid.
    """
    if to not in (FIELDS, PROBES):
        raise CaseError(f"--to: must be {FIELDS} or {PROBES}; got {to!r}")
    if at and to != PROBES:
        raise CaseError(f"--at: goes with --to {PROBES}")
    workspace, folder = Workspace(context), into or context.out / FOLDER
    write = _write_all if to == FIELDS else partial(_write_tables, at=at or ())
    if write(workspace, folder) == 0:
        raise ArtifactError(
            f"{context.out}: nothing to export; make runs with `sphrom run {context.words}`"
        )


def _runs(workspace: Workspace) -> list[Item]:
    """Return every run of the case that is there, at the points and of the models asked for."""
    case, context = workspace.case, workspace.context
    points = () if context.models else context.chosen(case.plan.points)
    found = [Item(workspace.full_run(point), point) for point in points]
    for model in context.chosen_models:
        for point in context.chosen(case.plan.rom_points(model)):
            found.append(Item(workspace.reduced_run(model, point), point, model))
    return [item for item in found if item.target.path.exists()]


def _others(workspace: Workspace) -> list[Item]:
    """Return the other artifacts of the case that are there and may hold fields."""
    case, targets = workspace.case, [workspace.basis()]
    if case.plan.packed:
        targets.append(workspace.packing())
    for point in workspace.context.chosen(case.plan.points):
        targets.append(workspace.mapped(point))
        if case.time.spin_up > 0.0:
            targets.append(workspace.spin_up(point))
    return [Item(target) for target in targets if target.path.exists()]


def _write_all(workspace: Workspace, folder: Path) -> int:
    """Write the fields of all artifacts that are there, and return how many views they have."""
    context, n_written = workspace.context, 0
    for item in [*_runs(workspace), *([] if context.models else _others(workspace))]:
        with _opened(workspace, item) as source:
            for name, view in views(item.target.schema, source.shapes).items():
                path = folder / f"{item.target.path.stem}{'-' * bool(name)}{name}.pvd"
                write_vtu(path, source, view, force=context.force)
                steps = f", {view.n_steps} steps" if view.n_steps else ""
                context.report.info(f"wrote {path}: {view.n_points} points{steps}")
                n_written += 1
    return n_written


@contextmanager
def _opened(workspace: Workspace, item: Item) -> Iterator[Source]:
    """Open an artifact; of a reduced run of coordinates alone, with the fields that they give.

    Raises ArtifactError when it or its basis is missing, damaged, or of another case.
    """
    point, model = item.point, item.model
    with workspace.open(item.target) as artifact:
        shapes = {name: artifact.dataset(name).shape for name in artifact.datasets}
        computed: dict[str, Callable[[Any], Array]] = {}
        if model and point and model.from_operators and POINTS not in artifact:
            run, sound_speed = (
                StoredRun(workspace, artifact, point, model),
                workspace.case.plan.sound_speed,
            )
            points, state = run.position(0), lru_cache(maxsize=1)(run.rebuilt)
            computed = {
                POINTS: points.__getitem__,
                "density_fluctuation": lambda index: state(index)[0],
                "velocity": lambda index: state(index)[1],
                "pressure": lambda index: pressure_of(state(index)[0], sound_speed),
            }
            shape = (artifact.length("time"), len(points))
            shapes |= dict.fromkeys(computed, shape)
            shapes |= {POINTS: points.shape, "velocity": (*shape, points.shape[1])}

        def read(name: str, index: Any) -> NDArray[Any]:
            if name in computed:
                return computed[name](index)
            return np.asarray(artifact.dataset(name)[index])

        yield Source(shapes, read)


def write_vtu(path: Path, source: Source, view: View, *, force: bool) -> None:
    """Write a view as `path`, a .pvd file, and a .vtu file for each step in a folder beside it.

    Raises ArtifactError when one of them is there and `force` is not set, or can't be written.
    """
    times: Sequence[float] = [float(step + 1) for step in range(view.n_steps)] or [0.0]
    if view.times is not None:
        times = source.read(view.times, ...).tolist()
    stem = path.name.removesuffix(path.suffix)
    width = len(str(len(times) - 1))
    entries = []
    for step, time in enumerate(times):
        name = f"{stem}/{stem}-{step:0{width}}.vtu"
        _write_xml(path.parent / name, "UnstructuredGrid", _grid(source, view, step, time), force)
        entries.append(_tag("DataSet", "", timestep=repr(time), part=0, file=name))
    _write_xml(path, "Collection", "".join(entries), force)


def _rows(source: Source, view: View, name: str, step: int) -> NDArray[Any]:
    """Return a field at one step as VTK has it, (n_points,) or (n_points, 3)."""
    if name not in view.stepped:
        values = source.read(name, ...)
    elif step < source.shapes[name][0]:
        values = source.read(name, step)
    else:  # a basis of fewer modes than another
        values = np.zeros(source.shapes[name][1:])
    if values.ndim == 1:
        return values
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _grid(source: Source, view: View, step: int, time: float) -> str:
    """Return one step as an unstructured grid whose cells are the points."""
    n = view.n_points
    cells: dict[str, NDArray[Any]] = {
        "connectivity": np.arange(n),
        "offsets": np.arange(1, n + 1),
        "types": np.full(n, _VERTEX, dtype=np.uint8),
    }
    fields = {shown: _rows(source, view, name, step) for shown, name in view.fields.items()}
    piece = (
        _tag("PointData", "".join(_array(name, rows) for name, rows in fields.items()))
        + _tag("Points", _array("Points", _rows(source, view, view.points, step)))
        + _tag("Cells", "".join(_array(name, values) for name, values in cells.items()))
    )
    when = _array("TimeValue", np.array([time]))
    return _tag("FieldData", when) + _tag("Piece", piece, NumberOfPoints=n, NumberOfCells=n)


def _array(name: str, values: NDArray[Any]) -> str:
    """Return an array as its length [bytes] and its bytes, in letters that XML allows."""
    length = np.uint64(values.nbytes).tobytes()
    return _tag(
        "DataArray",
        base64.b64encode(length + np.ascontiguousarray(values).tobytes()).decode("ascii"),
        type=_TYPES[values.dtype.name],
        Name=name,
        NumberOfTuples=len(values),
        NumberOfComponents=1 if values.ndim == 1 else values.shape[1],
        format="binary",
    )


def _tag(name: str, body: str, **attributes: object) -> str:
    given = "".join(f" {key}={quoteattr(str(value))}" for key, value in attributes.items())
    return f"<{name}{given}>{body}</{name}>\n"


def _write_xml(path: Path, kind: str, body: str, force: bool) -> None:
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    about = {"type": kind, "version": "1.0", "byte_order": order, "header_type": "UInt64"}
    with replacement(path, force=force) as file:
        file.write(f'<?xml version="1.0"?>\n{_tag("VTKFile", _tag(kind, body), **about)}'.encode())


def _write_tables(workspace: Workspace, folder: Path, at: Sequence[str]) -> int:
    """Write a table of every run at points like `0.5,0.5`, or along the line, and return how many.

    A run that became unstable is in its table as far as it went.
    """
    points = np.array([place("at", text) for text in at]) if at else probes_of(workspace.case).line
    outside = points[~workspace.case.scene.domain.contains(points)]
    if len(outside):
        raise CaseError(f"--at: {outside[0].tolist()} m is not in the fluid")
    runs = _runs(workspace)
    for item in runs:
        assert item.point is not None
        path = folder / f"{item.target.path.stem}.csv"
        if path.exists() and not workspace.context.force:
            raise ArtifactError(f"{path} exists already; --force replaces it")
        with StoredRun.opened(workspace, item.point, item.model) as run:
            samples = run.sampled(points)
        times, n_times = np.repeat(samples.time, len(points)), len(samples.time)
        fields = samples.velocity.reshape(-1, 2), samples.pressure.ravel()
        values = np.column_stack((times, np.tile(points, (n_times, 1)), *fields)).tolist()
        rows = [dict(zip(HEAD, row, strict=True)) for row in values]
        if rows:  # of a run that became unstable at once there are none
            make_folder(folder, "--into")
            write_csv(path, rows_of_columns(HEAD, rows))
            workspace.context.report.info(f"wrote {path}: {len(points)} points")
    return len(runs)
