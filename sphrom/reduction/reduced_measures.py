"""Forces on walls, flow rates and fields at places as functions of generalized coordinates.

They are projected once; no field is reconstructed. Flow rates and fields at places are products of
constant arrays with the terms (1, separate mean density fluctuation, coordinates).

A force follows from the balance of momentum, tested with the Stokes flow w of the wall's motion
(`sphrom.reduction.stokes_fields`). With the velocity sum_k a_k phi_k and the model's rates it is

    F = beta(t) p - q . da/dt + a . A a - nu s . a - r . a,

with p = rho int f . w, q_k = rho int phi_k . w, A_kl = rho int phi_k . (phi_l . grad) w,
s_k = 2 rho int E(phi_k) : E(w), and r_k = rho int lambda phi_k . w for damping at a rate lambda;
in porous bodies s includes the same integral with 1/k in place of lambda. The errors of F are those
of the velocity, weighted over the whole fluid. The pressure's share is F less the viscous force at
the wall. The viscous force, and both forces of a wall without such a field w, are the forces on
ghosts of fields at fixed points (`sphrom.sph.fixed_points`), linear in the state:

    pressure: P z + beta(t) B z,    viscous: nu (V z + s w).

A model with pressure modes of its own (`sphrom.reduction.own_pressure`) may add their forces on
ghosts to P z; `sphrom.reduction.force_choice` decides this for each component.

The difference from the recorded forces of training runs is interpolated between them
(`sphrom.reduction.correction`) and added; `docs/forces.md` explains how.

Rows are the components of the force, then the torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array, Indices, Mask
from sphrom.declaration import Record, Tensors, dataset, part
from sphrom.metrics.measures import Quantities
from sphrom.metrics.quantities import FROM_FIELDS, stored
from sphrom.reduction.affine import VISCOSITY, Affine, factor_of
from sphrom.reduction.mode_splines import Values
from sphrom.reduction.reduced_operators import FORCE, VALUE, VISCOUS, WALLS, Polynomial
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fluid import NONE, Factors

N_OTHER_TERMS = 2
"""Number of terms before the coordinates."""
_LOADS = "N/m, N of the torque, of the terms"
_BALANCED = "N/m, N of the torque, of the modes"


class MomentumBalance(Record):
    """The terms of the balance of momentum, tested with the Stokes flows of a wall's motions."""

    follows: Indices = dataset("load", "1", "1 for loads with a Stokes flow, else 0")
    momentum: Array = dataset("load mode", f"{_BALANCED}, s", "momentum of the fluid", "q")
    advection: Array = dataset("load mode mode", _BALANCED, "advection of momentum", "A")
    strain: Array = dataset("load mode", _BALANCED + VISCOUS, "viscous stress in the fluid", "s")
    push: Array | None = dataset("load", f"N/m, N{FORCE}", "body force", "p", default=None)
    slowing: Array | None = dataset(
        "load mode", _BALANCED, "damping of the fluid at a prescribed rate", "r", default=None
    )


class DriveForce(Record):
    """The force and torque caused by one parameter, through walls and the body force."""

    walls: Array | None = dataset(
        "load", _LOADS + WALLS + VALUE, "due to moving walls", default=None
    )
    force: Array | None = dataset(
        "load term", _LOADS + FORCE + VALUE, "due to heads of the body force", default=None
    )
    push: Array | None = dataset(
        "load", f"N/m, N{FORCE}{VALUE}", "due to the body force on the whole fluid", default=None
    )


class ReducedForce(Record):
    """The force along x and y [N/m] and the torque [N] on a wall, as functions of coordinates.

    The axis `term` has the constant part, the factor of the separate mean density fluctuation, and
    the factors of the coordinates.
    """

    pressure: Array = dataset("load term", _LOADS, "due to pressure", "P")
    viscous: Array = dataset("load term", _LOADS + VISCOUS, "due to viscosity", "V")
    walls: Array = dataset("load", _LOADS + WALLS, "due to moving walls", "w")
    body_force: Array | None = dataset(
        "load term", _LOADS + FORCE, "due to heads of the body force", "B", default=None
    )
    own: Array | None = dataset(
        "load pressure_mode", "N/m, N of the torque, of the modes", "due to separate modes",
        default=None,
    )  # fmt: skip
    balance: MomentumBalance | None = part(default=None)
    drives: Mapping[str, DriveForce] = part(default_factory=dict)

    def of_modes(self, modes: NDArray[np.int64]) -> ReducedForce:
        """Return the force in the coordinates of some modes."""
        kept = _kept_terms(modes)
        loads = np.arange(3)
        bare = replace(self, balance=None, own=None)
        direct = replace(bare.mapped(lambda x: x if x.ndim == 1 else x[:, kept]), own=self.own)
        if self.balance is None:
            return direct
        few = self.balance.mapped(lambda x: x[np.ix_(loads, *[modes] * (x.ndim - 1))])
        return replace(direct, balance=few)

    def with_own(self, modes: Array, loads: Mask) -> ReducedForce:
        """Return the force with some `loads` (3,) on ghosts, by separate pressure modes too.

        `modes` are their factors (3, n_own_modes).
        """
        balance = self.balance
        if balance is not None:
            balance = replace(balance, follows=np.where(loads, 0, balance.follows))
        return replace(self, own=modes * loads[:, None], balance=balance)

    def at(
        self,
        kinematic_viscosity: float,
        walls_driven: bool = False,
        factors: Factors = NONE,
        correction: TimedLoads | None = None,
    ) -> PointForce:
        """Return the force at a parameter point.

        Parameters
        ----------
        kinematic_viscosity : [m2/s].
        walls_driven : whether walls move with the amplitude.
        factors : the values of the driving parameters.
        correction : loads added by the training runs.
        """
        values = {VISCOSITY: kinematic_viscosity, **factors}
        parts = [(factor_of(name, walls_driven), loads) for name, loads in self._parts]
        steady, driven = Affine(parts).at(values)
        momentum = np.zeros((6, self.n_modes))
        if self.balance is not None:
            momentum[:3] = -self.balance.follows[:, None] * self.balance.momentum
        powers = tuple(
            (terms[..., 0], terms[..., N_OTHER_TERMS:], *quadratic)
            for terms, *quadratic in (steady, driven)
        )
        uniform = np.stack((steady[0][..., 1], driven[0][..., 1]), axis=-2)
        return PointForce(Polynomial(powers), momentum, uniform, correction, self.own)

    @property
    def n_modes(self) -> int:
        """Number of generalized coordinates."""
        return self.pressure.shape[1] - N_OTHER_TERMS

    @cached_property
    def _parts(self) -> list[tuple[str, Tensors]]:
        """The six loads by part: factors of the terms, and of products of coordinates."""
        balance = self.balance
        balancing = np.diag(np.zeros(3) if balance is None else balance.follows.astype(float))
        none = np.zeros((3, 3))
        # A pressure force by the balance of momentum is the whole force less the viscous one.
        pressure = np.vstack((np.eye(3) - balancing, none))
        viscous = np.vstack((-balancing, np.eye(3)))
        balanced = np.vstack((balancing, none))
        onto = {
            "pressure": pressure, "body_force": pressure, "force": pressure,
            "viscous": viscous, "walls": viscous,
            "push": balanced, "strain": -balanced, "slowing": -balanced,
        }  # fmt: skip
        nothing = np.zeros((6, self.pressure.shape[1]))
        products = np.zeros((3, *(self.n_modes,) * 2)) if balance is None else balance.advection
        parts: list[tuple[str, Tensors]] = [
            ("pressure", (nothing, np.tensordot(balanced, products, 1))),
            ("body_force", (nothing,)),
        ]
        drives = ((f"/{parameter}", drive) for parameter, drive in self.drives.items())
        for parameter, record in (("", self), ("", balance), *drives):
            for name, matrix in onto.items():
                if (loads := getattr(record, name, None)) is not None:
                    parts.append((name + parameter, (matrix @ self._terms(loads),)))
        return parts

    def _terms(self, loads: Array) -> Array:
        """Return the loads (3, n_terms) of the constant part, of the modes, or of both."""
        terms = np.zeros_like(self.pressure)
        if loads.ndim == 1:
            terms[:, 0] = loads
        else:
            terms[:, -loads.shape[1] :] = loads
        return terms


@dataclass(frozen=True)
class TimedLoads:
    """The loads over time that training runs add to a force."""

    time: Array
    """(n_times,) [s]."""
    loads: Array
    """(..., n_times, 6), those of the pressure, then the viscous ones [N/m, N]."""

    @classmethod
    def of(cls, time: Array, loads: Array) -> TimedLoads:
        """Return the sum of slow and fast loads (..., n_snapshots, 12) at times (n_snapshots,).

        After the last time it is constant: the mean of the later half.
        """
        total = loads[..., :6] + loads[..., 6:]
        after = 2.0 * time[-1] - time[-2]
        mean = total[..., len(time) // 2 :, :].mean(axis=-2, keepdims=True)
        return cls(np.append(time, after), np.concatenate((total, mean), axis=-2))

    def at(self, time: Array) -> Array:
        """Return the loads (..., n_times, 6) at times (n_times,) [s], linear in between."""
        within = np.clip(time, self.time[0], self.time[-1])
        after = np.clip(np.searchsorted(self.time, within), 1, len(self.time) - 1)
        start = self.time[after - 1]
        share = ((within - start) / (self.time[after] - start))[:, None]
        return (1.0 - share) * self.loads[..., after - 1, :] + share * self.loads[..., after, :]


@dataclass(frozen=True)
class PointForce:
    """A force at one parameter point, as a function of state and time."""

    polynomial: Polynomial
    """The six loads as functions of the coordinates and the amplitude."""
    momentum: Array
    """(6, n_modes), the factors of the coordinates' rates."""
    uniform: Array
    """(..., 2, 6) factors of the mean density fluctuation: alone [m3/s2], times the amplitude."""
    correction: TimedLoads | None = None
    own: Array | None = None
    """(3, n_own_modes) factors of the coordinates of separate pressure modes, if they add loads."""

    def at(
        self,
        time: Array,
        coordinates: Array,
        rates: Array,
        amplitude: Array,
        mean: Array | float = 0.0,
        own: Array | None = None,
    ) -> Array:
        """Return the pressure and the viscous force and torque (..., n_states, 2, 3) [N/m, N].

        Arrays of many runs have a first axis of runs.

        Parameters
        ----------
        time, amplitude : (n_states,) time [s], amplitude of the body force or of driven walls.
        coordinates, rates : (n_states, n_modes) coordinates and their rates [1/s].
        mean : separate density fluctuation [kg/m3], (n_states,) or one for all.
        own : (n_states, n_own_modes) coordinates of separate pressure modes, if they add loads;
            those of the last modes may be left out.
        """
        loads = self.polynomial.along(coordinates, amplitude) + rates @ self.momentum.T
        alone, driven = np.moveaxis(self.uniform[..., None, :], -3, 0)
        by_mean = alone + amplitude[..., None] * driven
        loads += np.broadcast_to(mean, amplitude.shape)[..., None] * by_mean
        if self.own is not None:
            assert own is not None
            loads[..., :3] += own @ self.own[:, : own.shape[-1]].T
        if self.correction is not None:
            loads += self.correction.at(time)
        return loads.reshape(*amplitude.shape, 2, 3)


def _kept_terms(modes: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate((np.arange(N_OTHER_TERMS), N_OTHER_TERMS + modes))


Measuring = Callable[[Array, Array], Mapping[str, Quantities]]
"""Measured quantities of a density fluctuation (n_positions,) and velocity (n_positions, n_dim)."""


class ReducedMeasure(Record):
    """A measurement in the fluid, linear in the same terms as forces."""

    quantities: Mapping[str, Array] = stored(FROM_FIELDS, after="term", units="{}, of the terms")
    """The factors of the terms (..., n_terms), by quantity."""

    def of_modes(self, modes: NDArray[np.int64]) -> ReducedMeasure:
        """Return the measurement for coordinates of some modes, with the others zero."""
        kept = _kept_terms(modes)
        return self.mapped(lambda terms: terms[..., kept])

    def at(self, coordinates: Array, mean_density_fluctuation: Array | float) -> Quantities:
        """Return the measured quantities (..., n_states, ...) of states, by name.

        Parameters
        ----------
        coordinates : (..., n_states, n_modes); those of the last modes may be left out.
        mean_density_fluctuation : (..., n_states) or one for all [kg/m3].
        """
        states = coordinates.shape[:-1]
        ones = np.ones(states)
        mean = np.broadcast_to(mean_density_fluctuation, states)
        terms = np.concatenate((np.stack((ones, mean), axis=-1), coordinates), axis=-1)
        n_terms = terms.shape[-1]
        return {
            name: (terms @ q[..., :n_terms].reshape(-1, n_terms).T).reshape(states + q.shape[:-1])
            for name, q in self.quantities.items()
        }


def project_measures(
    basis: TrialBasis, values: Values, position: Array, measured: Measuring
) -> dict[str, ReducedMeasure]:
    """Project measurements onto a basis, given the values of its modes.

    `measured` must be affine in the fields at positions (n_positions, n_dim) [m].
    """
    product = basis.inner_product
    modes = values(position).reshape(len(position), -1, 1 + position.shape[1])
    fields = np.concatenate((np.zeros((2, *modes.shape[::2])), modes.swapaxes(0, 1)))
    density, velocity = fields[..., 0] / product.density_scale, fields[..., 1:]
    density[0] = product.density_fluctuation(density[0])
    density[1] = 1.0
    columns = list(map(measured, density, velocity))
    offset = measured(0.0 * density[0], velocity[0])
    linear = np.arange(len(columns)) > 0

    def terms(name: str, quantity: str) -> Array:
        values = np.stack([column[name][quantity] for column in columns], -1)
        return np.asarray(values - np.multiply.outer(offset[name][quantity], linear))

    return {
        name: ReducedMeasure(quantities={quantity: terms(name, quantity) for quantity in first})
        for name, first in offset.items()
    }
