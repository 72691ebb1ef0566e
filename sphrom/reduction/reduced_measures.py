"""Forces on walls, flow rates and fields at places, in generalized coordinates: projected once.

At fixed points the force on a wall is linear in the state (`sphrom.sph.fixed_points`), so that

    F = P z + nu (V z + s w) + beta(t) B z + (C + (nu / nu_mean - 1) C') y

with the terms z = (1, mean of the density fluctuation that is carried apart, coordinates), the
kinematic viscosity nu, the walls' speed s over the given one, and the amplitude beta of the body
force. C and C' correct it, where it is calibrated, with y = (1, s, beta, coordinates). No field is
rebuilt. Rows are the components of the force, then the torque. An interpolation from the reference
points is linear in the state too: flow rates and fields at places are products of constant arrays
with z.

Forces are calibrated with those that training runs recorded. The force that particles feel differs
from that of the same fields at fixed points: particles beside a wall move closer to it and lose
their order, and their pressures follow how they are arranged, which a map smooths. It is a tenth of
a cylinder's drag at 5 spacings per radius. And a reduced run lies apart from the states that its
basis would represent best. Both are alike in all runs of one flow. A small correction makes up for
them, affine in the kinematic viscosity as that of the rates is (`sphrom.reduction.calibration`).
Each component of the pressure's and of the viscous force is fitted by ridge regression, each term
over its root mean square. The projected force is the prior: it stays as it is where it is better in
snapshots that the fit has not seen. Those are the runs whose viscosity lies between others', each
left out in turn; where there is none, every fourth snapshot of all runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.declaration import Record, dataset, part
from sphrom.metrics.measures import Quantities
from sphrom.reduction.reduced_operators import FORCE, VALUE, VISCOSITY, WALLS, with_drives
from sphrom.reduction.trial_basis import TrialBasis, reconstruct
from sphrom.sph.fluid import Factors

N_OTHER_TERMS = 2
"""Terms before the coordinates."""
_LOADS = "N/m, N of the torque, of the terms"


@dataclass(frozen=True)
class ForceCorrection:
    """What is added to a force, by viscosity."""

    mean: Array
    """C (2, 3, n_terms) of the pressure's and the viscous part [N/m, N], at the mean viscosity."""
    slope: Array
    """C' likewise."""
    mean_viscosity: float
    """nu_mean [m2/s]."""

    def at(self, kinematic_viscosity: float) -> Array:
        """Return what is multiplied with y (2, 3, n_terms), at a viscosity [m2/s]."""
        return self.mean + (kinematic_viscosity / self.mean_viscosity - 1.0) * self.slope


class DriveForce(Record):
    """The force and the torque that one parameter gives by walls and by the body force."""

    walls: Array | None = dataset(
        "load", _LOADS + WALLS + VALUE, "by walls that move", default=None
    )
    force: Array | None = dataset(
        "load term", _LOADS + FORCE + VALUE, "by the heads of the body force", default=None
    )


class ReducedForce(Record):
    """The force along x and y [N/m] and the torque [N] on a wall, linear in the coordinates.

    Terms are one, the mean of the density fluctuation that is carried apart, and the coordinates.
    """

    pressure: Array = dataset("load term", _LOADS, "by the pressure", "P")
    viscous: Array = dataset("load term", _LOADS + VISCOSITY, "by the viscosity", "V")
    walls: Array = dataset("load", _LOADS + WALLS, "by walls that move", "w")
    body_force: Array | None = dataset(
        "load term", _LOADS + FORCE, "by the heads of the body force at walls", "B", default=None
    )
    drives: Mapping[str, DriveForce] = part(default_factory=dict)
    correction: ForceCorrection | None = None
    """C and C'; None where it isn't calibrated."""

    def of_modes(self, modes: NDArray[np.int64]) -> ReducedForce:
        """Return the force in the coordinates of some modes, not calibrated."""
        kept = _kept_terms(modes)
        return self.mapped(lambda terms: terms if terms.ndim == 1 else terms[:, kept])

    def with_drives(self, factors: Factors) -> ReducedForce:
        """Return the force at values of the parameters that drive the flow."""
        return replace(
            self,
            walls=with_drives(self.walls, self.drives, "walls", factors),
            body_force=with_drives(self.body_force, self.drives, "force", factors),
            drives={},
        )

    def at(
        self,
        coordinates: Array,
        mean_density_fluctuation: Array | float,
        kinematic_viscosity: float,
        wall_speed: Array | float = 1.0,
        amplitude: Array | float = 0.0,
    ) -> Array:
        """Return the pressure's and the viscous force and torque (n_states, 2, 3) [N/m, N].

        Parameters
        ----------
        coordinates : (n_states, n_modes).
        mean_density_fluctuation, wall_speed, amplitude : (n_states,) or one for all.
        """
        n_states, n_modes = coordinates.shape
        linear, speed, beta = slice(2, 2 + n_modes), 2 + n_modes, 3 + n_modes
        # One product of all terms: of short runs, calls take longer than the sums.
        terms = np.ones((n_states, 5 + 2 * n_modes))
        terms[:, 1] = mean_density_fluctuation
        terms[:, linear] = coordinates
        terms[:, speed], terms[:, beta] = wall_speed, amplitude
        np.multiply(terms[:, 1:speed], terms[:, beta, None], out=terms[:, beta + 1 :])
        return (terms @ self._matrix(kinematic_viscosity)).reshape(n_states, 2, 3)

    def _matrix(self, kinematic_viscosity: float) -> Array:
        """Return the factors (n_terms, 6) of z, s, beta, and beta times z but for its one."""
        n = self.pressure.shape[1]
        matrix = np.zeros((2 * n + 1, 6))
        matrix[:n, :3] = self.pressure.T
        matrix[:n, 3:] = kinematic_viscosity * self.viscous.T
        matrix[n, 3:] = kinematic_viscosity * self.walls
        if self.body_force is not None:
            matrix[n + 1 :, :3] = self.body_force.T
        if self.correction is not None:
            own = self.correction.at(kinematic_viscosity).reshape(6, -1).T
            matrix[0] += own[0]
            matrix[n : n + 2] += own[1:3]
            matrix[N_OTHER_TERMS:n] += own[3:]
        return matrix


def _kept_terms(modes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places of the terms of some modes."""
    return np.concatenate((np.arange(N_OTHER_TERMS), N_OTHER_TERMS + modes))


def correction_terms(
    coordinates: Array, wall_speed: Array | float, amplitude: Array | float
) -> Array:
    """Return y (n_states, 3 + n_modes): one, s, beta, and the coordinates."""
    n_states = len(coordinates)
    speed, beta = (np.broadcast_to(v, n_states) for v in (wall_speed, amplitude))
    return np.column_stack((np.ones(n_states), speed, beta, coordinates))


Measuring = Callable[[Array, Array], Mapping[str, Quantities]]
"""From density fluctuation (n_points,) and velocity (n_points, 2), what is measured, by name."""


class ReducedMeasure(Record):
    """A measurement in the fluid, linear in the terms that forces have too."""

    flow_rate: Array | None = dataset(
        "term", "m2/s, of the terms", "flow through a section", default=None
    )
    velocity: Array | None = dataset(
        "place component term", "m/s, of the terms", "velocity at places", default=None
    )
    pressure: Array | None = dataset(
        "place term", "Pa, of the terms", "pressure at places", default=None
    )

    @property
    def quantities(self) -> Quantities:
        """The terms' factors (..., n_terms) by quantity."""
        return {name: terms for name, terms in vars(self).items() if terms is not None}

    def of_modes(self, modes: NDArray[np.int64]) -> ReducedMeasure:
        """Return the measurement in the coordinates of some modes, the others zero."""
        kept = _kept_terms(modes)
        return self.mapped(lambda terms: terms[..., kept])

    def at(self, coordinates: Array, mean_density_fluctuation: Array | float) -> Quantities:
        """Return what is measured in states, by quantity (n_states, ...).

        Parameters
        ----------
        coordinates : (n_states, n_modes).
        mean_density_fluctuation : (n_states,) or one for all [kg/m3].
        """
        n_states = len(coordinates)
        mean = np.broadcast_to(mean_density_fluctuation, n_states)
        terms = np.column_stack((np.ones(n_states), mean, coordinates))
        return {name: np.tensordot(terms, q, (1, -1)) for name, q in self.quantities.items()}


def project_measures(basis: TrialBasis, measured: Measuring) -> dict[str, ReducedMeasure]:
    """Project what is measured onto a basis; `measured` is affine in its fields."""
    density, velocity = reconstruct(basis, np.zeros(basis.n_modes))
    mean = np.ones_like(density), np.zeros_like(velocity)
    modes = zip(
        basis.density_modes / basis.inner_product.density_scale, basis.velocity_modes, strict=True
    )
    found = [measured(*fields) for fields in ((density, velocity), mean, *modes)]
    offset, linear = measured(0.0 * density, 0.0 * velocity), np.arange(len(found)) > 0

    def terms(name: str, quantity: str) -> Array:
        values = np.stack([each[name][quantity] for each in found], -1)
        return np.asarray(values - np.multiply.outer(offset[name][quantity], linear))

    return {
        name: ReducedMeasure(**{quantity: terms(name, quantity) for quantity in first})
        for name, first in offset.items()
    }


PENALTIES = (1e-2, math.inf)
"""Penalties over the mean squares of the terms; the last leaves the force as it is.

Of 1e-5 to 1e-1, 1e-2 is the best or near it for 8 to 20 modes of a cylinder's flow between the
trained viscosities; 1e-3 and less is better where trained, and worse between.
"""
N_PARTS = 4
"""Parts of runs that are left out in turn where no viscosity lies between others."""


@dataclass(frozen=True)
class ForceRecord:
    """The force on a wall that a training run recorded, and the reduced states of the same times.

    Arrays are (n_snapshots,) where they don't say otherwise.
    """

    loads: Array
    """(n_snapshots, 2, 3) the pressure's and the viscous force and torque [N/m, N]."""
    coordinates: Array
    """(n_snapshots, n_modes)."""
    mean_density_fluctuation: Array
    """What is carried apart [kg/m3]."""
    kinematic_viscosity: float
    """[m2/s]."""
    wall_speed: Array
    """Over the given one."""
    amplitude: Array
    """Of the body force."""
    factors: Factors = field(default_factory=dict)
    """The values of the parameters that drive the flow."""


def calibrate_force(force: ReducedForce, runs: Sequence[ForceRecord]) -> ReducedForce:
    """Return a force with the correction that its training runs ask for.

    It is without one if no run has more than one snapshot.
    """
    if max((len(run.loads) for run in runs), default=0) < 2:
        return force
    terms = np.concatenate(
        [correction_terms(run.coordinates, run.wall_speed, run.amplitude) for run in runs]
    )
    errors = np.concatenate([_errors(force, run) for run in runs])
    size = np.sqrt(np.mean(terms**2, axis=0))
    scale = np.where(size > 0.0, size, 1.0)
    viscosity = np.array([run.kinematic_viscosity for run in runs])
    mean_viscosity = float(viscosity.mean())
    of_run = np.repeat(np.arange(len(runs)), [len(run.loads) for run in runs])
    offset = viscosity[of_run] / mean_viscosity - 1.0
    features = np.hstack((terms / scale, offset[:, None] * (terms / scale)))
    squares = np.zeros((len(PENALTIES), errors.shape[1]))
    for left_out in _folds(viscosity, of_run):
        fitted = _ridge(features[~left_out], errors[~left_out])
        wrong = errors[left_out] - features[left_out] @ fitted
        squares += np.sum(wrong**2, axis=1)
    best = np.argmin(squares, axis=0)
    fitted = np.take_along_axis(_ridge(features, errors), best[None, None, :], axis=0)[0]
    mean, slope = ((half / scale[:, None]).T.reshape(2, 3, -1) for half in np.split(fitted, 2))
    return replace(force, correction=ForceCorrection(mean, slope, mean_viscosity))


def _folds(viscosity: Array, of_run: NDArray[np.int64]) -> list[NDArray[np.bool_]]:
    """Return which samples (n_samples,) to leave out in turn, from the run that each is of."""
    between = np.flatnonzero((viscosity.min() < viscosity) & (viscosity < viscosity.max()))
    if between.size:
        return [of_run == run for run in between]
    return [np.arange(len(of_run)) % N_PARTS == part for part in range(N_PARTS)]


def _ridge(features: Array, errors: Array) -> Array:
    """Return coefficients (n_penalties, n_features, 6), fitted to some samples."""
    left, size, right = np.linalg.svd(features, full_matrices=False)
    shrunk = size / (size**2 + len(features) * np.array(PENALTIES)[:, None])
    return np.asarray(right.T @ (shrunk[..., None] * (left.T @ errors)))


def _errors(force: ReducedForce, run: ForceRecord) -> Array:
    """Return recorded loads less those of a force (n_snapshots, 6)."""
    around = run.kinematic_viscosity, run.wall_speed, run.amplitude
    found = force.with_drives(run.factors).at(
        run.coordinates, run.mean_density_fluctuation, *around
    )
    return (run.loads - found).reshape(len(found), -1)
