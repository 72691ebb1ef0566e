"""Where ghosts are, whose walls they are of, and that there are enough of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.sph.domain import Domain
from sphrom.sph.functional import Functional
from sphrom.sph.walls.kinds import KINDS

SPACING = 0.0625


def searched(domain: Domain, layers: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ghosts and their normals, by a search from every place of a wider lattice."""
    size = [round(length / SPACING) for length in domain.lengths]
    beyond = [0 if periodic else layers for periodic in domain.periodic]
    column, row = (
        grid.ravel()
        for grid in np.meshgrid(*(np.arange(-b, n + b) for n, b in zip(size, beyond, strict=True)))
    )
    place = np.array(domain.lower) + SPACING * (np.stack((column, row), axis=1) + 0.5)
    fluid = domain.contains(place)
    ghosts, normals = [], []
    for point, i, j in zip(place[~fluid], column[~fluid], row[~fluid], strict=True):
        across, up = np.abs(column[fluid] - i), np.abs(row[fluid] - j)
        if domain.periodic[0]:
            across = np.minimum(across, size[0] - across)
        if np.any((across <= layers) & (up <= layers)):
            beside = bool(np.any((up == 0) & (across <= layers)))
            above = bool(np.any((across == 0) & (up <= layers)))
            ghosts.append(point)
            normals.append((beside, above) if beside or above else (1.0, 1.0))
    return np.array(ghosts), np.array(normals, dtype=float)


@pytest.mark.parametrize("name", ["box", "cavity"])
@pytest.mark.parametrize("layers", [1, 3, 5])
def test_ghosts_fill_the_lattice_around_the_fluid(scenes: dict, name: str, layers: int) -> None:
    domain = scenes[name].domain
    walls = domain.ghosts(SPACING, layers)
    ghosts, normals = searched(domain, layers)
    order, other = (np.lexsort(np.round(p.T / SPACING, 3)) for p in (walls.position, ghosts))
    np.testing.assert_allclose(walls.position[order], ghosts[other], atol=1e-12)
    assert np.array_equal(walls.normal[order], normals[other])
    assert not walls.velocity.any()
    assert not domain.contains(walls.position).any()


@pytest.mark.parametrize(("ratio", "enough"), [(2.0, True), (4.0, True), (4.0, False)])
@pytest.mark.parametrize("name", ["box", "cavity"])
def test_layers_complete_the_kernel(
    scenes: dict, brute_force: type, name: str, ratio: float, enough: bool
) -> None:
    """Beside walls the kernel sums up to what it does amid the fluid; with 3 layers only at 2 dx.

    At h = 4 dx three layers miss 5 % of it in the first layer of fluid.
    """
    domain = scenes[name].domain
    walls = scenes[name].walls(ratio, None if enough else 3)
    points = domain.fill(SPACING)
    everything = np.concatenate((points, walls.position))
    sums = brute_force(everything, domain.lengths, domain.periodic, ratio * SPACING, SPACING)
    total = sums.kernel(np.linalg.norm(sums.offsets(points), axis=2)).sum(axis=1)
    steps = SPACING * np.arange(-9, 10)
    far = np.hypot(*np.meshgrid(steps, steps))
    whole = sums.kernel(far).sum()
    missing = 1.0 - total.min() / whole
    if enough:
        assert abs(missing) < 1e-12
        assert total.max() < whole * (1.0 + 1e-12)
    else:
        assert 0.045 < missing < 0.12


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("speed", [0.6, 0.0])
def test_walls_move_as_fast_as_the_time_has_it(scenes: dict, kind: str, speed: float) -> None:
    scene = scenes["lid"]
    usual = scene.functional(wall_kind=kind)
    walls = usual.ghosts.walls
    timed, given = (
        Functional(usual.fluid, usual.discretization, scene.domain, of, wall_speed=share)
        for of, share in (
            (walls, lambda time: speed * (time - 1.0)),
            (replace(walls, velocity=speed * walls.velocity), None),
        )
    )
    state = scene.state(5)
    if kind.startswith("printed") and speed == 0.0:
        # As printed, walls that move keep their speed, and those at rest turn the fluid's round: a
        # lid about to start is one of the first.
        assert not np.allclose(timed(state, 2.0), given(state))
    else:
        np.testing.assert_allclose(timed(state, 2.0), given(state), rtol=1e-12, atol=1e-12)
        fields = (state[:2], state[2], state[3:])
        np.testing.assert_allclose(
            timed.advection(*fields, 2.0), given.advection(*fields), rtol=1e-12, atol=1e-12
        )
    assert not np.allclose(timed(state, 2.0), usual(state))
