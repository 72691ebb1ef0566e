"""How many modes are integrated, and had, of models whose later modes are known to be wrong."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.held_out import (
    DIVERGED,
    FieldProducts,
    TrainedSizes,
    best_size,
    choose_integrated,
)

TIME = np.linspace(0.0, 1.0, 101)
PLACES = np.log([[50.0], [100.0], [200.0]])
AMPLITUDES = np.array([1.0, 0.3, 0.1, 0.03])


def runs() -> np.ndarray:
    """Return runs of four modes that change a little with the parameter."""
    phases = np.arange(1.0, 5.0) * TIME[:, None] + 0.1 * PLACES[:, None]
    return AMPLITUDES * np.cos(phases)


def sizes(projected: np.ndarray, of_velocity: float = 1.0) -> TrainedSizes:
    """Return what errors follow from where every mode is as much of velocity as of pressure.

    Modes from the third have only a share of their velocity.
    """
    n_modes, n_runs = projected.shape[2], len(projected)
    shares = np.ones((2, n_modes))
    shares[0, 2:] = of_velocity
    columns = shares * projected[:, :, None]
    squares = np.sum(columns * projected[:, :, None], axis=3)
    gram = np.stack([np.diag(share) for share in shares])
    products = FieldProducts(gram=gram, projections=columns, squares=squares)
    return TrainedSizes(PLACES[:n_runs], projected, products, np.arange(len(TIME)))


def noise(shape: tuple[int, ...], size: float) -> np.ndarray:
    return size * np.random.default_rng(1).standard_normal(shape)


def models(projected: np.ndarray, wrong_from: int) -> list[np.ndarray]:
    """Return runs of 1, 2, ... modes, that are noise as large as the third from some number on."""
    found = [projected[..., :n].copy() for n in range(1, 5)]
    for n, each in enumerate(found, 1):
        if n >= wrong_from:
            each += noise(each.shape, 0.1)
    return found


def test_modes_that_make_runs_wrong_are_not_integrated() -> None:
    projected = runs()
    chosen, _ = choose_integrated(sizes(projected), models(projected, wrong_from=3))
    assert np.array_equal(chosen, [1, 2, 2, 2])


def test_modes_that_make_only_the_pressure_wrong_are_integrated() -> None:
    """A model may have another pressure than that of its modes."""
    projected = runs()
    integrated = models(projected, wrong_from=5)
    for each in integrated[2:]:
        each[..., 2:] += noise(each[..., 2:].shape, 0.1)
    chosen, errors = choose_integrated(sizes(projected, of_velocity=0.0), integrated)
    assert np.array_equal(chosen, [1, 2, 3, 4])
    assert errors[3, 1] > 1.5 * errors[1, 1]


def test_errors_never_grow_with_modes_that_models_have() -> None:
    """More modes are never worse: those that would be are predicted, or left to the others."""
    projected = runs()
    known, integrated = sizes(projected), models(projected, wrong_from=2)
    chosen, errors = choose_integrated(known, integrated)
    assert np.array_equal(errors[3], known.errors(4, integrated[chosen[3] - 1]))
    assert np.all(np.diff(errors.max(axis=1)) <= 1e-12), errors
    unchosen = [known.errors(n, integrated[n - 1]).max() for n in range(1, 5)]
    assert np.any(np.diff(unchosen) > 0.1 * unchosen[0])


def test_what_other_runs_share_is_predicted() -> None:
    projected = runs()
    known = sizes(projected)
    squares = np.mean(known.products.squares)
    left_out = np.sqrt(np.mean(np.sum(projected[..., 2:] ** 2, axis=2)) / squares)
    assert (known.errors(4, projected[..., :2]) < 0.5 * left_out).all()


def test_what_other_runs_do_not_share_is_not_predicted() -> None:
    """With tails of noise a model has the error of the leading modes, and not twice the noise."""
    projected = runs()
    projected[..., 2:] = noise(projected[..., 2:].shape, 0.1)
    known = sizes(projected)
    left_out = np.sqrt(np.mean(projected[1, :, 2:] ** 2) * 2 / np.mean(known.products.squares[1]))
    assert known.errors(4, projected[..., :2]) == pytest.approx([left_out] * 2, rel=0.08)


def test_models_that_diverge_are_never_chosen() -> None:
    projected = runs()
    integrated = models(projected, wrong_from=5)
    for each in integrated[2:]:
        each[1, 50:] = np.nan
    assert np.array_equal(choose_integrated(sizes(projected), integrated)[0], [1, 2, 2, 2])
    assert np.array_equal(sizes(projected).errors(3, integrated[2]), [DIVERGED] * 2)


def test_runs_at_the_ends_do_not_count_where_others_are_between() -> None:
    """The middle run is the mean of its neighbours in all modes, and each end is extrapolated."""
    projected = runs()
    projected[1] = projected[[0, 2]].mean(axis=0)
    between, ends = sizes(projected), sizes(projected[[0, 2]])
    assert np.array_equal(between.judged, [1])
    assert np.array_equal(ends.judged, [0, 1])
    nothing = np.zeros((3, len(TIME), 1))
    assert (between.errors(4, nothing) < 0.1 * ends.errors(4, nothing[:2])).all()


def test_a_single_run_counts_itself() -> None:
    projected = runs()[:1]
    integrated, errors = choose_integrated(sizes(projected), models(projected, wrong_from=4))
    assert np.array_equal(integrated, [1, 2, 3, 4])
    assert best_size(errors) == 3


def test_the_best_size_is_the_least_with_nearly_the_least_product_of_errors() -> None:
    errors = np.array([[1.0, 4.0], [2.0, 1.02], [1.0, 2.0], [3.0, 1.0]])
    assert best_size(errors) == 2
    errors[1] *= 1.02
    assert best_size(errors) == 3
