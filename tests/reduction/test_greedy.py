from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.greedy import (
    NEAR,
    candidate_places,
    choose,
    ending,
    first_corners,
    safety_factor,
)


def toy_error(places: np.ndarray, trained: np.ndarray) -> np.ndarray:
    """An error that is known: a distance from the training, ten times larger at the low end."""
    distance = np.linalg.norm(places[:, None] - trained, axis=2).min(axis=1)
    return distance * np.where(places[:, 0] < 0.2, 10.0, 1.0)


def trained_to(tolerance: float, bias: float, budget: int = 40) -> tuple[np.ndarray, float, float]:
    """Train on the toy with estimates that are wrong by a factor; return places and errors."""
    places = candidate_places(200, 1, seed=3)
    trained, held_out = first_corners(1), []
    while True:
        truth = toy_error(places, trained)
        estimates = bias * truth
        factor = safety_factor(*(np.array([pair[k] for pair in held_out]) for k in (0, 1)))
        worst = float(factor * estimates.max())
        left = {"n_held_out": len(held_out), "n_left": budget - len(trained)}
        if ending(worst, 0.0, tolerance, **left) is not None:
            return trained, worst, float(truth.max())
        (chosen,) = choose(places, factor * estimates, trained, 1, tolerance)
        held_out.append((estimates[chosen], truth[chosen]))
        trained = np.vstack((trained, places[chosen]))


@pytest.mark.parametrize("n_parameters", [1, 2, 3, 5])
def test_the_first_corners_have_both_ends_of_every_parameter(n_parameters: int) -> None:
    corners = first_corners(n_parameters)
    assert 2 <= len(corners) <= 4
    assert len(np.unique(corners, axis=0)) == len(corners)
    assert (corners.min(axis=0) == 0.0).all()
    assert (corners.max(axis=0) == 1.0).all()


def test_a_longer_set_of_candidates_begins_with_a_shorter_and_a_seed_moves_it() -> None:
    some, more = candidate_places(20, 2, seed=1), candidate_places(90, 2, seed=1)
    assert np.array_equal(more[: len(some)], some)
    assert len(more) == 4 + 90
    assert not np.array_equal(candidate_places(20, 2, seed=2), some)
    gaps = np.diff(np.sort(candidate_places(200, 1, seed=5)[:, 0]))
    assert gaps.max() < 0.02


@pytest.mark.parametrize("bias", [0.4, 1.0, 2.5])
def test_no_promise_is_broken_whatever_factor_the_estimates_are_wrong_by(bias: float) -> None:
    trained, promised, true = trained_to(0.3, bias)
    assert true <= promised <= 0.3
    assert promised / true == pytest.approx(max(1.0, bias))
    spaced = next(
        n for n in range(2, 100)
        if toy_error(candidate_places(200, 1, 3), np.linspace(0.0, 1.0, n)[:, None]).max() <= true
    )  # fmt: skip
    assert len(trained) < 0.7 * spaced


def test_the_factor_covers_the_worst_run_held_out_and_is_never_below_one() -> None:
    nothing = np.array([])
    assert safety_factor(nothing, nothing) == 1.0
    assert safety_factor(np.array([2.0, 4.0]), np.array([1.0, 6.0])) == 1.5
    assert safety_factor(np.array([2.0, 4.0]), np.array([1.0, 2.0])) == 1.0
    diverged = np.array([2.0, np.inf, 3.0]), np.array([np.inf, 1.0, 6.0])
    assert safety_factor(*diverged) == 2.0


def test_the_worst_is_chosen_but_nothing_next_to_what_is_trained() -> None:
    places = np.linspace(0.0, 1.0, 101)[:, None]
    trained = np.array([[0.0], [1.0]])
    (chosen,) = choose(places, places[:, 0], trained, 1, 0.1)
    assert places[chosen, 0] == pytest.approx(1.0 - NEAR * 0.5, abs=0.011)
    (farthest,) = choose(places, np.full(101, np.inf), trained, 1, 0.1)
    assert places[farthest, 0] == 0.5


def test_of_several_at_once_all_but_the_first_are_beyond_the_tolerance_and_apart() -> None:
    places = np.linspace(0.0, 1.0, 101)[:, None]
    trained = np.array([[0.0], [1.0]])
    estimates = 1.0 - np.abs(places[:, 0] - 0.45)
    found = places[choose(places, estimates, trained, 3, 0.7), 0]
    assert found[0] == pytest.approx(0.45)
    assert len(found) == 3
    assert np.abs(found[:, None] - found)[~np.eye(3, dtype=bool)].min() > 0.5 * 0.45 - 1e-9
    assert len(choose(places, estimates, trained, 3, 2.0)) == 1
    assert len(choose(np.array([[0.0]]), np.ones(1), trained, 2, 0.1)) == 0


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, None),
        ({"worst_estimate": 1.0}, "within"),
        ({"worst_estimate": 0.5, "n_held_out": 0}, None),
        ({"worst_estimate": 0.5, "n_held_out": 0, "n_left": 0}, "budget"),
        ({"n_left": 0}, "budget"),
        ({"floor": 1.5}, "floor"),
        ({"worst_estimate": np.inf}, None),
    ],
)
def test_why_training_ends(changes: dict[str, float], expected: str | None) -> None:
    found = {"worst_estimate": 2.0, "floor": 0.1, "n_held_out": 1, "n_left": 4, **changes}
    assert ending(tolerance=1.0, **found) == expected
