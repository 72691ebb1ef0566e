"""A box of three axes that fluid fills, periodic along some axes and with plane walls elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.sph.domain import Domain


@dataclass(frozen=True)
class SpaceBox(Domain):
    """Stand-in until the branch with the full model is merged."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    periodic: tuple[bool, ...]

    fluid = fluid_with_images = wall_search = ghosts = nearest_wall = None  # type: ignore

    @property
    def lengths(self):
        return tuple(u - l for l, u in zip(self.lower, self.upper))

    @property
    def solid_names(self):
        return ()

    @property
    def wall_names(self):
        sides = (("left", "right"), ("bottom", "top"), ("back", "front"))
        return tuple(n for s, p in zip(sides, self.periodic) if not p for n in s)

    def contains(self, position: Array) -> Mask:
        p = self.wrap(position)
        return np.all((p >= self.lower) & (p <= self.upper), axis=1)

    def distance_and_normal(self, position):
        p = self.wrap(position)
        d = np.full(len(p), np.inf)
        n = np.zeros_like(p)
        for a, per in enumerate(self.periodic):
            if per:
                continue
            for s, w in ((1, self.lower[a]), (-1, self.upper[a])):
                x = s * (p[:, a] - w)
                near = x < d
                d[near] = x[near]
                n[near] = 0
                n[near, a] = s
        return d, n

    def fill(self, spacing):
        axes = [lo + (np.arange(k := round(L / spacing)) + 0.5) * L / k for lo, L in zip(self.lower, self.lengths)]
        g = np.meshgrid(*axes[::-1], indexing="ij")
        return np.stack(g[::-1], -1).reshape(-1, 3)
