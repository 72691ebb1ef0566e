"""Command `export`: the fields of artifacts, in files of their own for other programs.

Artifacts that hold fields open in ParaView from 5.12 on as they are. Exported files open in older
versions, need no artifact, and show more: the ghosts of walls, and the fields of runs that store
coordinates alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from sphrom.artifacts import open_artifact, schema_of
from sphrom.artifacts.vtk_files import Fields, artifact_views, write_vtkhdf, write_vtu
from sphrom.case.loader import case_of_text
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.probe_tables import write_probe_tables
from sphrom.exchange.rebuilt_fields import POINTS, open_with_fields
from sphrom.setup.context import Reporter, StageContext
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace

FOLDER = "export"
"""Where files go unless another folder is named, beside the artifacts."""
FORMATS = {"vtu": (".pvd", write_vtu), "vtkhdf": (".vtkhdf", write_vtkhdf)}
"""By name: the ending of the file to be opened, and its writer."""
DEFAULT = "vtu"
"""What every version of ParaView opens; VTKHDF of particles needs 5.12."""
COORDINATES = "sphrom/coordinates"
PROBES = "csv"
"""The format that holds fields at some points only."""


def run(
    context: StageContext, to: str = DEFAULT, into: Path | None = None, at: Sequence[str] = ()
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
        write_probe_tables(workspace, folder, at)
        return
    if at:
        raise CaseError(f"--at: goes with --to {PROBES}")
    export = Export(to, folder, context.force, context.report)
    if sum(export(opened) for path, opened in _sources(workspace) if path.exists()) == 0:
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
    export = Export(to, into or path.parent / FOLDER, force, report)
    schema = schema_of(path)
    if export(_opened(path, schema, report)) == 0:
        raise ArtifactError(f"{path} ({schema}) holds no fields to export")


@contextmanager
def _opened(path: Path, schema: str, report: Reporter) -> Iterator[Fields]:
    """Open an artifact; a run that stores coordinates alone, with the artifacts beside it."""
    with open_artifact(path, schema, made_by="sphrom run CASE") as artifact:
        if schema != COORDINATES or POINTS in artifact:
            yield artifact
            return
        case = case_of_text(artifact.case_text)
    workspace = Workspace(StageContext(case, path.parent, False, None, report))
    for model in case.rom:
        for point in case.plan.rom_points(model):
            if workspace.reduced_run(model, point).path.name == path.name:
                with open_with_fields(workspace, model, point) as run:
                    yield run
                return
    raise ArtifactError(
        f"{path}: holds coordinates alone, and is no longer called as a run of its case: "
        "`sphrom export CASE` rebuilds fields of the runs in the case's folder"
    )


@dataclass(frozen=True)
class Export:
    """Writes all views of an artifact, and returns how many there are."""

    to: str
    folder: Path
    force: bool
    report: Reporter

    def __post_init__(self) -> None:
        if self.to not in FORMATS:
            known = ", ".join((*FORMATS, f"for a case {PROBES}"))
            raise CaseError(f"--to: must be one of {known}; got {self.to!r}")

    def __call__(self, opened: AbstractContextManager[Fields]) -> int:
        ending, write = FORMATS[self.to]
        with opened as artifact:
            views = artifact_views(artifact)
            for name, view in views.items():
                stem = artifact.path.stem + (f"-{name}" if name else "")
                path = self.folder / f"{stem}{ending}"
                write(path, artifact, view, force=self.force)
                steps = f", {view.n_steps} steps" if view.n_steps else ""
                self.report.info(f"wrote {path}: {view.n_points} points{steps}")
        return len(views)


def _sources(workspace: Workspace) -> Iterator[tuple[Path, AbstractContextManager[Fields]]]:
    """Yield every artifact of the case that may hold fields, to be opened if it is there."""
    for target in _targets(workspace):
        yield target.path, workspace.open(target)
    for model in workspace.case.rom:
        for point in workspace.context.chosen(workspace.case.plan.rom_points(model)):
            path = workspace.reduced_run(model, point).path
            yield path, open_with_fields(workspace, model, point)


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
