from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sphrom.metrics.draws import problem, quantiles, share_outside

SHARES = np.array([0.0, 0.2, 0.5, 1.0 - 1e-12])


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("uniform", {"loc": 0.5, "scale": 0.5}),
        ("norm", {"loc": 150, "scale": 10}),
        ("truncnorm", {"a": -2, "b": 2, "loc": 150, "scale": 10}),
        ("lognorm", {"s": 0.1, "scale": 150}),
        ("triang", {"c": 0.3, "loc": 100, "scale": 50}),
        ("beta", {"a": 2, "b": 3}),
        ("loguniform", {"a": 1, "b": 100}),
        ("expon", {}),
    ],
)
def test_draws_are_scipys_and_finite(name, arguments):
    assert problem(name, arguments) is None
    found = quantiles(name, arguments, SHARES)
    assert np.isfinite(found).all()
    assert found[1:3] == pytest.approx(getattr(stats, name).ppf(SHARES[1:3], **arguments))


@pytest.mark.parametrize(
    ("name", "arguments", "where", "words"),
    [
        ("nrm", {}, "distribution", "did you mean norm?"),
        ("poisson", {"mu": 3}, "distribution", "no continuous distribution poisson"),
        ("studentized_range", {"k": 3, "df": 3}, "distribution", "with a quantile function"),
        ("norm", {"mean": 3}, "mean", "is no argument of norm, which takes loc, scale"),
        ("truncnorm", {"a": 3}, "", "truncnorm needs b: it takes a, b, loc, scale"),
        ("norm", {"scale": 0}, "scale", "must be above zero; got 0"),
        ("triang", {"c": 2}, "", "triang has no values with c: 2"),
        ("truncnorm", {"a": 2, "b": 1}, "", "truncnorm has no values with a: 2, b: 1"),
    ],
)
def test_what_is_wrong_is_named(name, arguments, where, words):
    found = problem(name, arguments)
    assert found is not None
    assert found[0] == where
    assert words in found[1]


def test_the_share_outside_of_bounds():
    assert share_outside("norm", {"loc": 2}, 0.0, 1e12) == pytest.approx(0.02275, rel=1e-3)
    assert share_outside("uniform", {}, 0.0, 1.0) == pytest.approx(0.0, abs=1e-12)
