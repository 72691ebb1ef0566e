"""Independent solutions of flows in three dimensions, to compare runs with.

The Taylor-Green vortex in a periodic cube (Brachet et al., J. Fluid Mech. 130, 1983) is solved by a
pseudo-spectral method with fourth-order time steps, viscosity being integrated exactly. Prints
times, kinetic energies over the speed's square, and rates of dissipation.

The cube under a lid with the velocity ((1 - (2x - 1)^14) (1 - (2z - 1)^14))^2, started from rest,
is solved by finite differences on a staggered grid with projection by cosine transforms, both of
second order. Prints u along y and v along x through the centre, over the lid's speed and side.

    python scripts/space_references.py vortex --reynolds 100 --times 1 2 --points 32
    python scripts/space_references.py cube --reynolds 100 --times 2 5 --points 36
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
Waves = NDArray[np.complex128]


class Vortex:
    """The Taylor-Green vortex in [0, 2 pi]^3 with speed one, by n^3 points."""

    def __init__(self, n: int, reynolds: float) -> None:
        self.n = n
        self.viscosity = 1.0 / reynolds
        whole = np.fft.fftfreq(n, 1.0 / n)
        half = np.arange(n // 2 + 1)
        self.wave = np.stack(np.meshgrid(whole, whole, half, indexing="ij"))
        self.square = np.sum(self.wave**2, axis=0)
        self.resolved = np.all(np.abs(self.wave) < n / 3.0, axis=0)
        x, y, z = np.meshgrid(*3 * (np.arange(n) * 2.0 * math.pi / n,), indexing="ij")
        u = np.sin(x) * np.cos(y) * np.cos(z)
        v = -np.cos(x) * np.sin(y) * np.cos(z)
        self.state = self.forward(np.stack((u, v, np.zeros_like(u))))

    def forward(self, fields: Array) -> Waves:
        """Return the Fourier coefficients of fields (n_fields, n, n, n)."""
        return np.asarray(fft.rfftn(fields, axes=(1, 2, 3)))

    def backward(self, waves: Waves) -> Array:
        """Return the fields (n_fields, n, n, n) of Fourier coefficients."""
        return np.asarray(fft.irfftn(waves, s=3 * (self.n,), axes=(1, 2, 3)))

    def _convection(self, state: Waves) -> tuple[Waves, Waves]:
        """Return u x curl u without its gradient, and the head p + u^2/2 of that gradient."""
        curl = self.backward(1j * np.cross(self.wave, state, axis=0))
        term = self.forward(np.cross(self.backward(state), curl, axis=0)) * self.resolved
        along = np.sum(self.wave * term, axis=0) / np.maximum(self.square, 1.0)
        return term - self.wave * along, -1j * along

    def step(self, dt: float) -> None:
        """Advance by a time step."""
        half = np.exp(-0.5 * self.viscosity * self.square * dt)
        start = self.state
        a = self._convection(start)[0]
        b = self._convection(half * (start + 0.5 * dt * a))[0]
        c = self._convection(half * start + 0.5 * dt * b)[0]
        d = self._convection(half * (half * start + dt * c))[0]
        self.state = half * (half * (start + dt / 6.0 * a) + dt / 3.0 * (b + c)) + dt / 6.0 * d

    def fields(self) -> tuple[Array, Array]:
        """Return the velocity (3, n, n, n) and the pressure (n, n, n) with mean zero."""
        velocity = self.backward(self.state)
        head = self.backward(self._convection(self.state)[1][None])[0]
        pressure = head - 0.5 * np.sum(velocity**2, axis=0)
        return velocity, pressure - pressure.mean()

    def energy(self) -> tuple[float, float]:
        """Return the mean kinetic energy and the mean rate of its dissipation."""
        energy = 0.5 * float(np.mean(np.sum(self.backward(self.state) ** 2, axis=0)))
        curl = self.backward(1j * np.cross(self.wave, self.state, axis=0))
        return energy, self.viscosity * float(np.mean(np.sum(curl**2, axis=0)))


def lid(x: Array, z: Array) -> Array:
    """Return the velocity of the lid over its speed."""
    return np.asarray(((1.0 - (2.0 * x - 1.0) ** 14) * (1.0 - (2.0 * z - 1.0) ** 14)) ** 2)


def middles(field: Array, axis: int) -> Array:
    """Return the means of neighbours along an axis."""
    count = field.shape[axis]
    later = np.take(field, range(1, count), axis)
    return np.asarray(0.5 * (later + np.take(field, range(count - 1), axis)))


class Cube:
    """The flow in a cube under its lid, on n^3 cells."""

    def __init__(self, n: int, reynolds: float) -> None:
        self.n = n
        self.viscosity = 1.0 / reynolds
        self.velocity = [np.zeros([n + (axis == a) for axis in range(3)]) for a in range(3)]
        self.centres = (np.arange(n) + 0.5) / n
        self.lid = lid(np.arange(n + 1)[:, None] / n, self.centres[None])
        second = (2.0 * np.cos(np.pi * np.arange(n) / n) - 2.0) * n**2
        self.laplacian = second[:, None, None] + second[:, None] + second
        self.laplacian[0, 0, 0] = 1.0

    def _continued(self, a: int, axis: int) -> Array:
        """Return component a with a layer beyond the walls at the ends of another axis."""
        field = self.velocity[a]
        first = -np.take(field, [0], axis)
        last = -np.take(field, [-1], axis)
        if (a, axis) == (0, 1):
            last += 2.0 * self.lid[:, None]
        return np.concatenate((first, field, last), axis)

    def _rates(self) -> list[Array]:
        """Return the accelerations of the faces within the cube."""
        rates = []
        for a, field in enumerate(self.velocity):
            inner = [slice(None)] * 3
            inner[a] = slice(1, -1)
            rate = self.viscosity * self.n**2 * np.diff(field, 2, axis=a)
            rate -= self.n * np.diff(middles(field, a) ** 2, axis=a)
            for axis in (other for other in range(3) if other != a):
                wide = self._continued(a, axis)
                rate += self.viscosity * self.n**2 * np.diff(wide, 2, axis=axis)[tuple(inner)]
                flux = middles(wide, axis) * middles(self._continued(axis, a), a)
                rate -= self.n * np.diff(flux, axis=axis)[tuple(inner)]
            rates.append(rate)
        return rates

    def _add(self, start: Sequence[Array], rates: Sequence[Array], dt: float) -> None:
        """Set the velocity to `start` + dt `rates`, without its divergence."""
        n = self.n
        for a in range(3):
            within = tuple(slice(1, -1) if axis == a else slice(None) for axis in range(3))
            self.velocity[a] = start[a].copy()
            self.velocity[a][within] += dt * rates[a]
        divergence = sum(n * np.diff(self.velocity[a], axis=a) for a in range(3))
        potential = fft.idctn(fft.dctn(divergence) / self.laplacian)
        for a in range(3):
            within = tuple(slice(1, -1) if axis == a else slice(None) for axis in range(3))
            self.velocity[a][within] -= n * np.diff(potential, axis=a)

    def advance(self, time: float) -> None:
        """Advance by a time."""
        longest = min(0.15 / (self.n**2 * self.viscosity), 0.5 / self.n)
        n_steps = math.ceil(time / longest)
        dt = time / n_steps
        for _ in range(n_steps):
            start = [field.copy() for field in self.velocity]
            first = self._rates()
            self._add(start, first, dt)
            both = [0.5 * (a + b) for a, b in zip(first, self._rates(), strict=True)]
            self._add(start, both, dt)

    def profiles(self, places: Array) -> tuple[Array, Array]:
        """Return u along y and v along x through the centre, for an even number of cells."""
        half = self.n // 2
        u = middles(self.velocity[0][half, :, half - 1 : half + 1], 1)[:, 0]
        v = middles(self.velocity[1][:, half, half - 1 : half + 1], 1)[:, 0]
        first = np.concatenate(([0.0], self.centres, [1.0]))
        lines = np.concatenate(([0.0], u, [1.0])), np.concatenate(([0.0], v, [0.0]))
        return CubicSpline(first, lines[0])(places), CubicSpline(first, lines[1])(places)


def vortex_lines(n: int, reynolds: float, times: Sequence[float], step: float) -> Iterator[str]:
    """Yield the lines of energies at times."""
    yield "time,energy,dissipation"
    flow = Vortex(n, reynolds)
    now = 0.0
    for time in times:
        n_steps = math.ceil((time - now) / step - 1e-9)
        for _ in range(n_steps):
            flow.step((time - now) / n_steps)
        now = time
        energy, dissipation = flow.energy()
        yield f"{time:g},{energy:.8f},{dissipation:.8f}"


def cube_lines(n: int, reynolds: float, times: Sequence[float]) -> Iterator[str]:
    """Yield the lines of profiles at times."""
    yield "time,axis,coord,value"
    flow = Cube(n, reynolds)
    places = np.linspace(0.05, 0.95, 19)
    now = 0.0
    for time in times:
        flow.advance(time - now)
        now = time
        u, v = flow.profiles(places)
        for axis, line in (("u_along_y", u), ("v_along_x", v)):
            for place, value in zip(places, line, strict=True):
                yield f"{time:g},{axis},{place:.2f},{value:.6f}"


def main() -> None:
    """Print the solution."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flow", choices=("vortex", "cube"))
    parser.add_argument("--reynolds", type=float, default=100.0)
    parser.add_argument("--times", type=float, nargs="+", default=[1.0, 2.0])
    parser.add_argument("--points", type=int, default=32, help="along each axis; even")
    parser.add_argument("--step", type=float, default=0.05, help="of the vortex")
    arguments = parser.parse_args()
    n, reynolds = arguments.points, arguments.reynolds
    if arguments.flow == "vortex":
        lines = vortex_lines(n, reynolds, arguments.times, arguments.step)
    else:
        lines = cube_lines(n, reynolds, arguments.times)
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main()
