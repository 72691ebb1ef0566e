"""Command `export`: the fields of artifacts, in files of their own for other programs.

Artifacts that hold fields open in ParaView as they are; exported files need no artifact, and show
further views too, such as the ghosts of walls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from sphrom.artifacts import Artifact, open_artifact, schema_of
from sphrom.artifacts.vtk_files import artifact_views, write_vtkhdf, write_vtu
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.probe_tables import write_probe_tables
from sphrom.setup.context import Reporter, StageContext
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace

FOLDER = "export"
"""Where files go unless another folder is named, beside the artifacts."""
FORMATS = {"vtkhdf": (".vtkhdf", write_vtkhdf), "vtu": (".pvd", write_vtu)}
"""By name: the ending of the file to be opened, and its writer."""
PROBES = "csv"
"""The format that holds fields at some points only."""


def run(
    context: StageContext, to: str = "vtkhdf", into: Path | None = None, at: Sequence[str] = ()
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
    there = [target for target in _targets(workspace) if target.path.exists()]
    if sum(export(workspace.open(target)) for target in there) == 0:
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
    if export(open_artifact(path, schema, made_by="sphrom run CASE")) == 0:
        raise ArtifactError(f"{path} ({schema}) holds no fields to export")


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

    def __call__(self, opened: AbstractContextManager[Artifact]) -> int:
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


def _targets(workspace: Workspace) -> Iterator[Target]:
    """Yield every artifact of the case that may hold fields."""
    case = workspace.case
    by_point: tuple[Callable[..., Target], ...] = (workspace.full_run, workspace.mapped)
    if case.time.spin_up > 0.0:
        by_point = (workspace.spin_up, *by_point)
    if case.packed:
        yield workspace.packing()
    for point in workspace.context.chosen(case.points):
        yield from (target(point) for target in by_point)
    yield workspace.basis()
    for model in case.rom:
        for point in workspace.context.chosen(case.rom_points(model)):
            yield workspace.reduced_run(model, point)
