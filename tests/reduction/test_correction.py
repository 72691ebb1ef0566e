"""Defect corrections with defects whose reach over the parameters is known."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.correction import FADED, faded, learn_correction

TIME = np.linspace(0.0, 1.0, 201)
PLACES = np.log([[50.0], [100.0], [200.0], [400.0]])


def noise(seed: int, shape=(4, 201)) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


@pytest.fixture(scope="module")
def defects() -> np.ndarray:
    """One mode whose defects all runs share, one that falls with the parameter, one of noise."""
    shared = np.broadcast_to(np.sin(9.0 * TIME), (4, 201))
    return np.stack((shared, PLACES * np.cos(3.0 * TIME), noise(0)), axis=2)


def test_training_runs_get_their_own_defects(defects):
    correction = learn_correction(PLACES, defects)
    for place, defect in zip(PLACES, defects, strict=True):
        assert np.allclose(correction.at(place), defect, atol=1e-4)


def test_between_training_runs_defects_that_they_share_are_interpolated(defects):
    added = learn_correction(PLACES, defects).at(np.log([150.0]))
    assert np.allclose(added[:, 0], defects[0, :, 0], atol=1e-3)
    assert np.allclose(added[:, 1], np.log(150.0) * np.cos(3.0 * TIME), atol=0.05)


def test_noise_that_other_runs_do_not_share_is_not_added(defects):
    correction = learn_correction(PLACES, defects)
    for place in (np.log([150.0]), np.log([1000.0])):
        assert np.std(correction.at(place)[:, 2]) < 0.3


def test_outside_the_nearest_defect_counts_ever_less(defects):
    correction = learn_correction(PLACES, defects)
    near, far = (correction.at(np.log([value])) for value in (500.0, 1e6))
    assert np.allclose(near[:, 0], defects[-1, :, 0], atol=0.01)
    assert np.linalg.norm(far[:, 1]) < np.linalg.norm(near[:, 1])


def test_noise_alone_is_no_correction():
    assert learn_correction(PLACES, noise(1, (4, 201, 3))) is None


def test_a_run_held_out_has_what_the_others_give(defects):
    correction = learn_correction(PLACES, defects)
    changed = defects.copy()
    changed[1] = 1e3
    other = type(correction)(PLACES, changed, correction.lengths)
    assert np.array_equal(other.held_out(PLACES[1]), correction.held_out(PLACES[1]))
    assert np.allclose(correction.held_out(PLACES[1])[:, 0], defects[1, :, 0], atol=1e-3)


def test_several_parameters_in_any_order():
    places = np.log([[50.0, 1.0], [400.0, 1.0], [50.0, 2.0], [400.0, 2.0]])
    plane = (places @ [1.0, 2.0])[:, None, None] * np.sin(9.0 * TIME)[:, None]
    inside = np.log([140.0, 1.4])
    added = learn_correction(places, plane).at(inside)
    assert np.allclose(added[:, 0], inside @ [1.0, 2.0] * np.sin(9.0 * TIME), atol=0.2)
    order = [2, 0, 3, 1]
    assert np.allclose(learn_correction(places[order], plane[order]).at(inside), added)


def test_runs_that_diverged_are_left_out(defects):
    broken = defects.copy()
    broken[2, 150:] = np.nan
    correction = learn_correction(PLACES, broken)
    assert np.isfinite(correction.at(PLACES[2])).all()
    assert np.isfinite(correction.held_out(PLACES[2])).all()
    broken[[0, 1], 10] = np.nan
    assert learn_correction(PLACES, broken) is None
    assert learn_correction(PLACES[:1], defects[:1]) is None


def test_longer_runs_have_it_faded_out_without_a_kick():
    correction = np.ones((101, 2))
    assert np.array_equal(faded(correction, 101), correction)
    assert np.array_equal(faded(correction, 40), correction[:40])
    longer = faded(correction, 180)
    assert longer.shape == (180, 2)
    assert not longer[100:].any()
    kept = round((1.0 - FADED) * 100)
    assert np.array_equal(longer[: kept + 1], correction[: kept + 1])
    steps = np.abs(np.diff(longer[:, 0]))
    assert steps.max() < 2.0 / (FADED * 100)
    assert steps[[kept, 99]].max() < 0.3 * steps.max()
