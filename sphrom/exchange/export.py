"""Command `export`: export the fields of artifacts to files for other programs.

ParaView 5.12 and later opens artifacts with fields directly. Exported files also open in older
versions, do not need the artifact, and show more: the ghosts of walls, and the fields of runs that
store only coordinates, bitwise equal to those that `output: snapshots` stores.
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
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.import_options import place
from sphrom.metrics.quantities import AXES, component_names
from sphrom.models.contract import Model, model_of
from sphrom.models.stored_run import StoredRun
from sphrom.plots.tables import rows_of_columns, write_csv
from sphrom.portable import document, fmu, page
from sphrom.setup.context import StageContext
from sphrom.sph.fluid import pressure_of
from sphrom.store.artifact_folder import Target, make_folder
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace
from sphrom.text import data_size
from sphrom.whole_files import replacement

FOLDER = "export"
"""Default folder of exported files, beside the artifacts."""
FIELDS, PROBES, MODEL, UNIT, PAGE = "vtu", "csv", "model", "fmu", "page"
"""Fields for ParaView, tables of histories at points, and trained models for other programs, as
documents, as units for system simulation, or as pages that run them."""
POINTS = "reference_position"
_COMPUTED = "sphrom/coordinates"
"""The kind of artifact that may store all fields that are computed."""
_VERTEX = 1
"""VTK's type of a cell with a single point."""
_TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}


@dataclass(frozen=True)
class Item:
    """An artifact of a case: a reduced run at a point, a full run, or no run."""

    target: Target
    point: ParameterPoint | None = None
    model: ReducedModelSection | None = None


@dataclass(frozen=True)
class Source:
    """The fields of an artifact, stored or computed."""

    schema: str
    """The kind of artifact with these datasets; computed fields are those of coordinates."""
    shapes: Mapping[str, Shape]
    """The shapes of the datasets, by name."""
    read: Callable[[str, Any], NDArray[Any]]
    """Returns the part of a dataset that an index selects, such as one snapshot."""


def run(
    context: StageContext,
    to: str = FIELDS,
    into: Path | None = None,
    at: Sequence[str] | None = None,
    columns: int | None = None,
) -> None:
    """Export all existing artifacts of a case that have fields, or its trained models.

    With `to="csv"`, only runs are exported, at points `at` like `0.5,0.5`, or along the line.
    `columns` is the number of columns of the pictures of a page.

    Raises ArtifactError when there is none, one does not belong to the case, or a file can't be
    written; CaseError when the format is unknown, an option doesn't fit it, a point is not in the
    fluid, or a format can't represent a model.
    """
    formats: dict[str, Callable[[Workspace, Path], int]] = {
        FIELDS: _write_all,
        PROBES: partial(_write_tables, at=at or ()),
        **MODELS,
    }
    if to not in formats:
        raise CaseError(f"--to: must be one of {', '.join(formats)}; got {to!r}")
    if at and to != PROBES:
        raise CaseError(f"--at: needs --to {PROBES}")
    if columns is not None:
        if to != PAGE:
            raise CaseError(f"--columns: needs --to {PAGE}")
        page.require_columns(columns)
        show = partial(page.content, n_columns=columns)
        formats[PAGE] = partial(_write_models, suffix=".html", content=show)
    if to in MODELS and context.only is not None:
        raise CaseError(
            f"--only: --to {to} exports models, which are valid at all points; name models only"
        )
    workspace = Workspace(context)
    folder = into or context.out / FOLDER
    if formats[to](workspace, folder) == 0:
        raise ArtifactError(
            f"{context.out}: has nothing to export; make runs with `sphrom run {context.words}`"
        )


def _runs(workspace: Workspace) -> list[Item]:
    """Return the existing runs of the case at the selected points and of the selected models."""
    case = workspace.case
    context = workspace.context
    points = () if context.models else context.chosen(case.plan.points)
    runs = [Item(workspace.full_run(point), point) for point in points]
    for model in context.chosen_models:
        for point in context.chosen(case.plan.rom_points(model)):
            runs.append(Item(workspace.reduced_run(model, point), point, model))
    return [item for item in runs if item.target.path.exists()]


def _others(workspace: Workspace) -> list[Item]:
    """Return the other existing artifacts of the case that may have fields."""
    case = workspace.case
    targets = [workspace.basis()]
    if case.plan.packed:
        targets.append(workspace.packing())
    for point in workspace.context.chosen(case.plan.points):
        targets.append(workspace.mapped(point))
        if case.time.spin_up > 0.0:
            targets.append(workspace.spin_up(point))
    return [Item(target) for target in targets if target.path.exists()]


def _write_all(workspace: Workspace, folder: Path) -> int:
    """Write the fields of all existing artifacts, and return the number of views."""
    context = workspace.context
    n_written = 0
    for item in [*_runs(workspace), *([] if context.models else _others(workspace))]:
        with _opened(workspace, item) as source:
            for name, view in views(source.schema, source.shapes).items():
                path = folder / f"{item.target.path.stem}{'-' * bool(name)}{name}.pvd"
                make_folder(folder, "--into")
                write_vtu(path, source, view, force=context.force)
                steps = f", {view.n_steps} steps" if view.n_steps else ""
                context.report.info(f"wrote {path}: {view.n_points} points{steps}")
                n_written += 1
    return n_written


@contextmanager
def _opened(workspace: Workspace, item: Item) -> Iterator[Source]:
    """Open an artifact; fields of a run that stores only coordinates are computed from them.

    Raises ArtifactError when it or its basis is missing, damaged, or of another case.
    """
    point = item.point
    model = item.model
    schema = item.target.schema
    with workspace.open(item.target) as artifact:
        shapes = {name: artifact.dataset(name).shape for name in artifact.datasets}
        computed: dict[str, Callable[[Any], Array]] = {}
        run = StoredRun.of(workspace, artifact, point, model) if model and point else None
        if run is not None and run.is_computed and POINTS not in artifact:
            sound_speed = workspace.case.plan.sound_speed
            points = run.position(0)
            state = lru_cache(maxsize=1)(run.state)
            computed = {
                POINTS: points.__getitem__,
                "density_fluctuation": lambda index: state(index)[0],
                "velocity": lambda index: state(index)[1],
                "pressure": lambda index: pressure_of(state(index)[0], sound_speed),
            }
            shape = (artifact.length("time"), len(points))
            shapes |= dict.fromkeys(computed, shape)
            shapes |= {POINTS: points.shape, "velocity": (*shape, points.shape[1])}
            schema = _COMPUTED

        def read(name: str, index: Any) -> NDArray[Any]:
            if name in computed:
                return computed[name](index)
            return np.asarray(artifact.dataset(name)[index])

        yield Source(schema, shapes, read)


def write_vtu(path: Path, source: Source, view: View, *, force: bool) -> None:
    """Write a view as a .pvd file `path`, and a .vtu file per step in a folder beside it.

    Raises ArtifactError when one of them exists and `force` is not set, or can't be written.
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
    """Return a field at one step in VTK's shape, (n_points,) or (n_points, 3)."""
    if name not in view.stepped:
        values = source.read(name, ...)
    elif step < source.shapes[name][0]:
        values = source.read(name, step)
    else:  # this basis has fewer modes than another one
        values = np.zeros(source.shapes[name][1:])
    if values.ndim == 1:
        return values
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _grid(source: Source, view: View, step: int, time: float) -> str:
    """Return one step as an unstructured grid with one cell per point."""
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
    """Return an XML element with an array: its length [bytes] and its content, in base64."""
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
    pairs = "".join(f" {key}={quoteattr(str(value))}" for key, value in attributes.items())
    return f"<{name}{pairs}>{body}</{name}>\n"


def _write_xml(path: Path, kind: str, body: str, force: bool) -> None:
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    attributes = {"type": kind, "version": "1.0", "byte_order": order, "header_type": "UInt64"}
    with replacement(path, force=force) as file:
        file.write(
            f'<?xml version="1.0"?>\n{_tag("VTKFile", _tag(kind, body), **attributes)}'.encode()
        )


def _write_tables(workspace: Workspace, folder: Path, at: Sequence[str]) -> int:
    """Write a table per run at points like `0.5,0.5`, or along the line; return their number.

    The table of an unstable run ends at its last snapshot.
    """
    n_dim = workspace.case.scene.domain.n_dim
    asked = [place("at", text, n_dim) for text in at]
    points = np.array(asked) if asked else probes_of(workspace.case).line
    # The rows are all pairs of a time and a point.
    head = {"time": "s", **dict.fromkeys(AXES[:n_dim], "m")}
    head |= dict.fromkeys(component_names("velocity", n_dim), "m/s") | {"pressure": "Pa"}
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
        times = np.repeat(samples.time, len(points))
        n_times = len(samples.time)
        fields = samples.velocity.reshape(-1, n_dim), samples.pressure.ravel()
        values = np.column_stack((times, np.tile(points, (n_times, 1)), *fields)).tolist()
        rows = [dict(zip(head, row, strict=True)) for row in values]
        if rows:  # a run that became unstable immediately has no rows
            make_folder(folder, "--into")
            write_csv(path, rows_of_columns(head, rows))
            workspace.context.report.info(f"wrote {path}: {len(points)} points")
    return len(runs)


def _write_models(
    workspace: Workspace, folder: Path, suffix: str, content: Callable[[Model[Any]], bytes]
) -> int:
    """Write the selected trained models as files of one kind, and return their number.

    Models that the kind can't represent are left out, unless the user names them, or none is left.
    """
    context = workspace.context
    n_written = 0
    n_refused = 0
    for section in context.chosen_models:
        try:
            written = content(model_of(workspace, section))
        except CaseError as error:
            if context.models:
                raise
            context.report.warn(str(error))
            n_refused += 1
            continue
        make_folder(folder, "--into")
        path = folder / f"model-{section.name}{suffix}"
        with replacement(path, force=context.force) as file:
            file.write(written)
        context.report.info(f"wrote {path}: {data_size(len(written))}")
        n_written += 1
    if n_refused > 0 and n_written == 0:
        raise CaseError(
            "export: none of the case's models can be exported as such a file; the warnings say "
            "why. A model's own file, model-NAME.h5, can be handed on in any case: sphrom.load "
            "reads it"
        )
    return n_written


MODELS: Mapping[str, Callable[[Workspace, Path], int]] = {
    MODEL: partial(_write_models, suffix=".json", content=document.content),
    UNIT: partial(_write_models, suffix=".fmu", content=fmu.content),
    PAGE: partial(_write_models, suffix=".html", content=page.content),
}
"""Functions that write trained models, by format."""
