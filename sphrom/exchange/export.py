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
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import EllipsisType
from typing import Any, Protocol
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, open_artifact, schema_of
from sphrom.artifacts.layout import Shape
from sphrom.artifacts.paraview import View, views
from sphrom.case.loader import case_of_text
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.console import Reporter
from sphrom.errors import ArtifactError, CaseError
from sphrom.metrics.samples import Samples
from sphrom.online.stored_run import StoredRun
from sphrom.plots.tables import write_csv
from sphrom.setup.context import StageContext
from sphrom.sph import state_equation
from sphrom.store.bases import read_points
from sphrom.store.sampling import probes_of
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace, make_folder
from sphrom.whole_files import replacement

Array = NDArray[np.float64]

FOLDER = "export"
"""Where files go unless another folder is named, beside the artifacts."""
FIELDS, PROBES = "vtu", "csv"
"""The formats: fields for ParaView, and tables of runs at some points."""
COORDINATES, POINTS = "sphrom/coordinates", "reference_position"
_VERTEX = 1
"""VTK's number of a cell that is a single point."""
_TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}


class Rows(Protocol):
    """A field that is read whole, or one step at a time."""

    @property
    def shape(self) -> Shape:
        """The lengths of the axes."""

    def __getitem__(self, selection: int | EllipsisType, /) -> NDArray[Any]:
        """Return one item along the first axis, or all."""


Source = tuple[str, Mapping[str, Rows]]
"""The kind of an artifact, and its datasets by name."""


def run(
    context: StageContext, to: str = FIELDS, into: Path | None = None, at: Sequence[str] = ()
) -> None:
    """Export every artifact of a case that is there and holds fields.

    As CSV the runs alone, at points `at`, each like `0.5,0.5`, or along the line of comparison.

    Raises
    ------
    ArtifactError
        When there is none, one does not belong to the case, or a file can't be written.
    CaseError
        When there is no such format, or a point is not in the fluid.
    """
    workspace = Workspace(context)
    folder = into or context.out / FOLDER
    if to == PROBES:
        _write_tables(workspace, folder, at)
        return
    if at:
        raise CaseError(f"--at: goes with --to {PROBES}")
    _require_fields(to)
    n_written = 0
    for path, opened in _sources(workspace):
        if path.exists():
            with opened as source:
                n_written += _write_views(folder / path.stem, source, context.force, context.report)
    if n_written == 0:
        raise ArtifactError(
            f"{context.out}: there is no artifact with fields; make some with `sphrom run CASE`"
        )


def run_file(path: Path, to: str, into: Path | None, force: bool, report: Reporter) -> None:
    """Export one artifact, whatever case it belongs to.

    Raises
    ------
    ArtifactError
        When it can't be read, holds no fields, or a file can't be written.
    CaseError
        When there is no such format.
    """
    _require_fields(to)
    schema = schema_of(path)
    with _opened(path, schema, report) as source:
        if not _write_views((into or path.parent / FOLDER) / path.stem, source, force, report):
            raise ArtifactError(f"{path} ({schema}) holds no fields to export")


def _require_fields(to: str) -> None:
    if to != FIELDS:
        raise CaseError(f"--to: must be {FIELDS}, or for a case {PROBES}; got {to!r}")


@contextmanager
def _opened(path: Path, schema: str, report: Reporter) -> Iterator[Source]:
    """Open an artifact; a run that stores coordinates alone, with the artifacts beside it."""
    with open_artifact(path, schema, made_by="sphrom run CASE") as artifact:
        if schema != COORDINATES or POINTS in artifact:
            yield _datasets(artifact)
            return
        case = case_of_text(artifact.case_text)
    workspace = Workspace(StageContext(case, path.parent, False, None, report))
    for model in case.rom:
        for point in case.plan.rom_points(model):
            if workspace.reduced_run(model, point).path.name == path.name:
                with _open_run(workspace, model, point) as source:
                    yield source
                return
    raise ArtifactError(
        f"{path}: holds coordinates alone, and is no longer called as a run of its case: "
        "`sphrom export CASE` rebuilds fields of the runs in the case's folder"
    )


def _datasets(artifact: Artifact) -> Source:
    return artifact.text("schema"), {name: artifact.dataset(name) for name in artifact.datasets}


def _sources(workspace: Workspace) -> Iterator[tuple[Path, AbstractContextManager[Source]]]:
    """Yield every artifact of the case that may hold fields, to be opened if it is there."""
    for target in _targets(workspace):
        yield target.path, _open_target(workspace, target)
    for target, point, model in _runs(workspace):
        if model is not None:
            yield target.path, _open_run(workspace, model, point)


def _runs(
    workspace: Workspace,
) -> Iterator[tuple[Target, ParameterPoint, ReducedModelSection | None]]:
    """Yield every run of the case, at the parameter points that are asked for."""
    case, chosen = workspace.case, workspace.context.chosen
    for point in chosen(case.plan.points):
        yield workspace.full_run(point), point, None
    for model in case.rom:
        for point in chosen(case.plan.rom_points(model)):
            yield workspace.reduced_run(model, point), point, model


def _targets(workspace: Workspace) -> Iterator[Target]:
    """Yield every artifact of the case that may hold fields, but for reduced runs."""
    case = workspace.case
    by_point: tuple[Callable[..., Target], ...] = (workspace.full_run, workspace.mapped)
    if case.time.spin_up > 0.0:
        by_point = (workspace.spin_up, *by_point)
    if case.plan.packed:
        yield workspace.packing()
    for point in workspace.context.chosen(case.plan.points):
        yield from (target(point) for target in by_point)
    yield workspace.basis()


@contextmanager
def _open_target(workspace: Workspace, target: Target) -> Iterator[Source]:
    with workspace.open(target) as artifact:
        yield _datasets(artifact)


@contextmanager
def _open_run(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> Iterator[Source]:
    """Open a reduced run of the case, with the fields that its coordinates give.

    Raises ArtifactError when it or its basis is missing, damaged, or of another case.
    """
    with workspace.open(workspace.reduced_run(model, point)) as run:
        schema, stored = _datasets(run)
        if model.on_particles or POINTS in run:
            yield schema, stored
            return
        points = read_points(workspace)
        state = lru_cache(maxsize=1)(StoredRun(workspace, run, point, model).rebuilt)
        shape, sound_speed = (run.length("time"), len(points)), workspace.case.plan.sound_speed
        computed = {
            "density_fluctuation": Computed(shape, lambda i: state(i)[0]),
            "velocity": Computed((*shape, points.shape[1]), lambda i: state(i)[1]),
            "pressure": Computed(
                shape, lambda i: state_equation.pressure(state(i)[0], sound_speed)
            ),
        }
        yield schema, {**stored, POINTS: points, **computed}


@dataclass(frozen=True)
class Computed:
    """A field that is computed snapshot by snapshot."""

    shape: Shape
    at: Callable[[int], NDArray[np.float64]]

    def __getitem__(self, selection: int | EllipsisType, /) -> NDArray[np.float64]:
        """Return one snapshot, or all of them."""
        if isinstance(selection, int):
            return self.at(selection)
        return np.array([self.at(snapshot) for snapshot in range(self.shape[0])])


def _write_views(stem: Path, source: Source, force: bool, report: Reporter) -> int:
    """Write all views of an artifact, and return how many there are."""
    schema, datasets = source
    shown = views(schema, {name: rows.shape for name, rows in datasets.items()})
    for name, view in shown.items():
        path = stem.with_name(stem.name + (f"-{name}" if name else "") + ".pvd")
        write_vtu(path, datasets, view, force=force)
        steps = f", {view.n_steps} steps" if view.n_steps else ""
        report.info(f"wrote {path}: {view.n_points} points{steps}")
    return len(shown)


def write_vtu(path: Path, datasets: Mapping[str, Rows], view: View, *, force: bool) -> None:
    """Write a view as `path`, a .pvd file, and a .vtu file for each step in a folder beside it.

    Raises ArtifactError when one of them is there and `force` is not set, or can't be written.
    """
    times: Sequence[float] = [float(step + 1) for step in range(view.n_steps)] or [0.0]
    if view.times is not None:
        times = datasets[view.times][...].tolist()
    stem = path.name.removesuffix(path.suffix)
    width = len(str(len(times) - 1))
    entries = []
    for step, time in enumerate(times):
        name = f"{stem}/{stem}-{step:0{width}}.vtu"
        _write_xml(path.parent / name, "UnstructuredGrid", _grid(datasets, view, step, time), force)
        entries.append(_tag("DataSet", "", timestep=repr(time), part=0, file=name))
    _write_xml(path, "Collection", "".join(entries), force)


def _rows(datasets: Mapping[str, Rows], view: View, source: str, step: int) -> NDArray[Any]:
    """Return a field at one step as VTK has it, (n_points,) or (n_points, 3)."""
    rows = datasets[source]
    if source not in view.stepped:
        values = rows[...]
    elif step < rows.shape[0]:
        values = rows[step]
    else:  # a basis of fewer modes than another
        values = np.zeros(rows.shape[1:])
    if values.ndim == 1:
        return values
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _grid(datasets: Mapping[str, Rows], view: View, step: int, time: float) -> str:
    """Return one step as an unstructured grid whose cells are the points."""
    n = view.n_points
    cells: dict[str, NDArray[Any]] = {
        "connectivity": np.arange(n),
        "offsets": np.arange(1, n + 1),
        "types": np.full(n, _VERTEX, dtype=np.uint8),
    }
    fields = {name: _rows(datasets, view, source, step) for name, source in view.fields.items()}
    piece = (
        _tag("PointData", "".join(_array(name, rows) for name, rows in fields.items()))
        + _tag("Points", _array("Points", _rows(datasets, view, view.points, step)))
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


@dataclass(frozen=True)
class ProbeRow:
    """Velocity and pressure at one point and time."""

    time: float = field(metadata={"unit": "s"})
    x: float = field(metadata={"unit": "m"})
    y: float = field(metadata={"unit": "m"})
    u: float = field(metadata={"unit": "m/s"})
    v: float = field(metadata={"unit": "m/s"})
    pressure: float = field(metadata={"unit": "Pa"})


def _write_tables(workspace: Workspace, folder: Path, at: Sequence[str]) -> None:
    """Write a table of every run that is there, at points like `0.5,0.5`, or along the line."""
    points = _points(workspace, at)
    report = workspace.context.report
    there = [found for found in _runs(workspace) if found[0].path.exists()]
    if not there:
        raise ArtifactError(f"{workspace.out}: there is no run; make some with `sphrom run CASE`")
    for target, point, model in there:
        path = folder / f"{target.path.stem}.csv"
        if path.exists() and not workspace.context.force:
            raise ArtifactError(f"{path} exists already; --force replaces it")
        with StoredRun.opened(workspace, point, model) as run:
            rows = list(_probe_rows(points, run.sampled(points)))
        if not rows:
            report.warn(f"{target.path.name}: became unstable at once: no table")
            continue
        make_folder(folder, "--into")
        write_csv(path, rows)
        report.info(f"wrote {path}: {len(points)} points")


def _points(workspace: Workspace, at: Sequence[str]) -> Array:
    """Return the points that are asked for (n_points, 2) [m], checked."""
    if not at:
        return probes_of(workspace.case).line
    domain = workspace.case.scene.domain
    points = []
    for text in at:
        try:
            x, y = (float(number) for number in text.split(","))
        except ValueError as error:
            raise CaseError(f"--at: must be like 0.5,0.5; got {text!r}") from error
        if not domain.contains(np.array([[x, y]]))[0]:
            raise CaseError(f"--at: ({x:g}, {y:g}) m is not in the fluid")
        points.append((x, y))
    return np.array(points)


def _probe_rows(points: Array, samples: Samples) -> Iterator[ProbeRow]:
    """Yield all points of a snapshot after the other."""
    for time, velocities, pressures in zip(
        samples.time, samples.velocity, samples.pressure, strict=True
    ):
        for (x, y), (u, v), p in zip(points, velocities, pressures, strict=True):
            yield ProbeRow(*map(float, (time, x, y, u, v, p)))
