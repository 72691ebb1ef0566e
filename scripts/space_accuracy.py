"""Independent solutions of two flows in space, and the full model's errors against them.

- `taylor-green`: the vortex of Taylor and Green at unit speed in a periodic cube of side 2 pi, by a
  pseudo-spectral method (Fourier modes up to a third of the points, exact viscosity, Runge-Kutta).
- `cube`: the lid-driven cube of unit side and a regularised lid, by finite differences of second
  order on a staggered grid and a projection; two grids are extrapolated to h = 0.

With `--across` particles along the cube, the full model of the case that `sphrom case new` writes
runs too. Prints its errors, the time per particle and step and the memory, or else the solution as
CSV. Errors of the vortex are over the solution's norm, those of the cube over the lid's speed.

    python scripts/space_references.py taylor-green --across 32 --time 2
    python scripts/space_references.py cube --across 24 --time 5
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.setup import particles
from sphrom.sph.fluid import fluctuation_of, pressure_of
from sphrom.sph.packing import pack
from sphrom.sph.time_loop import runge_kutta_step

Array = NDArray[np.float64]

CASES = Path(__file__).resolve().parents[1] / "cases" / "new"
PERIOD = 2.0 * math.pi
SPECTRAL_STEP = 0.05
N_POINTS = 32
"""Of the spectral solution along the cube: at Re 100 the energy at t = 2 agrees with 48 points."""
GRIDS = (24, 36)
"""Cells along the cube of the two finite difference solutions."""
PLACES = np.linspace(0.05, 0.95, 19)
"""On the centre lines."""
LID_EXPONENT = 14
WRAP_EVERY = 10


class Vortex:
    """The vortex of Taylor and Green in Fourier space, with n_points along each axis."""

    def __init__(self, n_points: int, viscosity: float) -> None:
        self._shape = (n_points,) * 3
        along = np.fft.fftfreq(n_points, 1.0 / n_points)
        half = np.arange(n_points // 2 + 1.0)
        self._wave = np.stack(np.meshgrid(along, along, half, indexing="ij"))
        self._square = np.sum(self._wave**2, axis=0)
        self._inverse = 1.0 / np.where(self._square == 0.0, 1.0, self._square)
        self._kept = (np.abs(self._wave) < n_points / 3.0).all(axis=0)
        self._viscosity = viscosity
        x, y, z = np.meshgrid(*[np.arange(n_points) * PERIOD / n_points] * 3, indexing="ij")
        u = np.sin(x) * np.cos(y) * np.cos(z)
        v = -np.cos(x) * np.sin(y) * np.cos(z)
        self.modes = self._forward(np.stack((u, v, np.zeros_like(u))))

    def _forward(self, fields: Array) -> NDArray[np.complex128]:
        return np.fft.rfftn(fields, axes=(1, 2, 3))

    def _back(self, modes: NDArray[np.complex128]) -> Array:
        return np.fft.irfftn(modes, s=self._shape, axes=(1, 2, 3))

    def _lamb(self, modes: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the modes of u x (curl u)."""
        vorticity = self._back(1j * np.cross(self._wave, modes, axis=0))
        return self._forward(np.cross(self._back(modes), vorticity, axis=0)) * self._kept

    def _rates(self, modes: NDArray[np.complex128]) -> NDArray[np.complex128]:
        lamb = self._lamb(modes)
        return lamb - self._wave * (np.sum(self._wave * lamb, axis=0) * self._inverse)

    def advance(self, until: float) -> None:
        """Integrate the modes over a time, with viscosity as an integrating factor."""
        n_steps = math.ceil(until / SPECTRAL_STEP - 1e-9)
        step = until / n_steps
        half = np.exp(-0.5 * step * self._viscosity * self._square)
        for _ in range(n_steps):
            a = self._rates(self.modes)
            b = self._rates(half * (self.modes + 0.5 * step * a))
            c = self._rates(half * self.modes + 0.5 * step * b)
            d = self._rates(half * (half * self.modes + step * c))
            sums = half * (half * a + 2.0 * (b + c)) + d
            self.modes = half * half * self.modes + step / 6.0 * sums

    @property
    def velocity(self) -> Array:
        """(3, n_points, n_points, n_points)."""
        return self._back(self.modes)

    @property
    def energy(self) -> float:
        """The mean kinetic energy over the density."""
        return 0.5 * float(np.mean(np.sum(self.velocity**2, axis=0)))

    @property
    def pressure(self) -> Array:
        """Over the density, with zero mean."""
        total = np.sum(self._wave * self._lamb(self.modes), axis=0) * self._inverse
        found = self._back(-1j * total[None])[0] - 0.5 * np.sum(self.velocity**2, axis=0)
        return found - found.mean()

    def at(self, position: Array) -> tuple[Array, Array]:
        """Return the velocity (3, n) and the pressure (n,) at positions (3, n), by splines."""
        place = position / PERIOD * self._shape[0]
        fields = (*self.velocity, self.pressure)
        *velocity, pressure = (map_coordinates(f, place, mode="grid-wrap") for f in fields)
        return np.stack(velocity), pressure - pressure.mean()


def between(values: Array, axis: int) -> Array:
    """Return the means of neighbours along an axis."""
    low = [slice(None)] * 3
    low[axis] = slice(None, -1)
    high = [slice(None)] * 3
    high[axis] = slice(1, None)
    return 0.5 * (values[tuple(low)] + values[tuple(high)])


@dataclass
class Cube:
    """The lid-driven cube on n_cells along each axis; the lid at the upper end of y moves along x.

    Component d of the velocity is on the faces perpendicular to axis d, with the walls' included.
    """

    n_cells: int
    viscosity: float

    def __post_init__(self) -> None:
        n = self.n_cells
        self.faces = [np.zeros([n + (axis == d) for axis in range(3)]) for d in range(3)]
        centre = (np.arange(n) + 0.5) / n
        rim = [(1.0 - (2.0 * x - 1.0) ** LID_EXPONENT) ** 2 for x in (np.arange(n + 1) / n, centre)]
        self._lid = rim[0][:, None, None] * rim[1][None, None, :]
        second = (2.0 * np.cos(np.pi * np.arange(n) / n) - 2.0) * n**2
        self._laplacian = second[:, None, None] + second[:, None] + second
        self._laplacian[0, 0, 0] = 1.0

    def _beyond(self, component: int, axis: int) -> Array:
        """Return a component with values beyond the walls of another axis, for no slip."""
        inside = self.faces[component]
        lid = self._lid if (component, axis) == (0, 1) else 0.0
        low = -np.take(inside, [0], axis)
        high = 2.0 * lid - np.take(inside, [-1], axis)
        return np.concatenate((low, inside, high), axis)

    def rates(self) -> list[Array]:
        """Return viscosity less convection at all faces; those on walls are not used."""
        n = self.n_cells
        out = []
        for d in range(3):
            rate = np.zeros_like(self.faces[d])
            inner = tuple(slice(1, -1) if axis == d else slice(None) for axis in range(3))
            for axis in range(3):
                if axis == d:
                    field = self.faces[d]
                    flux = np.diff(between(field, d) ** 2, axis=d)
                    bend = np.diff(field, 2, axis=d)
                else:
                    field = self._beyond(d, axis)
                    carrier = between(self._beyond(axis, d), d)
                    flux = np.diff(between(field, axis) * carrier, axis=axis)[inner]
                    bend = np.diff(field, 2, axis=axis)[inner]
                rate[inner] += self.viscosity * n**2 * bend - n * flux
            out.append(rate)
        return out

    def project(self) -> None:
        """Remove the divergence, with cosine transforms."""
        n = self.n_cells
        divergence = sum(n * np.diff(face, axis=d) for d, face in enumerate(self.faces))
        potential = idctn(dctn(divergence, type=2) / self._laplacian, type=2)
        for d, face in enumerate(self.faces):
            inner = tuple(slice(1, -1) if axis == d else slice(None) for axis in range(3))
            face[inner] -= n * np.diff(potential, axis=d)

    def advance(self, until: float) -> None:
        """Integrate over a time by Heun's method."""
        n = self.n_cells
        n_steps = math.ceil(until / min(0.15 / (self.viscosity * n**2), 0.5 / n))
        step = until / n_steps
        for _ in range(n_steps):
            before = [face.copy() for face in self.faces]
            first = self.rates()
            for face, rate in zip(self.faces, first, strict=True):
                face += step * rate
            self.project()
            second = self.rates()
            for d in range(3):
                self.faces[d] = before[d] + 0.5 * step * (first[d] + second[d])
            self.project()

    def lines(self) -> Array:
        """Return u along y and v along x (2, n_places) through the centre."""
        c = self.n_cells // 2
        centre = (np.arange(self.n_cells) + 0.5) / self.n_cells
        u, v, _ = self.faces
        along = (u[c, :, c - 1 : c + 1].mean(axis=1), v[:, c, c - 1 : c + 1].mean(axis=1))
        return np.stack([CubicSpline(centre, values)(PLACES) for values in along])


def cube_lines(viscosity: float, until: float) -> tuple[Array, float]:
    """Return `Cube.lines` extrapolated from two grids, and the largest change that this makes."""
    found = []
    for n_cells in GRIDS:
        cube = Cube(n_cells, viscosity)
        cube.advance(until)
        found.append(cube.lines())
    coarse, fine = found
    change = (fine - coarse) / ((GRIDS[1] / GRIDS[0]) ** 2 - 1.0)
    return fine + change, float(np.abs(change).max())


def run(name: str, across: int, reynolds: float, until: float) -> tuple[Case, Array, str]:
    """Run the full model; return its case, its last state (7, n_particles), and its cost."""
    settings = [
        f"discretization.resolution={across}",
        f"parameters.train.reynolds=[{reynolds}]",
        "parameters.test.reynolds=[]",
        f"time.final_time={until}",
        "snapshots.every=1",
    ]
    case = load_case(CASES / f"{name}.yaml", settings, True)
    plan = case.plan
    point = plan.points[0]
    flow = plan.flow(point)
    position = case.scene.fill(plan.particle_spacing)
    if plan.packed:
        position = pack(flow.domain, plan.discretization).position
    density = fluctuation_of(flow.initial_pressure(position), plan.sound_speed)
    state = np.vstack((position.T, density, flow.initial_velocity(position).T))
    functional = particles.functional(case, point)
    functional(state)
    step = plan.steps.time_step
    began = time.process_time()
    for k in range(plan.steps.n_steps):
        state = runge_kutta_step(functional, state, k * step, step)
        if k % WRAP_EVERY == WRAP_EVERY - 1:
            state = functional.wrapped(state)
    spent = 1e6 * (time.process_time() - began) / (plan.steps.n_steps * len(position))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    mean = state[3].mean() / case.fluid.reference_density
    cost = f"{plan.steps.n_steps} steps, {spent:.1f} us per particle and step, {memory:.0f} MB"
    return case, state, f"{cost}, mean density {100 * mean:+.4f} %"


def taylor_green(across: int | None, reynolds: float, until: float) -> None:
    """Print the solution, or the errors of the full model."""
    vortex = Vortex(N_POINTS, 1.0 / reynolds)
    vortex.advance(until)
    if across is None:
        print(f"time,energy\n{until:g},{vortex.energy:.8f}")
        return
    case, state, cost = run("taylor-green-3d", across, reynolds, until)
    velocity, pressure = vortex.at(case.scene.domain.wrap(state[:3].T).T)
    energy = 0.5 * np.mean(np.sum(state[4:] ** 2, axis=0)) / vortex.energy - 1.0
    found = pressure_of(state[3], case.plan.sound_speed) / case.fluid.reference_density
    found -= found.mean()
    errors = (
        np.linalg.norm(state[4:] - velocity) / np.linalg.norm(velocity),
        np.linalg.norm(found - pressure) / np.linalg.norm(pressure),
    )
    print(f"energy {100 * energy:+.3f} %, velocity {100 * errors[0]:.2f} %", end=", ")
    print(f"pressure {100 * errors[1]:.1f} %; {cost}")


def lid_driven_cube(across: int | None, reynolds: float, until: float) -> None:
    """Print the solution on the centre lines, or the errors of the full model there."""
    lines, change = cube_lines(1.0 / reynolds, until)
    if across is None:
        print("place,u_along_y,v_along_x")
        for row in zip(PLACES, *lines, strict=True):
            print("{:.2f},{:.5f},{:.5f}".format(*row))
        return
    case, state, cost = run("lid-driven-cube", across, reynolds, until)
    middle = np.full_like(PLACES, 0.5)
    for component, along in ((0, 1), (1, 0)):
        places = np.stack((middle, middle, middle), axis=1)
        places[:, along] = PLACES
        sample = particles.sampler(case, places)
        _, velocity = sample(state[:3].T, state[3], state[4:].T)
        error = velocity[:, component] - lines[component]
        print(
            f"{'uvw'[component]} along {'xyz'[along]}: largest {np.abs(error).max():.4f}", end=", "
        )
        print(f"root mean square {math.sqrt(np.mean(error**2)):.4f}")
    print(f"extrapolation {change:.4f}; {cost}")


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flow", choices=("taylor-green", "cube"))
    parser.add_argument("--across", type=int)
    parser.add_argument("--reynolds", type=float, default=100.0)
    parser.add_argument("--time", type=float, default=2.0)
    arguments = parser.parse_args()
    show = taylor_green if arguments.flow == "taylor-green" else lid_driven_cube
    show(arguments.across, arguments.reynolds, arguments.time)


if __name__ == "__main__":
    main()
