from __future__ import annotations

from typing import Any

import pytest

from sphrom.case.checks import case_problems
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError
from sphrom.sph.fluid import COURANT_LIMIT
from sphrom.trade.full import Variant
from sphrom.trade.variants import Varied, learnt, variant_of, varied_models

MODELS = [ReducedModelSection(name="one", evaluation="operators", n_modes=3)]


def case(**extremes: Any) -> Case:
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
            "trade": {"extremes": extremes},
        }
    )


@pytest.mark.parametrize(
    ("what", "value"), [("Mach number", 0.02), ("Mach number", 0.3), ("h/dx", 1.3), ("h/dx", 3.9)]
)
def test_a_variant_is_the_case_but_for_one_thing(what, value):
    own, variant = case(), variant_of(case(), MODELS, what, value)
    other = variant.case
    assert not case_problems(other)
    assert other.discretization.resolution == 16
    mach = value if what == "Mach number" else 0.1
    assert other.sound_speed == pytest.approx(1.0 / mach)
    ratio = value if what == "h/dx" else 2.0
    assert other.smoothing_length == pytest.approx(ratio / 16)
    # It learns where the first basis does, and from as many snapshots at the same times.
    assert [point.reynolds for point in other.points] == [100, 200]
    assert other.bases.keys() == {"all"}
    assert step_plan(other).n_snapshots == step_plan(own).n_snapshots
    assert step_plan(other).snapshot_interval == pytest.approx(step_plan(own).snapshot_interval)
    assert variant.courant_number <= own.time.courant_number * 1.000001 < COURANT_LIMIT
    assert other.rom == tuple(MODELS)


def test_a_courant_number_is_what_sound_goes_in_a_step_over_h():
    own = case()
    step = step_plan(own).time_step
    assert Variant("x", own).courant_number == pytest.approx(step * 10.0 / (2.0 / 32), rel=1e-12)


def test_long_runs_are_cut():
    own = case(max_steps=60)
    plain = variant_of(own, MODELS, "Mach number", 0.2).case
    cut = variant_of(own, MODELS, "Mach number", 0.02).case
    assert plain.time.final_time == pytest.approx(0.4)
    assert cut.time.final_time == pytest.approx(0.4 * 60 / 135)
    assert cut.compare.from_time == pytest.approx(0.25 * cut.time.final_time)
    assert step_plan(cut).n_snapshots == step_plan(plain).n_snapshots
    assert step_plan(cut).n_steps <= 60 + step_plan(cut).n_snapshots
    assert not case_problems(cut)


def test_the_time_of_a_full_run_is_in_its_name():
    listed = varied_models(
        case(max_steps=60, mach_numbers=[0.2, 0.02], smoothing_length_ratios=[]), MODELS
    )
    assert [(each.what, each.value) for each in listed] == [
        ("Mach number", 0.02), ("Mach number", 0.2),
    ]  # fmt: skip
    cut, whole = (each.full_run for each in listed)
    assert whole == "full run, 16 across, to 0.4 s"
    assert cut == f"full run, 16 across, to {0.4 * 60 / 135:.4g} s"


def test_a_support_wider_than_the_box_is_refused():
    variant = variant_of(case(), MODELS, "h/dx", 4.5)
    with pytest.raises(CaseError, match="smoothing_length_ratio: a support of radius"):
        learnt(None, Varied("h/dx", 4.5, variant))  # type: ignore[arg-type]
