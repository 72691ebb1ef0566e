"""The terms of one pair of particles i and j (Eq. 2.6-2.14), in two or three dimensions.

The offset is x_i - x_j; differences are those of j minus those of i. A term is multiplied by
`slope_weight` in the sum over j; so every term vanishes beyond the kernel's support, and no branch
is needed. A particle and itself have no offset.
"""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from sphrom.kernels.fields import FluidConstants, RegularityConstants
from sphrom.kernels.jit import inlined, like, term
from sphrom.kernels.vectors import Vector, dot, times
from sphrom.kernels.wendland import gradient_factor, kernel, laplacian_weight

HALF = cast(float, np.float32(0.5))
"""It makes no double of a number in single precision, and is as exact in doubles."""
TINY = 1e-30
"""Guards 0/0 of a particle with itself, relative to h^2; far below rounding for other pairs."""


@term
def slope_weight(offset: Vector, volume: float, inverse_length: float) -> float:
    """Return G = F V_j, so that G times the offset is the kernel's gradient times the volume."""
    distance = math.sqrt(dot(offset, offset))
    return gradient_factor(distance, inverse_length, len(offset)) * volume


@term
def kernel_of(offset: Vector, inverse_length: float) -> float:
    """Return the kernel W [m^-n] at an offset."""
    return kernel(math.sqrt(dot(offset, offset)), inverse_length, len(offset))


@term
def laplacian(offset: Vector, inverse_length: float) -> float:
    """Return the Laplacian's weight in front of G."""
    return laplacian_weight(dot(offset, offset), inverse_length, len(offset))


@term
def shifting_push(offset: Vector, constants: RegularityConstants, inverse_length: float) -> float:
    """Return the bracket of Eq. 2.14 for w = W / W(dx), with xi = 4."""
    closeness = kernel_of(offset, inverse_length) * constants.inverse_kernel
    one = like(1.0, closeness)
    amplitude = constants.amplitude
    as_printed = constants.as_printed
    printed = (one + amplitude * closeness) * (one + amplitude * closeness)
    square = closeness * closeness
    return as_printed * printed * printed + (one - as_printed) * (one + amplitude * square * square)


@inlined
def density_exchange(jump: float, carried: float, slope: float, fluid: FluidConstants) -> float:
    """Return the terms of shifting and diffusion in the rate of density (Eq. 2.6, 2.10).

    `carried` is the shifting velocity times the offset, `slope` the sum of both renormalised
    gradients of the density times the offset.
    """
    return jump * carried - fluid.diffusion * (jump + HALF * slope)


@inlined
def push(pressures: float, fluid: FluidConstants) -> float:
    """Return the force along the offset, given the sum of both pressures over c0^2 (Eq. 2.7)."""
    return fluid.sound_speed * fluid.sound_speed * pressures


@inlined
def friction(
    offset: Vector, viscosities: float, fluid: FluidConstants, inverse_length: float
) -> float:
    """Return the friction per difference of velocities, given the sum of both factors c."""
    drag = fluid.laplacian_viscosity * fluid.reference_density
    return drag * viscosities * laplacian(offset, inverse_length)


@inlined
def pair_friction(
    offset: Vector, jump: Vector, fluid: FluidConstants, inverse_length: float
) -> float:
    """Return the friction along the offset, given the difference of velocities (Eq. 2.12)."""
    tiny = TINY / (inverse_length * inverse_length)
    strength = fluid.pair_viscosity * fluid.reference_density
    return strength * dot(jump, offset) / (dot(offset, offset) + tiny)


@inlined
def extrapolated(jump: Vector, depth: float, distance: float) -> Vector:
    """Return the difference to a ghost's velocity extrapolated through the wall.

    `jump` is the difference to the wall's velocity, `distance` is the particle's from the wall.
    """
    return times(1.0 + depth / distance, jump)
