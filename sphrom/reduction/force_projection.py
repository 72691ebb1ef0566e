"""Projection of the force on a wall from the reference points, done once.

`sphrom.reduction.reduced_measures` has the equations: the force is that on ghosts, or follows from
the balance of momentum, tested with the Stokes flows of the wall's motions.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sphrom.arrays import Array
from sphrom.metrics.measures import TORQUE
from sphrom.reduction.mode_fields import BLOCK_VALUES, blocks, mode_fields, mode_gradients
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.reduced_measures import (
    N_OTHER_TERMS,
    DriveForce,
    MomentumBalance,
    ReducedForce,
)
from sphrom.reduction.stokes_fields import StokesFields
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints
from sphrom.sph.fluid import NONE
from sphrom.sph.functional import MeasuredWall


def project_forces(
    points: FixedPoints,
    basis: TrialBasis,
    wall: MeasuredWall,
    circulations: Mapping[str, float] = NONE,
    balance: tuple[StokesFields, ModeSplines | None] | None = None,
    pressure_modes: Array | None = None,
) -> ReducedForce:
    """Project the force on a wall onto a basis.

    Parameters
    ----------
    circulations : of the wall velocity per unit of each driving parameter [m2/s].
    balance : the Stokes flows of the wall's motions and the splines of the modes, to project the
        balance of momentum too.
    pressure_modes : q (n_pressure_modes, n_points) [m/s], which a model may own.
    """
    terms = _TermFields(points, basis)

    def heads(force: Array | None) -> Array | None:
        if force is None:
            return None
        loads = wall.loads(
            points.ghost_heads(force[..., None] * terms.density) / points.sound_speed
        )
        loads[:, 0] += wall.loads(points.ghost_heads(force))
        return loads

    def drag(ghost_drag: Array, circulation: float) -> Array:
        loads = wall.loads(ghost_drag)
        loads[TORQUE] -= points.fluid.reference_density * circulation
        return loads

    def push(force: Array | None) -> Array | None:
        if balance is None or force is None:
            return None
        return points.particle_mass * np.einsum("lnd,dn->l", balance[0].value, force)

    own = None
    if pressure_modes is not None:
        columns = np.ascontiguousarray(pressure_modes.T)
        own = wall.loads(points.ghost_pressures(columns, np.zeros((2, *columns.shape))))
    drives = {}
    for name, drive in points.drives.items():
        walls = None
        if drive.walls is not None:
            walls = drag(points.drag_of(drive.walls.T), circulations[name])
        drives[name] = DriveForce(walls=walls, force=heads(drive.force), push=push(drive.force))
    return ReducedForce(
        pressure=wall.loads(points.ghost_pressures(terms.density, terms.velocity)),
        viscous=wall.loads(points.ghost_friction(terms.velocity)),
        walls=drag(points.ghost_drag, wall.circulation),
        body_force=heads(points.body_force),
        own=own,
        balance=None
        if balance is None
        else _balance(points, basis, *balance, push(points.body_force)),
        drives=drives,
    )


class _TermFields:
    """The constant part of a state, a uniform density and the modes, as fields at the points."""

    def __init__(self, points: FixedPoints, basis: TrialBasis) -> None:
        fields = mode_fields(basis, points)
        n_modes = fields.n_modes
        modes = slice(N_OTHER_TERMS, None)
        self.density = np.zeros((points.n_points, N_OTHER_TERMS + n_modes))
        """q (n_points, n_terms) [m/s]."""
        self.density[:, :1] = fields.scaled_density[:, n_modes:].sum(axis=1, keepdims=True)
        self.density[:, 1] = points.density_scale
        self.density[:, modes] = fields.scaled_density[:, :n_modes]
        self.velocity = np.zeros((2, *self.density.shape))
        """(2, n_points, n_terms) [m/s]; the first two terms are at rest."""
        self.velocity[..., modes] = fields.velocity[..., :n_modes]


def _balance(
    points: FixedPoints,
    basis: TrialBasis,
    tested: StokesFields,
    splines: ModeSplines | None,
    push: Array | None,
) -> MomentumBalance:
    """Project the terms of the balance of momentum, tested with Stokes flows."""
    fields = mode_fields(basis, points)
    n = basis.n_modes
    mass = points.particle_mass
    gradients_of = mode_gradients(points, fields, splines)
    momentum = np.zeros((3, n))
    strain = np.zeros((3, n))
    advection = np.zeros((3, n, n))
    for rows in blocks(points.n_points, BLOCK_VALUES // (6 * n)):
        velocity = fields.velocity[:, rows, :n]
        gradient = gradients_of(rows)[1:, ..., :n]
        value = tested.value[:, rows]
        slope = tested.gradient[:, rows]
        momentum += np.einsum("lni,ink->lk", value, velocity)
        strain += np.einsum("lnij,ijnk->lk", slope + slope.swapaxes(2, 3), gradient)
        carried = np.einsum("lnij,jnk->lnik", slope, velocity)
        advection += np.einsum("lnik,inm->lkm", carried, velocity, optimize=True)

    def slowed(rate: Array | None) -> Array | None:
        if rate is None:
            return None
        return mass * np.einsum("lnd,n,dnk->lk", tested.value, rate, fields.velocity[..., :n])

    in_bodies = slowed(points.inverse_permeability)
    return MomentumBalance(
        follows=tested.follows.astype(np.int64),
        momentum=mass * momentum,
        advection=0.5 * mass * (advection + advection.swapaxes(1, 2)),
        strain=mass * strain + (0.0 if in_bodies is None else in_bodies),
        slowing=slowed(points.slowing_rate),
        push=push,
    )
