from __future__ import annotations

import numpy as np
import pytest

from sphrom.scenes.flows import LogisticForce, OpenCavity

PAPER = LogisticForce(switch_time=0.01, sustained_share=0.001)


def test_fluid_fills_channel_and_cavity() -> None:
    domain = OpenCavity().domain
    assert (domain.lower, domain.upper) == ((0.0, 0.0), (0.4, 0.2))
    assert domain.periodic == (True, False)
    assert domain.area == pytest.approx(0.06)
    inside = [(0.05, 0.15), (0.2, 0.05), (0.45, 0.15), (0.101, 0.001), (-0.01, 0.199)]
    outside = [(0.05, 0.05), (0.35, 0.099), (0.2, -0.01), (0.2, 0.21), (0.46, 0.05)]
    assert domain.contains(np.array(inside)).all()
    assert not domain.contains(np.array(outside)).any()


def test_force_as_printed() -> None:
    """Eq. 4.5 with its constants, where f = -t."""
    for time in (0.0, 0.004, 0.01, 0.05):
        printed = 100.0 * (1.0 / (1.0 + np.exp(-400.0 * (-time + 0.01))) + 0.001)
        assert PAPER(time) == pytest.approx(printed, rel=1e-12)
    assert PAPER(0.0) == pytest.approx(98.3, abs=0.05)
    assert PAPER(0.01) == pytest.approx(50.1)
    assert PAPER(1.0) == pytest.approx(0.1)


@pytest.mark.parametrize(("form", "ends"), [("kick", (100.58, 0.58)), ("ramp-up", (0.58, 100.58))])
def test_our_force_keeps_a_share_of_its_magnitude(form: str, ends: tuple[float, float]) -> None:
    force = LogisticForce(form=form)  # type: ignore[arg-type]
    assert (force(0.0), force(5.0)) == pytest.approx(ends, abs=0.01)


@pytest.mark.parametrize("form", ["kick", "ramp-up"])
def test_force_never_overflows_nor_passes_its_bound(form: str) -> None:
    force = LogisticForce(rate=1e6, form=form)  # type: ignore[arg-type]
    with np.errstate(all="raise"):
        values = [force(time) for time in (0.0, 1e-3, 1.0, 1e9)]
    assert max(values) <= force.largest


def test_force_acts_along_x_above_the_cavity_only() -> None:
    scene = OpenCavity()
    above = [(0.1, 0.1), (0.2, 0.15), (0.3, 0.2), (0.6, 0.15), (-0.2, 0.15)]
    elsewhere = [(0.05, 0.15), (0.35, 0.15), (0.2, 0.05), (0.75, 0.15), (-0.05, 0.12)]
    for places, expected in ((above, scene.force(0.02)), (elsewhere, 0.0)):
        acceleration = scene.body_force(np.array(places).T, 0.02)
        assert acceleration.shape == (2, 5)
        assert acceleration[0] == pytest.approx(expected)
        assert not acceleration[1].any()


def test_force_follows_the_geometry() -> None:
    scene = OpenCavity(channel_length=1.0, cavity_length=0.5, cavity_height=0.3)
    x = np.array([0.2499, 0.2501, 0.7499, 0.7501])
    pushed = scene.body_force(np.stack((x, np.full(4, 0.35))), 0.0)[0] > 0.0
    assert pushed.tolist() == [False, True, True, False]
    y = np.array([0.2999, 0.3001, 0.3999])
    pushed = scene.body_force(np.stack((np.full(3, 0.5), y)), 0.0)[0] > 0.0
    assert pushed.tolist() == [False, True, True]
