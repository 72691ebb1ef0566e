"""How a scene's geometry and its particles fit together."""

from __future__ import annotations

from sphrom.case.models import Case


def n_particles(case: Case) -> int:
    """Return the number of particles that the scene is filled with."""
    return case.scene.domain.n_particles(case.particle_spacing)


def n_ghosts(case: Case) -> int:
    """Return the number of ghost particles of the scene's walls."""
    return case.scene.domain.n_ghosts(case.particle_spacing, case.n_wall_layers)


def nearest_fitting_resolution(case: Case) -> int | None:
    """Return the resolution nearest to the case's at which walls fit the lattice, if one is near.

    It is at most half as coarse, or twice as fine.
    """
    domain, length = case.scene.domain, case.scene.resolved_length
    resolution = case.discretization.resolution
    for distance in range(resolution // 2):
        for candidate in (resolution + distance, resolution - distance):
            if domain.fits_lattice(length / candidate):
                return candidate
    return None
