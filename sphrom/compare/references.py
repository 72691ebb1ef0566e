"""Comparison of full runs with profiles of reference solutions of their flow, if there are any.

A single snapshot contains sound, because the model is weakly compressible, and noise of particles
that rearrange, so its errors change with the output step. Therefore profiles are means over a time
window, and tables have the scatter of its snapshots beside the errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact
from sphrom.artifacts.records.comparison import ReferenceProfile as Profile
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Probes
from sphrom.metrics.quantities import AXES
from sphrom.scenes.reference_profiles import ReferenceProfile
from sphrom.sph.fluid import ROUNDING
from sphrom.store.stored_run import ON_WALL, sample_run

SETTLED = 0.01
"""Largest change of a settled flow, relative to the reference speed U, or rho U2 for a pressure."""
SETTLING_SHARE = 0.1
"""Last part of a run, in which a steady flow must not change; steady profiles are its means."""
SCALE = {"unit": "U, or rho U2"}


@dataclass(frozen=True)
class ReferenceRow:
    """One profile in a table; errors are dimensionless."""

    parameters: str
    profile: str
    state: str
    """`steady`, `time average`, or `transient`."""
    from_time: float = field(metadata={"unit": "s"})
    """Time of the first snapshot in the averaging window."""
    time: float = field(metadata={"unit": "s"})
    """Time of the last snapshot in the window."""
    n_snapshots: int
    """Number of snapshots in the window."""
    reference_time: float | None = field(metadata={"unit": "s"})
    """Time of a transient reference."""
    largest_error: float = field(metadata=SCALE)
    """Largest error of the mean over the window."""
    largest_scatter: float | None = field(metadata=SCALE)
    """Largest standard deviation of snapshots in the window; None for one snapshot."""
    rms_error: float = field(metadata=SCALE)
    rms_scatter: float | None = field(metadata=SCALE)
    """Root mean square, over the points, of the standard deviation of snapshots in the window."""
    last_change: float | None = field(metadata=SCALE)
    """Largest change of the mean over the last tenth of the run, for a steady profile."""
    settled: bool
    """Whether all steady profiles changed by at most SETTLED."""
    source: str


def window_of(case: Case, reference: ReferenceProfile, times: Array) -> range:
    """Return the snapshots to average for a reference; none if the run does not reach its time.

    Time averages use all snapshots, and steady profiles the last tenth of the run. Transient
    profiles use a period of the longest sound wave around their time, in which the flow hardly
    changes. This window is symmetric, also near the ends of the run, so that linear changes cancel.
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
    n_before = int(within[:nearest].sum())
    n_after = int(within[nearest + 1 :].sum())
    n_beside = min(n_before, n_after)
    return range(nearest - n_beside, nearest + n_beside + 1)


def time_scale(case: Case) -> float:
    """Return the unit of time of references [s]."""
    return case.scene.length_scale / case.fluid.reference_speed


def profiles_of(case: Case, point: ParameterPoint) -> tuple[ReferenceProfile, ...]:
    """Return the reference profiles at a point, if walls and force have the scene's own values."""
    if any(value != case.plan.own_values[name] for name, value in point.others):
        return ()
    return case.scene.reference_profiles(point.reynolds, case.fluid.reference_speed)


def compare_with_references(
    case: Case, point: ParameterPoint, trajectory: Artifact, probes: Probes
) -> list[tuple[ReferenceRow, Profile]]:
    """Compare a full run with all reference profiles of its flow.

    Profiles at times without a snapshot are left out. If a steady velocity still changed, all
    steady profiles are marked as unsettled; the noise of pressures never settles.
    """
    times = trajectory.read("time")
    pairs = []
    changes = [0.0]
    for reference in profiles_of(case, point):
        if window := window_of(case, reference, times):
            row, profile = _comparison(case, point, trajectory, probes, reference, times, window)
            pairs.append((row, profile))
            if row.last_change is not None and reference.quantity != "p":
                changes.append(row.last_change)
    if max(changes) <= SETTLED:
        return pairs
    return [(replace(row, settled=row.last_change is None), profile) for row, profile in pairs]


def _comparison(
    case: Case,
    point: ParameterPoint,
    trajectory: Artifact,
    probes: Probes,
    reference: ReferenceProfile,
    times: Array,
    window: range,
) -> tuple[ReferenceRow, Profile]:
    """Compare a reference with the mean over a window of snapshots, at points off the walls."""
    domain = case.scene.domain
    length = case.scene.length_scale
    before = range(0)
    state, transient = "time average" if reference.averaged else "steady", None
    if reference.time is not None:
        state, transient = "transient", reference.time * time_scale(case)
    elif not reference.averaged:  # as many snapshots, a tenth of the run earlier
        earlier = times[-1] - SETTLING_SHARE * (times[-1] - times[0])
        last = min(int(np.searchsorted(times, earlier)), len(times) - 2)
        before = range(max(0, last + 1 - len(window)), max(0, last) + 1)
    places = np.full((len(reference.coordinate), domain.n_dim), reference.offset)
    places[:, AXES.index(reference.axis)] = reference.coordinate
    points = length * places
    # On the walls, a run has its boundary conditions rather than a solution.
    off_walls = domain.wall_distance(points) > ON_WALL * case.plan.particle_spacing
    compared = off_walls & domain.contains(points)
    points = points[compared]
    number = int(compared.sum())
    speed = case.fluid.reference_speed
    if reference.quantity == "p":  # also sample the points whose mean pressure is the datum
        centre = 0.5 * np.add(domain.lower, domain.upper)[None]
        points = np.concatenate((points, probes.grid if reference.datum == "mean" else centre))
    chosen = sorted({*window, *before})
    samples = sample_run(case, trajectory, points, snapshots=chosen)
    if reference.quantity == "p":
        zero = samples.pressure[:, number:].mean(axis=1, keepdims=True)
        scale = case.fluid.reference_density * speed**2
        values = (samples.pressure[:, :number] - zero) / scale
    else:
        values = samples.velocity[..., "uvw".index(reference.quantity)] / speed
    now, then = (values[np.isin(chosen, part)] for part in (window, before))
    value = now.mean(axis=0)
    scatter = now.std(axis=0)
    several = len(now) > 1
    expected = reference.value[compared]
    error = value - expected
    row = ReferenceRow(
        parameters=point.label,
        profile=reference.name,
        state=state,
        from_time=float(times[window[0]]),
        time=float(times[window[-1]]),
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
    at = reference.coordinate[compared]
    return row, Profile(coordinate=at, reference_value=expected, value=value, scatter=scatter)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
