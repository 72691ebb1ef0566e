"""Snapshots at instants between those of files, by polynomials in time through the nearest four.

Each particle's position, velocity and density are interpolated, so that particles have to be the
same ones, in the same order, in all files.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sphrom.errors import CaseError
from sphrom.sph.domain import Domain
from sphrom.sph.time_loop import Snapshot

Array = NDArray[np.float64]

N_NODES = 4
"""Snapshots that one instant is interpolated from: cubic polynomials."""
ROUNDING = 1e-9
"""Of the time between two snapshots: nearer than this, one is taken as it is."""
FARTHEST = 2.0
"""How far a particle may move between two snapshots, over what the largest speed carries it."""


class Resampler:
    """Gives snapshots at any instant between the first and the last of a series.

    `read` gives the snapshot of a number, in the units and the frame of the case, and `times` are
    theirs [s]; `spacing` [m] is that of particles.
    """

    def __init__(
        self,
        times: Sequence[float],
        read: Callable[[int], Snapshot],
        domain: Domain,
        spacing: float,
    ) -> None:
        self._times = times
        self._read = lru_cache(maxsize=2 * N_NODES)(read)
        self._domain = domain
        self._spacing = spacing

    def __call__(self, time: float) -> Snapshot:
        """Return the snapshot of an instant [s].

        Raises CaseError where particles jump, so that they can't be the same in all files.
        """
        nodes, exact = self._nodes(time)
        if exact is not None:
            return self._read(exact)
        snapshots = [self._read(node) for node in nodes]
        weights = lagrange_weights([self._times[node] for node in nodes], time)
        nearest = int(np.argmax(weights))
        base = snapshots[nearest].position
        moved = np.zeros_like(base)
        for node, snapshot, weight in zip(nodes, snapshots, weights, strict=True):
            offset = self._offset(snapshot.position, base)
            self._refuse_jumps(offset, snapshots, self._times[node] - self._times[nodes[nearest]])
            moved += weight * offset
        parts = list(zip(weights, snapshots, strict=True))
        return Snapshot(
            np.ascontiguousarray(self._domain.wrap((base + moved).T).T),
            np.asarray(sum(w * snapshot.density_fluctuation for w, snapshot in parts)),
            np.asarray(sum(w * snapshot.velocity for w, snapshot in parts)),
        )

    def _nodes(self, time: float) -> tuple[range, int | None]:
        """Return the snapshots to interpolate from, and the one that is of the time itself."""
        n, after = len(self._times), bisect_left(self._times, time)
        for node in (after - 1, after):
            if 0 <= node < n and abs(self._times[node] - time) <= ROUNDING * self._gap(node):
                return range(0), node
        first = min(max(0, after - N_NODES // 2), max(0, n - N_NODES))
        return range(first, min(n, first + N_NODES)), None

    def _gap(self, node: int) -> float:
        other = node - 1 if node else 1
        return abs(self._times[node] - self._times[other])

    def _offset(self, position: Array, base: Array) -> Array:
        """Return the way from `base` to `position` (2, n_particles) [m], the shortest one."""
        offset = position - base
        for axis, (length, periodic) in enumerate(
            zip(self._domain.lengths, self._domain.periodic, strict=True)
        ):
            if periodic:
                offset[axis] -= length * np.round(offset[axis] / length)
        return offset

    def _refuse_jumps(self, offset: Array, snapshots: Sequence[Snapshot], duration: float) -> None:
        fastest = max(float(np.hypot(*snapshot.velocity).max()) for snapshot in snapshots)
        farthest = float(np.hypot(*offset).max())
        if farthest > FARTHEST * fastest * abs(duration) + self._spacing:
            raise CaseError(
                f"--resample: a particle moves by {farthest:.4g} m within {abs(duration):.4g} s, "
                f"and none is faster than {fastest:.4g} m/s: the files have their particles in "
                "different orders; --sort-by names the field that numbers them"
            )


def lagrange_weights(times: Sequence[float], time: float) -> Array:
    """Return the weights of values at `times` in the polynomial through them, at `time`."""
    nodes = np.asarray(times)
    return np.array(
        [
            np.prod((time - others) / (node - others))
            for node, others in ((node, nodes[nodes != node]) for node in nodes)
        ]
    )
