"""Stage `compare`: reduced against full, full against exact, and where the error comes from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import fields

import numpy as np

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.reduction.pod import kept_modes, truncate
from sphrom.stages import assembly, comparison_report
from sphrom.stages.context import StageContext
from sphrom.stages.figures_of_merit import (
    Comparison,
    ErrorRow,
    History,
    PointResults,
    compare,
    row,
)
from sphrom.stages.fit_psi import read_splines, select
from sphrom.stages.map import require_complete
from sphrom.stages.pod import read_basis
from sphrom.stages.rom import spline_columns
from sphrom.stages.sampling import (
    Probes,
    Samples,
    probes_of,
    sample_best,
    sample_exact,
    sample_mapped,
    sample_run,
    sampler,
)
from sphrom.stages.timings import RunTiming, reduced_timing
from sphrom.stages.workspace import Workspace


def run(context: StageContext) -> None:
    """Compare all runs of the case; write `compare.h5`, `compare.json`, tables and plots."""
    workspace = Workspace(context)
    target = workspace.comparison()
    if not workspace.wanted(target):
        comparison_report.show_stored(workspace)
        return
    probes = probes_of(context.case)
    with workspace.create(target) as artifact:
        results = [_compare_point(workspace, point, probes) for point in context.case.points]
        for result in results:
            _write(artifact, result, probes)
        comparison_report.publish(workspace, results, probes)


def _compare_point(workspace: Workspace, point: ParameterPoint, probes: Probes) -> PointResults:
    case = workspace.case
    sample = sampler(case, probes)
    models = [m for m in case.rom if point in case.rom_points(m)]
    comparisons: list[Comparison] = []
    timings: list[RunTiming] = []
    role = "trained" if point in case.train_points else "predicted"

    def add(
        samples: Samples,
        reference: Samples,
        compared: str,
        against: str,
        n_modes: int | None = None,
        status: str = "complete",
        at: str = role,
    ) -> None:
        history = compare(samples, reference, probes, case.compare.from_time)
        described = row(
            history,
            compared=compared,
            against=against,
            parameters=point.label,
            role=at,
            n_modes=n_modes,
            status=status,
        )
        comparisons.append(Comparison(samples, history, described))

    with workspace.open(workspace.full_run(point)) as trajectory:
        require_complete(trajectory)
        full_timing = trajectory.number("timing/integration")
        n_snapshots = len(trajectory.dataset("time"))
        with _progress(workspace, f"sample the full run, {point.label}", n_snapshots) as advance:
            full = sample_run(case, trajectory, sample, advance)
    exact = None
    if case.compare.exact:
        exact = sample_exact(assembly.exact_flow(case, point), probes, full.time)
        add(full, exact, "full", "exact", at="")
    if models:
        with workspace.open(workspace.mapped(point)) as mapped:
            add(sample_mapped(case, mapped, sample), full, "map", "full", at="")
            for name, size in _distinct(models):
                best = _best(workspace, mapped, name, size, probes)
                model_role = _role(workspace, name, point)
                add(best, full, f"best possible, {name} M={size}", "full", size, at=model_role)
    for model in models:
        with workspace.open(workspace.reduced_run(model, point)) as trajectory:
            status = trajectory.text("status")
            total = len(trajectory.dataset("time"))
            with _progress(workspace, f"sample {model.name}, {point.label}", total) as advance:
                reduced = sample_run(case, trajectory, sample, advance)
            timings.append(reduced_timing(case, model, point, trajectory, full_timing))
        model_role = _role(workspace, model.basis, point)
        add(reduced, full, model.name, "full", model.n_modes, status, at=model_role)
        if exact is not None:
            add(reduced, exact, model.name, "exact", model.n_modes, status, at=model_role)
    return PointResults(point, full, exact, comparisons, timings)


def _progress(
    workspace: Workspace, text: str, total: int
) -> AbstractContextManager[Callable[[int], None]]:
    return workspace.context.report.progress(text, total)


def _role(workspace: Workspace, basis: str, point: ParameterPoint) -> str:
    return "trained" if point in workspace.case.bases[basis] else "predicted"


def _distinct(models: list[ReducedModelSection]) -> list[tuple[str, int]]:
    """Return each basis and size that some model uses, once."""
    return sorted({(model.basis, model.n_modes) for model in models})


def _best(workspace: Workspace, mapped: Artifact, name: str, size: int, probes: Probes) -> Samples:
    whole = read_basis(workspace, name)
    chosen = spline_columns(whole, kept_modes(whole, size))
    splines = select(read_splines(workspace, name), chosen)
    return sample_best(workspace.case, mapped, truncate(whole, size), splines, probes)


def _write(artifact: ArtifactWriter, result: PointResults, probes: Probes) -> None:
    """Store every history, and the centrelines of the full run."""
    n_line = len(probes.line)
    place = result.point.file_label
    for comparison in result.comparisons:
        group = f"series/{_group_name(comparison.row)}/{place}"
        for name in (f.name for f in fields(History)):
            artifact.write(f"{group}/{name}", getattr(comparison.history, name))
        for name, value in _numbers(comparison.row):
            artifact.annotate(f"{group}/{name}", value)
    for name, samples in _centrelines(result):
        group = f"centreline/{name}/{place}"
        artifact.write(f"{group}/position", probes.line)
        artifact.write(f"{group}/time", samples.time)
        artifact.write(f"{group}/velocity", np.ascontiguousarray(samples.velocity[:, :n_line]))
        artifact.write(f"{group}/pressure", np.ascontiguousarray(samples.pressure[:, :n_line]))


def _group_name(described: ErrorRow) -> str:
    """Return an HDF5 group's name for a comparison."""
    name = described.compared.replace(", ", "-").replace(" ", "-").replace("=", "")
    return f"{name}-against-{described.against}"


def _numbers(described: ErrorRow) -> Iterator[tuple[str, float | str]]:
    yield "status", described.status
    for f in fields(described):
        value = getattr(described, f.name)
        if isinstance(value, float):
            yield f.name, value


def _centrelines(result: PointResults) -> Iterator[tuple[str, Samples]]:
    yield "full", result.full
    for comparison in result.comparisons:
        if comparison.row.against == "full":
            yield _group_name(comparison.row), comparison.samples
