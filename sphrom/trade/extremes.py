"""Stage `trade --extremes`: map where full and reduced models are stable and accurate.

Models run at several values of each property, and are compared with full runs at these values.
`sphrom.trade.stability` judges the runs, finds the causes of limits, and draws the maps. Mach
number, h/dx and resolution are properties of the full model, which a reduced model inherits from
its training runs. Therefore each of their values has full runs, a basis and operators in a folder
of its own. Runs on particles with other time steps leave no artifacts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.case.checks import case_problems, coarser_resolution
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint, TestValues
from sphrom.case.sections import ALL, ReducedModelSection
from sphrom.case.studies import trained_at
from sphrom.errors import CaseError, ResourceError, UnstableError
from sphrom.metrics.histories import relative_l2, without_mean
from sphrom.metrics.measures import Samples
from sphrom.models import fom, stages
from sphrom.models.contract import Ability, family_of
from sphrom.models.particles.runs import build_model, close, doubts_of_step
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.models.stable_ranges import MEMORY, STEP, TIME
from sphrom.models.starts import start
from sphrom.models.stored_run import StoredRun
from sphrom.reduction.particle_model import reduced_jacobian
from sphrom.reduction.polynomial_model import EXPONENTIAL, RUNGE_KUTTA, steps_within
from sphrom.reduction.reduced_operators import stability_limits
from sphrom.reduction.reference_model import Integrator, ReferenceModel, Steps, choose, runge_kutta
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.sph.fluid import fluctuation_of, pressure_of
from sphrom.sph.time_loop import Clock, Model, TimeSteps, march
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade.candidates import (
    candidates,
    first_model,
    global_basis,
    make,
    prepared,
    trade_points,
    with_steps,
    workspace_of,
)
from sphrom.trade.stability import (
    HALF,
    ONE_RUN,
    RESOLUTION,
    ExtremeRun,
    Kind,
    cause_of_divergence,
    kind_of,
    limiting_step,
    longest_memory,
    publish,
)

FULL_MODEL: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "Mach number": ("fluid", "mach_number", (0.05, 0.1, 0.2, 0.3, 0.4)),
    "h/dx": ("discretization", "smoothing_length_ratio", (1.2, 1.5, 2.0, 3.0, 4.0)),
    RESOLUTION: ("discretization", "resolution", (10, 14, 20, 28, 40)),
}
"""Properties of the full model, with their section, key and values."""
FACTORS: dict[str, tuple[float, ...]] = {
    STEP: (0.25, 0.5, 1.0, 2.0, 4.0, 10.0, 20.0, 40.0),
    MEMORY: (1e-3, 1e-2, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3),
    TIME: (1.0, 2.0, 5.0, 10.0, 20.0),
    REYNOLDS: (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
}
"""Values over the automatic step and memory length, over the trained time, and over the trained
parameter values: factors up to 1 apply to the least, factors from 1 to the greatest."""
QUICK: dict[str, tuple[float, ...]] = {
    STEP: (0.5, 1.0, 4.0, 40.0),
    MEMORY: (1e-3, 1.0, 30.0, 1e3),
    TIME: (1.0, 2.0, 5.0),
    REYNOLDS: (0.1, 0.5, 1.0, 2.0, 10.0),
}
SPARSER = 10
"""A longer full run keeps at most one in so many snapshots, and at least so many per part."""


@dataclass(frozen=True)
class Truth:
    """A full run to compare with."""

    samples: Samples
    """Fields at the points where runs are compared."""
    snapshots: Indices
    """Indices of the same snapshots in a reduced run."""

    def within(self, first: float, last: float) -> Truth:
        """Return the part between two snapshots of a reduced run."""
        kept = np.flatnonzero((self.snapshots >= first) & (self.snapshots <= last))
        return Truth(self.samples.at(kept), self.snapshots[kept])


class GridModes:
    """The modes of a model at the points where runs are compared."""

    def __init__(self, basis: BasisModel, grid: Array) -> None:
        self._values = basis.splines.values(grid).reshape(len(grid), -1, 3)
        self._product = basis.basis.inner_product
        self._sound_speed = basis.workspace.case.plan.sound_speed
        # Pressures are compared without their means.
        constant = np.tile([1.0, 0.0, 0.0], len(grid))[:, None]
        columns = self._values.transpose(0, 2, 1).reshape(len(constant), -1)
        self._inverse = np.linalg.pinv(np.hstack((columns, constant)))[:-1]

    def samples(self, coordinates: Array) -> Samples:
        """Return the fields of coordinates (n_snapshots, n_modes), with placeholder times."""
        fields = np.tensordot(coordinates, self._values, (1, 1))
        density = self._product.density_fluctuation(fields[..., 0])
        times = np.arange(len(fields), dtype=np.float64)
        return Samples(times, fields[..., 1:], pressure_of(density, self._sound_speed))

    def nearest(self, full: Samples) -> Samples:
        """Return the states in the basis that are nearest to those of a full run at the points."""
        first = self._product.first_field(fluctuation_of(full.pressure, self._sound_speed))
        states = np.concatenate((first[..., None], full.velocity), axis=2)
        return self.samples(states.reshape(len(states), -1) @ self._inverse.T)


def errors_of(run: Samples, full: Samples) -> tuple[float, float]:
    """Return the relative L2 errors [%] of the velocity, and of the pressure less its mean."""
    pressures = (without_mean(each.pressure)[..., None] for each in (run, full))
    velocity = float(relative_l2(run.velocity, full.velocity, field_axes=3))
    return velocity, float(relative_l2(*pressures, field_axes=3))


def run(context: StageContext, quick: bool = False) -> None:
    """Run models at their extremes, and write tables and maps into the case's folder `trade`.

    With `quick`, there are fewer values, and no other Mach numbers, h/dx and resolutions.

    Raises CaseError when the case has no reduced models, ArtifactError when a full run, the basis,
    its splines or the operators are missing.
    """
    maps = Maps(context, quick)
    publish(maps.workspace, list(maps.runs()), maps.default, maps.own_values, maps.notes)


class Maps:
    """All runs of the maps of a case."""

    def __init__(self, context: StageContext, quick: bool) -> None:
        case = context.case
        family_of(case).require(Ability.EXTREMES, "--extremes")
        basis = global_basis(case)
        first = first_model(case)
        n_modes = family_of(case, first).part("sized")(Workspace(context), first, basis).size
        self.factors, self.quick = QUICK if quick else FACTORS, quick
        self.notes: list[str] = []
        self.point = context.chosen(trade_points(case))[0]
        self.default = first.projection, n_modes
        sections = candidates(case, (self.point,), basis, n_modes)
        self.workspace = prepared(context, sections)
        self.case = case
        self.grid = probes_of(case).grid
        self.trained = case.plan.bases[basis]
        self.models = [FastModel(self.workspace, section) for section in sections]
        self._galerkin = [each for each in sections if each.projection == "galerkin"]
        self._truths: dict[tuple[ParameterPoint, float, bool], Truth | None] = {}
        self._points: dict[str, ParameterPoint] = {}
        self._modes: dict[BasisModel, GridModes] = {}

    def runs(self) -> Iterator[ExtremeRun]:
        """Yield the runs of all maps."""
        parts = [self._steps, self._memory_lengths, self._parameters, self._times]
        if not self.quick:
            parts.append(self._one_training_run)
        if not self.quick and self.case.trade.full_runs:
            parts.append(self._full_models)
        with self.workspace.context.report.progress("extremes", len(parts)) as advance:
            for part in parts:
                yield from part()
                advance(1)

    @property
    def own_values(self) -> dict[str, float]:
        """The default values of the varied quantities."""
        of_case = {
            name: float(getattr(getattr(self.case, section), key))
            for name, (section, key, _) in FULL_MODEL.items()
        }
        return {**self.point.as_dict(), ONE_RUN: self.trained[0].reynolds, **of_case}

    # Maps

    def _steps(self) -> Iterator[ExtremeRun]:
        truth = self._truth(self.point)
        plan = self.case.plan
        limits = plan.step_limits(self.point)
        begin = start(self.workspace, self.point).state
        for factor in self.factors[STEP]:
            run = self._described(STEP, factor, self.point, "full")
            run.mechanism = "sound" if limits.acoustic <= limits.viscous else "viscosity"
            run.predicted = limits.least / plan.steps.time_step
            functional = particles.functional(self.case, self.point)
            yield self._marched(run, functional, begin, truth, factor)
            yield from self._on_particles(factor, truth)
            for method, fast in product((EXPONENTIAL, RUNGE_KUTTA), self.models):
                yield self._fast(fast, STEP, factor, self.point, truth, factor, method)

    def _memory_lengths(self) -> Iterator[ExtremeRun]:
        truth = self._truth(self.point)
        for model in self.models:
            if model.section.projection == "galerkin":
                continue
            automatic = model.at(self.point).memory_length or 0.0
            with_memory = {}
            for factor in (1.0, 2.0, *self.factors[MEMORY]):
                length = {"memory_length": factor * automatic}
                with_memory[factor] = FastModel(
                    self.workspace, model.section.model_copy(update=length)
                )
            longest = longest_memory(*(with_memory[factor].at(self.point) for factor in (1.0, 2.0)))
            for factor in self.factors[MEMORY]:
                run = self._fast(with_memory[factor], MEMORY, factor, self.point, truth)
                run.predicted = longest
                yield run

    def _parameters(self) -> Iterator[ExtremeRun]:
        at = self.point.as_dict()
        for name in at:
            if not all(point.as_dict()[name] > 0.0 for point in self.trained):
                self.notes.append(f"{name} is not varied: its trained values aren't above zero")
                continue
            for value in self._extreme_values(name):
                point = self.case.plan.point(at | {name: value})
                truth = self._truth(point)
                coarse = self._truth(point, coarse=True)
                if truth is not None and coarse is not None:
                    run = self._described(name, value, point, "full", f", {HALF}")
                    yield _compared(run, coarse.samples, truth.samples)
                for model in self.models:
                    yield self._fast(model, name, value, point, truth)

    def _extreme_values(self, name: str) -> list[float]:
        """Return the values of a parameter inside and outside of its trained range."""
        trained, factors = [p.as_dict()[name] for p in self.trained], self.factors[REYNOLDS]
        values = [factor * min(trained) for factor in factors if factor <= 1.0]
        values += [factor * max(trained) for factor in factors if factor >= 1.0]
        # Rounding errors would show in file names.
        return sorted({self.point.as_dict()[name], *(float(f"{value:.12g}") for value in values)})

    def _times(self) -> Iterator[ExtremeRun]:
        n_trained = self.case.plan.steps.n_snapshots - 1
        truth = self._truth(self.point, self.factors[TIME][-1])
        for factor in self.factors[TIME]:
            # Errors count over the last part, as long as the training runs.
            ends = (factor - 1.0) * n_trained, factor * n_trained
            last = truth and truth.within(*ends)
            for model in self.models:
                yield self._fast(model, TIME, factor, self.point, last, until=factor)

    def _one_training_run(self) -> Iterator[ExtremeRun]:
        """Yield the runs of models whose only training run is the first one."""
        case = self.case
        only = self.trained[0]
        others = [point for point in case.plan.points if point != only]
        if not others:
            return
        # The points stay the same, so that existing full runs and their maps are used.
        parameters = trained_at(case, [only]).parameters
        parameters = parameters.model_copy(
            update={"test": trained_at(case, others).parameters.train}
        )
        n_modes = min(case.plan.n_modes, case.plan.steps.n_snapshots)
        alone = {"subsets": {}, "lagrangian": False, "n_modes": n_modes}
        sections = [m for m in self._galerkin if m.size <= n_modes]
        changes = {
            "name": "extreme-one-training-run",
            "parameters": parameters,
            "basis": case.basis.model_copy(update=alone),
            "rom": _of_all(sections),
        }
        kinds = ("packing", "state", "trajectory", "reference-snapshots")
        folders = dict.fromkeys(kinds, self.workspace.out)
        try:
            own = self._trained(case.model_copy(update=changes), folders)
        except (UnstableError, CaseError, ResourceError) as error:
            self.notes.append(f"{ONE_RUN}: {error}")
            return
        at = self.point.as_dict()
        for value in self._extreme_values(REYNOLDS):
            point = case.plan.point(at | {REYNOLDS: value})
            truth = self._truth(point)
            for model in own.case.rom:
                yield self._fast(FastModel(own, model), ONE_RUN, value, point, truth)

    def _full_models(self) -> Iterator[ExtremeRun]:
        """Yield the runs of varied full models, and of reduced models that are trained on them."""
        own = self._truth(self.point)
        coarse = self._truth(self.point, coarse=True)
        for varied, value, variant in varied_models(
            self.case, (self.trained, self.point), self._galerkin
        ):
            run = self._described(varied, value, self.point, "full")
            try:
                made = self._trained(variant, {})
                truth = self._full_run(made, self.point)
            except (UnstableError, CaseError, ResourceError) as error:
                yield _failed(run, error)
                continue
            # The reference has the resolution of the variant, unless the resolution varies.
            if (beside := own if varied == RESOLUTION else coarse or own) is not None:
                yield _compared(run, truth.samples, beside.samples)
            for model in made.case.rom:
                yield self._fast(FastModel(made, model), varied, value, self.point, truth)

    # Full runs to compare with

    def _truth(
        self, point: ParameterPoint, until: float = 1.0, *, coarse: bool = False
    ) -> Truth | None:
        """Return a full run `until` times as long, if `coarse` at half resolution, or None."""
        if (key := (point, until, coarse)) not in self._truths:
            self._truths[key] = self._find(*key)
        return self._truths[key]

    def _find(self, point: ParameterPoint, until: float, coarse: bool) -> Truth | None:
        case = self.case
        if point in case.plan.points and until == 1.0 and not coarse:
            return self._full_run(self.workspace, point)
        resolution = coarser_resolution(case) if coarse else case.discretization.resolution
        if not case.trade.full_runs or resolution is None:
            return None
        changes = {}
        steps = case.plan.steps
        stride = 1
        if until > 1.0:
            stride = max(1, min(SPARSER, (steps.n_snapshots - 1) // SPARSER))
            end = case.time.spin_up + until * case.plan.recorded_time
            changes = {"time": case.time.model_copy(update={"final_time": end})}
            steps = replace(steps, every=stride * steps.every)
        name = f"{point.file_label}-{exact(until)}"
        variant = varied_case(case, (point,), None, name, resolution, changes, steps)
        made = workspace_of(self.workspace, variant)
        try:
            failed = make(made, variant.name, [point])
        except (CaseError, ResourceError) as error:
            self.notes.append(f"{variant.name}, refused: {error}")
            return None
        return None if failed else self._full_run(made, point, stride)

    def _full_run(self, workspace: Workspace, point: ParameterPoint, stride: int = 1) -> Truth:
        with StoredRun.opened(workspace, point) as stored:
            samples = stored.sampled(self.grid)
        truth = Truth(samples, stride * np.arange(len(samples.time), dtype=np.int64))
        steps = self.case.plan.steps
        since = (self.case.compare.from_time - steps.start_time) / steps.snapshot_interval
        return truth.within(since - 1e-6, np.inf)

    def _trained(self, variant: Case, folders: Mapping[str, Any]) -> Workspace:
        """Make the full runs and the reduced models of a variant; return their workspace."""
        for problem in case_problems(variant):
            raise CaseError(str(problem))
        context = self.workspace.context
        context = replace(context, only=None, report=context.report.brief(label=variant.name))
        own = workspace_of(Workspace(context), variant, folders)
        fom.run(own.context)
        stages.map_runs(own.context)
        stages.make_operators(own.context)
        return own

    # Runs

    def _described(
        self, varied: str, value: float, point: ParameterPoint, kind: Kind, steps: str = ""
    ) -> ExtremeRun:
        self._points[point.label] = point
        at = point.label
        return ExtremeRun(varied=varied, value=value, parameters=at, kind=kind, steps=steps)

    def _fast(
        self,
        model: FastModel,
        varied: str,
        value: float,
        point: ParameterPoint,
        truth: Truth | None,
        factor: float = 1.0,
        method: str = EXPONENTIAL,
        *,
        until: float = 1.0,
    ) -> ExtremeRun:
        """Run a fast model with steps `factor` times as long as the automatic ones."""
        basis = model.at_point(point)
        row = self._described(varied, value, point, "fast", method)
        row.projection = basis.section.projection
        row.n_modes = basis.section.size
        try:
            reduced = model.at(point)
            times = reduced.output_times
            n_snapshots = round(until * (times.n_snapshots - 1)) + 1
            reduced = replace(reduced, output_times=replace(times, n_snapshots=n_snapshots))
            integrator = basis.integrator(reduced).with_steps(factor)
            if method == RUNGE_KUTTA:
                integrator = choose(reduced, partial(_runge_kutta, factor))
                row.mechanism, limit = limiting_step(integrator.steps.model)
                row.predicted = factor * limit / integrator.steps.time_step
            run = self.integrated(row, model, reduced, integrator)
        except CaseError as refused:  # it would need too many steps
            return _failed(row, refused)
        row.time_step = run.time_step
        row.memory_length = reduced.memory_length
        row.extrapolated = bool(run.outside)
        row.end_time = float(run.time[-1])
        if run.failure is not None:
            row.state = "unstable"
            row.diverged_at = run.diverged_at
            row.mechanism = cause_of_divergence(run, integrator)
            row.reason = f"{str(run.failure).partition(';')[0]}: {row.mechanism}"
            return row
        if (own := run.estimate) is not None:
            row.velocity_estimate = own.velocity_percent
            row.pressure_estimate = own.pressure_percent
        row.told = "; ".join(run.doubts)
        if truth is None:
            return row
        if basis not in self._modes:
            self._modes[basis] = GridModes(basis, self.grid)
        modes = self._modes[basis]
        samples = modes.samples(run.coordinates[truth.snapshots])
        return _compared(row, samples, truth.samples, modes.nearest(truth.samples))

    def integrated(
        self, row: ExtremeRun, model: FastModel, reduced: ReferenceModel, integrator: Integrator
    ) -> FastRun:
        """Run a fast model."""
        return model.run(self._points[row.parameters], reduced, integrator)

    def _on_particles(self, factor: float, truth: Truth | None) -> Iterator[ExtremeRun]:
        """Run models on particles with steps `factor` times as long as those of the full model."""
        plan = self.case.plan.steps
        own = self.default[1]
        for section in (model.section for model in self.models if model.section.size == own):
            row = self._described(STEP, factor, self.point, "particles")
            row.projection = section.projection
            row.n_modes = own
            row.told = "; ".join(doubts_of_step(factor))
            moving = section.model_copy(update={"evaluation": "particles"})
            model, state = build_model(self.workspace, moving, self.point)
            jacobian = reduced_jacobian(model, state, plan.start_time)
            close(self.case, moving, model, state, plan.start_time)
            values, vectors = np.linalg.eig(jacobian[: section.size, : section.size])
            limits = stability_limits(values.astype(np.complex128))
            worst = int(limits.argmin())
            basis = FastModel(self.workspace, section).at_point(self.point).basis
            row.mechanism = kind_of(basis, values[worst], vectors[:, worst])
            row.predicted = float(limits[worst]) / plan.time_step
            yield self._marched(row, model, state, truth, factor)

    def _marched(
        self, row: ExtremeRun, model: Model, state: Array, truth: Truth | None, factor: float
    ) -> ExtremeRun:
        """Run a model of particles with steps over those of the full model, without artifacts."""
        plan = self.case.plan.steps
        fields = []
        ratio = Fraction(factor).limit_denominator(1000) / plan.every
        n_kept = (plan.n_snapshots - 1) // ratio.numerator
        row.time_step = factor * plan.time_step
        every = ratio.denominator
        n_steps = max(1, n_kept * every)
        steps = TimeSteps(row.time_step, n_steps, every, plan.start_time, every)
        sample = particles.sampler(self.case, self.grid)
        density = self.case.fluid.reference_density
        try:
            with np.errstate(all="ignore"):
                for _, kept in march(model, state, steps, density, Clock(), lambda done: None):
                    at = model.snapshot(kept)
                    fields.append(sample(at.position.T, at.density_fluctuation, at.velocity.T))
        except (UnstableError, ValueError) as error:
            return _failed(row, error)
        snapshots = ratio.numerator * np.arange(len(fields), dtype=np.int64)
        if truth is None or not (both := np.isin(snapshots, truth.snapshots)).any():
            return row
        densities, velocities = (np.array(each)[both] for each in zip(*fields, strict=True))
        full = truth.samples.at(np.searchsorted(truth.snapshots, snapshots[both]))
        pressures = pressure_of(densities, self.case.plan.sound_speed)
        return _compared(row, Samples(full.time, velocities, pressures), full)


def _compared(
    row: ExtremeRun, samples: Samples, full: Samples, best: Samples | None = None
) -> ExtremeRun:
    """Set the errors of a run, and of the nearest states in its basis; none for fluid at rest."""
    with suppress(ValueError):
        row.velocity_error, row.pressure_error = errors_of(samples, full)
        if best is not None:
            row.velocity_best, row.pressure_best = errors_of(best, full)
    return row


def _failed(row: ExtremeRun, error: Exception) -> ExtremeRun:
    """Set the state of a run that was refused or became unstable."""
    refused = isinstance(error, CaseError | ResourceError)
    row.state = "refused" if refused else "unstable"
    row.reason = str(error)
    return row


def _runge_kutta(factor: float, part: ReferenceModel) -> Steps:
    n_steps = steps_within(part.output_times.duration, factor * part.step_limit)
    return runge_kutta(part, n_steps)


def _of_all(models: list[ReducedModelSection]) -> tuple[ReducedModelSection, ...]:
    return tuple(model.model_copy(update={"basis": ALL}) for model in models)


def varied_models(
    case: Case,
    points: tuple[tuple[ParameterPoint, ...], ParameterPoint],
    sections: list[ReducedModelSection],
) -> Iterator[tuple[str, float, Case]]:
    """Yield the full model at half resolution for all values of its properties, with models."""
    for varied, (section, key, values) in FULL_MODEL.items():
        for value in values:
            resolution = coarser_resolution(case) or case.discretization.resolution
            changes = {section: getattr(case, section).model_copy(update={key: value})}
            if varied == RESOLUTION:
                resolution = int(value)
                changes = {}
                if value >= case.discretization.resolution:
                    continue
            name = f"{key}-{exact(value)}"
            variant = varied_case(case, *points, name, resolution, changes)
            yield varied, value, variant.model_copy(update={"rom": _of_all(sections)})


def varied_case(
    case: Case,
    points: tuple[ParameterPoint, ...],
    tested: ParameterPoint | None,
    name: str,
    resolution: int,
    changes: Mapping[str, Any],
    snapshots: TimeSteps | None = None,
) -> Case:
    """Return the full model at some points, with one basis; `snapshots` replaces the case's."""
    parameters = trained_at(case, points).parameters
    others = [each for each in (tested,) if each is not None and each not in points]
    test = trained_at(case, others).parameters.train if others else TestValues()
    whole: dict[str, Any] = {
        "parameters": parameters.model_copy(update={"test": test}),
        "basis": case.basis.model_copy(update={"subsets": {}, "lagrangian": False}),
        "compare": case.compare.model_copy(update={"figures": ()}),
        # Sections of other studies may name models that the variant does not have.
        **{name: type(getattr(case, name))() for name in ("sweep", "fit", "training")},
    }
    other = case.model_copy(update=whole | dict(changes))
    variant = with_steps(other, resolution, other.time.courant_number, snapshots or case.plan.steps)
    return variant.model_copy(update={"name": f"extreme-{resolution}-{name}"})
