"""From a case to numerics: each kind of scene becomes the flow that it names."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.measures import Samples
from sphrom.scenes.flows import LidDrivenCavity, LogisticForce, OpenCavity, TaylorGreen
from sphrom.setup import particles
from sphrom.setup.assembly import without_air


def test_taylor_green(case_of) -> None:
    case = case_of("taylor-green", scene={"pressure_sign": "paper"})
    point = case.plan.points[0]
    flow = case.plan.flow(point)
    assert flow == TaylorGreen(1.0, 1.0, 1000.0, 0.01, pressure_sign=-1.0)
    assert case.plan.flow(point).exact == TaylorGreen(1.0, 1.0, 1000.0, 0.01)
    functional = particles.functional(case, point)
    assert functional.ghosts is None
    assert functional.body_force is None
    assert functional.discretization.shifting_transport == "advective"


def test_lid_driven_cavity(case_of) -> None:
    case = case_of("lid-driven-cavity", scene={"lid": "uniform"}, fluid={"reference_speed": 3.0})
    point = case.plan.points[0]
    assert case.plan.flow(point) == LidDrivenCavity(1.0, 3.0, "uniform")
    assert case.plan.flow(point).exact is None
    functional = particles.functional(case, point)
    assert functional.ghosts is not None
    assert len(functional.ghosts.walls.position) == 48**2 - 40**2
    assert functional.ghosts.walls.velocity[:, 0].max() == 3.0
    assert functional.discretization.wall_kind == "mirrored"
    assert not functional.discretization.free_slip
    assert functional.discretization.acoustic_damping == 1.0
    assert functional.discretization.shifting_transport == "advective"
    assert functional.discretization.fixed_volume


def test_open_cavity(case_of) -> None:
    force = {"switch_time": 0.01, "sustained_share": 0.001}
    case = case_of("open-cavity", scene={"body_force": force})
    point = case.plan.points[0]
    assert case.plan.flow(point) == OpenCavity(force=LogisticForce(**force))
    assert case.plan.flow(point).exact is None
    functional = particles.functional(case, point)
    assert functional.body_force is not None
    pushed = functional.body_force(np.array([[0.2, 0.2], [0.15, 0.05]]), 0.0)
    assert pushed[0] == pytest.approx([98.3, 0.0], abs=0.05)


@pytest.mark.parametrize("kind", ["taylor-green", "lid-driven-cavity", "open-cavity"])
def test_a_case_and_its_flow_agree_on_where_the_fluid_is(case_of, kind: str) -> None:
    case = case_of(kind)
    flow = case.plan.flow(case.plan.points[0])
    assert case.scene.domain == flow.domain
    if flow.body_force is not None:
        push = flow.body_force(flow.domain.fill(case.plan.particle_spacing).T, 0.0)
        assert case.scene.largest_head(1.0) == pytest.approx(0.1 * push.max(), rel=0.1)
    else:
        assert case.scene.largest_head(1.0) == 0.0


@pytest.mark.parametrize(
    ("kind", "length", "sound_speed"),
    [("taylor-green", 1.0, 10.0), ("lid-driven-cavity", 1.0, 10.0), ("open-cavity", 0.4, 20.0)],
)
def test_the_longest_standing_wave_has_a_half_of_its_length_in_the_box(
    case_of, kind: str, length: float, sound_speed: float
) -> None:
    """Between walls L apart sound stands at c0 / (2 L), c0 / L, ..."""
    period = case_of(kind).plan.longest_sound_period
    assert period == pytest.approx(2.0 * length / sound_speed, rel=1e-12)


def test_samples_above_a_free_surface_have_no_value(case_of) -> None:
    samples = Samples(np.zeros(1), np.array([[[1.0, 0.0], [0.0, 0.0]]]), np.array([[2.0, 0.0]]))
    box = {"box": {"lower": [0, 0], "upper": [1, 1]}}
    tank = box | {"fluid": {"level": 0.5, "gravity": 1.0}, "reference_length": 0.5}
    shown = without_air(case_of("custom", scene=tank), samples)
    np.testing.assert_array_equal(np.isnan(shown.pressure), [[False, True]])
    np.testing.assert_array_equal(np.isnan(shown.speed), [[False, True]])
    # Without a free surface, zeros are of fluid at rest.
    assert without_air(case_of("lid-driven-cavity"), samples) is samples
