"""The reference solutions in space: exact balances, and two resolutions of each against another."""

from __future__ import annotations

import numpy as np
import pytest


def test_the_vortex_starts_exactly_and_decays_by_viscosity(script):
    references = script("space_references")
    vortex = references.Vortex(16, 0.1)
    x, y, z = np.meshgrid(*[np.arange(16) * np.pi / 8] * 3, indexing="ij")
    pressure = (np.cos(2 * x) + np.cos(2 * y)) * (np.cos(2 * z) + 2.0) / 16.0
    assert vortex.pressure == pytest.approx(pressure, abs=1e-12)
    assert vortex.energy == pytest.approx(0.125)
    vortex.advance(0.01)
    # All modes of the start have a squared wave number of three.
    assert vortex.energy == pytest.approx(0.125 * np.exp(-6.0 * 0.1 * 0.01), rel=1e-5)
    finer = references.Vortex(24, 0.1)
    for one, time in ((vortex, 0.99), (finer, 1.0)):
        one.advance(time)
    assert vortex.energy == pytest.approx(finer.energy, rel=1e-3)


def test_the_cube_conserves_volume_and_converges(script):
    references = script("space_references")
    lines = {}
    for n_cells in (8, 12, 16):
        cube = references.Cube(n_cells, 0.05)
        cube.advance(0.3)
        divergence = sum(np.diff(face, axis=d) for d, face in enumerate(cube.faces))
        assert np.abs(divergence).max() < 1e-12
        # The flow is symmetric about the middle of z, and nothing flows through the centre plane.
        assert cube.faces[0] == pytest.approx(cube.faces[0][:, :, ::-1], abs=1e-12)
        assert cube.faces[0][n_cells // 2].sum() == pytest.approx(0.0, abs=1e-10)
        lines[n_cells] = cube.lines()
    coarse = np.abs(lines[8] - lines[12]).max()
    assert np.abs(lines[12] - lines[16]).max() < 0.6 * coarse
