"""The plan of a case, third part: time steps, their limits, and the times used for statistics."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.case.measure_sections import ForceMeasure, FrequencyMeasure
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.plan_flows import FlowsPlan
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.metrics.measures import Oscillating, Oscillations, since
from sphrom.metrics.series import settled_from
from sphrom.sph import fluid
from sphrom.sph.fluid import StepLimits
from sphrom.sph.polygons import jutting_corners
from sphrom.sph.time_loop import TimeSteps

STEPS_PER_PERIOD = 20
"""Smallest number of steps in a period of the driving; with fewer it would look slower."""
N_DRIVING = 1000
"""Number of times of a run at which the driving is sampled."""
MAX_STEPS = 1e9
"""Largest number of steps of one run; more are assumed to be a typing error."""
WHOLE_STEPS_TOLERANCE = 1e-6
"""Relative tolerance for a duration to be a whole number of steps."""
LARGEST_DENOMINATOR = 1000
"""Largest denominator of spin-up over recorded time, so that one automatic step fits both."""


class TimesPlan(FlowsPlan):
    """The time steps of one case, and the times from which statistics are computed."""

    def step_limits(self, point: ParameterPoint) -> StepLimits:
        """Return the largest stable time steps at a parameter point."""
        scene = self.scene
        sharpness = self._sharpest_corner
        slowing = scene.largest_resistance(self.kinematic_viscosity(point))
        # Images behind plane walls make no waves or friction that particles have not.
        has_ghosts = scene.domain.has_walls and scene.domain.n_dim == 2
        return fluid.step_limits(
            self.fluid(point), self.discretization, has_ghosts, sharpness, slowing
        )

    @cached_property
    def _sharpest_corner(self) -> float:
        """The sharpness of the sharpest corner that points into the fluid, 0 without corners."""
        domain = self._scene.domain
        if domain.fills_box:
            return 0.0
        sharpness = jutting_corners(domain.fluid_with_images, self.particle_spacing)[1]
        return float(sharpness.max(initial=0.0))

    @cached_property
    def limits(self) -> StepLimits:
        """The largest time steps that are stable at every point of the case."""
        return self.step_limits(min(self.points, key=lambda point: point.reynolds))

    @cached_property
    def recorded_time(self) -> float:
        """The recorded time of a run [s]."""
        return self._time.final_time - self._time.spin_up

    @cached_property
    def step_target(self) -> float:
        """The time step of the case [s], before it is adjusted to fit the durations.

        The automatic step is the same share of all limits.
        """
        time = self._case.time
        if time.step != "auto":
            return time.step
        share = time.courant_number / fluid.COURANT_LIMIT
        return min(share * self.limits.least, self.shortest_period / STEPS_PER_PERIOD)

    @cached_property
    def shortest_period(self) -> float:
        """The shortest period of the driving at all points [s]; infinite if none oscillates."""
        return self.scene.shortest_period(self._settings)

    def longest_step(self, point: ParameterPoint) -> float:
        """Return the longest step [s] that resolves the driving at a point, infinite if steady."""
        return self.scene.shortest_period([point.factors]) / STEPS_PER_PERIOD

    @cached_property
    def spin_up_ratio(self) -> Fraction:
        """The spin-up over the recorded time, or the nearest ratio that whole steps allow."""
        ratio = Fraction(self._time.spin_up / self.recorded_time)
        return ratio.limit_denominator(LARGEST_DENOMINATOR)

    @cached_property
    def steps(self) -> TimeSteps:
        """The steps of all full runs, the same at all points so that snapshots coincide.

        An automatic step is shortened: snapshots begin after the spin-up, and end with the run.
        """
        every = self._case.snapshots.every
        step = self._time.step
        if step != "auto":
            n_spin_up_steps = round(self._time.spin_up / step)
            n_steps = max(1, round(self.recorded_time / step))
            return TimeSteps(step, n_steps, every, n_spin_up_steps * step)
        ratio = self.spin_up_ratio
        unit = math.lcm(every, ratio.denominator)
        steps = self.recorded_time / self.step_target
        n_steps = unit * math.ceil(steps * (1.0 - WHOLE_STEPS_TOLERANCE) / unit)
        step = self.recorded_time / n_steps
        return TimeSteps(step, n_steps, every, int(ratio * n_steps) * step)

    def model_steps(self, model: ReducedModelSection) -> TimeSteps:
        """Return the steps of full runs that end when the runs of a reduced model end.

        Raises CaseError when `lengthened` does not allow the model's final time.
        """
        return self.steps if model.until is None else lengthened(self.steps, model.until)

    def ends_with_case(self, model: ReducedModelSection) -> bool:
        """Return whether a model's runs end with the full runs, so that they can be compared."""
        return self.model_steps(model) == self.steps

    def compared_at(self, point: ParameterPoint) -> list[ReducedModelSection]:
        """Return the reduced models whose runs at a point are compared with the full run."""
        models = filter(self.ends_with_case, self._case.rom)
        return [model for model in models if point in self.rom_points(model)]

    @cached_property
    def settled_from(self) -> float:
        """The time after the gradual start of the driving [s]; 0 without one."""
        times = np.linspace(0.0, self._time.final_time, N_DRIVING)
        with np.errstate(all="ignore"):  # a check refuses amplitudes that are not finite
            found = [settled_from(times, self.flow(p).driving(times)) for p in self.points]
        return max(self._scene.ramp, *found)

    @cached_property
    def means_from(self) -> dict[str, float]:
        """The times from which statistics of recorded measurements are computed [s], by name."""
        asked = {name: measure.from_time for name, measure in self._scene.recorded.items()}
        return {name: self.settled_from if t is None else t for name, t in asked.items()}

    @property
    def times_in_words(self) -> str:
        """The `from_time` of measurements, in words; empty if all of them are the start."""
        late = sorted({t for t in self.means_from.values() if t > 0.0})
        names = {t: ", ".join(n for n, s in self.means_from.items() if s == t) for t in late}
        times = " and ".join(f"from {t:.4g} s on ({names[t]})" for t in late)
        return times and f"means and errors of measurements are computed {times}"

    def counted(self, name: str, time: Array) -> Mask:
        """Return the mask of the times (n_snapshots,) [s] for statistics of a measurement."""
        return since(time, self.means_from.get(name, self.settled_from))

    @cached_property
    def oscillations(self) -> Oscillations:
        """The oscillating quantities, by the names of the measurements of their frequency."""
        columns = self._scene.columns
        found = Oscillations()
        for name, measure in self._scene.measure.items():
            if isinstance(measure, FrequencyMeasure):
                column = columns[measure.frequency.of]
                begin = measure.since
                begin = self.means_from[column.measure] if begin is None else begin
                found[name] = Oscillating(**vars(column), from_time=begin)
        return found

    @cached_property
    def coefficients(self) -> dict[str, float]:
        """The ratios of coefficients to forces [m/N], by the names of the measurements."""
        density = self._fluid.reference_density
        measures = self._scene.measure.items()
        scales = ((n, m.coefficient) for n, m in measures if isinstance(m, ForceMeasure))
        n_across = self._scene.domain.n_dim - 1
        return {
            n: 2.0 / (density * c.speed**2 * c.length**n_across) for n, c in scales if c is not None
        }


def lengthened(steps: TimeSteps, final_time: float) -> TimeSteps:
    """Return steps with the last snapshot as near as possible to another time [s].

    Raises CaseError if this would be the first snapshot, or need too many steps.
    """
    interval = steps.snapshot_interval
    intervals = (final_time - steps.start_time) / interval
    if not 0.5 <= intervals <= MAX_STEPS / steps.every:
        raise CaseError(
            f"final_time: must be {steps.start_time + interval:.6g} s, the time of the second "
            f"snapshot, or later, within {MAX_STEPS:g} steps; got {final_time:g}"
        )
    return replace(steps, n_steps=max(1, round(intervals)) * steps.every)


def moved_end(steps: TimeSteps, final_time: float) -> str | None:
    """Return a warning if runs with these steps end at another time than asked [s], else None."""
    asked = final_time - steps.start_time
    if abs(steps.end_time - final_time) <= WHOLE_STEPS_TOLERANCE * asked:
        return None
    return (
        f"runs end at {steps.end_time:.6g} s, not {final_time:.6g} s, because snapshots are "
        f"{steps.snapshot_interval:.6g} s apart"
    )
