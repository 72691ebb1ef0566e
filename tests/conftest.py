"""What all tests share: sets of particles, and sums over all pairs to compare neighbour loops with.

`BruteForce` writes every sum as it is printed (Eq. 2.4-2.14, 3.5-3.6, 3.15), over all pairs and
all images, in plain numpy: nothing of it is regrouped, sorted or compiled.
"""

from __future__ import annotations

import importlib
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray
from typer.testing import CliRunner, Result

from sphrom.artifacts import reader
from sphrom.case.models import Case
from sphrom.reduction.mode_fields import mode_fields, mode_gradients, weighted_rows

Array = NDArray[np.float64]
SCRIPTS = str(Path(__file__).parents[1] / "scripts")

# A script's background jobs ignore it, and hand that on: tests have to be able to interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Beginning with them, no worker has a long file left when the others have finished.
LONGEST_FILES = (
    "documentation/test_tutorials.py",
    "verification/test_open_flows.py",
    "pipeline/test_gallery.py",
    "pipeline/test_sweep.py",
    "pipeline/test_train.py",
    "pipeline/test_surfaces.py",
)
"""Those that take longest, which `make test` and `make test-all` begin with."""

settings.register_profile("sphrom", deadline=None, derandomize=True, database=None)
settings.load_profile("sphrom")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files; the order is otherwise that of folders and files."""
    ranks = {Path(__file__).parent / file: rank for rank, file in enumerate(LONGEST_FILES)}
    assert all(path.exists() for path in ranks)
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


def scatter_particles(
    lower: tuple[float, float],
    spacing: float,
    shape: tuple[int, int],
    kind: str,
    seed: int = 0,
    amplitude: float = 1.0,
) -> Array:
    """Return a full state (5, nx ny): jittered or random positions, and rough random fields."""
    random = np.random.default_rng(seed)
    size = np.array(shape) * spacing
    if kind == "random":
        position = random.uniform(0.0, 1.0, (shape[0] * shape[1], 2)) * size
    else:
        axes = [(np.arange(n) + 0.5) * spacing for n in shape]
        position = np.stack([grid.ravel() for grid in np.meshgrid(*axes)], axis=1)
        position += 0.3 * spacing * random.uniform(-1.0, 1.0, position.shape)
    fields = amplitude * random.standard_normal((3, len(position)))
    return np.vstack(((position + np.array(lower)).T, fields))


@dataclass(frozen=True)
class BruteForce:
    """The sums over all pairs of a set of particles; indices i, j, then components."""

    position: Array
    """(n_particles, 2)."""
    lengths: tuple[float, float]
    periodic: tuple[bool, bool]
    smoothing_length: float
    spacing: float

    def kernel(self, distance: Array) -> Array:
        """W, from the C2 function of Wendland (1995) scaled to integrate to one."""
        q = np.minimum(distance / self.smoothing_length, 2.0)
        return 7.0 / (4.0 * np.pi * self.smoothing_length**2) * (1 - q / 2) ** 4 * (2 * q + 1)

    def kernel_slope(self, distance: Array) -> Array:
        """dW/dr."""
        h = self.smoothing_length
        q = np.minimum(distance / h, 2.0)
        by_q = -2 * (1 - q / 2) ** 3 * (2 * q + 1) + 2 * (1 - q / 2) ** 4
        return 7.0 / (4.0 * np.pi * h**2) * by_q / h

    def offsets(self, points: Array) -> Array:
        """x_i - x_j (n_points, 9 n_particles, 2): the nearest image and the eight around it."""
        nearest = points[:, None, :] - self.position[None, :, :]
        turns = [(-1, 0, 1) if periodic else (0,) for periodic in self.periodic]
        for axis in range(2):
            if self.periodic[axis]:
                length = self.lengths[axis]
                nearest[..., axis] -= length * np.round(nearest[..., axis] / length)
        shifts = [np.array(turn) * self.lengths for turn in itertools.product(*turns)]
        return np.concatenate([nearest + shift for shift in shifts], axis=1)

    def images(self, field: Array) -> Array:
        """f_j of every source of `offsets`."""
        n_images = int(np.prod([3 if periodic else 1 for periodic in self.periodic]))
        return np.concatenate([field] * n_images)

    def pairs(self) -> tuple[Array, Array, Array]:
        """x_i - x_j, their lengths, and the kernel's gradient with respect to x_i."""
        offset = self.offsets(self.position)
        distance = np.linalg.norm(offset, axis=2)
        direction = offset / np.where(distance > 0.0, distance, 1.0)[..., None]
        return offset, distance, self.kernel_slope(distance)[..., None] * direction

    def kernel_gradient_sum(self, volume: Array) -> Array:
        """The sum of the kernel's gradient times V_j (n_particles, 2)."""
        return np.einsum("ijd,j->id", self.pairs()[2], self.images(volume))

    def renormalization(self, volume: Array) -> Array:
        """L_i of Eq. 2.11 (n_particles, 2, 2)."""
        offset, _, gradient = self.pairs()
        return np.linalg.inv(np.einsum("ijd,ije,j->ide", -offset, gradient, self.images(volume)))

    def renormalised_gradient(self, field: Array, volume: Array) -> Array:
        """Eq. 2.11 (n_particles, 2)."""
        jump = self.images(field)[None, :] - field[:, None]
        plain = np.einsum("ij,ijd,j->id", jump, self.pairs()[2], self.images(volume))
        return np.einsum("ide,ie->id", self.renormalization(volume), plain)

    def diffusion(self, density: Array, volume: Array) -> Array:
        """Eq. 2.10 (n_particles,)."""
        offset, distance, gradient = self.pairs()
        slope = self.renormalised_gradient(density, volume)
        jump = self.images(density)[None, :] - density[:, None]
        mean = 0.5 * (self.images(slope)[None, :, :] + slope[:, None, :])
        rest = jump - np.einsum("ijd,ijd->ij", mean, -offset)
        along = np.einsum("ijd,ijd->ij", -offset, gradient)
        square = np.where(distance > 0.0, distance, 1.0) ** 2
        return 2.0 * np.einsum("ij,ij,j->i", rest, along / square, self.images(volume))

    def continuity(
        self, density: Array, velocity: Array, shifting: Array, volume: Array, diffusivity: float
    ) -> Array:
        """Eq. 2.6 (n_particles,), with `diffusivity` = delta h c0."""
        _, _, gradient = self.pairs()
        total = velocity + shifting
        apart = self.images(total)[None] - total[:, None]
        flux = density[:, None] * shifting
        carried = self.images(flux)[None] + flux[:, None]
        weights = self.images(volume)
        return (
            -density * np.einsum("ijd,ijd,j->i", apart, gradient, weights)
            + np.einsum("ijd,ijd,j->i", carried, gradient, weights)
            + diffusivity * self.diffusion(density, volume)
        )

    def carried(self, first: Array, second: Array, volume: Array) -> Array:
        """Sum (a_j outer b_j + a_i outer b_i) . grad W V_j (n_particles, 2)."""
        outer = first[:, :, None] * second[:, None, :]
        both = self.images(outer)[None] + outer[:, None]
        return np.einsum("ijde,ije,j->id", both, self.pairs()[2], self.images(volume))

    def divergence(self, velocity: Array, volume: Array) -> Array:
        """Sum (u_j - u_i) . grad W V_j (n_particles,)."""
        apart = self.images(velocity)[None] - velocity[:, None]
        return np.einsum("ijd,ijd,j->i", apart, self.pairs()[2], self.images(volume))

    def pair_friction(self, velocity: Array, volume: Array, viscosity: float) -> Array:
        """The sum over Eq. 2.12 in Eq. 2.7 (n_particles, 2), with `viscosity` = nu."""
        offset, distance, gradient = self.pairs()
        apart = self.images(velocity)[None] - velocity[:, None]
        square = np.where(distance > 0.0, distance, 1.0) ** 2
        pi = 2 * (2 + 2) * viscosity * np.einsum("ijd,ijd->ij", apart, -offset) / square
        return np.einsum("ij,ijd,j->id", pi, gradient, self.images(volume))

    def laplacian_pairs(self, distance: Array, slope: Array) -> Array:
        """w F, with w = 1 - 55/84 q^2 and the gradient F times the offset."""
        weight = 1.0 - 55.0 / 84.0 * (distance / self.smoothing_length) ** 2
        return weight * slope / np.where(distance > 0.0, distance, 1.0)

    def laplacian_moment(self, volume: Array) -> Array:
        """Sum r^2 w F V_j (n_particles,)."""
        distance = self.pairs()[1]
        pairs = self.laplacian_pairs(distance, self.kernel_slope(distance))
        return (distance**2 * pairs) @ self.images(volume)

    def laplacian_friction(
        self, velocity: Array, volume: Array, viscosity: float, beyond: Array | float = 0.0
    ) -> Array:
        """nu times the Laplacian -sum (c_i + c_j) (u_j - u_i) w F V_j (n_particles, 2).

        c = -2 / sum r^2 w F V, where `beyond` is what ghosts add to the sum.
        """
        factor = -2.0 / (self.laplacian_moment(volume) + beyond)
        distance = self.pairs()[1]
        both = factor[:, None] + self.images(factor)[None]
        along = both * self.laplacian_pairs(distance, self.kernel_slope(distance))
        apart = self.images(velocity)[None] - velocity[:, None]
        return -viscosity * np.einsum("ij,ijd,j->id", along, apart, self.images(volume))

    def advected(self, field: Array, shifting: Array, volume: Array) -> Array:
        """Sum (f_j - f_i) delta u_i . grad W V_j: (n_particles,), or (n_particles, 2)."""
        jump = self.images(field)[None] - field[:, None]
        along = np.einsum("id,ijd->ij", shifting, self.pairs()[2])
        return np.einsum("ij...,ij,j->i...", jump, along, self.images(volume))

    def momentum(
        self,
        density: Array,
        pressure: Array,
        velocity: Array,
        shifting: Array,
        volume: Array,
        reference_density: float,
        friction: Array,
    ) -> Array:
        """Eq. 2.7 (n_particles, 2), without body force, with its sum of friction."""
        gradient = self.pairs()[2]
        weights = self.images(volume)
        both = pressure[:, None] + self.images(pressure)[None]
        ratio = (reference_density / density)[:, None]
        return (
            -np.einsum("ij,ijd,j->id", both, gradient, weights) / density[:, None]
            + ratio * friction
            + ratio * self.carried(velocity, shifting, volume)
            - ratio * velocity * self.divergence(shifting, volume)[:, None]
        )

    def density_advection(self, density: Array, velocity: Array, volume: Array) -> Array:
        """Eq. 3.5 (n_particles,)."""
        flux = density[:, None] * velocity
        both = self.images(flux)[None] + flux[:, None]
        spread = np.einsum("ijd,ijd,j->i", both, self.pairs()[2], self.images(volume))
        return spread - density * self.divergence(velocity, volume)

    def velocity_advection(self, velocity: Array, volume: Array) -> Array:
        """Eq. 3.6 (n_particles, 2)."""
        divergence = self.divergence(velocity, volume)[:, None]
        return self.carried(velocity, velocity, volume) - velocity * divergence

    def shepard(self, points: Array, field: Array) -> Array:
        """Eq. 3.15 of one field at points (n_points, 2)."""
        weights = self.kernel(np.linalg.norm(self.offsets(points), axis=2)) * self.spacing**2
        return (weights @ self.images(field)) / weights.sum(axis=1)

    def moving_least_squares(self, points: Array, field: Array, n_terms: int = 6) -> Array:
        """The value of the weighted fit around each point, quadratic or of three linear terms."""
        offset = -self.offsets(points)
        weights = self.kernel(np.linalg.norm(offset, axis=2))
        values = self.images(field)
        fits = []
        for x, y, weight in zip(offset[..., 0], offset[..., 1], weights, strict=True):
            x, y = x / self.smoothing_length, y / self.smoothing_length
            terms = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y)[:n_terms], axis=1)
            near = weight > 0.0
            root = np.sqrt(weight[near] / weight.max())
            solved = np.linalg.lstsq(root[:, None] * terms[near], root * values[near], rcond=None)
            fits.append(solved[0][0])
        return np.array(fits)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Compute on one thread, whatever the tests before: more cost more on loops this small.

    Linear algebra too, as in commands: tests compare their bits with those of this process.
    """
    from sphrom.kernels.jit import set_threads
    from sphrom.machine import one_blas_thread

    set_threads(1)
    with one_blas_thread():
        yield


@pytest.fixture
def same_on_threads() -> Iterator[Callable[..., Any]]:
    """Return arrays of a function, after a check of their bits on one thread and on two."""
    from sphrom.kernels.jit import set_threads

    def compute(function: Callable[[], tuple[Array, ...]]) -> tuple[Array, ...]:
        set_threads(2)
        parallel = function()
        set_threads(1)
        serial = function()
        assert [each.tobytes() for each in parallel] == [each.tobytes() for each in serial]
        return serial

    yield compute
    set_threads(1)


@pytest.fixture(scope="session", autouse=True)
def fine_clock() -> Iterator[None]:
    """Take a file for settled soon, as the local disk's clock is fine: artifacts are just made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reader, "SETTLED", 0.1)
        yield


@pytest.fixture(scope="session")
def scatter() -> Callable[..., Array]:
    """A full state of scattered particles."""
    return scatter_particles


@pytest.fixture(scope="session")
def brute_force() -> type[BruteForce]:
    """The sums over all pairs."""
    return BruteForce


def rates_at_points(points, q, u, gradients, conditions, order=None) -> Array:
    """Return the rates (3, n_points) [m/s2] of q and of the velocity at fixed points, unprojected.

    Parameters
    ----------
    q, u : (n_points,) and (2, n_points) [m/s].
    gradients : (3, 2, n_points) of q and of the velocity by x and y [1/s].
    conditions : the viscosity [m2/s], the body force's amplitude, the walls' speed over the given
        one, and the factors of drives by parameter.
    order : of the expansion of rho0/rho, None for none.
    """
    conditions = {"amplitude": 0.0, "wall_speed": 1.0, **conditions}
    terms = points.terms(q[:, None], u[..., None])
    continuity = points.diffusion(q[:, None])[:, 0]
    continuity -= (points.sound_speed + q) * terms.divergence[:, 0]
    if points.fixed_volume:
        continuity -= continuity.mean()
    drag = np.zeros_like(u) if points.wall_friction is None else points.wall_friction
    force = np.zeros_like(u) if points.body_force is None else points.body_force
    for name, drive in points.drives.items():
        if drive.walls is not None:
            drag = drag + conditions["factors"][name] * points.friction_of(drive.walls.T)
        if drive.force is not None:
            force = force + conditions["factors"][name] * drive.force
    speed = conditions["wall_speed"] * (conditions["amplitude"] if points.walls_driven else 1.0)
    push = conditions["viscosity"] * (terms.laplacian[..., 0] + speed * drag)
    push -= points.sound_speed * terms.pressure_gradient[..., 0]
    share, own = q / points.sound_speed, conditions["amplitude"] * force
    head, more = points.head_push(own), points.head_push(own * share)
    if order is None:
        acceleration = (push + head + more) / (1.0 + share) + own
    elif order == 0:
        acceleration = push + head + own
    else:
        acceleration = (push + head) * (1.0 - share) + more + own
    if points.slowing_rate is not None:
        slowed = points.slowing_rate * u
        acceleration -= slowed + points.head_push(slowed)
    carried = np.einsum("dn,fdn->fn", u, gradients)
    return np.concatenate((continuity[None], acceleration)) - carried


@pytest.fixture(scope="session")
def point_rates() -> Callable[..., Array]:
    """The rates at fixed points."""
    return rates_at_points


class UnprojectedModel:
    """Rates that are evaluated at all fixed points for each state, to compare operators with.

    Parameters are those of `project_operators`; an order of None does not expand rho0/rho.
    """

    def __init__(self, points, basis, splines=None, *, order=None) -> None:
        self.points, self.basis, self.order = points, basis, order
        self._modes = mode_fields(basis, points)
        everywhere = slice(0, points.n_points)
        self._slopes = mode_gradients(points, self._modes, splines)(everywhere)
        self._weights = weighted_rows(basis, self._modes, everywhere)

    def _factors(self, coordinates: Array) -> Array:
        """Return the factors of the modes, and that of the constant part if there is one."""
        return np.append(coordinates, np.ones(self._modes.n_fields - self._modes.n_modes))

    def fields(self, coordinates: Array) -> tuple[Array, Array]:
        """Return q (n_points,) and the velocity (2, n_points) of coordinates (n_modes,) [m/s]."""
        factors = self._factors(coordinates)
        return self._modes.scaled_density @ factors, self._modes.velocity @ factors

    def full_rates(
        self, coordinates: Array, conditions: dict, change: Array | None = None
    ) -> Array:
        """Return the rates (3, n_points) [m/s2] of q and of the velocity, after a change."""
        slopes = self._slopes @ self._factors(coordinates)
        q, u = self.fields(coordinates)
        if change is not None:
            q, u = q + change[0], u + change[1:]
            slopes = slopes + np.stack([self.points.gradients(field) for field in change])
        return rates_at_points(self.points, q, u, slopes, conditions, self.order)

    def __call__(self, coordinates: Array, conditions: dict, change: Array | None = None) -> Array:
        """Return the rates (n_modes,) of the generalized coordinates."""
        rates = self.full_rates(coordinates, conditions, change)
        return np.einsum("mfn,fn->m", self._weights, rates)

    def memory(self, coordinates: Array, conditions: dict) -> Array:
        """Return Eq. 3.22's term (n_modes,); a quadratic's central difference is its derivative."""
        inside, modes = self(coordinates, conditions), self._modes
        n = modes.n_modes
        rest = self.full_rates(coordinates, conditions)
        rest[0] -= modes.scaled_density[:, :n] @ inside
        rest[1:] -= modes.velocity[..., :n] @ inside
        ahead, back = (self(coordinates, conditions, s * rest) for s in (1e-3, -1e-3))
        return (ahead - back) / 2e-3

    def residual(self, coordinates: Array, conditions: dict, rates: Array | None = None) -> float:
        """Return |R - Phi da/dt| of rates (n_modes,), by default the projected ones."""
        rates = self(coordinates, conditions) if rates is None else rates
        found = self.full_rates(coordinates, conditions)
        found[0] /= self._modes.density_ratio
        found[0] -= rates @ self.basis.density_modes
        found[1:] -= np.einsum("m,mnd->dn", rates, self.basis.velocity_modes)
        return float(np.sqrt(np.sum(self.basis.weights * found**2)))


@pytest.fixture(scope="session")
def unprojected() -> type[UnprojectedModel]:
    """The rates at all fixed points."""
    return UnprojectedModel


@pytest.fixture(scope="session")
def vtk_arrays() -> Callable[[Any], dict[str, np.ndarray]]:
    """The points and fields of what VTK read."""

    def read(data: Any) -> dict[str, np.ndarray]:
        from vtkmodules.util.numpy_support import vtk_to_numpy

        fields = data.GetPointData()
        found = {
            fields.GetArrayName(i): vtk_to_numpy(fields.GetArray(i)).copy()
            for i in range(fields.GetNumberOfArrays())
        }
        return {**found, "points": vtk_to_numpy(data.GetPoints().GetData()).copy()}

    return read


@pytest.fixture(scope="session")
def printed() -> Callable[..., str]:
    """What a process prints that runs some code, with arguments and environment variables."""

    def run(code: str, *arguments: object, **variables: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)], env={**os.environ, **variables},
            capture_output=True, text=True, check=True, timeout=600,
        )  # fmt: skip
        return done.stdout

    return run


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Import a program of the folder `scripts`."""
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser, started once; tests are skipped where there is none."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(SCRIPTS)
        programs = importlib.import_module("browser")
    if programs.PROGRAM is None:
        pytest.skip("no chromium is installed to open pages in")
    found = programs.Browser(tmp_path_factory.mktemp("browser"))
    yield found
    found.close()


def run_command(*arguments: object, code: int | None = None) -> Result:
    """Run a command within this process, to an exit code; what isn't one is raised."""
    from sphrom.cli.app import app

    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert code in (None, result.exit_code), result.output
    return result


@pytest.fixture(scope="session")
def sphrom() -> Callable[..., Result]:
    """Run a command."""
    return run_command


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A real disk of one megabyte, where this user may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1M", "tmpfs", str(folder)]
    try:
        mounted = (
            subprocess.run(mount, capture_output=True, check=False, timeout=30).returncode == 0
        )
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("this user may not mount a disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True, timeout=30)


Flow = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]
"""Velocity (N, 2) and pressure (N,) at positions (N, 2) and a time."""


class MadeUp:
    """A trajectory of particles that stay on a lattice, as stages read one."""

    def __init__(self, case: Case, flow: Flow, times: np.ndarray) -> None:
        position = case.scene.domain.fill(case.plan.particle_spacing)
        fields = [flow(position, float(time)) for time in times]
        pressure = np.array([p for _, p in fields])
        self._data = {
            "time": times,
            "position": np.repeat(position[None], len(times), axis=0),
            "velocity": np.array([u for u, _ in fields]),
            "pressure": pressure,
            "density_fluctuation": pressure / case.plan.sound_speed**2,
        }
        self._mass = case.fluid.reference_density * case.plan.particle_spacing**2

    def read(self, name: str) -> np.ndarray:
        return self._data[name]

    dataset = read

    def number(self, name: str) -> float:
        assert name == "mass"
        return self._mass

    def text(self, name: str) -> str:
        assert name == "status"
        return "complete"


@pytest.fixture(scope="session")
def made_up() -> type[MadeUp]:
    """Make a trajectory of a case, a flow and times."""
    return MadeUp


@pytest.fixture(scope="session")
def case_of() -> Callable[..., Case]:
    """Make a case of a kind of scene; sections may be given."""

    def make(kind: str, resolution: int = 40, **sections: Any) -> Case:
        scene = {"kind": kind, **sections.pop("scene", {})}
        discretization = {"resolution": resolution, **sections.pop("discretization", {})}
        return Case.model_validate(
            {"name": "made-up", "scene": scene, "discretization": discretization, **sections}
        )

    return make
