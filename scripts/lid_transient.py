"""The lid-driven cavity started from rest, by a Legendre-Galerkin method, to compare runs with.

The stream function is a lift of the lid's velocity (1 - (2x - 1)^14)^2 and products of polynomials
that vanish at the walls with their derivatives (Shen, SIAM J. Sci. Comput. 15, 1994). Viscosity is
integrated exactly and convection by a fourth-order exponential scheme (Cox and Matthews, J. Comput.
Phys. 176, 2002), in the eigenvectors of the Stokes problem. Prints u along y and v along x through
the centre as CSV, over the lid's speed and side.

    python scripts/lid_transient.py --reynolds 200 --times 5 9 --modes 36
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import eigh

Array = NDArray[np.float64]

CONTOUR = 32
"""Points of the circle that coefficients are averaged over (Kassam and Trefethen 2005)."""
LID_DEGREE = 28
"""Of the lid's velocity as a polynomial."""


def clamped(n_modes: int, x: Array, derivative: int = 0) -> Array:
    """Return polynomials (n_points, n_modes) on [0, 1] that end at zero with zero slope."""
    columns = []
    for k in range(n_modes):
        series = np.zeros(k + 5)
        series[[k, k + 2, k + 4]] = 1.0, -2.0 * (2 * k + 5) / (2 * k + 7), (2 * k + 3) / (2 * k + 7)
        series /= np.sqrt(2.0 * (2 * k + 3) ** 2 * (2 * k + 5))
        told = legendre.legder(series, derivative) if derivative else series
        columns.append(2.0**derivative * legendre.legval(2.0 * x - 1.0, told))
    return np.stack(columns, axis=1)


def lift(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return u, v and the Laplacian of the lift g(x) y^2 (y - 1), (nx, ny)."""
    s = 2.0 * x - 1.0
    lid, slope = (1.0 - s**14) ** 2, -56.0 * s**13 * (1.0 - s**14)
    bend = -112.0 * (13.0 * s**12 - 27.0 * s**26)
    rise, rise_slope, rise_bend = y**2 * (y - 1.0), 3.0 * y**2 - 2.0 * y, 6.0 * y - 2.0
    laplacian = np.outer(bend, rise) + np.outer(lid, rise_bend)
    return np.outer(lid, rise_slope), -np.outer(slope, rise), laplacian


class Cavity:
    """The flow in a box at rest under a lid that moves from t = 0 on.

    States are coordinates in the eigenvectors of the Stokes problem.
    """

    def __init__(self, n_modes: int, viscosity: float) -> None:
        nodes, weights = legendre.leggauss((3 * (n_modes + LID_DEGREE)) // 2 + 4)
        x, w = 0.5 * (nodes + 1.0), 0.5 * weights
        self.n_modes, self.viscosity = n_modes, viscosity
        self.values = [clamped(n_modes, x, derivative) for derivative in range(3)]
        self.weights, self.lifted = np.outer(w, w), lift(x, x)
        flat, slope, bend = (v.T @ (w[:, None] * v) for v in self.values)
        inertia = np.kron(slope, flat) + np.kron(flat, slope)
        friction = np.kron(bend, flat) + np.kron(flat, bend) + 2.0 * np.kron(slope, slope)
        decay, self.vectors = eigh(friction, inertia)
        self.decay = viscosity * decay

    def start(self) -> Array:
        """Return the state at rest: the lift is made up for within the box."""
        u, v, _ = self.lifted
        return -self.vectors.T @ self._tested(u, v).ravel()

    def _tested(self, u: Array, v: Array) -> Array:
        """Return a velocity field times the curls of all products."""
        flat, slope, _ = self.values
        return flat.T @ (self.weights * u) @ slope - slope.T @ (self.weights * v) @ flat

    def convection(self, state: Array) -> Array:
        """Return what all but the viscosity of the products does to a state."""
        flat, slope, bend = self.values
        modes = (self.vectors @ state).reshape(self.n_modes, self.n_modes)
        u = self.lifted[0] + flat @ modes @ slope.T
        v = self.lifted[1] - slope @ modes @ flat.T
        laplacian = self.lifted[2] + bend @ modes @ flat.T + flat @ modes @ bend.T
        spun = self.weights * laplacian
        rate = slope.T @ (spun * u) @ flat + flat.T @ (spun * v) @ slope
        # The lift's own viscosity, tested with the Laplacians of the products.
        still = self.weights * self.lifted[2]
        rate += self.viscosity * (bend.T @ still @ flat + flat.T @ still @ bend)
        return -self.vectors.T @ rate.ravel()

    def integrate(self, end: float, n_steps: int, state: Array) -> Array:
        """Return the state after a time in so many steps."""
        step = end / n_steps
        z = -step * self.decay
        turns = np.exp(2j * np.pi * (np.arange(CONTOUR) + 0.5) / CONTOUR)
        r = z[:, None] + turns
        e = np.exp(r)
        full, half = np.exp(z), np.exp(0.5 * z)
        q = step * ((np.exp(0.5 * r) - 1.0) / r).mean(1).real
        a = step * ((-4.0 - r + e * (4.0 - 3.0 * r + r**2)) / r**3).mean(1).real
        b = step * ((2.0 + r + e * (r - 2.0)) / r**3).mean(1).real
        c = step * ((-4.0 - 3.0 * r - r**2 + e * (4.0 - r)) / r**3).mean(1).real
        for _ in range(n_steps):
            first = self.convection(state)
            one = half * state + q * first
            second = self.convection(one)
            two = half * state + q * second
            third = self.convection(two)
            three = half * one + q * (2.0 * third - first)
            fourth = self.convection(three)
            state = full * state + a * first + 2.0 * b * (second + third) + c * fourth
        return state

    def profiles(self, state: Array, places: Array) -> tuple[Array, Array]:
        """Return u along y and v along x through the centre."""
        modes = (self.vectors @ state).reshape(self.n_modes, self.n_modes)
        middle = np.array([0.5])
        (at,) = clamped(self.n_modes, middle)
        slope = clamped(self.n_modes, places, 1)
        u = lift(middle, places)[0][0] + slope @ (modes.T @ at)
        v = lift(places, middle)[1][:, 0] - slope @ (modes @ at)
        return u, v


def main() -> None:
    """Print the profiles."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--reynolds", type=float, default=100.0)
    parser.add_argument("--times", type=float, nargs="+", default=[1.0, 5.0])
    parser.add_argument("--modes", type=int, default=32, help="along each axis")
    parser.add_argument("--step", type=float, default=0.01)
    arguments = parser.parse_args()
    cavity = Cavity(arguments.modes, 1.0 / arguments.reynolds)
    places, state, now = np.linspace(0.0, 1.0, 101), cavity.start(), 0.0
    print("re,time,axis,coord,value")
    for time in arguments.times:
        n_steps = round((time - now) / arguments.step)
        state, now = cavity.integrate(time - now, n_steps, state), time
        for axis, line in zip(("u_along_y", "v_along_x"), cavity.profiles(state, places),
                              strict=True):  # fmt: skip
            for place, value in zip(places, line, strict=True):
                print(f"{arguments.reynolds:g},{time:.2f},{axis},{place:.4f},{value:.8f}")


if __name__ == "__main__":
    main()
