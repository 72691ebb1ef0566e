"""The linear state equation and particle volumes (Eq. 2.8), on density fluctuations rho - rho_0."""

from __future__ import annotations

from sphrom.arrays import Array


def pressure(density_fluctuation: Array, sound_speed: float) -> Array:
    """Return the pressure [Pa] of density fluctuations [kg/m3]."""
    return sound_speed**2 * density_fluctuation


def density_fluctuation(pressure: Array, sound_speed: float) -> Array:
    """Return the density fluctuation [kg/m3] that has a pressure [Pa]."""
    return pressure / sound_speed**2


def volume(density_fluctuation: Array, reference_density: float, mass: float) -> Array:
    """Return the volume [m2] of particles of one mass [kg/m]."""
    return mass / (reference_density + density_fluctuation)
