"""The layout of particles' fields for sums over pairs, and the records in which sums take them.

`source` (n_fields, n_sources) has a row for each field. In records a field is the number of one
particle, or an array with those of a range of sources; vectors are tuples of components.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from sphrom.arrays import Array, Indices
from sphrom.kernels.jit import inlined
from sphrom.kernels.vectors import Vector

# Rows of `source`.
X, Y, DENSITY, U, V, VOLUME, PRESSURE, VISCOUS, GRADIENT_X, GRADIENT_Y, SHIFT_U, SHIFT_V = range(12)
N_FIELDS = 10
"""Number of rows that the sums need."""
FIRST = VOLUME + 1
"""The first row with one of three additional fields for gradients."""

# Rows of a ghost: its depth behind the wall if velocities are extrapolated, else 0; 1 along the
# normals of its wall that are used, else 0; w_gj V_g phi_g over W_gj (see `wall_sweeps.py`).
DEPTH, NORMAL_X, NORMAL_Y, RETURN = range(PRESSURE + 1, PRESSURE + 5)
N_GHOST_ROWS = RETURN + 1

# Rows of the result of `sweeps.regularity`; the first ones are in the order of `source`.
(
    OWN_PRESSURE, OWN_VISCOUS, OWN_GRADIENT_X, OWN_GRADIENT_Y, OWN_SHIFT_U, OWN_SHIFT_V, DIVERGENCE,
    SUPPORT_X, SUPPORT_Y,
) = range(9)  # fmt: skip
N_REGULAR_ROWS = 9


class Flow(NamedTuple):
    """The fields of a particle, or of a range of sources."""

    place: Vector
    """[m]; in lists of candidates relative to the first target of a block."""
    density: Any
    """Fluctuation [kg/m3]."""
    velocity: Vector
    volume: Any


class Derived(NamedTuple):
    """The results of the first sweep that the second one needs."""

    pressure: Any
    """Pressure, with that of the damper, divided by c0^2 [kg/m3]."""
    viscous: Any
    """c of the Laplacian."""
    gradient: Vector
    """Gradient of the density [kg/m4]."""


class BesideWalls(NamedTuple):
    """The particles near walls."""

    particle: Indices
    """(n_sources,) the particle of each source of the fluid."""
    targets: Indices
    """(n_targets,) the sources that are particles near walls."""
    source: Array
    """The sources of the fluid."""
    distance: Array
    """(n_targets,) from the wall [m], not zero."""


class RegularityConstants(NamedTuple):
    """Constants of Eq. 2.13-2.14, and of the acoustic damper."""

    magnitude: float
    """2 h c0 Ma [m2/s]."""
    amplitude: float
    inverse_kernel: float
    """1 / W(dx) [m2]."""
    as_printed: float
    """1 for [1 + chi w]^xi as printed, 0 for 1 + chi w^xi (Sun et al. 2017)."""
    limit: float
    """U_max / 2 [m/s]."""
    damping: float
    """alpha h rho_0 / c0 [kg s/m3]: the damper's pressure over c0^2, per minus the divergence."""
    walls_return: float
    """1 if walls return the flux into them, 0 if the velocities of ghosts are used."""


class FluidConstants(NamedTuple):
    """The constants of the fluid in Eq. 2.6-2.8."""

    reference_density: float
    sound_speed: float
    pair_viscosity: float
    """K of Eq. 2.12, 2 (n + 2) nu [m2/s]: friction along the line between two particles."""
    laplacian_viscosity: float
    """nu [m2/s] of the velocity's Laplacian (Morris, Fox and Zhu 1997)."""
    diffusion: float
    """2 delta h c0 [m2/s]."""
    advective: float
    """1 if shifting carries differences by a particle's own velocity, 0 for terms as printed."""


@inlined
def vector_at(fields: Array, first: int, columns: Any) -> Vector:
    """Return the vector whose components are rows of an array from the first one on."""
    return fields[first, columns], fields[first + 1, columns]


@inlined
def flow_at(source: Array, columns: Any) -> Flow:
    """Return the fields of a source, or of those in a slice."""
    return Flow(
        vector_at(source, X, columns),
        source[DENSITY, columns],
        vector_at(source, U, columns),
        source[VOLUME, columns],
    )


@inlined
def derived_at(fields: Array, first: int, columns: Any) -> Derived:
    """Return the derived fields in the rows from `first` on, of one source or of a slice of
    them."""
    return Derived(
        fields[first, columns],
        fields[first + 1, columns],
        vector_at(fields, first + 2, columns),
    )
