"""Expressions of case files: what they are worth, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.scenes.expressions import Expression

X = np.linspace(-1.0, 2.0, 7)


def value(text: str, **constants: float) -> np.ndarray:
    return Expression(text, ("x", "y", "t"), constants)(x=X, y=0.5, t=2.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1", np.ones(7)),
        ("-x**2", -(X**2)),
        ("0.1*sin(2*pi*x) + y", 0.1 * np.sin(2.0 * math.pi * X) + 0.5),
        ("exp(-t)*x/2", math.exp(-2.0) * X / 2.0),
        ("1/2", np.full(7, 0.5)),
        ("a*x - b", 3.0 * X - 0.25),
        ("where(x > y, 1, sqrt(t))", np.where(X > 0.5, 1.0, math.sqrt(2.0))),
        ("arctan2(x, y)", np.arctan2(X, 0.5)),
        ("2*min(x, y, a - 3) - max(x, 1)", 2.0 * np.minimum(X, 0.0) - np.maximum(X, 1.0)),
        ("interp(x, -b, 1, 1, 3*a, 1.5, -1)", np.interp(X, [-0.25, 1.0, 1.5], [1.0, 9.0, -1.0])),
        ("interp(x, 0, y, 1, t)", 0.5 + 1.5 * np.clip(X, 0.0, 1.0)),
        ("where(max(x, 0) > y, interp(t, 0, 0, 4, 1), 0)", np.where(X > 0.5, 0.5, 0.0)),
    ],
)
def test_values(text: str, expected: np.ndarray) -> None:
    np.testing.assert_allclose(value(text, a=3.0, b=0.25), expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x +", "is not an expression"),
        ("z + 1", "z is not a known name; use x, y, t, pi"),
        ("__import__('os')", "__import__ is not a known function"),
        ("x.real", "is not allowed"),
        ("[x]", "is not allowed"),
        ("(lambda: x)()", "not a known function"),
        ("x > 1", "is not allowed"),
        ("True", "is not allowed"),
        ("sin(x, y)", "sin takes 1 arguments; got 2"),
        ("where(x, 1, 2)", "where needs a comparison first"),
        ("1e400", "is too large"),
        ("9**9**9", "can't be evaluated"),
        ("1/0", "can't be evaluated"),
        ("-" * 60 + "x", "nested levels"),
        ("min(x)", "min takes two or more arguments; got 1"),
        ("max(x, 1/0)", "can't be evaluated"),
        ("interp(x, 0, 1)", "interp takes a variable, then places and values"),
        ("interp(x, 0, 1, 2)", "got 4 arguments"),
        ("interp(x, 0, 1, 0, 2)", "must increase"),
        ("interp(x, 0, 1, y, 2)", "must be numbers or constants"),
        ("+".join(f"min(x, {n})" for n in range(40)), "interp, max, min or histories too often"),
    ],
)
def test_refusals(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words.replace("(", r"\(")):
        value(text)


def test_a_value_that_is_no_number_is_passed_on() -> None:
    for text in ("sqrt(x)", "min(2, sqrt(x))", "interp(sqrt(x), 0, 1, 2, 3)"):
        assert np.isnan(value(text)[0])
    assert np.isinf(Expression("1/x", ("x",))(x=np.zeros(1)))[0]


@pytest.mark.parametrize(
    "text", ["sin(y)*cos(t)", "-2*x/(1 + t**2)*exp(y)", "t", "x", "cos(t)/(3*t)", "5", "-(t*x)"]
)
def test_a_product_is_a_field_times_an_amplitude(text: str) -> None:
    whole = Expression(text, ("x", "y", "t"))
    field, amplitude = whole.separated("t")
    assert "t" not in field.depends_on
    assert amplitude.depends_on <= {"t"}
    product = field(x=X, y=0.3) * amplitude(t=1.7)
    np.testing.assert_allclose(product, whole(x=X, y=0.3, t=1.7), rtol=1e-14)


@pytest.mark.parametrize("text", ["sin(x + t)", "x + t", "x**t", "sin(x)*cos(t*y)"])
def test_what_is_no_such_product_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="must be a field times an amplitude"):
        Expression(text, ("x", "y", "t")).separated("t")


def test_degrees_in_constants() -> None:
    """Knots' values may be parameters of projected operators, their places may not."""
    degrees = {
        "interp(x, 0, a, 1, 2*b + 1)": 1.0,
        "x*interp(x, 0, a, 1, y)": 1.0,
        "interp(x, 0, 1, 2, a*b)": 2.0,
        "interp(x, a, 1, 2, 2)": np.inf,
        "interp(a, 0, 1, 2, 2)": np.inf,
        "min(x, a)": np.inf,
        "max(x, y)": 0.0,
    }
    for text, degree in degrees.items():
        expression = Expression(text, ("x", "y"), {"a": 1.0, "b": 1.0})
        assert expression.degree_in(["a", "b"]) == degree
