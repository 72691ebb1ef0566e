"""Stage `compare`: reduced against full, full against exact, and where the error comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.reduction.trial_basis import kept_modes, truncate
from sphrom.stages import assembly, comparison_report
from sphrom.stages.check import require_room
from sphrom.stages.context import StageContext
from sphrom.stages.figures_of_merit import (
    Comparison,
    ErrorRow,
    Excerpt,
    History,
    PointResults,
    compare,
    row,
)
from sphrom.stages.fit_psi import read_splines, select
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
from sphrom.stages.trajectory import require_complete
from sphrom.stages.workspace import Workspace


def run(context: StageContext) -> None:
    """Compare all runs of the case; write `compare.h5`, `compare.json`, tables and plots."""
    workspace = Workspace(context)
    require_room(context.case, workspace.out, None, "compare")
    if not (context.case.rom or context.case.compare.exact):
        context.report.info("nothing to compare: no reduced models, and compare.exact is false")
        return
    target = workspace.comparison()
    if not workspace.wanted(target):
        comparison_report.show_stored(workspace)
        return
    probes = probes_of(context.case)
    with workspace.create(target) as artifact:
        results = [
            _PointComparison(workspace, point, probes).results() for point in context.case.points
        ]
        for result in results:
            _write(artifact, result, probes)
        comparison_report.publish(workspace, results, probes)


class _PointComparison:
    """The comparisons at one parameter point, in the order in which tables show them."""

    def __init__(self, workspace: Workspace, point: ParameterPoint, probes: Probes) -> None:
        self.workspace = workspace
        self.case = workspace.case
        self.point = point
        self.probes = probes
        self.sample = sampler(self.case, probes)
        self.models = [m for m in self.case.rom if point in self.case.rom_points(m)]
        self.comparisons: list[Comparison] = []
        self.timings: list[RunTiming] = []
        with workspace.open(workspace.full_run(point)) as trajectory:
            require_complete(trajectory)
            self.full_seconds = trajectory.number("timing/integration")
            self.full = self._sampled("the full run", trajectory)
        self.middle = len(self.full.time) // 2
        self.exact = (
            sample_exact(assembly.exact_flow(self.case, point), probes, self.full.time)
            if self.case.compare.exact
            else None
        )

    def results(self) -> PointResults:
        """Compare everything that there is at this point."""
        if self.exact is not None:
            self._add(self.full, "full", against="exact")
        if self.models:
            self._compare_limits()
        for model in self.models:
            self._compare_model(model)
        return PointResults(
            point=self.point,
            full=self._excerpt(self.full),
            exact=self._excerpt(self.exact) if self.exact is not None else None,
            comparisons=self.comparisons,
            timings=self.timings,
        )

    def _compare_limits(self) -> None:
        """Compare what the map alone, and the best state in each basis, would give."""
        with self.workspace.open(self.workspace.mapped(self.point)) as mapped:
            self._add(sample_mapped(self.case, mapped, self.sample), "map")
            for name, size in _distinct(self.models):
                best = _best(self.workspace, mapped, name, size, self.probes)
                self._add(best, f"best possible, {name} M={size}", basis=name, n_modes=size)

    def _compare_model(self, model: ReducedModelSection) -> None:
        target = self.workspace.reduced_run(model, self.point)
        with self.workspace.open(target) as trajectory:
            status = trajectory.text("status")
            reduced = self._sampled(model.name, trajectory)
            if status == "complete":  # a run that stopped early has no speed-up
                self.timings.append(
                    reduced_timing(self.case, model, self.point, trajectory, self.full_seconds)
                )
        for against in ("full", "exact") if self.exact is not None else ("full",):
            self._add(reduced, model.name, against, model.basis, model.n_modes, status)

    def _sampled(self, name: str, trajectory: Artifact) -> Samples:
        text = f"sample {name}, {self.point.label}"
        total = len(trajectory.dataset("time"))
        with self.workspace.context.report.progress(text, total) as advance:
            return sample_run(self.case, trajectory, self.sample, advance)

    def _add(
        self,
        samples: Samples,
        compared: str,
        against: str = "full",
        basis: str | None = None,
        n_modes: int | None = None,
        status: str = "complete",
    ) -> None:
        reference = self.exact if against == "exact" else self.full
        if reference is None:
            raise ValueError(f"there is no {against} solution to compare with")
        history = compare(samples, reference, self.probes, self.case.compare.from_time)
        if status == "complete" and len(history.time) == 0:
            raise CaseError(
                "compare.line_points, compare.grid, compare.from_time: there is no snapshot in "
                f"which the {against} solution varies over the probes"
            )
        described = row(
            history,
            compared=compared,
            against=against,
            parameters=self.point.label,
            role=_role(self.workspace, basis, self.point) if basis is not None else "",
            n_modes=n_modes,
            status=status,
        )
        self.comparisons.append(Comparison(self._excerpt(samples), history, described))

    def _excerpt(self, samples: Samples) -> Excerpt:
        return Excerpt.of(samples, self.probes, self.middle)


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
    place = result.point.file_label
    for comparison in (c for c in result.comparisons if len(c.history.time)):
        group = f"series/{_group_name(comparison.row)}/{place}"
        for name in (f.name for f in fields(History)):
            artifact.write(f"{group}/{name}", getattr(comparison.history, name))
        for name, value in _numbers(comparison.row):
            artifact.annotate(f"{group}/{name}", value)
    for name, samples in _centrelines(result):
        group = f"centreline/{name}/{place}"
        artifact.write(f"{group}/position", probes.line)
        artifact.write(f"{group}/time", samples.time)
        artifact.write(f"{group}/velocity", samples.velocity)
        artifact.write(f"{group}/pressure", samples.pressure)


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
    yield "full", result.full.line
    for comparison in result.comparisons:
        if comparison.row.against == "full" and len(comparison.history.time):
            yield _group_name(comparison.row), comparison.excerpt.line
