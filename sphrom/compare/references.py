"""Full runs against the profiles of reference solutions, where there are any of their flow.

An instant of a run has the sound of a weakly compressible model and the noise of particles that
rearrange, so that errors of one instant change with the output step. Profiles are therefore means
over a window of time; the scatter of its snapshots stands beside the errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.artifacts import Artifact
from sphrom.artifacts.records.comparison import ReferenceProfile as Profile
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.samples import Probes
from sphrom.scenes.reference_profiles import ReferenceProfile
from sphrom.store.sampling import ON_WALL, ROUNDING, sample_run

SETTLED = 0.01
"""The largest change of a settled flow, over U, or rho U2 for a pressure."""
SETTLING_SHARE = 0.1
"""The part of a run, at its end, over which a steady flow should no longer change.

Unless the case says otherwise, steady profiles are means over it.
"""
SCALE = {"unit": "U, or rho U2"}


@dataclass(frozen=True)
class ReferenceRow:
    """One profile in a table; errors are dimensionless."""

    parameters: str
    profile: str
    state: str
    """`steady`, `time average`, or `transient`."""
    from_time: float = field(metadata={"unit": "s"})
    """Of the first snapshot of the window whose mean is compared."""
    time: float = field(metadata={"unit": "s"})
    """Of the last one."""
    n_snapshots: int
    """In the window."""
    reference_time: float | None = field(metadata={"unit": "s"})
    """Of a transient reference."""
    largest_error: float = field(metadata=SCALE)
    """Of the mean over the window."""
    largest_scatter: float | None = field(metadata=SCALE)
    """Standard deviation of the window's snapshots, where it is largest; None for one snapshot."""
    rms_error: float = field(metadata=SCALE)
    rms_scatter: float | None = field(metadata=SCALE)
    """Its root mean square over the points."""
    last_change: float | None = field(metadata=SCALE)
    """How much the mean changed, at most, over the run's last tenth, if it should be steady."""
    settled: bool
    """Whether nothing that should be steady changed more than it may."""
    source: str


def window_of(case: Case, reference: ReferenceProfile, times: Array) -> range:
    """Return the snapshots whose mean is compared with a reference; none for one out of reach.

    Those of an average are all. Steady profiles have the last tenth of the run, transient ones
    a period of the longest sound wave around their instant, in which the flow hardly changes: a
    window about an instant leaves its linear change out, and is cut on both sides where the run
    ends.
    """
    if reference.averaged:
        return range(len(times))
    if reference.time is None:
        length = SETTLING_SHARE * float(times[-1] - times[0])
        first = int(np.searchsorted(times, times[-1] - length - ROUNDING * times[-1]))
        return range(first, len(times))
    distance = np.abs(times - reference.time * time_scale(case))
    nearest = int(distance.argmin())
    interval = float(np.diff(times).max()) if len(times) > 1 else 0.0
    if distance[nearest] > 0.5 * interval * (1.0 + ROUNDING):
        return range(0)
    period = case.plan.longest_sound_period
    within = np.abs(times - times[nearest]) <= 0.5 * period * (1.0 + ROUNDING)
    n_before, n_after = int(within[:nearest].sum()), int(within[nearest + 1 :].sum())
    n_beside = min(n_before, n_after)
    return range(nearest - n_beside, nearest + n_beside + 1)


def time_scale(case: Case) -> float:
    """Return the unit of a reference's times [s]."""
    return case.scene.length_scale / case.fluid.reference_speed


def profiles_of(case: Case, point: ParameterPoint) -> tuple[ReferenceProfile, ...]:
    """Return the known profiles of the flow at a parameter point: with the scene's own drive."""
    if any(value != case.plan.own_values[name] for name, value in point.others):
        return ()
    return case.scene.reference_profiles(point.reynolds, case.fluid.reference_speed)


@dataclass(frozen=True)
class _Line:
    """A reference, where a run is compared with it, and the snapshots whose mean is."""

    reference: ReferenceProfile
    compared: NDArray[np.bool_]
    """(n_points,) which of the reference's points are off the walls."""
    points: Array
    """(n_compared + n_datum, 2) [m] where they are; then where the mean of the pressure is zero."""
    window: range
    before: range
    """As many snapshots a tenth of the run before, of a flow that should be steady; else none."""

    @classmethod
    def of(
        cls, case: Case, reference: ReferenceProfile, probes: Probes, times: Array
    ) -> _Line | None:
        """Return the line of a reference, None for an instant that the run does not have."""
        window, before = window_of(case, reference, times), range(0)
        if not window:
            return None
        if reference.time is None and not reference.averaged:
            earlier = times[-1] - SETTLING_SHARE * (times[-1] - times[0])
            last = min(int(np.searchsorted(times, earlier)), len(times) - 2)
            before = range(max(0, last + 1 - len(window)), max(0, last) + 1)
        domain, length = case.scene.domain, case.scene.length_scale
        across = np.full_like(reference.coordinate, reference.offset)
        columns = (reference.coordinate, across)
        points = length * np.stack(columns if reference.axis == "x" else columns[::-1], axis=1)
        # On the walls themselves a run has its boundary conditions, not a solution.
        off_walls = domain.wall_distance(points) > ON_WALL * case.plan.particle_spacing
        compared = off_walls & domain.contains(points)
        datum = np.empty((0, 2))
        if reference.quantity == "p":
            centre = 0.5 * np.add(domain.lower, domain.upper)[None]
            datum = probes.grid if reference.datum == "mean" else centre
        points = np.concatenate((points[compared], datum))
        return cls(reference, compared, points, window, before)

    def values(self, case: Case, velocity: Array, pressure: Array) -> Array:
        """Return the dimensionless profiles (n_snapshots, n_compared) of fields at the points."""
        speed, number = case.fluid.reference_speed, int(self.compared.sum())
        if self.reference.quantity != "p":
            return velocity[..., "uv".index(self.reference.quantity)] / speed
        zero = pressure[:, number:].mean(axis=1, keepdims=True)
        return (pressure[:, :number] - zero) / (case.fluid.reference_density * speed**2)


def compare_with_references(
    case: Case, point: ParameterPoint, trajectory: Artifact, probes: Probes
) -> list[tuple[ReferenceRow, Profile]]:
    """Compare a full run with every profile that is known of its flow.

    A profile of an instant that the run did not reach or record is left out. All steady profiles
    are marked as unsettled, if a velocity shows that the flow still changed: pressure has noise
    that never settles.
    """
    times = trajectory.read("time")
    each = (_Line.of(case, reference, probes, times) for reference in profiles_of(case, point))
    lines = [line for line in each if line is not None]
    if not lines:
        return []
    chosen = sorted({i for line in lines for i in (*line.window, *line.before)})
    samples = sample_run(
        case, trajectory, np.concatenate([line.points for line in lines]), snapshots=chosen
    )
    found, changes, first = [], [0.0], 0
    for line in lines:
        where = slice(first, first + len(line.points))
        first = where.stop
        values = line.values(case, samples.velocity[:, where], samples.pressure[:, where])
        now, then = (values[np.isin(chosen, part)] for part in (line.window, line.before))
        row, profile = _comparison(case, point, line, times, now, then)
        found.append((row, profile))
        if row.last_change is not None and line.reference.quantity != "p":
            changes.append(row.last_change)
    if max(changes) <= SETTLED:
        return found
    return [(replace(row, settled=row.last_change is None), profile) for row, profile in found]


def _comparison(
    case: Case, point: ParameterPoint, line: _Line, times: Array, now: Array, then: Array
) -> tuple[ReferenceRow, Profile]:
    """Compare the profiles of the window (n_snapshots, n_compared), and of the one before."""
    reference, several = line.reference, len(now) > 1
    value, scatter = now.mean(axis=0), now.std(axis=0)
    expected = reference.value[line.compared]
    error = value - expected
    state, transient = "time average" if reference.averaged else "steady", None
    if reference.time is not None:
        state, transient = "transient", reference.time * time_scale(case)
    row = ReferenceRow(
        parameters=point.label,
        profile=reference.name,
        state=state,
        from_time=float(times[line.window[0]]),
        time=float(times[line.window[-1]]),
        n_snapshots=len(now),
        reference_time=transient,
        largest_error=float(np.abs(error).max()),
        largest_scatter=float(scatter.max()) if several else None,
        rms_error=_rms(error),
        rms_scatter=_rms(scatter) if several else None,
        last_change=float(np.abs(value - then.mean(axis=0)).max()) if len(then) else None,
        settled=True,
        source=reference.source,
    )
    return row, Profile(
        coordinate=reference.coordinate[line.compared],
        reference_value=expected,
        value=value,
        scatter=scatter,
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
