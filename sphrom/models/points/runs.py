"""Reduced runs on the reference points, whose cost does not depend on the number of particles.

A steady state can be searched from the end of a run. A zero of the model's rates is not always a
steady flow. A steady state is therefore stored with the residual of the full rates, an estimate of
its errors, and its distance from the nearest state of the training runs or between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache, partial

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import ArtifactWriter, write_record
from sphrom.artifacts.records.runs import Converged, Steady
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.machine import seconds_of
from sphrom.metrics.measures import Quantities, Samples
from sphrom.metrics.quantities import MEASURABLE, components
from sphrom.models.contract import N_TIMED, basis_used
from sphrom.models.estimates import measured_once
from sphrom.models.points.error_estimates import (
    distance_from,
    estimate_errors,
    steady_errors,
)
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.models.points.quantities import forces_of
from sphrom.models.reference.stored import expand, read_points, read_values, read_whole
from sphrom.models.stable_ranges import against
from sphrom.models.stored_run import OWN_PRESSURE, ComputedRun
from sphrom.plots.tables import format_figure
from sphrom.reduction.polynomial_model import EXPONENTIAL, steady_state
from sphrom.reduction.reduced_operators import largest_growth
from sphrom.reduction.reference_model import Integrator, ReferenceModel
from sphrom.reduction.trial_basis import TrialBasis, reconstruct
from sphrom.setup import assembly
from sphrom.setup.assembly import field_measures
from sphrom.sph.fluid import pressure_of
from sphrom.store.trajectory import field_datasets, force_datasets, write_positions
from sphrom.store.workspace import Workspace

FAR = 0.05
"""Distance from the nearest training state, relative to the state's norm, that causes a warning."""


def seek_steady_state(run: FastRun, artifact: ArtifactWriter) -> None:
    """Find a steady state by Newton's method from the end of a run, write and report it.

    If the search fails, the state with the smallest residual is written as not converged.
    """
    report = run.model.workspace.context.report
    model = run.model.at_point(run.point)
    polynomial = run.reduced.polynomial
    amplitude = float(run.reduced.amplitudes(run.time)[-1])
    seek = partial(steady_state, polynomial, run.coordinates[-1], amplitude=amplitude)
    found = seek()
    seconds = min(seconds_of(seek) for _ in range(N_TIMED))
    growth = largest_growth(polynomial.jacobian(found.coordinates, amplitude))
    status: Converged = "converged" if found.converged else "not converged"
    stored = Steady.of(found, status=status, largest_real_part=growth)
    artifact.annotate("timing/steady", seconds)
    text = (
        f"{run.name}: steady state {status} in {found.n_steps} Newton steps, "
        f"{1e3 * seconds:.3g} ms: residual {found.residual:.2g}, largest real part {growth:.3g} 1/s"
    )
    if not found.converged:
        write_record(artifact, stored, "steady")
        report.warn(text)
        return
    report.info(text)
    distance = distance_from(model.states, found.coordinates)
    errors = steady_errors(run, found.coordinates)
    if errors is not None:
        distance = min(distance, errors.distance)
        stored = replace(
            stored,
            residual_left_out=errors.residual,
            velocity_error_estimate=float(errors.errors[0]),
            pressure_error_estimate=float(errors.errors[1]),
        )
    there = replace(run, time=run.time[-1:], coordinates=found.coordinates[None])
    quantities = there.measured
    single = {name: measured_once(each) for name, each in quantities.items()}
    write_record(artifact, replace(stored, training_distance=distance, measure=single), "steady")
    text = f"{run.name}: the steady state is {format_figure(100.0 * distance)} % of its norm away "
    text += "from the nearest state of the training runs or of the run interpolated between them"
    if errors is not None:
        velocity, pressure = (f"{format_figure(100.0 * each)} %" for each in errors.relative)
        text += f"; estimated errors: velocity {velocity}, pressure {pressure}"
    for name, each in quantities.items():
        if figures := _figures(each):
            report.info(f"{run.name}: {name} in the steady state: {figures}")
    if distance > FAR:
        report.warn(f"{text}: the basis may not represent a flow so far from training")
    else:
        report.info(text)


def _figures(quantities: Quantities) -> str:
    """Return the measurements in one state, in words; lines are left out."""
    return ", ".join(
        f"{component.replace('_', ' ')} {format_figure(float(values.item()))} "
        f"{MEASURABLE[quantity].unit}"
        for quantity, vectors in quantities.items()
        for component, values in components(quantity, vectors).items()
        if values.size == 1
    )


def run_point(workspace: Workspace, section: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model from operators at a parameter point, and write its artifact."""
    workspace.require(workspace.operators())
    target = workspace.reduced_run(section, point)
    model = _fast_model(workspace, section.name)
    reduced = model.at(point)
    integrator = model.at_point(point).integrator(reduced)
    _warn(workspace, section, point, reduced, integrator)
    attributes = assembly.run_attributes(workspace.case, point, integrator.steps.time_step)
    with workspace.create(target, attributes) as artifact:
        result, seconds = integrator.timed(N_TIMED)
        run = FastRun(**vars(result), model=model, point=point, reduced=reduced)
        _write(run, artifact)
        artifact.annotate("status", "complete" if run.failure is None else "unstable")
        if run.failure is not None:
            artifact.annotate("status_detail", str(run.failure))
        artifact.annotate("timing/integration", seconds)
        artifact.annotate("integrator", integrator.steps.system.integrator)
        _report(run, integrator, seconds)
        if run.failure is None:
            estimate_errors(run, artifact)
            for doubt in run.doubts[len(run.outside) :]:
                workspace.context.report.warn(f"{run.name}: {doubt}")
            if section.steady:
                seek_steady_state(run, artifact)


@lru_cache(maxsize=1)
def _fast_model(workspace: Workspace, name: str) -> FastModel:
    """Return the model, which is shared by runs at different points and trained once."""
    return FastModel(workspace, next(m for m in workspace.case.rom if m.name == name))


def _warn(
    workspace: Workspace,
    section: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
    integrator: Integrator,
) -> None:
    """Warn before a run that is known to be unstable or inaccurate."""
    texts = list(against(workspace, section, point))
    step = integrator.steps.time_step
    if integrator.steps.system.integrator != EXPONENTIAL and step > reduced.step_limit:
        limit = f"the model's stability limit of {reduced.step_limit:.3g} s"
        texts.append(f"a step of {step:.3g} s is beyond {limit}")
    for text in texts:
        workspace.context.report.warn(f"{section.name}, {point.label}: {text}")


def _report(run: FastRun, integrator: Integrator, seconds: float) -> None:
    """Report the number of steps of a run, their length, and their computing time."""
    report = run.model.workspace.context.report
    reduced = run.reduced
    step = run.time_step
    exponential = integrator.steps.system.integrator == EXPONENTIAL
    if run.failure is not None:
        report.warn(f"{run.name}: {run.failure}")
        return
    kind = "exponential steps" if exponential else "steps"
    length = reduced.memory_length
    closure = "" if length is None else f", memory length {length:.3g} s"
    if reduced.leading is not None:
        closure += f", {reduced.n_integrated} of {reduced.basis.n_modes} modes integrated"
    # Rounded first: the last exponential step may end beyond the run, but not by rounding.
    n_steps = math.ceil(round((run.time[-1] - run.time[0]) / step, 6))
    report.info(f"{run.name}: {n_steps} {kind} of {step:.3g} s in {1e3 * seconds:.3g} ms{closure}")


def _write(run: FastRun, artifact: ArtifactWriter) -> None:
    """Write the coordinates of a run up to a divergence, and the fields that the case requests."""
    workspace = run.model.workspace
    reduced = run.reduced
    done = run.done
    section = run.model.at_point(run.point).section
    artifact.write("time", done.time)
    artifact.write("generalized_coordinates", done.coordinates)
    if reduced.pressure is not None:
        artifact.write(OWN_PRESSURE, done.states[:, reduced.basis.n_modes :])
    if done.correction is not None:
        artifact.write("correction", done.correction)
        artifact.annotate("integrated_modes", reduced.n_integrated)
    artifact.annotate("mean_density_fluctuation", reduced.mean_density_fluctuation)
    if math.isfinite(reduced.step_limit):
        artifact.annotate("step_limit", reduced.step_limit)
    if reduced.memory_length is not None:
        artifact.annotate("memory_length", reduced.memory_length)
    growth = largest_growth(reduced.polynomial.jacobian(reduced.start))
    artifact.annotate("largest_real_part", growth)
    mean = reduced.mean_density_fluctuation
    datasets = field_datasets(reduced.measured(done.states, mean))
    for name, loads in forces_of(reduced, done.time, done.coordinates).items():
        datasets |= force_datasets(name, loads, workspace.case.scene.domain.n_dim)
    write_positions(artifact, field_measures(workspace.case))
    for path, values in datasets.items():
        artifact.write(path, values)
    if section.output == "snapshots":
        _write_fields(done, artifact)


def _write_fields(run: FastRun, artifact: ArtifactWriter) -> None:
    """Reconstruct and write the fields of all snapshots, one at a time."""
    workspace = run.model.workspace
    whole = run.model.at_point(run.point).whole
    mean = run.reduced.mean_density_fluctuation
    points = read_points(workspace)
    n_snapshots = len(run.time)
    artifact.write("reference_position", points)
    densities = artifact.stream("density_fluctuation", points.shape[:1], n_snapshots)
    velocities = artifact.stream("velocity", points.shape, n_snapshots)
    pressures = artifact.stream("pressure", points.shape[:1], n_snapshots)
    for state in run.states:
        density, velocity = reconstruct(whole, state, mean)
        densities.append(density)
        velocities.append(velocity)
        pressures.append(pressure_of(density, workspace.case.plan.sound_speed))


class CoordinateRun(ComputedRun):
    """A stored run of a model, whose fields are sums of modes."""

    @cached_property
    def _used(self) -> tuple[str, int]:
        return basis_used(self._workspace, self.model, self._point)

    @cached_property
    def _basis(self) -> TrialBasis:
        return read_whole(self._workspace, *self._used, own_pressure=self._owns_pressure)

    @property
    def _owns_pressure(self) -> bool:
        return OWN_PRESSURE in self._run

    @cached_property
    def _states(self) -> Array:
        if not self._owns_pressure:
            return self.coordinates
        return np.hstack((self.coordinates, self._run.read(OWN_PRESSURE)))

    def position(self, snapshot: int) -> Array:
        """Return the reference points (n, 2) [m]."""
        return read_points(self._workspace)

    def state(self, snapshot: int) -> tuple[Array, Array]:
        """Return density fluctuation (n,) [kg/m3] and velocity (n, 2) [m/s] at these points."""
        mean = self._run.number("mean_density_fluctuation")
        return reconstruct(self._basis, self._states[snapshot], mean)

    def sampled(
        self,
        points: Array,
        snapshots: Sequence[int] | None = None,
        advance: Callable[[int], None] = lambda done: None,
    ) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], at some or all snapshots."""
        chosen = range(len(self.time)) if snapshots is None else snapshots
        own = self._owns_pressure
        values = read_values(self._workspace, *self._used, own_pressure=own)
        means = np.full(len(chosen), self._run.number("mean_density_fluctuation"))
        case = self._workspace.case
        states, time = self._states[chosen], self.time[chosen]
        return expand(case, self._basis, values, points, time, states, means)
