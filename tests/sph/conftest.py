"""Small scenes, and the sums over fluid and ghosts to compare the functional with.

`WallSums` writes Eq. 2.15-2.16 and the ghosts' terms of Eq. 2.6-2.7 as they are printed, over all
pairs and images, in plain numpy, beside `BruteForce`, which does so for the fluid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from shapely.affinity import translate

from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.domain import Domain, Walls
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import BodyForce, Functional
from sphrom.sph.polygon_domain import PolygonDomain
from sphrom.sph.polygons import disc

Array = NDArray[np.float64]

SPACING = 0.0625
FLUID = Fluid(reference_density=800.0, sound_speed=7.0, kinematic_viscosity=0.013, max_speed=0.9)
BOX = BoxDomain((-0.3, 0.2), (0.7, 1.075), (False, False))
PERIODIC = replace(BOX, periodic=(True, True))
CAVITY = BoxDomain(
    (0.1, -0.5),
    (1.1, 0.25),
    (True, False),
    rectangles=(Rectangle((0.1, -0.125), (1.1, 0.25)), Rectangle((0.35, -0.5), (0.85, -0.125))),
)
"""A channel, periodic along x, over a cavity; corners of both kinds."""
SHAPES = PolygonDomain(
    (0.0, 0.0),
    (1.5, 1.25),
    (True, False),
    (
        ("disc", disc((0.1, 0.7), 0.25)),
        ("fin", shapely.Polygon([(0.7, -0.1), (1.1, -0.1), (0.8, 0.6)])),
    ),
)
"""A channel, periodic along x, with a disc across its seam and an oblique fin on its floor."""
SOLIDS = {
    BOX: [(-9.0, -9.0, -0.3, 9.0), (0.7, -9.0, 9.0, 9.0), (-9.0, -9.0, 9.0, 0.2),
          (-9.0, 1.075, 9.0, 9.0)],
    CAVITY: [(-9.0, -9.0, 9.0, -0.5), (-9.0, 0.25, 9.0, 9.0), (-0.15, -9.0, 0.35, -0.125),
             (0.85, -9.0, 1.35, -0.125)],
}  # fmt: skip
"""What is solid, by hand: lower and upper corners of rectangles."""
FLUIDS = {
    BOX: [(-0.3, 0.2, 0.7, 1.075)],
    CAVITY: [(-9.0, -0.125, 9.0, 0.25), (-0.65, -0.5, -0.15, -0.125), (0.35, -0.5, 0.85, -0.125),
             (1.35, -0.5, 1.85, -0.125)],
}  # fmt: skip
"""What is fluid, by hand, with images."""
CORNERS = {
    CAVITY: [(x, -0.125, 1.0) for x in (-0.65, -0.15, 0.35, 0.85, 1.35, 1.85)],
    SHAPES: [(x, 0.6, 3.0) for x in (-0.7, 0.8, 2.3)],
}
"""Corners that jut into the fluid, by hand, with images, and how sharp they are."""


RULES = {
    "mirrored": ("linear", "adjoint"),
    "adjoint": ("linear", "adjoint"),
    "normal": ("linear", "normal"),
    "adami": ("whole", "normal"),
    "adami-as-fluid": ("whole", "paper"),
    "printed": ("paper", "paper"),
    "printed-normal": ("paper", "normal"),
}
"""What each rule of walls does for no slip, and in the continuity equation."""


def lid(position: Array) -> Array:
    """Return the velocity of walls whose lid moves along itself, and a little up."""
    x, y = position.T
    above = y > BOX.upper[1]
    return np.where(above, np.stack((0.8 + 0.5 * np.sin(3.0 * x), 0.2 * np.cos(x))), 0.0).T


def push(position: Array, time: float) -> Array:
    """Return a body force that depends on place and time."""
    x, y = position
    return np.stack((3.0 * np.sin(x) + time, -9.0 + 2.0 * y * time))


def turn(position: Array) -> Array:
    """Return the velocity of walls of which the disc turns."""
    foot = SHAPES.on_wall(position)
    on_disc = SHAPES.nearest_wall(position) == SHAPES.wall_names.index("disc")
    x, y = (SHAPES.wrap(np.add(foot, (0.5, 0.0))) - (0.6, 0.7)).T
    return 0.9 * on_disc[:, None] * np.stack((-y, x), axis=1)


@dataclass(frozen=True)
class Scene:
    """A domain, and what is given on its walls."""

    domain: Domain
    wall_velocity: Callable[[Array], Array] = np.zeros_like
    body_force: BodyForce | None = None

    def walls(self, ratio: float = 2.0, layers: int | None = None) -> Walls | None:
        if not self.domain.has_walls:
            return None
        depth = layers or Discretization(SPACING, ratio * SPACING).n_layers
        return self.domain.ghosts(SPACING, depth).moving(self.wall_velocity)

    def functional(
        self, ratio: float = 2.0, *, fluid: Fluid = FLUID, layers: int | None = None, **options
    ) -> Functional:
        discretization = Discretization(SPACING, ratio * SPACING, **options)
        walls = self.walls(ratio, layers)
        return Functional(fluid, discretization, self.domain, walls, self.body_force)

    def state(self, seed: int = 0, jitter: float = 0.3, amplitude: float = 1.0) -> Array:
        """Return a full state of jittered particles with rough random fields."""
        random = np.random.default_rng(seed)
        position = self.domain.fill(SPACING)
        position += jitter * SPACING * random.uniform(-1.0, 1.0, position.shape)
        return np.vstack((position.T, amplitude * random.standard_normal((3, len(position)))))


SCENES = {
    "periodic": Scene(PERIODIC),
    "box": Scene(BOX),
    "lid": Scene(BOX, wall_velocity=lid),
    "forced box": Scene(BOX, body_force=push),
    "cavity": Scene(CAVITY),
    "forced cavity": Scene(CAVITY, body_force=push),
    "shapes": Scene(SHAPES, wall_velocity=turn),
}


@dataclass(frozen=True)
class GhostFields:
    """What ghosts take from the fluid (Eq. 2.15-2.16)."""

    weights: Array
    """(n_ghosts, n_sources) Shepard's weights w_gj, of every image."""
    fluctuation: Array
    velocity: Array
    volume: Array


def gaps(points: Array, rectangles: list[tuple[float, ...]]) -> Array:
    """Return how far points (n, 2) are from the nearest of some rectangles (n,)."""
    corners = np.reshape(rectangles, (-1, 4))
    ways = np.clip(points[:, None], corners[:, :2], corners[:, 2:]) - points[:, None]
    return np.linalg.norm(ways, axis=2).min(axis=1, initial=np.inf)


def distances(domain: Domain, position: Array, ghosts: Array) -> tuple[Array, Array]:
    """Return how far positions (n, 2) are from the solid (n,), and ghosts from the fluid."""
    if domain is not SHAPES:
        solid, fluid = (rectangles.get(domain, []) for rectangles in (SOLIDS, FLUIDS))
        return gaps(domain.wrap(position), solid), gaps(ghosts, fluid)
    solids = shapely.union_all([shape for _, shape in SHAPES.solids])
    images = shapely.union_all([translate(solids, step, 0.0) for step in (-1.5, 0.0, 1.5)])
    fluid = shapely.difference(shapely.box(-1.5, 0.0, 3.0, 1.25), images)
    solid = shapely.difference(shapely.box(-1.5, -9.0, 3.0, 9.0), fluid)
    places = shapely.points(domain.wrap(position)), shapely.points(domain.wrap(ghosts))
    return shapely.distance(solid, places[0]), shapely.distance(fluid, places[1])


def gains(domain: Domain, ghosts: Array, length: float, most: float) -> Array:
    """Return what ghosts gain in depth behind corners that jut into the fluid (n_ghosts,)."""
    gain = np.ones(len(ghosts))
    for x, y, sharpness in CORNERS.get(domain, []):
        q = np.minimum(np.hypot(*(ghosts - (x, y)).T) / length, 2.0)
        gain = np.maximum(gain, 1.0 + most * sharpness * (1.0 - q / 2.0) ** 4 * (2.0 * q + 1.0))
    return gain


class WallSums:
    """The sums over all pairs of fluid and ghosts of a functional, which may have no walls."""

    def __init__(self, brute_force: type, functional: Functional, state: Array, time: float):
        self.functional, self.state, self.time = functional, state, time
        domain, discretization = functional.domain, functional.discretization
        ghosts = functional.ghosts
        self.walls = domain.ghosts(SPACING, 1) if ghosts is None else ghosts.walls
        common = (
            domain.lengths, domain.periodic, discretization.smoothing_length,
            discretization.particle_spacing,
        )  # fmt: skip
        self.fluid = brute_force(state[:2].T, *common)
        self.ghosts = brute_force(self.walls.position, *common)
        force = functional.body_force
        self.body_force = np.zeros_like(state[:2]).T if force is None else force(state[:2], time).T
        self.fluctuation, self.velocity = state[2], state[3:].T
        self.reference_density = functional.fluid.reference_density
        self.density = self.reference_density + self.fluctuation
        self.mass = self.reference_density * discretization.particle_spacing**2
        self.volume = self.mass / self.density
        offset = self.ghosts.offsets(self.fluid.position)
        self.distance = np.linalg.norm(offset, axis=2)
        direction = offset / self.distance[..., None]
        self.offset = offset
        self.gradient = self.fluid.kernel_slope(self.distance)[..., None] * direction
        self.mirrored = discretization.wall_kind == "mirrored"
        nearest = (0.35 if self.mirrored else 0.5) * discretization.particle_spacing
        from_wall, depth = distances(domain, self.fluid.position, self.walls.position)
        self.depth = depth
        self.no_slip, self.continuity = RULES[discretization.wall_kind]
        if self.continuity == "adjoint":
            most = 2.5 if self.mirrored else 3.0
            length = discretization.smoothing_length
            self.depth *= gains(domain, self.walls.position, length, most)
        self.from_wall = np.maximum(from_wall, nearest)

    def ghost_fields(self) -> GhostFields:
        offset = self.fluid.offsets(self.walls.position)
        kernel = self.fluid.kernel(np.linalg.norm(offset, axis=2))
        total = kernel.sum(axis=1, keepdims=True)
        weights = np.where(total > 0.0, kernel / np.where(total > 0.0, total, 1.0), 0.0)
        push = self.fluid.images(self.density[:, None] * self.body_force)
        head = np.einsum("gj,gjd,jd->g", weights, offset, push)
        stiffness = self.functional.fluid.sound_speed**2
        if self.mirrored:
            weights, head = self.fits(), np.zeros(len(head))
        fluctuation = weights @ self.fluid.images(self.fluctuation) + head / stiffness
        return GhostFields(
            weights=weights,
            fluctuation=fluctuation,
            velocity=self._ghost_velocity(weights @ self.fluid.images(self.velocity)),
            volume=self.mass / (self.reference_density + fluctuation),
        )

    def fits(self) -> Array:
        """The weights (n_ghosts, n_sources) of linear fits around mirror points in the fluid."""
        domain, ghost = self.functional.domain, self.walls.position
        length = self.functional.discretization.smoothing_length
        way = domain.on_wall(ghost) - ghost
        depth = np.linalg.norm(way, axis=1)
        inside = np.maximum(depth, length)
        for _ in range(9):
            mirror = ghost + (1.0 + inside / depth)[:, None] * way
            beyond = distances(domain, mirror, ghost)[0] <= 0.0
            inside[beyond] /= 2.0
        # Offsets point from sources to places.
        offset = -self.fluid.offsets(mirror)
        kernel = self.fluid.kernel(np.linalg.norm(offset, axis=2))
        out = np.zeros_like(kernel)
        for g, (w, o) in enumerate(zip(kernel, offset / length, strict=True)):
            if not w.any():
                continue
            out[g] = w / w.sum()
            if np.linalg.det(np.cov(o.T, aweights=w, bias=True)) > 1e-3:
                terms = np.hstack((np.ones((len(o), 1)), o)) * np.sqrt(w)[:, None]
                row = np.append(1.0, (ghost - mirror)[g] / length)
                out[g] = row @ np.linalg.pinv(terms) * np.sqrt(w)
        return out

    def _ghost_velocity(self, mean: Array) -> Array:
        """What ghosts have for all particles alike; where it is extrapolated, their wall's."""
        wall, normal = self.walls.velocity, self.walls.normal
        if self.no_slip == "linear":
            return wall
        if self.no_slip == "whole":
            return 2.0 * wall - mean
        out = []
        for u, w, (across_x, across_y) in zip(mean, wall, normal, strict=True):
            if w.any():
                out.append(w)
            elif across_x and across_y:
                out.append(-u)
            else:
                out.append([u[0], -u[1]] if across_x else [-u[0], u[1]])
        return np.array(out)

    def apart(self, ghosts: GhostFields) -> Array:
        """u_g - u_i (n_particles, n_sources, 2)."""
        apart = self.ghosts.images(ghosts.velocity)[None] - self.velocity[:, None]
        if self.no_slip != "linear":
            return apart
        return (1.0 + self.ghosts.images(self.depth) / self.from_wall[:, None])[..., None] * apart

    def divergence(self, ghosts: GhostFields) -> Array:
        """The ghosts' part of the velocity's divergence (n_particles,), without shifting."""
        volume = self.ghosts.images(ghosts.volume)
        reading = self.continuity
        if reading == "adjoint":
            support = np.einsum("igd,g->id", self.gradient, volume)
            offset = self.fluid.offsets(self.walls.position)
            distance = np.linalg.norm(offset, axis=2)
            # The gradient with respect to the fluid's place, which the offset points away from.
            towards = -self.fluid.kernel_slope(distance)[..., None] * offset / distance[..., None]
            carried = self.fluid.images(self.volume[:, None] * self.velocity)
            flux = np.einsum("gjd,jd->g", towards, carried)
            returned = (ghosts.volume * flux) @ ghosts.weights
            returned = returned.reshape(-1, len(self.volume)).sum(axis=0) / self.volume
            return -np.einsum("id,id->i", self.velocity, support) - returned
        apart = self.apart(ghosts)
        if reading == "normal":
            apart = apart * self.ghosts.images(self.walls.normal)[None]
        return np.einsum("igd,igd,g->i", apart, self.gradient, volume)

    def shifting_velocity(self) -> Array:
        """Eq. 2.13-2.14 over fluid and ghosts, before anything is held back."""
        functional = self.functional
        discretization, max_speed = functional.discretization, functional.fluid.max_speed
        if not discretization.shifting:
            return np.zeros_like(self.velocity)
        chi, printed = discretization.shifting_amplitude, discretization.shifting_as_printed
        scale = self.fluid.kernel(np.array(discretization.particle_spacing))
        ghost_volume = self.ghosts.images(self.ghost_fields().volume)
        total = np.zeros_like(self.velocity)
        _, distance, gradient = self.fluid.pairs()
        for r, slope, volume in (
            (distance, gradient, self.fluid.images(self.volume)),
            (self.distance, self.gradient, ghost_volume),
        ):
            w = self.fluid.kernel(r) / scale
            bracket = (1.0 + chi * w) ** 4 if printed else 1.0 + chi * w**4
            total += np.einsum("ij,ijd,j->id", bracket, slope, volume)
        raw = -2.0 * discretization.smoothing_length * max_speed * total
        speed = np.linalg.norm(raw, axis=1, keepdims=True)
        return raw * np.minimum(1.0, 0.5 * max_speed / np.maximum(speed, 1e-300))

    def held_back(self, shifting: Array, against: float = 1.0) -> Array:
        """What is left of shifting velocities beside walls, or of their push alone (against 0)."""
        if not self.functional.discretization.shifting:
            return shifting
        spacing = self.functional.discretization.particle_spacing
        out = shifting.copy()
        solids = np.array(SOLIDS.get(self.functional.domain, []))
        place = self.functional.domain.wrap(self.fluid.position)
        for i, (x, u) in enumerate(zip(place, self.velocity, strict=True)):
            for solid in solids:
                way = np.clip(x, solid[:2], solid[2:]) - x
                distance = np.linalg.norm(way) / spacing
                if 0.0 < distance < 1.5:
                    way /= np.linalg.norm(way)
                    towards = out[i] @ way
                    low, high = (0.1, 0.2) if self.mirrored else (0.25, 0.5)
                    pushed = max(towards, 0.0) * np.interp(distance, [high, 1.5], [0.0, 1.0])
                    back = (
                        against * max(u @ way, 0.0) * np.interp(distance, [low, high], [1.0, 0.0])
                    )
                    if towards > pushed - back:
                        out[i] += (pushed - back - towards) * way
        return out

    def friction(self, ghosts: GhostFields) -> Array:
        """The ghosts' part of the sum of viscous forces (n_particles, 2)."""
        volume, apart = self.ghosts.images(ghosts.volume), self.apart(ghosts)
        viscosity = self.functional.fluid.kinematic_viscosity
        if self.functional.discretization.viscosity == "pair":
            along = np.einsum("igd,igd->ig", apart, -self.offset) / self.distance**2
            return 8.0 * viscosity * np.einsum("ig,igd,g->id", along, self.gradient, volume)
        factor = -2.0 / (self.fluid.laplacian_moment(self.volume) + self.moment(ghosts))
        total = np.einsum("ig,igd,g->id", self.laplacian_pairs(), apart, volume)
        return -2.0 * viscosity * factor[:, None] * total

    def laplacian_pairs(self) -> Array:
        """The Laplacian's weights w F of ghosts (n_particles, n_sources)."""
        return self.fluid.laplacian_pairs(self.distance, self.fluid.kernel_slope(self.distance))

    def moment(self, ghosts: GhostFields) -> Array:
        """The ghosts' part of the Laplacian's second moment (n_particles,)."""
        return (self.distance**2 * self.laplacian_pairs()) @ self.ghosts.images(ghosts.volume)

    def damper(self, ghosts: GhostFields) -> tuple[Array, Array]:
        """-alpha rho0 c0 h D u at particles (n_particles,), and interpolated to ghosts."""
        discretization, fluid = self.functional.discretization, self.functional.fluid
        bulk = discretization.acoustic_damping * discretization.smoothing_length
        bulk *= fluid.reference_density * fluid.sound_speed
        divergence = self.fluid.divergence(self.velocity, self.volume) + self.divergence(ghosts)
        return -bulk * divergence, ghosts.weights @ self.fluid.images(-bulk * divergence)

    def rates(self, shifting: Array) -> tuple[Array, Array]:
        """Eq. 2.6-2.7 (n_particles,) and (n_particles, 2) with a given shifting velocity."""
        functional, ghosts = self.functional, self.ghost_fields()
        discretization, sound_speed = functional.discretization, functional.fluid.sound_speed
        volume, density, velocity = self.volume, self.density, self.velocity
        advective = discretization.shifting_transport == "advective"
        within = np.zeros_like(shifting) if advective else shifting
        terms = (velocity, volume, functional.fluid.kinematic_viscosity)
        if discretization.viscosity == "pair":
            friction = self.fluid.pair_friction(*terms)
        else:
            friction = self.fluid.laplacian_friction(*terms, self.moment(ghosts))
        diffusivity = (
            discretization.diffusion_coefficient * discretization.smoothing_length * sound_speed
        )
        ghost_volume = self.ghosts.images(ghosts.volume)
        ratio = (self.reference_density / density)[:, None]
        continuity = self.fluid.continuity(density, velocity, within, volume, diffusivity)
        continuity -= density * self.divergence(ghosts)
        own, theirs = self.damper(ghosts)
        own = own + sound_speed**2 * self.fluctuation
        theirs = theirs + sound_speed**2 * ghosts.fluctuation
        momentum = self.fluid.momentum(
            density, own, velocity, within, volume, self.reference_density, friction
        )
        both = own[:, None] + self.ghosts.images(theirs)[None]
        push = np.einsum("ig,igd,g->id", both, self.gradient, ghost_volume)
        momentum += -push / density[:, None] + ratio * self.friction(ghosts) + self.body_force
        # Ghosts don't shift: of each printed sum only the particle's own part is left.
        along = np.einsum("id,igd->ig", shifting, self.gradient)
        if advective:
            continuity += self.fluid.advected(density, shifting, volume)
            momentum += ratio * self.fluid.advected(velocity, shifting, volume)
        else:
            spread = along @ ghost_volume
            apart, carried = -spread, spread
            continuity += -density * apart + density * carried
            momentum += ratio * velocity * (carried - apart)[:, None]
        if discretization.fixed_volume:
            expansion = volume / density
            continuity = continuity - (expansion @ continuity) / expansion.sum()
        return continuity, momentum

    def check(self, tolerance: float = 1e-11) -> None:
        """Compare the functional's rates with the sums, whose terms cancel, by the largest."""
        state, transport = self.state, self.functional.discretization.shifting_transport
        rates = self.functional.evaluate(state[:2], state[2], state[3:], self.time)
        wanted = self.shifting_velocity()
        shifting = self.held_back(wanted)
        carrying = shifting if transport == "advective" else self.held_back(wanted, against=0.0)
        continuity, momentum = self.rates(carrying)
        for found, expected in (
            (rates.density, continuity),
            (rates.velocity.T, momentum),
            (rates.shifting_velocity.T, shifting),
        ):
            assert found.shape == expected.shape
            assert np.max(np.abs(found - expected)) <= tolerance * np.max(np.abs(expected))

    def advection(self) -> tuple[Array, Array]:
        """Eq. 3.5-3.6 over fluid and ghosts."""
        ghosts = self.ghost_fields()
        volume, density, velocity = self.volume, self.density, self.velocity
        ghost_volume = self.ghosts.images(ghosts.volume)
        apart = self.apart(ghosts)
        ghost_velocity = velocity[:, None] + apart
        ghost_density = self.reference_density + self.ghosts.images(ghosts.fluctuation)
        spread = np.einsum("igd,igd,g->i", apart, self.gradient, ghost_volume)
        fluxes = ghost_density[:, None] * ghost_velocity + (density[:, None] * velocity)[:, None]
        own = velocity[:, :, None] * velocity[:, None]
        outer = ghost_velocity[..., :, None] * ghost_velocity[..., None, :] + own[:, None]
        return (
            self.fluid.density_advection(density, velocity, volume)
            + np.einsum("igd,igd,g->i", fluxes, self.gradient, ghost_volume)
            - density * spread,
            self.fluid.velocity_advection(velocity, volume)
            + np.einsum("igde,ige,g->id", outer, self.gradient, ghost_volume)
            - velocity * spread[:, None],
        )


@pytest.fixture(scope="session")
def scenes() -> dict[str, Scene]:
    """Small scenes, by name."""
    return SCENES


@pytest.fixture(scope="session")
def wall_sums(brute_force: type) -> Callable[..., WallSums]:
    """The sums over all pairs, ghosts among them, of a functional at a state and a time."""

    return lambda functional, state, time=0.7: WallSums(brute_force, functional, state, time)
