"""Stage `operators`: right-hand sides on the reference points, projected once (Eq. 3.21-3.22).

Beside the operators, the stage stores the data of error estimates, so that no run needs the points:
the factor of the residual, and products of some training snapshots with the basis, from which the
errors of reduced training runs follow. Held-out training runs also determine the numbers of modes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, ArtifactWriter, write_record
from sphrom.artifacts.records.reduced_models import (
    BasisOperators,
    Estimate,
    HeldOut,
    TrainedMeasure,
    WallForce,
)
from sphrom.case.model_sections import AUTO
from sphrom.case.plan import LEAST_SNAPSHOTS
from sphrom.case.plan_times import MAX_STEPS
from sphrom.machine import computing_seconds
from sphrom.metrics.series import smoothed
from sphrom.models.points.missed_outputs import output_shares
from sphrom.models.points.pressures import pressure_space
from sphrom.models.points.stored import (
    calibrated,
    memory_timing,
    snapshot_times,
    starts_record,
    training_runs,
)
from sphrom.models.reference.splines import fit
from sphrom.models.reference.stored import (
    both,
    mapped_runs,
    read_basis,
    read_points,
    read_splines,
)
from sphrom.plots.tables import format_figure
from sphrom.reduction import held_out, reference_model, trial_basis
from sphrom.reduction.decomposition import N_FIELD_VALUES
from sphrom.reduction.error_calibration import LEFT_OUT, compared_snapshots
from sphrom.reduction.force_projection import project_forces
from sphrom.reduction.memory_projection import project_memory
from sphrom.reduction.mode_fields import BLOCK_VALUES, FieldProjections, blocks, mode_fields
from sphrom.reduction.mode_splines import Values
from sphrom.reduction.operator_projection import (
    project_operators,
    residual_factor,
)
from sphrom.reduction.own_pressure import PressureSpace
from sphrom.reduction.polynomial_model import step_limit
from sphrom.reduction.reduced_measures import project_measures
from sphrom.reduction.reduced_operators import (
    MemoryOperators,
    ResidualFactor,
    largest_growth,
    spectral_radius,
)
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.stokes_fields import stokes_fields
from sphrom.reduction.trial_basis import truncate, with_pressures
from sphrom.setup import particles
from sphrom.setup.assembly import amplitude_of, output_times_of, scaled_parameters, sound_averages
from sphrom.setup.particles import MeasuredFields
from sphrom.sph.fixed_points import FixedPoints
from sphrom.store.trajectory import measured_of, read_forces
from sphrom.store.workspace import Workspace

N_STATES = 10
"""Approximate number of training snapshots per run around which the step limit is computed."""
N_AT_ONCE = 10
"""Number of snapshots read at once."""
UNBALANCED = 0.05
"""Largest relative difference of a force from the balance of momentum without a warning."""


def project(workspace: Workspace) -> None:
    """Project the operators onto every basis that a model on the reference points uses."""
    target = workspace.operators()
    points = particles.fixed_points(workspace.case, read_points(workspace))
    with workspace.create(target, {"walls_driven": int(points.walls_driven)}) as artifact:
        started = time.perf_counter()
        for name in workspace.case.plan.reference_bases:
            projection = _Projection(workspace, points, name)
            write_record(artifact, projection.stored(artifact), f"bases/{name}")
            if projection.pressure_splines is not None:
                write_record(artifact, projection.pressure_splines, f"pressure_splines/{name}")
        write_record(artifact, starts_record(workspace), "starts")
        artifact.annotate("timing/projection", time.perf_counter() - started)


class _Projection:
    """The projection onto one basis, and the choices that its training runs determine."""

    def __init__(self, workspace: Workspace, points: FixedPoints, name: str) -> None:
        self.workspace, self.points, self.name = workspace, points, name
        self.case = workspace.case
        self.report = workspace.context.report
        self.trained = self.case.plan.bases[name]
        self.basis = read_basis(workspace, name)
        self.splines = read_splines(workspace, name)
        with self.report.progress(f"operators, basis {name}", points.n_points) as advance:
            self.operators = project_operators(points, self.basis, self.splines, advance=advance)
        self.compared = compared_snapshots(self.case.plan.steps.n_snapshots)
        self.whole = self.basis
        self.pressure_splines = None
        self.pressures: PressureSpace | None = None
        self.pressure_modes: Array | None = None
        found = pressure_space(workspace, points, name, self.basis, self.splines, self.compared)
        if found is not None:
            self.pressures, self.pressure_modes = found
            self.whole = with_pressures(self.basis, self.pressures.modes)
            columns = np.ascontiguousarray(self.pressures.modes.T)
            self.pressure_splines = fit(
                self.case, points.position, columns, f"pressure {name}", self.report
            )

    def stored(self, artifact: ArtifactWriter) -> BasisOperators:
        """Project everything, report it, and return the record to store; time the parts."""
        closures = self._closures(artifact)
        states = []
        for _, densities, velocities in mapped_runs(self.workspace, self.name):
            every = max(1, (len(densities) - 1) // N_STATES)
            states.append(trial_basis.project(self.basis, densities[::every], velocities[::every]))
        # Steps must be stable around these states.
        self.states = np.concatenate(states)
        runs = None
        if self.name in self.case.plan.corrected_bases:
            runs = training_runs(self.workspace, self.basis, self.name)
        forces = self._wall_forces()
        measures = self._measures()
        residual, estimate = self._error_data(forces, measures)
        chosen = self._held_out(runs, estimate)
        stored = BasisOperators(
            rates=self.operators,
            states=self.states,
            training_runs=runs,
            residual=residual,
            estimate=estimate,
            held_out=chosen,
            memory=closures,
            wall_force=forces,
            measure=measures,
            pressure=self.pressures,
            skewness=self.operators.skewness,
        )
        self._report_operators()
        if chosen is not None:
            self._report_choice(chosen)
        return stored

    def _closures(self, artifact: ArtifactWriter) -> dict[str, MemoryOperators]:
        """Project the term of the closure, for every number of modes of a model that uses it."""
        sizes = [n_modes for used, n_modes in self.case.plan.memory_models if used == self.name]
        closures: dict[str, MemoryOperators] = {}
        if not sizes:
            return closures
        with self.report.progress(f"memory operators, basis {self.name}", len(sizes)) as advance:
            for n_modes in sizes:
                started = computing_seconds()
                closures[str(n_modes)] = project_memory(
                    self.points, truncate(self.basis, n_modes), self.splines.first(n_modes)
                )
                taken = computing_seconds() - started
                artifact.annotate(memory_timing(self.name, n_modes), taken)
                advance(1)
        return closures

    def _wall_forces(self) -> dict[str, WallForce]:
        """Project the measured forces, and add those recorded by training runs."""
        case = self.case
        walls = particles.driven_measured_walls(self.case)
        if not walls:
            return {}
        loads: dict[str, list[Array]] = {measured: [] for measured in walls}
        for point in self.trained:
            with self.workspace.open(self.workspace.full_run(point)) as run:
                for measured, recorded in loads.items():
                    recorded.append(read_forces(run, measured))
        forces = {}
        ghosts = particles.walls(case, case.plan.flow(self.trained[0]))
        assert ghosts is not None
        names = case.scene.measured_walls
        viscosity = case.plan.kinematic_viscosity(self.trained[0])
        slowing, strip = self.points.slowed_over(viscosity)
        tested = stokes_fields(
            case.scene.domain,
            self.points.position,
            ghosts=ghosts.position,
            spacing=case.plan.particle_spacing,
            names=set(names.values()),
            slowing=slowing,
            strip=strip,
        )
        for measured, (wall, circulations) in walls.items():
            balance = tested[names[measured]], self.splines
            force = project_forces(
                self.points, self.basis, wall, circulations, balance, self.pressure_modes
            )
            forces[measured] = WallForce(**vars(force), training_loads=np.stack(loads[measured]))
        self._report_balance(forces, {name: wall.arm for name, (wall, _) in walls.items()})
        return forces

    def _report_balance(self, forces: Mapping[str, WallForce], arms: Mapping[str, float]) -> None:
        """Report the difference of recorded training forces from the balance of momentum.

        Sound is averaged out of both, and the start is left out.
        """
        case = self.case
        times = snapshot_times(self.case)
        averages = sound_averages(self.case)
        late = times >= times[0] + LEFT_OUT * (times[-1] - times[0])
        states = training_runs(self.workspace, self.basis, self.name)
        rows = []
        for name, force in forces.items():
            if force.balance is None or not force.balance.follows.any() or len(times) < 2:
                continue
            scale, shares = force.balance.follows / [1.0, 1.0, arms[name]], []
            for k, point in enumerate(self.trained):
                viscosity = case.plan.kinematic_viscosity(point)
                driven = self.points.walls_driven
                amplitude = amplitude_of(case, point)
                pushes = np.zeros(len(times)) if amplitude is None else amplitude(times)
                # The change of momentum is that of the snapshots, not of a model.
                change = np.gradient(states[k], times, axis=0)
                local = replace(force, own=None).at(viscosity, driven, point.factors)
                found = local.at(times, states[k], change, pushes).sum(axis=1)
                recorded = force.training_loads[k].sum(axis=1)
                recorded, found = (smoothed(x, averages)[late] for x in (recorded, found))
                size = np.linalg.norm(scale * recorded)
                shares.append(float(np.linalg.norm(scale * (recorded - found)) / size))
            rows.append((name, format_figure(100.0 * max(shares))))
            if max(shares) > UNBALANCED:
                self.report.warn(
                    f"the force {name} of training runs differs by {rows[-1][1]} % from the "
                    "balance of momentum: a finer discretization.resolution may be needed"
                )
        if rows:
            self.report.table(
                f"basis {self.name}: largest difference between the forces of training runs and "
                "the balance of momentum, without sound",
                ("measured", "difference [%]"),
                rows,
            )

    def _measures(self) -> dict[str, TrainedMeasure]:
        """Project the measured fields, and add the measurements recorded by training runs."""
        fields = MeasuredFields.of(self.case)
        recorded = []
        if fields is None:
            return {}
        for point in self.trained:
            with self.workspace.open(self.workspace.full_run(point)) as run:
                recorded.append(measured_of(self.case, run))
        values: Values = self.splines.values
        if (own := self.pressure_splines) is not None:
            values = both(values, own.values)
        projected = project_measures(self.basis, values, fields.position, fields.of_fields)
        return {
            name: TrainedMeasure(
                quantities=measure.quantities,
                training={
                    f"training_{q}": np.stack([r[name][q] for r in recorded])
                    for q in measure.quantities
                },
            )
            for name, measure in projected.items()
        }

    def _error_data(
        self, forces: Mapping[str, WallForce], measures: Mapping[str, TrainedMeasure]
    ) -> tuple[ResidualFactor | None, Estimate | None]:
        """Return the data for error estimates of models with the basis, if the case has any."""
        plan = self.case.plan
        name = self.name
        if not plan.has_error_estimate(name):
            return None, None
        # The sizes of the parameters' factors, by part.
        scales = {"viscosity": plan.largest_viscosity, "walls": plan.largest_viscosity}
        for parameter in plan.parameter_names[1:]:
            largest = max(abs(point.factors[parameter]) for point in plan.train_points) or 1.0
            scales[f"walls/{parameter}"] = plan.largest_viscosity * largest
            scales[f"force/{parameter}"] = largest
        with self.report.progress(f"residual, basis {name}", self.points.n_points) as advance:
            factor = residual_factor(
                self.points,
                self.basis,
                self.operators,
                self.splines,
                largest=np.max(np.abs(self.states), axis=0),
                scales=scales,
                advance=advance,
            )
        return factor, self._estimate(forces, measures)

    def _estimate(
        self, forces: Mapping[str, WallForce], measures: Mapping[str, TrainedMeasure]
    ) -> Estimate:
        """Return products of training snapshots with the basis, and the start of each run."""
        projections_of = FieldProjections(self.whole, mode_fields(self.whole, self.points))
        starts, projections, squares = [], [], []
        for _, densities, velocities in mapped_runs(self.workspace, self.name):
            starts.append(trial_basis.project(self.basis, densities[0], velocities[0]))
            found = []
            for first in range(0, len(self.compared), N_AT_ONCE):
                some = self.compared[first : first + N_AT_ONCE]
                density, velocity = (
                    np.stack([field[int(k)] for k in some]) for field in (densities, velocities)
                )
                scaled = self.points.density_scale * density
                found.append(projections_of.products(scaled, velocity))
            projections.append(np.concatenate([p for p, _ in found]))
            squares.append(np.concatenate([s for _, s in found]))
        snapshots = self._snapshot_products()
        places = scaled_parameters(self.case, self.trained)
        return Estimate(
            unheld=held_out.unheld_shares(snapshots, places, self.basis.n_modes),
            outputs=output_shares(
                self.case,
                self.trained,
                snapshots,
                forces,
                measures,
                self.points.walls_driven,
                self.basis.n_modes,
            ),
            start=np.stack(starts),
            gram=projections_of.gram,
            projections=np.stack(projections),
            squares=np.stack(squares),
        )

    def _snapshot_products(self) -> held_out.SnapshotProducts:
        """Return the products of the compared training snapshots with each other."""
        n_snapshots = len(self.trained) * len(self.compared)
        scale = self.points.density_scale

        def read(runs: list[Artifact]) -> Iterator[tuple[slice, Array, Array]]:
            for rows in blocks(
                self.points.n_points, BLOCK_VALUES // (N_FIELD_VALUES * n_snapshots)
            ):
                density, velocity = (
                    np.stack([r.dataset(field)[int(k), rows] for r in runs for k in self.compared])
                    for field in ("density_fluctuation", "velocity")
                )
                yield rows, density, velocity

        with ExitStack() as stack:
            mapped = map(self.workspace.mapped, self.trained)
            runs = [stack.enter_context(self.workspace.open(target)) for target in mapped]
            return held_out.snapshot_products(self.basis, n_snapshots, scale, read(runs))

    def _held_out(self, runs: Array | None, estimate: Estimate | None) -> HeldOut | None:
        """Return the numbers of modes that training runs determine for calibrated models.

        `runs` are projected (n_runs, n_snapshots, n_modes), if they are stored. None without data
        for their errors, or if they are too short for a calibration.
        """
        if runs is None or estimate is None or runs.shape[1] < LEAST_SNAPSHOTS:
            return None
        places = scaled_parameters(self.case, self.trained)
        joint = estimate.only(np.arange(runs.shape[2]), self.whole.n_modes)
        sizes = held_out.TrainedSizes(places, runs, products=joint, compared=self.compared)
        repeated = [self._repeated(runs, n + 1) for n in range(sizes.largest)]
        integrated, error = held_out.choose_integrated(sizes, repeated)
        return HeldOut(integrated=integrated, error=error)

    def _repeated(self, runs: Array, n_modes: int) -> Array:
        """Return training runs (n_runs, n_snapshots, n_modes) of a model calibrated on them.

        They are NaN if the model is not stable.
        """
        case = self.case
        modes = np.arange(n_modes)
        operators = self.operators.of_modes(modes)
        runs = runs[..., modes]
        calibration = calibrated(case, self.trained, operators, runs)
        basis = truncate(self.basis, n_modes)
        states = self.states[:, modes]
        found = []
        for point, own in zip(self.trained, runs, strict=True):
            viscosity = case.plan.kinematic_viscosity(point)
            rates = operators.at(viscosity, point.factors)
            model = ReferenceModel(
                polynomial=rates.plus(calibration.at(viscosity, point.factors)),
                basis=basis,
                start=own[0],
                output_times=output_times_of(case, case.plan.steps, states, point),
                amplitude=amplitude_of(case, point),
                longest_step=case.plan.longest_step(point),
            )
            model = model.around(states)
            if model.output_times.duration > MAX_STEPS * model.step_limit:
                found.append(np.full_like(own, np.nan))
            else:
                found.append(reference_model.automatic(model).run().coordinates)
        return np.stack(found)

    def _report_operators(self) -> None:
        """Report the growth rates of sound in the operators, and the limits of steps."""
        rows = []
        for point in self.trained:
            viscosity = self.case.plan.kinematic_viscosity(point)
            polynomial = self.operators.at(viscosity, point.factors)
            at_rest = polynomial.at_rest()
            limit = step_limit(polynomial, self.states)
            figures = largest_growth(at_rest), spectral_radius(at_rest), limit
            rows.append((point.label, *(f"{figure:.3g}" for figure in figures)))
        self.report.table(
            f"operators of basis {self.name}, {self.operators.n_modes} modes: acoustic part "
            f"skew-symmetric to {self.operators.skewness:.1e}",
            ("parameters", "largest real part [1/s]", "spectral radius [1/s]", "step limit [s]"),
            rows,
        )

    def _report_choice(self, chosen: HeldOut) -> None:
        """Report the automatic numbers of modes, and of integrated modes."""
        plan = self.case.plan
        name = self.name
        size = 0
        if self.name in plan.sized_bases:
            size = held_out.best_size(chosen.error)
            velocity, pressure = (format_figure(100.0 * e) for e in chosen.error[size - 1])
            self.report.info(
                f"basis {name}: n_modes: auto takes {size} of {len(chosen.error)} modes, expected "
                f"errors between training runs: velocity {velocity} %, pressure {pressure} %"
            )
        for model in self.case.rom:
            n_modes = size if model.n_modes == AUTO and size else model.size
            chosen_here = model.integrated_modes == AUTO and model.is_calibrated
            used = name in {plan.basis_for(model, point) for point in plan.rom_points(model)}
            n_integrated = int(chosen.integrated[n_modes - 1])
            if used and chosen_here and plan.is_corrected(model, name) and n_integrated < n_modes:
                self.report.info(
                    f"{model.name}, basis {name}: integrates {n_integrated} of {n_modes} modes; "
                    "the others are predicted from training runs"
                )
