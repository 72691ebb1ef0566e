from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sphrom.case.checks import case_problems
from sphrom.case.models import Case
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError
from sphrom.plots.canvas import save
from sphrom.reduction.polynomial_model import OutputTimes
from sphrom.reduction.reduced_rates import Polynomial, spectrum
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.sph.fluid import COURANT_LIMIT
from sphrom.trade import extremes
from sphrom.trade.extremes import (
    STATES,
    ExtremeRow,
    StabilityMap,
    draw_stability,
    learnt,
    run_in_steps,
    state_of,
)
from sphrom.trade.models import courant_number, extreme_points, varied_models

MODELS = [ReducedModelSection(name="one", evaluation="operators", n_modes=3)]


def row(**changes: Any) -> ExtremeRow:
    keys: dict[str, Any] = {
        "parameters": "a",
        "varied": "time step",
        "value": 1.0,
        "n_modes": 2,
        "projection": "galerkin",
        "calibrated": False,
        "state": "stable",
        "velocity_error": math.pi,
        "compared_with": "full run",
    }
    return ExtremeRow(**keys | changes)


@pytest.mark.parametrize(
    ("error", "growth", "state"),
    [
        (None, None, "unstable"),
        (9.0, 100.0, "stable"),
        (11.0, 1.0, "inaccurate"),
        (None, extremes.MOST_GROWTH, "stable"),
        (None, 1.1 * extremes.MOST_GROWTH, "inaccurate"),
    ],
)
def test_states(error, growth, state):
    assert state_of(error, growth) == state


def test_a_map_has_a_field_for_each_run(tmp_path):
    states = [(2, 0.5, "stable"), (2, 2.0, "unstable"), (5, 0.5, "inaccurate")]
    rows = [row(n_modes=n, value=value, state=state) for n, value, state in states]
    lost = [row(value=0.1, state="full unstable"), row(value=0.2, state="refused")]
    maps = [StabilityMap(rows), *[StabilityMap(lost)] * 4]
    figure = draw_stability(maps)
    first, second, *_ = figure.axes
    assert len(first.patches) == 3
    assert [text.get_text() for text in first.texts] == [STATES[s][1] for *_, s in states]
    assert len(second.patches) == 2
    assert [axes.axison for axes in figure.axes] == [True] * 5 + [False] * 3
    save(figure, tmp_path / "extremes.png")


def case(**listed: Any) -> Case:
    return Case.model_validate(
        {
            "name": "x",
            "scene": {"kind": "taylor-green"},
            "discretization": {"resolution": 32, "smoothing_length_ratio": 2.0},
            "time": {"final_time": 0.4},
            "snapshots": {"every": 2},
            "parameters": {
                "train": {"reynolds": [100, 200, 300]},
                "test": {"reynolds": [150]},
            },
            "basis": {"subsets": {"low": {"reynolds": [100, 200]}}, "lagrangian": True},
            "rom": [{"name": "fast", "evaluation": "operators", "basis": "low", "n_modes": 3}],
            "compare": {"from_time": 0.1},
            "trade": {"extremes": listed},
        }
    )


def test_values_reach_out_of_the_trained_range():
    values = [p.reynolds for p in extreme_points(case(reynolds_factors=[10.0, 0.1, 1.0, 0.5]))]
    assert values == pytest.approx([10.0, 50.0, 200.0, 2000.0])


def variant_of(what: str, value: float) -> Case:
    key = "mach_numbers" if what == "Mach number" else "smoothing_length_ratios"
    return varied_models(case(**{key: [value]}), MODELS)[what, value]


@pytest.mark.parametrize(
    ("what", "value"), [("Mach number", 0.02), ("Mach number", 0.3), ("h/dx", 1.3), ("h/dx", 3.9)]
)
def test_a_variant_is_the_case_but_for_one_thing(what, value):
    own, other = case(), variant_of(what, value)
    assert not case_problems(other)
    assert other.discretization.resolution == 16
    mach = value if what == "Mach number" else 0.1
    assert other.plan.sound_speed == pytest.approx(1.0 / mach)
    ratio = value if what == "h/dx" else 2.0
    assert other.plan.smoothing_length == pytest.approx(ratio / 16)
    # It learns where the first basis does, and from as many snapshots at the same times.
    assert [point.reynolds for point in other.plan.points] == [100, 200]
    assert other.plan.bases.keys() == {"all"}
    assert other.plan.steps.n_snapshots == own.plan.steps.n_snapshots
    assert other.plan.steps.snapshot_interval == pytest.approx(own.plan.steps.snapshot_interval)
    assert courant_number(other) <= own.time.courant_number * 1.000001 < COURANT_LIMIT
    assert other.rom == tuple(MODELS)


def test_the_courant_number_is_the_way_of_sound_in_a_step_over_h():
    own = case()
    step = own.plan.steps.time_step
    assert courant_number(own) == pytest.approx(step * 10.0 / (2.0 / 32), rel=1e-12)


def test_a_support_wider_than_the_box_is_refused():
    variant = variant_of("h/dx", 4.5)
    with pytest.raises(CaseError, match="smoothing_length_ratio: a support of radius"):
        learnt(None, variant, "h/dx 4.5")  # type: ignore[arg-type]


def decaying(interval: float = 0.05, n_snapshots: int = 41) -> ReferenceModel:
    """Return two coordinates that turn into one another while both decay."""
    linear = np.array([[-1.0, -5.0], [5.0, -1.0]])
    return ReferenceModel(
        polynomial=Polynomial(((np.zeros(2), linear),)),
        basis=None,  # type: ignore[arg-type]
        start=np.array([1.0, 0.0]),
        mean_density_fluctuation=0.0,
        step_limit=spectrum(linear).step_limit,
        output_times=OutputTimes(interval, n_snapshots, 3.0, 10.0),
    )


@pytest.mark.parametrize("time_step", [0.01, 0.0137, 0.1, 0.3])
def test_steps_need_not_divide_snapshots(time_step):
    runs = run_in_steps(decaying(), time_step)
    passed = 0.05 * np.arange(41)
    exact = np.exp(-passed) * np.array([np.cos(5.0 * passed), np.sin(5.0 * passed)])
    # Eq. 2.18 is of fourth order in the step times the eigenvalue's size, and so are the cubics.
    assert np.abs(runs.coordinates - exact.T).max() < 0.1 * (time_step * 5.1) ** 4
    assert runs.time_step == pytest.approx(time_step)


@pytest.mark.parametrize(("factor", "diverges"), [(0.99, False), (1.1, True)])
def test_the_limit_divides_stable_from_unstable(factor, diverges):
    model = decaying(1.0, 400)
    runs = run_in_steps(model, factor * model.step_limit)
    assert np.isnan(runs.diverged_at) != diverges
    assert diverges or np.linalg.norm(runs.coordinates[-1]) < 1.0
