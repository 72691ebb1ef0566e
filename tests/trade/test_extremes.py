from __future__ import annotations

from dataclasses import replace

import pytest

from sphrom.case.checks import case_problems
from sphrom.case.models import Case
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError
from sphrom.plots.canvas import save
from sphrom.sph.fluid import COURANT_LIMIT
from sphrom.trade import extremes
from sphrom.trade.candidates import extreme_points
from sphrom.trade.extremes import (
    AXES,
    ExtremeRow,
    draw_extremes,
    learnt,
    state_of,
    varied_models,
)

MODELS = [ReducedModelSection(name="one", evaluation="operators", n_modes=3)]


@pytest.mark.parametrize(
    ("error", "growth", "state"),
    [
        (9.0, 100.0, "stable"),
        (11.0, 1.0, "inaccurate"),
        (None, extremes.MOST_GROWTH, "stable"),
        (None, 1.1 * extremes.MOST_GROWTH, "inaccurate"),
    ],
)
def test_states(error, growth, state):
    assert state_of(error, growth) == state


def test_a_map_has_a_marker_for_each_run(tmp_path):
    rows = [
        ExtremeRow(
            parameters="a",
            varied=varied,
            value=value,
            n_modes=n_modes,
            projection="galerkin",
            calibrated=False,
            state=state,
        )
        for varied, value, n_modes, state in [
            ("time step", 0.5, 2, "stable"),
            ("time step", 2.0, 2, "unstable"),
            ("time step", 0.5, 5, "inaccurate"),
            ("h/dx", 1.0, 2, "full unstable"),
            ("h/dx", 1.0, 2, "refused"),
        ]
    ]
    figure = draw_extremes(rows)
    first, second, *_ = figure.axes
    drawn = {line.get_label(): line.get_xydata().tolist() for line in first.get_lines()}
    assert {name: places for name, places in drawn.items() if places} == {
        "stable": [[0.5, 2.0]], "unstable": [[2.0, 2.0]], "inaccurate": [[0.5, 5.0]],
    }  # fmt: skip
    assert second.get_xlabel() == "h/dx [–]"
    save(figure, tmp_path / "extremes.png")


def case() -> Case:
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
        }
    )


def test_values_reach_out_of_the_trained_range():
    assert [p.reynolds for p in extreme_points(case())] == [10.0, 30.0, 200.0, 600.0, 2000.0]


@pytest.fixture
def variant_of(monkeypatch):
    """The full model with another value of a property."""

    def vary(what: str, value: float) -> Case:
        monkeypatch.setitem(AXES, what, replace(AXES[what], values=(value,)))
        return varied_models(case(), MODELS)[what, value]

    return vary


@pytest.mark.parametrize(
    ("what", "value"), [("Mach number", 0.02), ("Mach number", 0.3), ("h/dx", 1.3), ("h/dx", 3.9)]
)
def test_a_variant_is_the_case_but_for_one_thing(variant_of, what, value):
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
    step = other.plan.steps.time_step
    courant = other.plan.steps.time_step * other.plan.sound_speed / other.plan.smoothing_length
    assert courant == pytest.approx(step / mach / (ratio / 16))
    assert courant <= own.time.courant_number * 1.000001 < COURANT_LIMIT
    assert [(model.name, model.basis) for model in other.rom] == [("one", "all")]


def test_a_support_wider_than_the_box_is_refused(variant_of):
    variant = variant_of("h/dx", 4.5)
    with pytest.raises(CaseError, match="smoothing_length_ratio: a support of radius"):
        learnt(None, variant, "h/dx 4.5")  # type: ignore[arg-type]
