"""Walls as fixed ghost particles with fields extrapolated from the fluid (Eq. 2.15-2.16).

After Adami, Hu and Adams (J. Comput. Phys. 231, 2012). Ghosts fill the lattice beyond the fluid's
domain to the depth of the kernel's reach. A ghost's pressure is interpolated from the fluid, with
the weight of the fluid in between added. A rule decides their velocity and their share in the
continuity equation; it may replace any other method of `WallRule`, too, such as the interpolation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import shapely

from sphrom.arrays import Array
from sphrom.kernels import advection, fields, ghost_fields, wall_sweeps
from sphrom.kernels.cells import Search
from sphrom.kernels.fields import FluidConstants, RegularityConstants
from sphrom.kernels.pairs import TINY
from sphrom.kernels.rectangles import Limits
from sphrom.kernels.sweeps import gather
from sphrom.sph.domain import Domain, Walls
from sphrom.sph.fluid import Discretization, Fluid, fluctuation_of, volume_of
from sphrom.sph.neighbourhood import MOVE_RATIO, Sources, sort_sources
from sphrom.sph.polygons import jutting_corners

if TYPE_CHECKING:
    from sphrom.sph.point_sums import GhostSums

FELT = 1.5
"""Distance of the second layer from a wall, relative to the spacing."""
SHARE_SLOPE = 0.78
"""Integral of the kernel along a line through its centre, times the smoothing length."""
THIN_SHARE = 0.2
"""Share of the kernel's sum from which ghosts below thin fluid have full weight."""


class WallRule(ABC):
    """The ghosts of a scene's walls, which take their fields from the fluid beside them."""

    returns_flux: ClassVar[float] = 0.0
    """1 if walls return the flux into them, 0 if the velocities of ghosts enter continuity."""
    extrapolates: ClassVar[bool] = True
    """Whether velocities are extrapolated from each particle through the wall."""
    deeper_at_corners: ClassVar[float] = 0.0
    """Relative increase of the ghosts' depth at a right angle."""
    nearest: ClassVar[float] = 0.5
    """Least distance from a wall, relative to the spacing, for the extrapolation of velocities."""
    closest: ClassVar[float] = 0.25
    """Least distance from a wall that shifting allows, relative to the spacing."""
    touching: ClassVar[float] = 0.5
    """Distance from a wall at which shifting stops pushing towards it, relative to the spacing."""
    adds_heads: ClassVar[bool] = True
    """Whether a body force adds the weight of the fluid in between to the pressure of ghosts."""

    def __init__(
        self, walls: Walls, domain: Domain, fluid: Fluid, discretization: Discretization
    ) -> None:
        spacing = discretization.particle_spacing
        self.walls = walls
        self.fluid = fluid
        self.discretization = discretization
        self.search_walls = domain.wall_search(spacing)
        self._depth: Array | float = 0.0
        if self.extrapolates and not discretization.free_slip:
            self._depth = self.depths(domain, walls.position, discretization)
        self._mass = fluid.reference_density * spacing**2
        self._position = np.ascontiguousarray(walls.position.T)
        # Walls not parallel to the axes are treated like corners: normal to both axes.
        normal = np.ones_like(walls.position) if walls.normal is None else walls.normal
        self.normal = np.ascontiguousarray(normal.T)
        """(2, n_ghosts), 1 along the normals of their walls, else 0."""
        self._into_fluid = domain.distance_and_normal(walls.position)[1].T
        # Fluid may have left the box along a periodic axis since the last wrap.
        self._drift = 2.0 * MOVE_RATIO * spacing
        margin = discretization.support_radius + self._drift
        self._near = sort_sources(self._position, domain, margin, spacing)
        self._full_weights = (
            self._weights_beside_all(domain) if discretization.free_surface else None
        )

    def _weights_beside_all(self, domain: Domain) -> Array:
        """Return the sums of the kernel (n_ghosts,) [1/m2] if fluid filled the whole domain."""
        spacing = self.discretization.particle_spacing
        reach = self.discretization.support_radius
        lattice = np.ascontiguousarray(domain.fill(spacing).T)
        near = sort_sources(lattice, domain, reach, spacing)
        source = np.zeros((fields.N_FIELDS, near.particle.size))
        gather(near.particle, near.image, lattice, fields.X, source)
        search = near.search(reach, self.discretization.smoothing_length)
        return self.interpolated(source, search)[0][3]

    def interpolated(self, source: Array, search: Search) -> tuple[Array, Array]:
        """Return the rows (5, n_ghosts) of `ghost_fields.ghost_means`, and the fits of a rule."""
        means = np.empty((5, self._position.shape[1]))
        ghost_fields.ghost_means(self._position, source, search, means)
        return means, np.empty(0)

    def _below_surface(self, weights: Array, depth: Array) -> Array:
        """Return the share (n_ghosts,) of each ghost's cell that is below the free surface.

        Across the surface, the share of the kernel's sum grows by SHARE_SLOPE per smoothing length.
        Where fluid is thin, as at a front on the floor, the sum is small, although ghosts are below
        the fluid.

        Parameters
        ----------
        depth : (n_ghosts,) of ghosts below the fluid beside them, along the body force, in rows.
        """
        assert self._full_weights is not None
        share = np.zeros_like(weights)
        np.divide(weights, self._full_weights, out=share, where=self._full_weights > 0.0)
        rows = self.discretization.smoothing_length / self.discretization.particle_spacing
        by_weight = np.clip(0.5 + (share - 0.5) * rows / SHARE_SLOPE, 0.0, 1.0)
        return np.maximum(by_weight, np.clip(np.minimum(depth, share / THIN_SHARE), 0.0, 1.0))

    @property
    def search(self) -> Search:
        """The cells of the ghosts with the search radius."""
        discretization = self.discretization
        return self._near.search(discretization.support_radius, discretization.smoothing_length)

    def beside(
        self,
        sources: Sources,
        source: Array,
        search: Search,
        body_force: Array | None,
        wall_speed: float | Array = 1.0,
    ) -> WallTerms:
        """Return the ghosts beside some fluid, with fields derived from it (Eq. 2.15-2.16).

        Parameters
        ----------
        sources, source : of the fluid, with fields laid out as in `sphrom.kernels.fields`.
        search : with which ghosts search the fluid.
        body_force : (2, n_particles) [m/s2], or None.
        wall_speed : factor of the walls' velocity, or one for each ghost (n_ghosts,).
        """
        means, fits = self.interpolated(source, search)
        fluctuation, u, v, weights, flux = means
        share: Array | float = 1.0
        if body_force is not None and self.adds_heads:
            density = self.fluid.reference_density + source[fields.DENSITY]
            force = density * body_force[:, sources.particle]
            head = np.empty_like(fluctuation)
            ghost_fields.ghost_heads(self._position, source, force, weights, search, head)
            without_head = fluctuation
            fluctuation = without_head + fluctuation_of(head, self.fluid.sound_speed)
            if self._full_weights is not None:
                row = self.discretization.particle_spacing * np.hypot(*force).max(initial=0.0)
                share = self._below_surface(weights, head / max(row, TINY))
                # Falling fluid has no such head, which would pull it to the wall.
                fluctuation = np.maximum(fluctuation, np.minimum(without_head, 0.0))
        volume = share * volume_of(fluctuation, self.fluid.reference_density, self._mass)
        ghost = np.zeros((fields.N_GHOST_ROWS, fluctuation.size))
        ghost[:2] = self._position
        ghost[fields.DENSITY] = fluctuation
        wall = wall_speed * self.walls.velocity.T
        velocity = self.slipping if self.discretization.free_slip else self.velocity
        ghost[fields.U : fields.V + 1] = velocity(np.stack((u, v)), wall)
        ghost[fields.VOLUME] = volume
        ghost[fields.PRESSURE] = fluctuation
        ghost[fields.DEPTH] = self._depth
        self.enter_continuity(ghost, weights, flux)
        return WallTerms(self, sources, source, ghost, means, fits, search)

    @classmethod
    def depths(cls, domain: Domain, ghost: Array, discretization: Discretization) -> Array:
        """Return the depths (n_ghosts,) [m] of ghosts (n_ghosts, 2) [m], to extrapolate velocities.

        They are distances from the fluid d, increased behind corners that jut into it. There
        friction is singular (Moffatt, J. Fluid Mech. 18, 1964), and particles a spacing apart
        resolve only part of it, so a solid acts as if it were smaller. The missing part has one
        form for all flows past one angle, and one number c (`deeper_at_corners`) compensates for
        it: d (1 + c tan^2(turn / 2) W(r) / W(0)), r from the corner.
        """
        depth = np.maximum(-domain.distance_and_normal(ghost)[0], 0.0)
        if cls.deeper_at_corners == 0.0:
            return depth
        corner, sharpness = jutting_corners(
            domain.fluid_with_images, discretization.particle_spacing
        )
        near, which = shapely.STRtree(shapely.points(corner)).query(
            shapely.points(ghost), predicate="dwithin", distance=discretization.support_radius
        )
        q = np.hypot(*(ghost[near] - corner[which]).T) / discretization.smoothing_length
        deeper = cls.deeper_at_corners * sharpness[which] * (1 - 0.5 * q) ** 4 * (1 + 2 * q)
        gain = np.zeros_like(depth)
        np.maximum.at(gain, near, deeper)
        return depth * (1.0 + gain)

    def velocity(self, mean: Array, wall: Array) -> Array:
        """Return the ghosts' velocity (2, n_ghosts) [m/s]; one that is extrapolated is the wall's.

        `mean` is the interpolated one of the fluid, `wall` the walls', both (2, n_ghosts) [m/s].
        """
        return wall

    def slipping(self, mean: Array, wall: Array) -> Array:
        """Return the ghosts' velocity where fluid slips freely: the part across the wall is
        reversed."""
        if self.walls.normal is None:
            into_fluid = self._into_fluid
            return mean - 2.0 * np.sum((mean - wall) * into_fluid, axis=0) * into_fluid
        return mean - 2.0 * self.normal * (mean - wall)

    @abstractmethod
    def enter_continuity(self, ghost: Array, weights: Array, flux: Array) -> None:
        """Set the rows of ghosts for their share in the continuity equation (`wall_sweeps.py`).

        Parameters
        ----------
        ghost : (n_fields, n_ghosts) with all other rows.
        weights, flux : (n_ghosts,) the sum of the kernel [1/m2]; the flux towards the ghost [1/s].
        """

    def give_back(self, beside: WallTerms, out: Array) -> None:  # noqa: B027 - optional
        """Subtract the flux into walls from the divergence (n_particles,) [1/s] of the fluid.

        That is the work of rules that do not return it by the rows of ghosts.
        """

    def damp(self, beside: WallTerms, damping: Array) -> None:
        """Add the damper's pressure of the fluid's sources (n_sources,), over c0^2, to ghosts."""
        ghost = beside.ghost
        weights = beside.means[3]
        out = ghost[fields.PRESSURE]
        source = beside.source
        ghost_fields.ghost_damping(ghost[:2], source, damping, weights, beside.search, out)

    @classmethod
    def sums_at(
        cls, position: Array, walls: Walls, domain: Domain, discretization: Discretization
    ) -> GhostSums:
        """Return the matrices between fixed points (n_points, 2) [m] and the ghosts of walls."""
        from sphrom.sph.point_sums import ghost_sums  # importing scipy.sparse takes long

        return ghost_sums(position, walls, domain, discretization)

    def gathered(self, ghost: Array) -> Array:
        """Return fields (n_fields, n_ghosts) as sources, including periodic images."""
        near = self._near
        source = np.empty((len(ghost), near.particle.size))
        gather(near.particle, near.image, ghost, fields.X, source)
        return source


@dataclass(eq=False)
class WallTerms:
    """The contributions of ghosts to the sums of particles near walls."""

    ghosts: WallRule
    sources: Sources
    source: Array
    """The fields of the fluid's sources."""
    ghost: Array
    """(n_fields, n_ghosts) the fields of ghosts."""
    means: Array
    """The fields that ghosts took from the fluid, by `WallRule.interpolated`."""
    fits: Array
    """The rule's fits, also from `WallRule.interpolated`."""
    search: Search
    """The cells in which ghosts search the fluid."""

    distance: Array = field(init=False)
    """(n_targets,) of the particles from walls [m]."""

    def __post_init__(self) -> None:
        ghosts = self.ghosts
        sources = self.sources
        self._gathered = ghosts.gathered(self.ghost)
        discretization = ghosts.discretization
        self.distance = ghosts.search_walls.distances(sources.targets, self.source)
        near = self.distance < discretization.support_radius
        nearest = ghosts.nearest * discretization.particle_spacing
        self._distance = np.maximum(self.distance, nearest)
        self._beside = fields.BesideWalls(
            sources.particle, sources.targets[near], self.source, self._distance[near]
        )

    def regularity(self, constants: RegularityConstants) -> Array:
        """Return the sums (6, n_particles) over ghosts that `sweeps.regularity` includes."""
        out = np.zeros((6, self.sources.targets.size))
        search = self.ghosts.search
        wall_sweeps.wall_regularity(self._beside, self._gathered, search, constants, out)
        self.ghosts.give_back(self, out[5])
        return out

    def damp(self, pressure: Array) -> None:
        """Set the damper's pressure of ghosts, given that of the fluid's sources (n_sources,)."""
        self.ghosts.damp(self, pressure - self.source[fields.DENSITY])
        self._gathered = self.ghosts.gathered(self.ghost)

    def hold_back(self, shifting_velocity: Array, against: float = 1.0) -> None:
        """Limit shifting velocities (2, n_particles), so that no particle crosses a wall.

        With `against` = 0, only so that none pushes into a wall.
        """
        search = self.ghosts.search_walls
        spacing = self.ghosts.discretization.particle_spacing
        # Only shifting moves particles away from walls again.
        least = spacing if self.ghosts.discretization.shifting else 0.5 * spacing
        ghosts = self.ghosts
        limits = Limits(ghosts.closest * least, ghosts.touching * least, FELT * spacing, against)
        search.kernels.hold_back(self._beside, *search.lists, limits, shifting_velocity)

    def add_rates(self, fluid: FluidConstants, regular: Array, out: Array) -> None:
        """Add the ghosts' contribution to the acceleration (2, n_particles)."""
        search = self.ghosts.search
        wall_sweeps.wall_rates(self._beside, self._gathered, search, regular, fluid, out)

    def forces(self, fluid: FluidConstants) -> Array:
        """Return the pressure and the viscous force on each ghost (2, 2, n_ghosts) [N/m].

        `self.source` must contain the pressure and the Laplacian's factor.
        """
        particle = self.sources.particle
        distance = np.empty(self._distance.size)
        distance[particle[self.sources.targets]] = self._distance
        out = np.empty((4, self.ghost.shape[1]))
        wall_sweeps.ghost_forces(
            self.ghost, self.source, distance[particle], self.search, fluid, out
        )
        return out.reshape(2, 2, -1)

    def add_transport(self, out: Array) -> None:
        """Add the ghosts' contribution to the advection (3, n_particles) of Eq. 3.5-3.6."""
        part = np.zeros_like(out)
        advection.transport(
            self._beside,
            self._gathered,
            self.ghosts.search,
            self._gathered[fields.DEPTH],
            self.ghosts.fluid.reference_density,
            part,
        )
        out += part
