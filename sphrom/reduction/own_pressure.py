"""Pressure with modes of its own, from the balance of momentum or from training runs.

A model's modes have a velocity and a pressure each. The pressure of its coordinates a is a small
difference of large contributions. It may therefore be given modes psi of its own, those of the
training pressures. In units of q = c0 rho'/rho0 it is

    q = sum_k a_k q_k + sum_m b_m psi_m.

With the rates f of the velocity at fixed points (`sphrom.reduction.forms`), which contain the
pressure of the first sum, the balance of momentum determines b:

    b = K^-1 (c0 G psi, f(a) - sum_k da_k/dt u_k),    K = (c0 G psi, c0 G psi).

These b minimise the residual of the balance over all pressures of these modes. The products are
those of the velocity. Like the rates, b is quadratic in a and affine in factors of the parameters.

The remaining error is known in training runs. It may be added: by ridge regression on a
(`sphrom.reduction.calibration`), or interpolated between the runs (`sphrom.reduction.correction`).
`CANDIDATES` lists the combinations. Two errors in training runs decide which of them a model uses:
e with the fits to all runs, and h if the run is held out from the modes psi and from all fits. The
distance of a point between training runs from its neighbours is s times (`NEARER`) that of a
held-out run. The expected squared error there is (1 - s^2) e^2 + s^2 h^2. It does not show what the
joint modes miss, because they contain the held-out run; so the joint pressure has to be `CLEARLY`
better.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.declaration import Record, attribute, dataset, part
from sphrom.reduction.affine import VISCOSITY, Affine, factor_of
from sphrom.reduction.calibration import Calibration, TrainingRun, fit
from sphrom.reduction.correction import Correction, interpolated
from sphrom.reduction.held_out import ALIKE, DIVERGED, NEARER, surrounded
from sphrom.reduction.monomials import monomials_of
from sphrom.reduction.reduced_operators import Polynomial, unpack
from sphrom.sph.fluid import NONE, Factors

JOINT, BALANCE, INTERPOLATED = "joint", "balance", "interpolated"
CANDIDATES = (
    JOINT,
    f"{JOINT}-{INTERPOLATED}",
    BALANCE,
    f"{BALANCE}-{INTERPOLATED}",
    f"{BALANCE}-ridge",
    INTERPOLATED,
)
"""The candidates, from simple to complex: the pressure of the model's modes, the same with
separate modes from the balance of momentum, each with additions from training runs, and separate
modes alone."""
WIDER = 3
"""Dimension of the space in which pressures are compared, over the number of these modes."""
CLEARLY = 0.7
"""Largest expected error with the joint pressure, relative to that without, for which it is used.

This ratio is larger in 43 models of nine flows. Between their training runs, the pressure without
the joint modes was at most 4 % worse, and 8 times better in a channel with obstacles, where the
ratio was 0.94.
"""
NEGLIGIBLE = 1e-6
"""Difference of relative errors that counts as none, because it may be rounding."""

_OWN = "separate pressure modes"
_BY_PART = "by part of the rates; `walls.lid` is for walls, per unit of a parameter `lid`"


class PressureBalance(Record):
    """The balance of momentum, projected onto the gradients of pressure modes."""

    parts: Mapping[str, Array] = dataset(
        "pressure_mode monomial", "m2/s3", f"products of rates with pressure gradients, {_BY_PART}"
    )
    gradients: Array = dataset(
        "pressure_mode pressure_mode", "m2/s4", "products of the pressure gradients", "K"
    )
    rates: Array = dataset(
        "pressure_mode mode", "m2/s2", "products of the gradients with the modes' velocities"
    )
    joint: Array = dataset("mode pressure_mode", "1", "products of the modes' pressures with these")
    walls_driven: int = attribute("", "1 if walls move with the amplitude, else 0")


class PressureSpace(PressureBalance):
    """The modes of training pressures, the leading ones of which a model may own."""

    modes: Array = dataset("own_mode particle", "of the inner product's state", _OWN, "psi")
    coordinates: Array = dataset(
        "run snapshot pressure_mode", "of the inner product", "coordinates of training pressures"
    )
    squares: Array = dataset(
        "run snapshot", "of the inner product, squared", "squared norms of training pressures"
    )

    def of_modes(self, modes: Indices) -> PressureSpace:
        """Return the space for models with some of the modes."""
        kept = monomials_of(modes, len(self.joint))
        return replace(
            self,
            parts={name: columns[:, kept] for name, columns in self.parts.items()},
            rates=self.rates[:, modes],
            joint=self.joint[modes],
        )


def pressure_modes(pressures: Iterable[Array], weights: Array, n_modes: int) -> Array:
    """Return at most `n_modes` orthonormal modes (n_modes, n_points) of pressures.

    Parameters
    ----------
    pressures : (n_snapshots, n_points) each; their leading modes are accumulated one by one.
    weights : (n_points,) of the inner product.
    """
    root = np.sqrt(weights)
    kept = np.zeros((0, len(weights)))
    for some in pressures:
        rows = np.concatenate((kept, some * root))
        _, values, modes = np.linalg.svd(rows, full_matrices=False)
        used = values[:n_modes] > len(rows) * np.finfo(float).eps * values[0]
        kept = (values[:, None] * modes)[:n_modes][used]
    return np.asarray(kept / np.linalg.norm(kept, axis=1)[:, None] / root)


@dataclass(frozen=True)
class PointPressure:
    """Coordinates of separate pressure modes at one point: a polynomial, and a part over time."""

    polynomial: Polynomial
    correction: Array | None = None
    """(n_trained_snapshots, n_own_modes), if training runs add one."""


class OwnPressure(Record):
    """The coordinates of separate pressure modes as functions of those of a model."""

    modes: Array = dataset("own_mode particle", "of the inner product's state", _OWN, "psi")
    parts: Mapping[str, Array] = dataset(
        "own_mode monomial",
        "of the inner product",
        f"coordinates of separate pressure modes, {_BY_PART}",
        default_factory=dict,
    )
    rates: Array = dataset("own_mode mode", "s", "factors of the rates, to be subtracted")
    walls_driven: int = attribute("", "1 if walls move with the amplitude, else 0")
    ridge: Calibration | None = part(default=None)
    correction: Correction | None = part(default=None)

    @cached_property
    def _affine(self) -> Affine:
        driven = bool(self.walls_driven)
        n_modes = self.rates.shape[1]
        return Affine(
            [
                (factor_of(name.replace(".", "/"), driven), unpack(columns, n_modes))
                for name, columns in self.parts.items()
            ]
        )

    def at(
        self,
        rates: Polynomial,
        kinematic_viscosity: float,
        factors: Factors = NONE,
    ) -> Polynomial:
        """Return the coordinates of the modes, without the correction, at a parameter point.

        Parameters
        ----------
        rates : the model's rates there.
        kinematic_viscosity : [m2/s].
        factors : the values of the driving parameters.
        """
        found = Polynomial(self._affine.at({VISCOSITY: kinematic_viscosity, **factors}))
        if self.ridge is not None:
            found = found.plus(self.ridge.at(kinematic_viscosity, factors))
        change = (
            tuple(_applied(self.rates, tensor, degree) for degree, tensor in enumerate(power))
            for power in rates.powers
        )
        return found.plus(Polynomial(tuple(change)), -1.0)

    def along(self, run: TrainingRun) -> Array:
        """Return the coordinates (n_snapshots, n_own_modes) in a run, without the correction."""
        amplitude = np.zeros(len(run.coordinates)) if run.amplitude is None else run.amplitude
        found = self.at(run.rates, run.kinematic_viscosity, run.factors)
        return found.along(run.coordinates, amplitude)


def _applied(matrix: Array, tensor: Array, degree: int) -> Array:
    """Return a matrix (n_rows, n) times tensors (..., n, ...) of a degree."""
    split = tensor.ndim - degree
    rows = tensor.reshape(*tensor.shape[:split], -1)
    return (matrix @ rows).reshape(*tensor.shape[: split - 1], -1, *tensor.shape[split:])


def fitted(
    space: PressureSpace,
    own: Array,
    candidate: str,
    runs: Mapping[int, TrainingRun],
    places: Array,
) -> OwnPressure:
    """Return a candidate, fitted to training runs.

    Parameters
    ----------
    own : (n_own_modes, n_pressure_modes), the separate modes in the space.
    runs : the model's runs by number, which have the coordinates of full runs.
    places : (n_all_runs, n_parameters), scaled so that distances are comparable.
    """
    joint = space.joint @ own.T
    parts: dict[str, Array] = {}
    rates = np.zeros((len(own), len(joint)))
    if candidate.startswith(BALANCE):
        solved = np.linalg.solve(own @ space.gradients @ own.T, own)
        parts = {name: solved @ columns for name, columns in space.parts.items()}
        rates = solved @ space.rates
    elif candidate == INTERPOLATED:
        width = space.parts["inertia"].shape[1]
        parts = {"inertia": np.pad(-joint.T, ((0, 0), (1, width - 1 - len(joint))))}
    pressure = OwnPressure(modes=own, parts=parts, rates=rates, walls_driven=space.walls_driven)
    if candidate in (JOINT, BALANCE):
        return pressure
    missed = []
    for k, run in runs.items():
        known = run.coordinates @ joint + pressure.along(run)
        missed.append(space.coordinates[k] @ own.T - known)
    if candidate.endswith(INTERPOLATED):
        correction = interpolated(places[list(runs)], np.stack(missed))
        return replace(pressure, correction=correction)
    samples = [(run.coordinates, m) for run, m in zip(runs.values(), missed, strict=True)]
    return replace(pressure, ridge=fit(list(runs.values()), samples))


def choose(
    space: PressureSpace,
    runs: Mapping[int, TrainingRun],
    predicted: Mapping[int, Mapping[int, TrainingRun]],
    places: Array,
) -> tuple[str, Array, dict[int, Array]]:
    """Return the best candidate, and the expected relative errors (n_candidates, n_runs) of all.

    The third result has the coordinates (n_snapshots, n_pressure_modes) of the best candidate's own
    modes in the predicted runs.

    Errors are root mean squares over a training run, and large where it diverged.

    Parameters
    ----------
    runs : the training runs of the model, by number.
    predicted : by the number of a held-out run, all training runs for a model that is fitted to
        the others.
    places : (n_runs, n_parameters), scaled so that distances are comparable.
    """
    errors = np.full((len(CANDIDATES), len(places)), DIVERGED)
    added: dict[str, dict[int, Array]] = {candidate: {} for candidate in CANDIDATES}
    base = np.eye(len(space.modes), len(space.gradients))
    whole = [fitted(space, base, candidate, runs, places) for candidate in CANDIDATES]
    for k, unseen in predicted.items():
        others = {j: other for j, other in unseen.items() if j != k}
        known = space.coordinates[list(others)].reshape(-1, len(space.gradients))
        own = np.linalg.svd(known, full_matrices=False)[2][: len(space.modes)]
        for row, candidate in enumerate(CANDIDATES):
            pressure = fitted(space, own, candidate, others, places)
            added[candidate][k] = _added(pressure, unseen[k], places[k]) @ own
            square = _missed(space, k, unseen[k], added[candidate][k])
            if k in runs:
                seen = _missed(space, k, runs[k], _added(whole[row], runs[k], places[k]) @ base)
                square = (1.0 - NEARER**2) * seen + NEARER**2 * square
            errors[row, k] = np.sqrt(square)
    best = best_candidate(expected_errors(errors, places))
    return best, errors, added[best]


def best_candidate(expected: Array) -> str:
    """Return the first candidate among the best, by their expected errors (n_candidates,)."""
    joint = np.array([candidate.startswith(JOINT) for candidate in CANDIDATES])
    weighed = np.where(joint, expected / CLEARLY, expected)
    return CANDIDATES[int(np.flatnonzero(weighed <= ALIKE * weighed.min() + NEGLIGIBLE)[0])]


def _added(pressure: OwnPressure, run: TrainingRun, place: Array) -> Array:
    """Return the coordinates (n_snapshots, n_own_modes) in a run, with the correction."""
    found = pressure.along(run)
    return found if pressure.correction is None else found + pressure.correction.at(place)


def _missed(space: PressureSpace, k: int, run: TrainingRun, added: Array) -> float:
    """Return the squared relative error of the pressure in a training run.

    `added` are the coordinates (n_snapshots, n_pressure_modes) of the separate modes.
    """
    known = space.coordinates[k]
    size = space.squares[k].sum()
    outside = max(0.0, size - np.sum(known**2))
    missed = known - run.coordinates @ space.joint - added
    return float((outside + np.sum(missed**2)) / size)


def expected_errors(errors: Array, places: Array) -> Array:
    """Return the root mean square error (n_candidates, ...) over the runs that decide.

    These are the runs that others surround in the parameters, or all of them if there is none.
    Parameters: as returned by and given to `choose`; errors may have more axes.
    """
    complete = np.flatnonzero(errors[0].reshape(len(places), -1)[:, 0] < DIVERGED)
    inside = np.intersect1d(complete, surrounded(places))
    return np.sqrt(np.mean(errors[:, inside if len(inside) else complete] ** 2, axis=1))
