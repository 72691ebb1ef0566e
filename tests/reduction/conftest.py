"""Small scenes at fixed points, with bases of smooth modes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

from sphrom.reduction.mode_splines import basis_columns
from sphrom.reduction.spline import LocalSplines, fit_splines
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.fixed_points import FixedPoints
from sphrom.sph.fluid import Discretization, Fluid, Resistance, Strip

N_MODES = 5
SPACING = 0.0625
LENGTH = 14 * SPACING
FLUID = Fluid(reference_density=1000.0, sound_speed=10.0, kinematic_viscosity=0.01, max_speed=1.0)
ACOUSTIC = InnerProduct.acoustic(FLUID.reference_density, FLUID.sound_speed)
RAW = InnerProduct.raw(FLUID.reference_density)


def lid(position: np.ndarray) -> np.ndarray:
    """Return the velocity of walls whose lid moves."""
    velocity = np.zeros_like(position)
    velocity[position[:, 1] > LENGTH, 0] = 1.0
    return velocity


def smooth(points: np.ndarray, seed: int) -> np.ndarray:
    """Return a random smooth field (n_points,) of points (n_points, 2)."""
    random = np.random.default_rng(seed)
    wave_numbers = 2.0 * np.pi / LENGTH * np.array([(0, 1), (1, 0), (1, 1), (2, 1), (1, -2)])
    phases = points @ wave_numbers.T + 2.0 * np.pi * random.random(5)
    return np.cos(phases) @ random.standard_normal(5)


@dataclass(frozen=True)
class Setting:
    """A small scene, and a basis of smooth modes that are orthonormal in a product."""

    name: str
    product: InnerProduct = ACOUSTIC
    separate_mean: bool = False
    fixed_volume: bool = False
    amplitude: float = 1.0
    walls_driven: bool = False
    acoustic_damping: float = 1.0
    resistance: Resistance | None = None

    @cached_property
    def domain(self) -> Domain:
        around = {"periodic": (True, True), "box": (False, False), "channel": (True, False)}
        return BoxDomain((0.0, 0.0), (LENGTH, LENGTH), around[self.name])

    @cached_property
    def position(self) -> np.ndarray:
        random = np.random.default_rng(1)
        points = self.domain.fill(SPACING)
        return points + 0.2 * SPACING * random.uniform(-1.0, 1.0, points.shape)

    @cached_property
    def points(self) -> FixedPoints:
        discretization = Discretization(
            SPACING,
            2.0 * SPACING,
            fixed_volume=self.fixed_volume,
            acoustic_damping=self.acoustic_damping,
        )
        walls = force = None
        if self.domain.has_walls:
            walls = self.domain.ghosts(SPACING, discretization.n_layers).moving(lid)
        if self.name == "channel":
            force = self.amplitude * np.stack((np.sin(self.position[:, 1]), self.position[:, 0]))
        return FixedPoints(
            self.position,
            FLUID,
            discretization,
            self.domain,
            walls,
            force,
            walls_driven=self.walls_driven,
            resistance=self.resistance,
        )

    @cached_property
    def states(self) -> np.ndarray:
        """(n_states, 3, n_points): first field of the product, and velocity."""
        n_states = N_MODES + 3
        fields = [smooth(self.position, seed) for seed in range(3 * n_states)]
        states = np.array(fields).reshape(n_states, 3, -1)
        states[:, 0] *= 0.05
        if self.separate_mean:
            states[:, 0] -= states[:, 0].mean(axis=1, keepdims=True)
        if self.product.name == "raw":
            states[:, 0] = states[:, 0] * FLUID.reference_density / FLUID.sound_speed
            states[:, 0] += self.product.density_offset
        return states

    @cached_property
    def weights(self) -> np.ndarray:
        return self.product.weights(np.full(len(self.position), SPACING**2))

    @cached_property
    def basis(self) -> TrialBasis:
        root = np.sqrt(self.weights)
        columns = (root * self.states).reshape(len(self.states), -1).T
        left, values, _ = np.linalg.svd(columns, full_matrices=False)
        modes = left.T[:N_MODES].reshape(N_MODES, 3, -1) / root
        return TrialBasis(
            density_modes=modes[:, 0],
            velocity_modes=np.ascontiguousarray(modes[:, 1:].transpose(0, 2, 1)),
            singular_values={"joint": values},
            inner_product=self.product,
            weights=self.weights,
            gram_error=0.0,
            separate_mean=self.separate_mean,
        )

    @cached_property
    def splines(self) -> LocalSplines:
        columns = basis_columns(self.basis)
        return fit_splines(self.position, columns, self.domain, cell_width=3.0 * SPACING)

    @property
    def coordinates(self) -> np.ndarray:
        """Those of a state, not far from one of the basis's own."""
        basis, weighted = self.basis, self.weights * self.states[2]
        return basis.density_modes @ weighted[0] + np.einsum(
            "mnd,dn->m", basis.velocity_modes, weighted[1:]
        )


SLOWED = Resistance(
    own=lambda at: 2.0 + np.sin(at[1]),
    inverse_permeability=lambda at: np.where(at[0] > 0.5, 300.0, 0.0),
    strip=Strip(0, 0.1, 0.4, 0.4, 20.0),
)
"""All that slows fluid."""
SETTINGS = {
    "periodic": Setting("periodic"),
    "lid": Setting("box", separate_mean=True, fixed_volume=True),
    "lid with its mean": Setting("box", fixed_volume=True),
    "driven lid": Setting("box", separate_mean=True, fixed_volume=True, walls_driven=True),
    "forced": Setting("channel"),
    "forced between driven walls": Setting("channel", walls_driven=True),
    "open": Setting("channel", resistance=SLOWED),
    "raw": Setting("box", product=RAW),
    "raw and forced": Setting("channel", product=RAW),
}


@pytest.fixture(scope="session")
def settings() -> dict[str, Setting]:
    """Small scenes with their bases, by name."""
    return SETTINGS


@pytest.fixture(params=SETTINGS)
def setting(request) -> Setting:
    """Every small scene."""
    return SETTINGS[request.param]
