"""Flows past walls that no lattice fits, by particles that move, against what is known of them.

- `array`: slow flow through a square array of cylinders, a fifth of it solid, that a body force
  drives. Of the pressure gradient over the whole cell, F / (mu U) is 51.53 (Sangani and Acrivos
  1982); of the force on the fluid alone it is 0.8 of that.
- `cylinders`: between a cylinder that turns and one at rest, u = A r + B / r.
- `poiseuille`, `couette`: fluid from rest in a channel at an angle to the lattice that particles
  start from, against the exact series.

Prints what is measured from time to time.

    python scripts/wall_flows.py array --across 12
    python scripts/wall_flows.py cylinders --across 50
    python scripts/wall_flows.py poiseuille --across 40 --angle 30
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from sphrom.sph.fluid import Discretization, Fluid, step_limits
from sphrom.sph.functional import Functional
from sphrom.sph.packing import pack
from sphrom.sph.polygon_domain import PolygonDomain
from sphrom.sph.polygons import disc
from sphrom.sph.time_loop import runge_kutta_step

Array = NDArray[np.float64]
Report = Callable[[Functional, Array, float], str]

PERTURBATION = 0.3
N_REPORTS = 8
DRAG = 51.53
SHARE = 0.2
INNER, OUTER = 0.5, 1.0
SWIRL, VORTEX = -1.0 / 3.0, 1.0 / 3.0
SOLID_LAYERS = 10


@dataclass(frozen=True)
class Flow:
    """What is run, and what is measured."""

    domain: PolygonDomain
    spacing: float
    fluid: Fluid
    end: float
    """[s]."""
    report: Report
    wall_velocity: Callable[[Array], Array] = np.zeros_like
    force: tuple[float, float] = (0.0, 0.0)
    start: Callable[[Array], Array] = np.zeros_like
    """The velocity (n, 2) at positions (n, 2)."""


def run(flow: Flow) -> None:
    """Run a flow, and print what is measured."""
    discretization = Discretization(
        flow.spacing, 2.0 * flow.spacing, acoustic_damping=1.0, fixed_volume=True
    )
    domain = flow.domain
    walls = domain.ghosts(flow.spacing, discretization.n_layers).moving(flow.wall_velocity)
    position = pack(
        domain, discretization, ghosts=walls.position, perturbation=PERTURBATION, tolerance=3e-4
    ).position
    print(f"{len(position)} particles, {len(walls.position)} ghosts", flush=True)
    force = np.array(flow.force)[:, None]
    functional = Functional(
        flow.fluid, discretization, domain, walls, lambda x, time: np.tile(force, x.shape[1])
    )
    limits = step_limits(flow.fluid, discretization, has_walls=True)
    n_steps = math.ceil(flow.end / min(limits.acoustic, limits.viscous))
    step = flow.end / n_steps
    state = np.zeros((5, len(position)))
    state[:2], state[3:] = position.T, flow.start(position).T
    for k in range(1, n_steps + 1):
        state = runge_kutta_step(functional, state, (k - 1) * step, step)
        if k % max(1, n_steps // N_REPORTS) == 0:
            found = flow.report(functional, state, k * step)
            print(f"{k:6d}  {k * step:8.4f} s  {found}", flush=True)


def array_of_cylinders(per_radius: int) -> Flow:
    """Return the flow through a square array, whose side is 1 m."""
    radius, viscosity, mean = math.sqrt(SHARE / math.pi), 1.0, 2.0
    spacing = radius / per_radius
    spacing = 1.0 / round(1.0 / spacing)
    push = mean * viscosity * DRAG
    domain = PolygonDomain(
        (0.0, 0.0), (1.0, 1.0), (True, True), (("cylinder", disc((0.513, 0.471), radius)),)
    )

    def report(functional: Functional, state: Array, time: float) -> str:
        found = state[3].sum() * spacing**2
        force = functional.ghost_forces(state, time).sum(axis=(0, 2))
        driven, held = (f / (viscosity * found * DRAG) - 1.0 for f in (push, force[0] / 0.8))
        return f"F/(mu U): {100 * driven:+.2f} %, from the cylinder {100 * held:+.2f} %"

    fluid = Fluid(1.0, 26.0 * mean, viscosity, 2.6 * mean)
    return Flow(domain, spacing, fluid, 0.3 / viscosity, report, force=(push, 0.0))


def cylinders(across: int) -> Flow:
    """Return the flow between a cylinder that turns at 1 rad/s and one at rest."""
    viscosity = 0.0073
    around = shapely.difference(shapely.box(-2, -2, 2, 2), disc((0, 0), OUTER))
    solids = ("inner", disc((0, 0), INNER)), ("outer", around)
    domain = PolygonDomain((-1.1, -1.1), (1.1, 1.1), (False, False), solids)
    inner = domain.wall_names.index("inner")

    def wall_velocity(place: Array) -> Array:
        x, y = domain.on_wall(place).T
        return (domain.nearest_wall(place) == inner)[:, None] * np.stack((-y, x), axis=1)

    def exact(place: Array) -> Array:
        turned = np.stack((-place[:, 1], place[:, 0]), axis=1)
        return turned * (SWIRL + VORTEX / np.sum(place**2, axis=1))[:, None]

    def report(functional: Functional, state: Array, time: float) -> str:
        place, walls = state[:2].T, functional.ghosts.walls
        error = state[3:].T - exact(place)
        x, y = domain.on_wall(walls.position).T
        force = functional.ghost_forces(state, time).sum(axis=0)
        torque = np.bincount(walls.wall, x * force[1] - y * force[0])
        torque[inner] -= 2.0 * math.pi * viscosity * INNER**2
        share = torque[[inner, inner + 1]] / (4.0 * math.pi * viscosity * VORTEX)
        ring = np.floor(np.hypot(*place.T) * across / INNER).astype(int)
        along = np.sum(error * np.stack((-place[:, 1], place[:, 0]), axis=1), axis=1)
        rings = np.bincount(ring, along / np.hypot(*place.T)) / np.maximum(np.bincount(ring), 1)
        return (
            f"error over the largest speed: {100 * np.hypot(*error.T).max() / INNER:.3f} % at any "
            f"particle, {100 * np.abs(rings).max() / INNER:.3f} % at any radius; torque "
            f"{100 * (-share[0] - 1):+.2f} % inside, {100 * (share[1] - 1):+.2f} % outside"
        )

    fluid = Fluid(1.0, 10.0 * INNER, viscosity, INNER)
    return Flow(domain, INNER / across, fluid, 0.08 / viscosity, report, wall_velocity, start=exact)


def channel(across: int, angle: float, driven: bool) -> Flow:
    """Return the flow in a channel 1 m wide at an angle [degrees], by a force or by one wall."""
    turn, viscosity, solid = math.radians(angle), 1.0 / 30.0, SOLID_LAYERS / across
    period = (1.0 + solid) / math.cos(turn)
    width = period / math.tan(turn) if angle else 16.0 / across
    along = np.array((math.cos(turn), math.sin(turn)))
    normal = np.array((-along[1], along[0]))

    def band(low: float, high: float) -> shapely.Polygon:
        ends = np.array([[-4.0], [4.0]]) * along
        return shapely.Polygon([*(ends + low * normal), *(ends[::-1] + high * normal)])

    solids = ("floor", band(-0.5 * solid, 0.0)), ("lid", band(-solid, -0.5 * solid))
    domain = PolygonDomain((0.0, 0.0), (width, period), (True, True), solids)
    force, lid = (8.0 * viscosity, 0.0) if driven else (0.0, 1.0)

    def report(functional: Functional, state: Array, time: float) -> str:
        height = np.mod(domain.wrap(state[:2].T) @ normal, 1.0 + solid)
        error = state[3:].T - np.outer(series(height, viscosity, time, force, lid), along)
        largest = 100 * np.hypot(*error.T).max()
        return f"error over the largest speed: {largest:.3f} % at any particle"

    return Flow(
        domain,
        1.0 / across,
        Fluid(1.0, 10.0, viscosity, 1.0),
        0.3 / viscosity,
        report,
        lambda place: lid * np.outer(domain.nearest_wall(place) == 1, along),
        force=tuple(force * along),
    )


def series(height: Array, viscosity: float, time: float, force: float, lid: float) -> Array:
    """Return the exact velocity (n,) at heights (n,), a time after fluid was at rest."""
    number = np.arange(1, 400)[:, None]
    wave = number * math.pi
    decay = np.exp(-(wave**2) * viscosity * time)
    sign = (-1.0) ** number
    shapes = np.sin(wave * height) * decay
    driven = 0.5 * height * (1.0 - height) - np.sum(2.0 * (1.0 - sign) / wave**3 * shapes, axis=0)
    return force / viscosity * driven + lid * (height + np.sum(2.0 * sign / wave * shapes, axis=0))


def main() -> None:
    """Read the arguments, and run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flow", choices=("array", "cylinders", "poiseuille", "couette"))
    parser.add_argument("--across", type=int, default=20, help="particles per radius, or across")
    parser.add_argument("--angle", type=float, default=30.0, help="of a channel [degrees]")
    given = parser.parse_args()
    if given.flow == "array":
        run(array_of_cylinders(given.across))
    elif given.flow == "cylinders":
        run(cylinders(given.across))
    else:
        run(channel(given.across, given.angle, given.flow == "poiseuille"))


if __name__ == "__main__":
    main()
