from __future__ import annotations

import numpy as np
import pytest

from sphrom.scenes.flows import LidDrivenCavity

LENGTH, SPEED = 2.0, 1.5


def test_regularised_lid_is_flat_amid_and_vanishes_at_its_ends() -> None:
    scene = LidDrivenCavity(1.0, 1.0)
    x = np.array([0.0, 0.5, 1.0, 0.9])
    assert scene.lid_velocity(x) == pytest.approx([0.0, 1.0, 0.0, (1.0 - 0.8**14) ** 2])
    across = np.linspace(0.0, 1.0, 101)
    assert scene.lid_velocity(across) == pytest.approx(scene.lid_velocity(1.0 - across))
    assert np.all(scene.lid_velocity(across[40:61]) > 0.999999)


@pytest.mark.parametrize("lid", ["regularised", "uniform"])
def test_only_ghosts_above_the_box_move_and_only_along_it(lid: str) -> None:
    """Beside corners that stand."""
    scene = LidDrivenCavity(LENGTH, SPEED, lid)  # type: ignore[arg-type]
    walls = scene.domain.ghosts(0.2, 4).moving(scene.wall_velocity)
    x, y = walls.position.T
    above = (y > LENGTH) & (x > 0.0) & (x < LENGTH)
    assert np.count_nonzero(above) == 40
    assert np.array_equal(walls.velocity[:, 0] > 0.0, above)
    assert not walls.velocity[:, 1].any()
    if lid == "uniform":
        assert set(walls.velocity[:, 0]) == {0.0, SPEED}


def test_a_ramp_is_smooth_at_both_ends() -> None:
    scene = LidDrivenCavity(LENGTH, SPEED, ramp=0.4)
    share = scene.wall_amplitude
    assert share is not None
    assert [share(t) for t in (0.0, 0.1, 0.2, 0.3, 0.4, 7.0)] == pytest.approx(
        [0.0, 0.5 - 0.125**0.5, 0.5, 0.5 + 0.125**0.5, 1.0, 1.0]
    )
    times = np.linspace(0.0, 0.5, 501)
    slopes = np.diff([share(t) for t in times]) / np.diff(times)
    assert slopes.min() >= 0.0
    assert slopes.max() == pytest.approx(0.5 * np.pi / 0.4, rel=1e-4)
    assert np.abs(np.diff(slopes)).max() < 0.01 * slopes.max()
    # Walls are given their full velocity, and flows are driven as their walls are.
    still = LidDrivenCavity(LENGTH, SPEED)
    x = np.linspace(0.0, LENGTH, 9)
    assert scene.lid_velocity(x) == pytest.approx(still.lid_velocity(x))
    assert scene.amplitude is not None
    assert scene.amplitude(0.1) == share(0.1)
