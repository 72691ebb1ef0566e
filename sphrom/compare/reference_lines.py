"""Where a full run is compared with profiles of references, and over which time.

An instant of a run has the sound of a weakly compressible model and the noise of particles that
rearrange, so that errors of one instant change with the output step. Profiles are therefore means
over a window of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.metrics.samples import spread
from sphrom.scenes.reference_profiles import ReferenceProfile
from sphrom.setup import assembly
from sphrom.setup.measured_fields import sampler
from sphrom.store.sampling import ON_WALL, ROUNDING, Probes, Samples, sample_snapshot

Array = NDArray[np.float64]

SETTLING_SHARE = 0.1
"""The part of a run, at its end, over which a steady flow should no longer change.

Unless the case says otherwise, steady profiles are means over it.
"""


def window_of(case: Case, reference: ReferenceProfile, times: Array) -> range:
    """Return the snapshots whose mean is compared with a reference; none for one out of reach.

    Those of an average are all. Steady profiles have the last `compare.reference_window` of the
    run, transient ones as much around their instant, but no more than a period of the longest sound
    wave, in which the flow hardly changes: a window about an instant leaves its linear change out,
    and is cut on both sides where the run ends.
    """
    if reference.averaged:
        return range(len(times))
    longest = case.compare.reference_window
    if reference.time is None:
        length = SETTLING_SHARE * float(times[-1] - times[0]) if longest is None else longest
        first = int(np.searchsorted(times, times[-1] - length - ROUNDING * times[-1]))
        return range(first, len(times))
    distance = np.abs(times - reference.time * time_scale(case))
    nearest = int(distance.argmin())
    interval = float(np.diff(times).max()) if len(times) > 1 else 0.0
    if distance[nearest] > 0.5 * interval * (1.0 + ROUNDING):
        return range(0)
    period = assembly.longest_sound_period(case)
    length = period if longest is None else min(period, longest)
    within = np.abs(times - times[nearest]) <= 0.5 * length * (1.0 + ROUNDING)
    n_before, n_after = int(within[:nearest].sum()), int(within[nearest + 1 :].sum())
    n_beside = min(n_before, n_after)
    return range(nearest - n_beside, nearest + n_beside + 1)


def time_scale(case: Case) -> float:
    """Return the unit of a reference's times [s]."""
    return case.scene.length_scale / case.fluid.reference_speed


class Line:
    """The points of one reference's line, and a run's profile there."""

    def __init__(
        self, case: Case, reference: ReferenceProfile, probes: Probes, window: range
    ) -> None:
        self.case = case
        self.reference = reference
        self.window = window
        domain, length = assembly.domain(case), case.scene.length_scale
        on_line = self._points(reference.coordinate * length)
        inside = domain.wall_distance(on_line) > ON_WALL * case.particle_spacing
        # On the walls themselves a run has its boundary conditions, not a solution.
        self.compared = inside & domain.contains(on_line)
        along = self._whole_line(len(probes.line))
        self.coordinate = along / length
        datum = self._datum(probes)
        self.n_compared, self.n_line = int(self.compared.sum()), len(along)
        self.points = np.concatenate((on_line[self.compared], self._points(along), datum))

    def profiles(self, samples: Samples) -> tuple[Array, Array]:
        """Return samples at the reference's points and on the line (n_snapshots, n_points)."""
        scaled = self._scaled(samples)
        return scaled[:, : self.n_compared], scaled[:, self.n_compared :][:, : self.n_line]

    def _scaled(self, samples: Samples) -> Array:
        """Return the dimensionless quantity (n_snapshots, n_points)."""
        speed = self.case.fluid.reference_speed
        if self.reference.quantity != "p":
            component = "uv".index(self.reference.quantity)
            return samples.velocity[..., component] / speed
        zero = samples.pressure[:, self.n_compared + self.n_line :].mean(axis=1, keepdims=True)
        return (samples.pressure - zero) / (self.case.fluid.reference_density * speed**2)

    def _points(self, along: Array) -> Array:
        """Return points (n_points, 2) [m] at distances along the reference's line."""
        across = np.full_like(along, self.reference.offset * self.case.scene.length_scale)
        columns = (along, across) if self.reference.axis == "x" else (across, along)
        return np.stack(columns, axis=1)

    def _whole_line(self, n_points: int) -> Array:
        domain = assembly.domain(self.case)
        if self.reference.axis == "y":
            across = self.reference.offset * self.case.scene.length_scale
            return spread(domain.sections(across), n_points)
        return spread([(domain.lower[0], domain.upper[0])], n_points)

    def _datum(self, probes: Probes) -> Array:
        """Return where the mean of the pressure is zero."""
        if self.reference.quantity != "p":
            return np.empty((0, 2))
        if self.reference.datum == "mean":
            return probes.grid
        domain = assembly.domain(self.case)
        return 0.5 * np.add(domain.lower, domain.upper)[None]


class Snapshots:
    """A run's snapshots at the points of several lines, each sampled once."""

    def __init__(self, case: Case, trajectory: Artifact, lines: Sequence[Line]) -> None:
        self._case, self._trajectory = case, trajectory
        ends = np.cumsum([0, *(len(line.points) for line in lines)])
        self._where = {
            id(line): slice(*pair) for line, pair in zip(lines, pairwise(ends), strict=True)
        }
        self._sample = sampler(case, np.concatenate([line.points for line in lines]))
        self._sampled: dict[int, tuple[Array, Array]] = {}

    def of(self, line: Line, snapshots: range) -> tuple[Array, Array]:
        """Return a line's profiles at snapshots, as `Line.profiles` does."""
        for i in snapshots:
            if i not in self._sampled:
                self._sampled[i] = sample_snapshot(self._case, self._trajectory, self._sample, i)
        where = self._where[id(line)]
        velocities = [self._sampled[i][0][where] for i in snapshots]
        pressures = [self._sampled[i][1][where] for i in snapshots]
        times = np.array(snapshots, dtype=float)
        return line.profiles(Samples(times, np.array(velocities), np.array(pressures)))
