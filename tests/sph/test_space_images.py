"""Images of particles along all periodic axes of a box in space."""

from __future__ import annotations

import numpy as np

from sphrom.metrics.grids import grid_points
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.sph.neighbourhood import periodic_images
from sphrom.sph.space_box import SpaceBox

BOX = SpaceBox((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (True, True, True))


def test_images_surround_the_box_along_all_axes() -> None:
    position = grid_points(BOX.lower, BOX.upper, (4, 4, 4))
    particle, image = periodic_images(position.T, BOX, 0.25)
    around = np.sort(np.round(position.T[:, particle] + image, 9).T, axis=0)
    expected = grid_points((-0.25,) * 3, (1.25,) * 3, (6, 6, 6))
    np.testing.assert_allclose(around, np.sort(np.round(expected, 9), axis=0))


def test_maps_are_the_same_along_all_axes() -> None:
    position = grid_points(BOX.lower, BOX.upper, (8, 8, 8))
    to = ReferenceMap(position, BOX, particle_spacing=0.125, smoothing_length=0.25)
    wave = np.cos(2.0 * np.pi * position)
    found = to(position, np.zeros(len(position)), wave)[1].reshape(8, 8, 8, 3)
    np.testing.assert_allclose(found[:, 0, 0, 2], found[0, 0, :, 0], atol=1e-13)
    np.testing.assert_allclose(found[0, :, 0, 1], found[0, 0, :, 0], atol=1e-13)
