"""Stage `trade --extremes`: map where full and reduced models are stable and accurate.

Models run at several values of each property, and are compared with full runs at these values.
`sphrom.trade.causes` finds the causes of limits, and `sphrom.trade.stability` judges the runs and
draws the maps. Mach number, h/dx and resolution are properties of the full model, which a reduced
model inherits from its training runs. Therefore each of their values has full runs, a basis and
operators in a folder of its own. Runs on particles with other time steps leave no artifacts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.checks import case_problems
from sphrom.case.model_sections import PointModelSection
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.case.studies import changed
from sphrom.errors import CaseError, ResourceError, UnstableError
from sphrom.metrics.measures import Samples
from sphrom.models import fom, stages
from sphrom.models.contract import Ability, family_of
from sphrom.models.particles.runs import build_model, close, doubts_of_step
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.models.stable_ranges import MEMORY, STEP, TIME
from sphrom.models.starts import start
from sphrom.reduction.particle_model import reduced_jacobian
from sphrom.reduction.polynomial_model import EXPONENTIAL, RUNGE_KUTTA, steps_within
from sphrom.reduction.reduced_operators import stability_limits
from sphrom.reduction.reference_model import Integrator, ReferenceModel, Steps, choose, runge_kutta
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.sph.fluid import pressure_of
from sphrom.sph.time_loop import Clock, Model, TimeSteps, march
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace
from sphrom.trade.candidates import (
    FULL_MODEL,
    RESOLUTION,
    candidates,
    first_model,
    global_basis,
    in_all,
    of_full_model,
    prepared,
    trade_points,
    variant_of,
    varied_models,
)
from sphrom.trade.causes import cause_of_divergence, kind_of, limiting_step, longest_memory
from sphrom.trade.stability import (
    HALF,
    ONE_RUN,
    ExtremeRun,
    Kind,
    publish,
)
from sphrom.trade.truth import GridModes, Truth, Truths, compared

FACTORS: dict[str, tuple[float, ...]] = {
    STEP: (0.25, 0.5, 1.0, 2.0, 4.0, 10.0, 20.0, 40.0),
    MEMORY: (1e-3, 1e-2, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3),
    TIME: (1.0, 2.0, 5.0, 10.0, 20.0),
    REYNOLDS: (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
}
"""Values relative to the automatic step and memory length, the trained time, and the trained
parameter values: factors up to 1 apply to the least, factors from 1 to the greatest."""
QUICK: dict[str, tuple[float, ...]] = {
    STEP: (0.5, 1.0, 4.0, 40.0),
    MEMORY: (1e-3, 1.0, 30.0, 1e3),
    TIME: (1.0, 2.0, 5.0),
    REYNOLDS: (0.1, 0.5, 1.0, 2.0, 10.0),
}
SHARED = ("packing", "state", "trajectory", "reference-snapshots")
"""Kinds of artifacts of the case that models with one training run use."""


def run(context: StageContext, quick: bool = False) -> None:
    """Run models at their extremes, and write tables and maps into the case's folder `trade`.

    With `quick`, there are fewer values, and no other Mach numbers, h/dx and resolutions.

    Raises CaseError when the case has no reduced models, ArtifactError when a full run, the basis,
    its splines or the operators are missing.
    """
    maps = Maps(context, quick)
    publish(Workspace(context), list(maps.runs()), maps.default, maps.own_values, maps.notes)


@dataclass(frozen=True)
class Trial:
    """A value of a varied quantity, and the point and the full run at this value."""

    varied: str
    value: float
    point: ParameterPoint
    truth: Truth | None = None
    """None if there is no full run to compare with."""
    step_factor: float = 1.0
    """Time steps over automatic ones."""
    until: float = 1.0
    """Final time relative to that of training runs."""

    def row(self, kind: Kind, **described: Any) -> ExtremeRun:
        """Return the row of a run."""
        return ExtremeRun(
            varied=self.varied,
            value=self.value,
            parameters=self.point.label,
            kind=kind,
            **described,
        )


class Maps:
    """All runs of the maps of a case."""

    def __init__(self, context: StageContext, quick: bool) -> None:
        case = context.case
        basis = global_basis(case)
        first = first_model(case)
        family = family_of(case, first)
        family.require(Ability.EXTREMES, "--extremes")
        first = family.part("sized")(Workspace(context), first, basis)
        self.context = context
        self.case = case
        self.quick = quick
        self.factors = QUICK if quick else FACTORS
        self.point = context.chosen(trade_points(case))[0]
        self.default = first.projection, first.size
        sections = candidates(case, (self.point,), basis, first.size)
        self.workspace = prepared(context, sections)
        self.grid = probes_of(case).grid
        self.truths = Truths(context, self.grid)
        self.notes = self.truths.notes
        self.trained = case.plan.bases[basis]
        self.models = [FastModel(self.workspace, section) for section in sections]
        self._galerkin = [section for section in sections if section.projection == "galerkin"]
        self._modes: dict[BasisModel, GridModes] = {}

    def runs(self) -> Iterator[ExtremeRun]:
        """Yield the runs of all maps."""
        maps = [self._steps, self._memory_lengths, self._parameters, self._times]
        if not self.quick:
            maps.append(self._one_training_run)
        if not self.quick and self.case.trade.full_runs:
            maps.append(self._full_models)
        with self.context.report.progress("extremes", len(maps)) as advance:
            for of_map in maps:
                yield from of_map()
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
        plan = self.case.plan
        limits = plan.step_limits(self.point)
        begin = start(self.workspace, self.point).state
        for factor in self.factors[STEP]:
            trial = Trial(STEP, factor, self.point, self.truths.at(self.point), step_factor=factor)
            full = trial.row(
                "full",
                mechanism="sound" if limits.acoustic <= limits.viscous else "viscosity",
                predicted=limits.least / plan.steps.time_step,
            )
            functional = particles.functional(self.case, self.point)
            yield self._marched(full, trial, functional, begin)
            yield from self._on_particles(trial)
            for method in (EXPONENTIAL, RUNGE_KUTTA):
                for model in self.models:
                    yield self._fast(model, trial, method)

    def _memory_lengths(self) -> Iterator[ExtremeRun]:
        for model in self.models:
            if (automatic := model.at(self.point).memory_length) is None:
                continue
            usual, longer = (self._with_memory(model, n * automatic) for n in (1.0, 2.0))
            longest = longest_memory(usual.at(self.point), longer.at(self.point))
            for factor in self.factors[MEMORY]:
                trial = Trial(MEMORY, factor, self.point, self.truths.at(self.point))
                run = self._fast(self._with_memory(model, factor * automatic), trial)
                run.predicted = longest
                yield run

    def _with_memory(self, model: FastModel, length: float) -> FastModel:
        section = model.section.model_copy(update={"memory_length": length})
        return FastModel(self.workspace, section)

    def _parameters(self) -> Iterator[ExtremeRun]:
        for name in self.point.as_dict():
            if not all(point.as_dict()[name] > 0.0 for point in self.trained):
                self.notes.append(f"{name} is not varied: its trained values aren't above zero")
                continue
            for trial in self._extremes(name, name):
                coarse = self.truths.at(trial.point, coarse=True)
                if trial.truth is not None and coarse is not None:
                    full = trial.row("full", steps=f", {HALF}")
                    yield compared(full, coarse.samples, trial.truth.samples)
                for model in self.models:
                    yield self._fast(model, trial)

    def _extremes(self, varied: str, name: str) -> Iterator[Trial]:
        """Yield trials at values of a parameter inside and outside of its trained range."""
        at = self.point.as_dict()
        trained = [point.as_dict()[name] for point in self.trained]
        factors = self.factors[REYNOLDS]
        values = [factor * min(trained) for factor in factors if factor <= 1.0]
        values += [factor * max(trained) for factor in factors if factor >= 1.0]
        # Rounding errors would show in file names.
        for value in sorted({at[name], *(float(f"{value:.12g}") for value in values)}):
            point = self.case.plan.point(at | {name: value})
            yield Trial(varied, value, point, self.truths.at(point))

    def _times(self) -> Iterator[ExtremeRun]:
        n_trained = self.case.plan.steps.n_snapshots - 1
        truth = self.truths.at(self.point, self.factors[TIME][-1])
        for factor in self.factors[TIME]:
            # Errors count over the last part, as long as the training runs.
            last = truth and truth.within((factor - 1.0) * n_trained, factor * n_trained)
            trial = Trial(TIME, factor, self.point, last, until=factor)
            for model in self.models:
                yield self._fast(model, trial)

    def _one_training_run(self) -> Iterator[ExtremeRun]:
        """Yield the runs of models whose only training run is the first one."""
        plan = self.case.plan
        first = self.trained[0]
        others = [point for point in plan.points if point != first]
        if not others:
            return
        n_modes = min(plan.n_modes, plan.steps.n_snapshots)
        variant = changed(
            # The points stay the same, so that existing full runs and their maps are used.
            of_full_model(self.case, [first], others),
            name="extreme-one-training-run",
            basis={"subsets": {}, "lagrangian": False, "n_modes": n_modes},
            rom=in_all([section for section in self._galerkin if section.size <= n_modes]),
        )
        try:
            made = self._trained(variant, SHARED)
        except (UnstableError, CaseError, ResourceError) as error:
            self.notes.append(f"{ONE_RUN}: {error}")
            return
        for trial in self._extremes(ONE_RUN, REYNOLDS):
            for section in made.case.rom:
                yield self._fast(FastModel(made, section), trial)

    def _full_models(self) -> Iterator[ExtremeRun]:
        """Yield the runs of varied full models, and of reduced models that are trained on them."""
        fine = self.truths.at(self.point)
        coarse = self.truths.at(self.point, coarse=True)
        points = self.trained, self.point
        for varied, value, variant in varied_models(self.case, points, self._galerkin):
            full = Trial(varied, value, self.point).row("full")
            try:
                made = self._trained(variant)
                truth = self.truths.of(made, self.point)
            except (UnstableError, CaseError, ResourceError) as error:
                yield full.failed(error)
                continue
            # The reference has the resolution of the variant, unless the resolution varies.
            if (beside := fine if varied == RESOLUTION else coarse or fine) is not None:
                yield compared(full, truth.samples, beside.samples)
            for section in made.case.rom:
                trial = Trial(varied, value, self.point, truth)
                yield self._fast(FastModel(made, section), trial)

    def _trained(self, variant: Case, shared: tuple[str, ...] = ()) -> Workspace:
        """Make the full runs and the reduced models of a variant; return their workspace."""
        for problem in case_problems(variant):
            raise CaseError(str(problem))
        made_by = (fom.run, stages.map_runs, *stages.OPERATORS)
        return variant_of(self.context, variant, shared).made(made_by)

    # Runs

    def _fast(self, model: FastModel, trial: Trial, method: str = EXPONENTIAL) -> ExtremeRun:
        """Run a fast model."""
        basis = model.at_point(trial.point)
        section = basis.section
        row = trial.row("fast", steps=method, projection=section.projection, n_modes=section.size)
        try:
            reduced = model.at(trial.point)
            times = reduced.output_times
            n_snapshots = round(trial.until * (times.n_snapshots - 1)) + 1
            reduced = replace(reduced, output_times=replace(times, n_snapshots=n_snapshots))
            integrator = basis.integrator(reduced).with_steps(trial.step_factor)
            if method == RUNGE_KUTTA:
                integrator = choose(reduced, partial(_runge_kutta, trial.step_factor))
                row.mechanism, limit = limiting_step(integrator.steps.model)
                row.predicted = trial.step_factor * limit / integrator.steps.time_step
            run = self.integrated(row, model, trial.point, integrator)
        except CaseError as refused:  # it would need too many steps
            return row.failed(refused)
        row.time_step = run.time_step
        row.memory_length = reduced.memory_length
        row.extrapolated = bool(run.outside)
        row.end_time = float(run.time[-1])
        if run.failure is not None:
            row.diverged_at = run.diverged_at
            row.mechanism = cause_of_divergence(run, integrator)
            cause = f"{str(run.failure).partition(';')[0]}: {row.mechanism}"
            return row.failed(UnstableError(cause))
        if (estimate := run.estimate) is not None:
            row.velocity_estimate = estimate.velocity_percent
            row.pressure_estimate = estimate.pressure_percent
        row.told = "; ".join(run.doubts)
        if (truth := trial.truth) is None:
            return row
        if basis not in self._modes:
            self._modes[basis] = GridModes(basis, self.grid)
        modes = self._modes[basis]
        samples = modes.samples(run.states[truth.snapshots])
        return compared(row, samples, truth.samples, modes.nearest(truth.samples))

    def integrated(
        self, row: ExtremeRun, model: FastModel, point: ParameterPoint, integrator: Integrator
    ) -> FastRun:
        """Run a fast model."""
        return model.run(point, integrator.model, integrator)

    def _on_particles(self, trial: Trial) -> Iterator[ExtremeRun]:
        """Run models on particles with the steps of a trial."""
        steps = self.case.plan.steps
        size = self.default[1]
        for fast in self.models:
            section = fast.section
            if section.size != size:
                continue
            assert isinstance(section, PointModelSection)
            moving = section.on_particles
            model, state = build_model(self.workspace, moving, self.point)
            jacobian = reduced_jacobian(model, state, steps.start_time)
            close(self.case, moving, model, state, steps.start_time)
            values, vectors = np.linalg.eig(jacobian[:size, :size])
            limits = stability_limits(values.astype(np.complex128))
            worst = int(limits.argmin())
            basis = fast.at_point(self.point).basis
            row = trial.row(
                "particles",
                projection=section.projection,
                n_modes=size,
                told="; ".join(doubts_of_step(trial.step_factor)),
                mechanism=kind_of(basis, values[worst], vectors[:, worst]),
                predicted=float(limits[worst]) / steps.time_step,
            )
            yield self._marched(row, trial, model, state)

    def _marched(self, row: ExtremeRun, trial: Trial, model: Model, state: Array) -> ExtremeRun:
        """Run a model of particles with steps over those of the full model, without artifacts."""
        plan = self.case.plan.steps
        ratio = Fraction(trial.step_factor).limit_denominator(1000) / plan.every
        every = ratio.denominator
        n_steps = max(1, (plan.n_snapshots - 1) // ratio.numerator * every)
        row.time_step = trial.step_factor * plan.time_step
        steps = TimeSteps(row.time_step, n_steps, every, plan.start_time, every)
        sample = particles.sampler(self.case, self.grid)
        density = self.case.fluid.reference_density
        fields = []
        try:
            with np.errstate(all="ignore"):
                for _, kept in march(model, state, steps, density, Clock(), lambda done: None):
                    at = model.snapshot(kept)
                    fields.append(sample(at.position.T, at.density_fluctuation, at.velocity.T))
        except (UnstableError, ValueError) as error:
            return row.failed(error)
        if (truth := trial.truth) is None:
            return row
        snapshots = ratio.numerator * np.arange(len(fields), dtype=np.int64)
        common, of_run, of_full = np.intersect1d(snapshots, truth.snapshots, return_indices=True)
        if not len(common):
            return row
        full = truth.samples.at(of_full)
        densities, velocities = (np.array(part)[of_run] for part in zip(*fields, strict=True))
        pressures = pressure_of(densities, self.case.plan.sound_speed)
        return compared(row, Samples(full.time, velocities, pressures), full)


def _runge_kutta(factor: float, part: ReferenceModel) -> Steps:
    n_steps = steps_within(part.output_times.duration, factor * part.step_limit)
    return runge_kutta(part, n_steps)
