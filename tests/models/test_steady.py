"""Steady states: found or not, it is written and said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import Mock, patch

import numpy as np
import pytest

from sphrom.artifacts import ArtifactWriter
from sphrom.console import Reporter
from sphrom.models.points.error_estimates import SteadyErrors, distance_from
from sphrom.models.points.fast_model import FastRun
from sphrom.models.points.runs import seek_steady_state
from sphrom.reduction.reduced_operators import Polynomial

NEAR = np.array([[1.01], [-1.01], [2.01]])
"""Training states near the roots that are looked for."""


def polynomial(constant: float) -> Polynomial:
    """Return da/dt = constant + a^2, which vanishes at a = -1 and a = 1 for a constant of -1."""
    return Polynomial(((np.array([constant]), np.zeros((1, 1)), np.ones((1, 1, 1))),))


def sought(
    rates: Polynomial,
    start: float,
    amplitude: float = 0.0,
    *,
    trained: np.ndarray = NEAR,
    estimated: SteadyErrors | None = None,
    measured: Callable[[np.ndarray], dict[str, Any]] = lambda states: {},
) -> tuple[dict[str, Any], Mock]:
    """Return what was written, by name, and the reporter that was told."""
    artifact, reporter, model = Mock(spec=ArtifactWriter), Mock(spec=Reporter), Mock()
    model.workspace.context.report = reporter
    model.section.name, model.at_point.return_value.states = "x", trained
    driven = lambda times: np.full(len(times), amplitude)  # noqa: E731
    run = FastRun(
        time=np.array([0.0, 1.0]),
        coordinates=np.array([[0.0], [start]]),
        time_step=1.0,
        diverged_at=np.nan,
        model=model,
        point=Mock(label="here"),
        reduced=Mock(polynomial=rates, amplitudes=driven),
    )
    quantities = "sphrom.models.points.fast_model.quantities_of"
    with (
        patch("sphrom.models.points.runs.steady_errors", return_value=estimated),
        patch(quantities, lambda case, reduced, time, states: measured(states)),
    ):
        seek_steady_state(run, artifact)
    calls = artifact.write.call_args_list + artifact.annotate.call_args_list
    return {call.args[0]: call.args[1] for call in calls}, reporter


@pytest.mark.parametrize(("start", "root"), [(3.0, 1.0), (-0.5, -1.0)])
def test_found(start: float, root: float) -> None:
    written, reporter = sought(polynomial(-1.0), start)
    assert written["steady/status"] == "converged"
    np.testing.assert_allclose(written["steady/coordinates"], [root])
    assert written["steady/largest_real_part"] == pytest.approx(2.0 * root)
    assert written["steady/residual"] < 1e-9
    assert written["timing/steady"] > 0.0
    assert written["steady/training_distance"] == pytest.approx(0.01)
    reporter.warn.assert_not_called()


@pytest.mark.parametrize(("distance", "warned"), [(0.6, True), (0.02, False)])
def test_one_that_is_far_from_training_is_warned_of(distance: float, warned: bool) -> None:
    """Though the rates vanish to rounding; it may also be near to a state between training runs."""
    found = SteadyErrors(3.0, np.array([0.2, 5.0]), np.array([0.4, 0.5]), distance)
    written, reporter = sought(polynomial(-1.0), 3.0, trained=np.array([[0.6]]), estimated=found)
    assert written["steady/training_distance"] == pytest.approx(min(distance, 0.4))
    assert written["steady/residual_left_out"] == 3.0
    assert written["steady/velocity_error_estimate"] == 0.2
    assert written["steady/pressure_error_estimate"] == 5.0
    (text,) = (reporter.warn if warned else reporter.info).call_args.args
    assert "estimated errors: velocity 40.0 %, pressure 50.0 %" in text
    assert reporter.warn.called == warned


def test_what_is_measured_there_is_written_and_said() -> None:
    written, reporter = sought(
        polynomial(-1.0),
        3.0,
        measured=lambda states: {
            "drag": {"force": 2.0 * states[:, [0, 0]], "torque": -states[:, 0]},
            "flux": {"flow_rate": 3.0 * states[:, 0]},
            "line": {"velocity": np.ones((1, 5, 2)), "pressure": np.ones((1, 5))},
        },
    )
    np.testing.assert_allclose(written["steady/measure/drag/force"], [2.0, 2.0])
    assert written["steady/measure/drag/torque"] == pytest.approx(-1.0)
    assert written["steady/measure/flux/flow_rate"] == pytest.approx(3.0)
    assert written["steady/measure/line/velocity"].shape == (5, 2)
    said = [call.args[0] for call in reporter.info.call_args_list]
    assert "x, here: flux in the steady state: flow rate 3.00 m2/s" in said
    assert not any("line in" in text for text in said)


def test_distances_are_those_of_the_nearest_state() -> None:
    states = np.array([[3.0, 0.0], [0.0, 4.0], [3.0, 4.5]])
    assert distance_from(states, np.array([3.0, 4.0])) == pytest.approx(0.1)


def test_of_a_driven_flow_it_is_that_of_the_amplitude() -> None:
    driven = Polynomial((polynomial(0.0).powers[0], (np.array([-2.0]), np.zeros((1, 1)))))
    written, _ = sought(driven, 3.0, 2.0)
    np.testing.assert_allclose(written["steady/coordinates"], [2.0])


def test_not_found_is_said() -> None:
    written, reporter = sought(polynomial(1.0), 0.3)
    assert written["steady/status"] == "not converged"
    assert written["steady/residual"] >= 1.0
    reporter.info.assert_not_called()
    assert "not converged" in reporter.warn.call_args.args[0]
