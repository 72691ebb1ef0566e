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
    ("name", "arguments", "words"),
    [
        ("nrm", {}, "no continuous distribution nrm"),
        ("poisson", {"mu": 3}, "no continuous distribution poisson"),
        ("studentized_range", {"k": 3, "df": 3}, "with a quantile function"),
        ("norm", {"mean": 3}, "norm takes loc, scale; got mean: 3"),
        ("truncnorm", {"a": 3}, "takes a, b, loc, scale; got a: 3"),
        ("norm", {"scale": 0}, "no values with scale: 0"),
        ("triang", {"c": 2}, "triang has no values with c: 2"),
        ("truncnorm", {"a": 2, "b": 1}, "truncnorm has no values with a: 2, b: 1"),
    ],
)
def test_what_is_wrong_is_named(name, arguments, words):
    assert words in (problem(name, arguments) or "")


def test_the_share_outside_of_bounds():
    assert share_outside("norm", {"loc": 2}, 0.0, 1e12) == pytest.approx(0.02275, rel=1e-3)
    assert share_outside("uniform", {}, 0.0, 1.0) == pytest.approx(0.0, abs=1e-12)
