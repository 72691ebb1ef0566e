"""Sections of studies: fit, trade, and the region of a training."""

from __future__ import annotations

from typing import Any

import pytest

from sphrom.case.discretization_checks import coarser_resolution
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import Region, fast_section, fit_ranges, fit_values, percent, trained_at
from sphrom.case.study_sections import N_CANDIDATES
from sphrom.errors import CaseError

CASE: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [50, 200], "lid": [0.5, 1.0]}},
    "rom": [
        {"name": "slow", "n_modes": 3},
        {"name": "fast", "evaluation": "operators", "n_modes": 3},
        {"name": "other", "evaluation": "operators", "n_modes": 2},
    ],
}


FAST = {"name": "fast", "evaluation": "operators", "n_modes": 3}


def test_what_varies_is_looked_for_where_it_was_trained():
    case = load_case(CASE)
    model = fast_section(case, case.fit.model)
    assert model is not None
    assert model.name == "fast"
    assert fit_ranges(case, model) == {"reynolds": (50.0, 200.0), "lid": (0.5, 1.0)}
    assert fit_values(case, model) == {}


def test_ranges_and_values():
    parameters = {"lid": 0.8, "reynolds": [60, 90]}
    case = load_case({**CASE, "fit": {"model": "other", "parameters": parameters}})
    model = fast_section(case, case.fit.model)
    assert model is not None
    assert model.name == "other"
    assert fit_ranges(case, model) == {"reynolds": (60.0, 90.0)}
    assert fit_values(case, model) == {"lid": 0.8}
    # A parameter with one trained value is fixed, unless the case gives a range.
    case = load_case({**CASE, "parameters": {"train": {"reynolds": [50, 200], "lid": [0.6]}}})
    assert fit_ranges(case, model) == {"reynolds": (50.0, 200.0)}
    assert fit_values(case, model) == {"lid": 0.6}


def test_percentages():
    assert [percent(given, "--noise") for given in ("1%", " 0.5 % ", "2", 3.0)] == [1, 0.5, 2, 3]
    for given in ("", "%", "much", "0%", "-1%", "nan", "1e9%", "1e-300%"):
        with pytest.raises(CaseError, match="--noise: must be a percentage from 1e-06% to"):
            percent(given, "--noise")


def test_half_the_resolution_where_it_fits(load):
    coarse = "discretization: {resolution: 20, smoothing_length_ratio: 2.0}\n"
    assert coarser_resolution(load(coarse)) == 10
    assert coarser_resolution(load(coarse, "discretization.resolution=14")) is None
    assert coarser_resolution(load("discretization: {resolution: 17}\n")) is None


LIDS = {"reynolds": [50, 200], "lid": [0.5, 1.0]}


def case_of(training, **changes):
    return load_case(
        {
            "name": "x",
            "scene": {"kind": "lid-driven-cavity"},
            "discretization": {"resolution": 20},
            "rom": [{"name": "slow", "n_modes": 2}, FAST],
            "training": training,
            **changes,
        }
    )


def test_candidates_fill_the_region_with_its_corners():
    case = case_of(LIDS)
    region = Region(case)
    found = region.candidates()
    assert len(found) == 4 + N_CANDIDATES
    assert all(region.contains(point) for point in found)
    places = region.places(found)
    assert places.min() == 0.0
    assert places.max() == 1.0
    # As many in each half of the logarithm of the Reynolds number.
    assert abs((places[:, 0] < 0.5).mean() - 0.5) < 0.1
    assert [region.point(place) for place in region.places(found[4:])] == found[4:]


def test_further_points_of_the_region_change_no_steps():
    case = case_of(LIDS)
    region = Region(case)
    starts = region.starts(())
    assert len(starts) == 4
    assert case.plan.train_points == tuple(starts)  # no others are given
    before = trained_at(case, starts)
    after = trained_at(case, [*starts, *region.candidates()])
    assert after.plan.steps == before.plan.steps
    assert after.plan.sound_speed == before.plan.sound_speed


def test_only_the_points_from_which_training_starts_are_no_test_points():
    region = {"reynolds": [50, 200]}
    parameters = {"test": {"reynolds": [100]}}
    assert case_of(region, parameters=parameters).plan.test_points == (ParameterPoint(100.0),)
    with pytest.raises(CaseError, match="reynolds=200 is a training value"):
        case_of(region, parameters={"test": {"reynolds": [200]}})


def test_corners_come_first_and_count_once():
    region = Region(case_of({"reynolds": [50, 200]}))
    known = [ParameterPoint(100.0), ParameterPoint(200.0)]
    assert region.starts(known) == [ParameterPoint(re) for re in (50.0, 200.0, 100.0)]
    assert region.contains(ParameterPoint(100.0))
    assert not region.contains(ParameterPoint(201.0))
    assert not region.contains(ParameterPoint(100.0, (("lid", 1.0),)))


def test_without_a_range_the_reynolds_number_is_that_of_the_case():
    parameters = {"train": {"reynolds": [120], "lid": [0.5, 1.0]}}
    case = case_of({"lid": [0.5, 1.0]}, parameters=parameters)
    region = Region(case)
    assert region.starts(()) == [
        ParameterPoint(120.0, (("lid", 0.5),)),
        ParameterPoint(120.0, (("lid", 1.0),)),
    ]
    trained = trained_at(case, region.starts(()))
    assert {point.reynolds for point in trained.plan.points} == {120.0}


def test_a_case_that_is_trained_elsewhere_forgets_where_it_was_trained():
    case = case_of({"reynolds": [50, 200]}, parameters={"train": {"reynolds": [100]}})
    assert [point.reynolds for point in case.plan.train_points] == [100.0]
    other = trained_at(case, [ParameterPoint(50.0), ParameterPoint(200.0)])
    assert [point.reynolds for point in other.plan.train_points] == [50.0, 200.0]
    assert [point.reynolds for point in case.plan.train_points] == [100.0]
