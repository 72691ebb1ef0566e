"""The lid-driven cavity: fluid in a square box, dragged along by its moving top wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.scenes.scene import Amplitude, Scene
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]

LID_EXPONENT = 14
"""How flat the regularised lid's profile is (Rodriguez et al., section 4.2)."""


@dataclass(frozen=True)
class LidDrivenCavity(Scene):
    """The cavity [0, L] x [0, L], in SI units; fluid starts at rest, at zero pressure.

    The regularised lid moves at U (1 - (2 x / L - 1)^14)^2, which vanishes at the corners; section
    4.2 of Rodriguez et al. prints it without its minus signs. The uniform one moves at U all along,
    and the flow is singular at the corners.

    A lid that starts at once, as there, starts sound too, which lasts for seconds. With a ramp it
    comes up to speed along half a cosine. Over 1.5 periods of the longest wave, 3 L / c0, that does
    not excite this wave at all, and shorter ones hardly.
    """

    length: float
    speed: float
    lid: Literal["regularised", "uniform"] = "regularised"
    ramp: float = 0.0
    """How long the lid takes to come up to speed [s]."""

    @property
    def domain(self) -> Domain:
        """The box, walls all around."""
        return BoxDomain((0.0, 0.0), (self.length, self.length), (False, False))

    def lid_velocity(self, x: Array) -> Array:
        """Return the lid's velocity (n_points,) [m/s] at places (n_points,) [m] along it."""
        if self.lid == "uniform":
            return np.full_like(x, self.speed)
        return self.speed * (1.0 - (2.0 * x / self.length - 1.0) ** LID_EXPONENT) ** 2

    @property
    def wall_amplitude(self) -> Amplitude | None:
        """The share of its speed that the lid has reached, or None where it starts at once."""
        return self._speed_share if self.ramp > 0.0 else None

    def _speed_share(self, time: float) -> float:
        return 0.5 - 0.5 * math.cos(math.pi * min(max(time / self.ramp, 0.0), 1.0))

    def wall_velocity(self, position: Array) -> Array:
        """Return the velocity (n_ghosts, 2) [m/s] of the walls that ghosts (n_ghosts, 2) are of.

        Ghosts above the box are the lid's, those beyond its corners the side walls', at rest.
        """
        x, y = position.T
        velocity = np.zeros_like(position)
        on_lid = (y > self.length) & (x >= 0.0) & (x <= self.length)
        velocity[on_lid, 0] = self.lid_velocity(x[on_lid])
        return velocity
