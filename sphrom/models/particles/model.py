"""Models on particles at any parameters: their runs are trajectories in the case's folder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial

from sphrom.arrays import Array
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Quantities, Samples
from sphrom.models.contract import Model, ModelRun
from sphrom.models.fom import seconds_of_steps
from sphrom.models.particles.runs import build_model, close
from sphrom.models.stages import ensure_run
from sphrom.models.stored_run import StoredRun
from sphrom.store.trajectory import measured_of


class ParticleRuns(Model[None]):
    """One model on particles. A run is written as the stage `rom` does, unless it exists."""

    def at(self, point: ParameterPoint) -> None:
        """Return nothing: a run needs its particles."""

    def run(self, point: ParameterPoint, reduced: None = None) -> ParticleRun:
        """Run the model at a parameter point, or read its run."""
        workspace = self.workspace
        with workspace.open(ensure_run(workspace, self.section, point)) as trajectory:
            is_complete = trajectory.text("status") == "complete"
            return ParticleRun(
                model=self,
                point=point,
                reduced=reduced,
                time=trajectory.read("time"),
                coordinates=trajectory.read("generalized_coordinates"),
                time_step=trajectory.number("time_step"),
                ended=None if is_complete else trajectory.text("status_detail"),
                histories=measured_of(workspace.case, trajectory),
            )

    def timer(self, point: ParameterPoint, step: float) -> Callable[[], float]:
        """Return a function that measures the seconds of a run in steps [s]."""
        case = self.workspace.case
        reduced, state = build_model(self.workspace, self.section, point)
        close(case, self.section, reduced, state, case.plan.steps.start_time)
        return partial(seconds_of_steps, case, reduced, state, step, step)


@dataclass(frozen=True, kw_only=True)
class ParticleRun(ModelRun):
    """A run of a model on particles."""

    model: ParticleRuns
    histories: dict[str, Quantities]

    @property
    def measured(self) -> dict[str, Quantities]:
        """All measurements of the case (n_snapshots, ...), by name and quantity."""
        return self.histories

    @property
    def kinetic_energy(self) -> Array:
        """The kinetic energy (n_snapshots,) [J/m]."""
        with self._opened() as run:
            return run.kinetic_energy

    @property
    def largest_speed(self) -> float:
        """The largest speed of all particles and snapshots [m/s]."""
        with self._opened() as run:
            return run.largest_speed

    def sampled(self, points: Array) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m]."""
        with self._opened() as run:
            return run.sampled(points)

    def _opened(self) -> AbstractContextManager[StoredRun]:
        return StoredRun.opened(self.model.workspace, self.point, self.model.section)
