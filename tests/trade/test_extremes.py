from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sphrom.case.checks import case_problems
from sphrom.case.model_sections import PointModelSection
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS
from sphrom.models.stable_ranges import MEMORY, STEP, TIME, StableRange
from sphrom.plots.panels import save
from sphrom.reduction.polynomial_model import OutputTimes
from sphrom.reduction.reduced_operators import Polynomial
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis
from sphrom.sph.fluid import COURANT_LIMIT
from sphrom.trade.candidates import FULL_MODEL, varied_models
from sphrom.trade.causes import growth, kind_of, limiting_step, longest_memory
from sphrom.trade.stability import ExtremeRun, draw_maps, judge, ranges_in


def fast(
    varied: str, value: float, errors: tuple[float, float] | None = None, **more
) -> ExtremeRun:
    velocity, pressure = errors or (None, None)
    given = {"parameters": "reynolds=150", "kind": "fast", "steps": "exponential"}
    given |= {"projection": "galerkin", "n_modes": 5} | more
    return ExtremeRun(
        varied=varied, value=value, velocity_error=velocity, pressure_error=pressure, **given
    )


OWN = {REYNOLDS: 150.0, "Mach number": 0.1}


def runs() -> list[ExtremeRun]:
    best = {"velocity_best": 0.5, "pressure_best": 5.0}
    full = {"kind": "full", "projection": "", "n_modes": None, "steps": ", half as fine"}
    far = {"velocity_best": 5.0, "pressure_best": 50.0, "extrapolated": True}
    return [
        fast(STEP, 1.0, (1.0, 10.0), time_step=0.1, **best),
        fast(STEP, 4.0, (1.0, 21.0), time_step=0.4, **best),
        fast(STEP, 1.0, (1.0, 25.0), steps="runge-kutta", time_step=0.01, predicted=1.1, **best),
        fast(STEP, 2.0, steps="runge-kutta", time_step=0.02, state="unstable", mechanism="sound"),
        fast(REYNOLDS, 50.0, (2.1, 10.0), parameters="reynolds=50", **far),
        fast(REYNOLDS, 150.0, (1.0, 10.0), **best),
        fast(REYNOLDS, 400.0, (1.9, 19.0), parameters="reynolds=400", **best),
        fast(REYNOLDS, 150.0, (3.0, 40.0), **full),
        fast(REYNOLDS, 400.0, (7.0, 40.0), **full | {"parameters": "reynolds=400"}),
        fast("Mach number", 0.1, (4.0, 40.0), velocity_best=1.0, pressure_best=1.0),
        fast("Mach number", 0.4, state="refused"),
    ]  # fmt: skip


def test_runs_are_right_within_twice_the_errors_of_the_default() -> None:
    found = runs()
    judge(found, ("galerkin", 5), OWN)
    assert [(run.state, run.mechanism) for run in found] == [
        ("right", ""), ("stable", "convection"), ("stable", "sound"), ("unstable", "sound"),
        ("stable", "extrapolated modes"), ("right", ""), ("right", ""),
        ("right", ""), ("stable", "spacing"), ("right", ""), ("refused", ""),
    ]  # fmt: skip


def test_ranges_reach_to_the_last_run_that_is_right() -> None:
    found = runs()
    judge(found, ("galerkin", 5), OWN)
    ranges = {(r.varied, r.kind, r.steps): r for r in ranges_in(found, ("galerkin", 5), OWN)}
    parameter = ranges[REYNOLDS, "fast", "exponential"]
    assert (parameter.right_from, parameter.right_to) == (150.0, 400.0)
    assert (parameter.stable_from, parameter.stable_to) == (50.0, 400.0)
    assert (parameter.below, parameter.above) == ("extrapolated modes", "")
    steps = ranges[STEP, "fast", "runge-kutta"]
    assert (steps.right_from, steps.stable_to, steps.above) == (None, 0.01, "sound")
    assert steps.predicted == pytest.approx(0.011)
    mach = ranges["Mach number", "fast", "exponential"]
    assert (mach.stable_to, mach.greatest, mach.is_unstable) == (0.1, 0.4, True)


RANGE = StableRange(
    varied=TIME, kind="fast", projection="galerkin", n_modes=5, steps="exponential",
    right_from=1.0, right_to=2.0, stable_from=1.0, stable_to=5.0, least=1.0, greatest=10.0,
    below="", above="extrapolated rates", predicted=None, predicted_by="",
)  # fmt: skip


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (1.5, ""),
        (3.0, "right for a time from 1.00 to 2.00 s; beyond: extrapolated rates"),
        (7.0, "stable for a time from 1.00 to 5.00 s; beyond: extrapolated rates"),
        (0.5, "stable for a time from 1.00 to 5.00 s, and was not tried beyond"),
    ],
)
def test_a_range_says_what_speaks_against_a_value(value, words):
    assert RANGE.says(value) == (words and f"according to its map it is {words}")


def test_a_model_that_is_right_nowhere_says_so():
    nowhere = replace(RANGE, right_from=None, right_to=None)
    assert nowhere.says(1.5).endswith("its map it is right at no time")
    assert replace(RANGE, stable_from=None).says(1.5).endswith("it is stable at no time")


def model(linear: list[list[float]]) -> ReferenceModel:
    """A linear model of two modes on one point: the first all pressure, the second all velocity."""
    basis = TrialBasis(
        density_modes=np.array([[1.0], [0.0]]),
        velocity_modes=np.array([[[0.0, 0.0]], [[1.0, 0.0]]]),
        singular_values={},
        weights=np.ones(1),
        gram_error=0.0,
        inner_product=InnerProduct.acoustic(1000.0, 10.0),
    )
    rates = Polynomial(((np.zeros(2), np.array(linear)),))
    times = OutputTimes(0.1, 11)
    return ReferenceModel(rates, basis, np.array([1.0, 1.0]), times, states=np.ones((1, 2)))


@pytest.mark.parametrize(
    ("linear", "name", "limit"),
    [
        ([[0.0, -50.0], [50.0, 0.0]], "sound", 2.0 * math.sqrt(2.0) / 50.0),
        ([[-1.0, 0.0], [0.0, -50.0]], "viscosity", 2.7853 / 50.0),
    ],
)
def test_an_eigenvector_limits_runge_kutta_steps(linear, name, limit):
    found, step = limiting_step(model(linear))
    assert (found, step) == (name, pytest.approx(limit, rel=1e-4))


def test_an_oscillation_of_the_velocity_is_convection():
    basis = model([[0.0, 0.0], [0.0, 0.0]]).basis
    assert kind_of(basis, -1.0 + 50.0j, np.array([0.1, 1.0])) == "convection"


def test_growth_in_the_last_modes_is_due_to_noise():
    for rates, name in (([3.0, 1.0], "aliasing"), ([1.0, 2.0], "noise modes")):
        found = growth(model(np.diag(rates)), np.ones((1, 2)))
        assert found == (pytest.approx(max(rates)), name)


def test_errors_have_the_name_of_their_cause():
    full = {"kind": "full", "projection": "", "n_modes": None}
    best, wrong = {"velocity_best": 0.5, "pressure_best": 5.0}, (9.0, 99.0)
    named = {
        "": fast(STEP, 1.0, (1.0, 10.0), **best),
        "none": fast(STEP, 1.0, (3.0, 40.0), **full, steps=", half as fine"),
        "compressibility": fast("Mach number", 0.3, wrong, **full),
        "smoothing": fast("h/dx", 4.0, wrong, **full),
        "viscosity": fast(STEP, 2.0, wrong, **full, mechanism="viscosity"),
        "modes": fast(TIME, 2.0, wrong, velocity_best=9.0, pressure_best=5.0),
        "rates": fast(TIME, 3.0, wrong, **best),
        "extrapolated rates": fast(TIME, 4.0, wrong, **best, extrapolated=True),
        "own": fast(MEMORY, 1.0, (1.0, 10.0), **best),
        "closure": fast(MEMORY, 4.0, wrong, **best),
        "convection": fast(STEP, 4.0, wrong, **best, steps="runge-kutta"),
        "sound": fast(STEP, 3.0, (1.0, 99.0), **best, steps="runge-kutta"),
    }
    judge(list(named.values()), ("galerkin", 5), OWN)
    stable = {name: run.mechanism for name, run in named.items() if run.state == "stable"}
    assert stable == {name: name for name in named.keys() - {"", "none", "own"}}


def test_the_longest_memory_is_where_something_grows():
    """The closure adds 0.1 f to a rate of 1: over a second, exp(0.1 f) is 3 at f = 10.99."""
    near, far = model([[1.1, 0.0], [0.0, -1.0]]), model([[1.2, 0.0], [0.0, -1.0]])
    longest = longest_memory(near, far)
    assert longest == pytest.approx(10.99, rel=0.13)
    still = model([[-1.0, 0.0], [0.0, -1.0]])
    assert longest_memory(still, still) is None


def test_a_map_has_a_cell_for_each_run(tmp_path):
    found = runs()
    judge(found, ("galerkin", 5), OWN)
    figure = draw_maps(found)
    assert [axes.get_title() for axes in figure.axes[:3]] == [
        "time step over the automatic one", REYNOLDS, "Mach number",
    ]  # fmt: skip
    assert sum(len(axes.patches) for axes in figure.axes) == len(found)
    words = [text.get_text() for text in figure.axes[0].texts]
    assert words == ["1.0 / 10", "1.0 / 21\nconvection", "1.0 / 25\nsound", "sound"]
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


@pytest.mark.parametrize(
    ("what", "value", "resolution"),
    [("Mach number", 0.02, 16), ("Mach number", 0.3, 16), ("h/dx", 1.3, 16), ("h/dx", 3.9, 16),
     ("resolution", 20.0, 20)],
)  # fmt: skip
def test_a_variant_is_the_case_but_for_one_thing(monkeypatch, what, value, resolution):
    for name, (section, key, _) in FULL_MODEL.items():
        values = (value,) if name == what else ()
        monkeypatch.setitem(FULL_MODEL, name, (section, key, values))
    own, models = case(), [PointModelSection(name="one", evaluation="operators", n_modes=3)]
    points = own.plan.bases["low"], own.plan.test_points[0]
    ((varied, at, other),) = varied_models(own, points, models)
    assert (varied, at, other.discretization.resolution) == (what, value, resolution)
    assert not case_problems(other)
    mach = value if what == "Mach number" else 0.1
    assert other.plan.sound_speed == pytest.approx(1.0 / mach)
    ratio = value if what == "h/dx" else 2.0
    assert other.plan.smoothing_length == pytest.approx(ratio / resolution)
    # It learns where the first basis does, and from as many snapshots at the same times.
    assert [point.reynolds for point in other.plan.points] == [100, 200, 150]
    assert other.plan.bases.keys() == {"all"}
    assert other.plan.steps.n_snapshots == own.plan.steps.n_snapshots
    assert other.plan.steps.snapshot_interval == pytest.approx(own.plan.steps.snapshot_interval)
    courant = other.plan.steps.time_step * other.plan.sound_speed / other.plan.smoothing_length
    assert courant <= own.time.courant_number * 1.000001 < COURANT_LIMIT
    assert [(model.name, model.basis) for model in other.rom] == [("one", "all")]
    # Where the models are judged at a trained value, it isn't tested too.
    ((_, _, untested),) = varied_models(own, (points[0], points[0][0]), models)
    assert untested.plan.test_points == ()
