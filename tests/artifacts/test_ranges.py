"""Which values and lengths an artifact can have."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.artifacts.layout import find_field, layout_problem
from sphrom.artifacts.ranges import Range, length_problem, range_of
from sphrom.artifacts.records import SCHEMAS
from sphrom.artifacts.schema import PROVENANCE


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ([0.0, 5.0], None),
        ([], None),
        ([1.0, 5.5], "holds 5.5, above 5"),
        ([-1, 2], "holds -1, below 0"),
        ([1.0, np.nan], "holds nan"),
        ([1.0, np.inf], "holds inf"),
        ([1.0, -1e101], "holds -1e+101"),
    ],
)
def test_a_range_says_what_lies_outside(values, problem) -> None:
    assert Range(0.0, 5.0).problem(np.array(values)) == problem


@pytest.mark.parametrize(
    ("schema", "name", "least"),
    [
        ("spline", "bases/all/cell_shape", 1),
        ("spline", "bases/all/cell_start", 0),
        ("spline", "bases/all/points", -1e100),
        ("b-spline", "bases/all/lattice_shape", 1),
        ("basis", "volume", 5e-324),
        ("sweep", "time_step", 5e-324),
        ("trajectory", "step", 0),
        ("sweep", "status", 0),
    ],
)
def test_ranges_of_datasets(schema, name, least) -> None:
    found = range_of(find_field(SCHEMAS[f"sphrom/{schema}"].datasets, name))
    assert (found.least, found.most) == (least, 1e100)


@pytest.mark.parametrize(
    ("name", "accepted", "refused"),
    [
        ("polynomial_degree", -1, -2),
        ("spline_order", 1, 0),
        ("threads", 1, 0),
    ],
)
def test_ranges_of_whole_numbers(name, accepted, refused) -> None:
    table = SCHEMAS["sphrom/spline"]
    field = find_field((*table.attributes, *PROVENANCE), name)
    assert range_of(field).problem(accepted) is None
    assert range_of(field).problem(refused) is not None


@pytest.mark.parametrize(
    ("lengths", "problem"),
    [
        ({"component": 2, "particle": 5}, None),
        ({"component": 3}, "has 3 along component, not 2"),
        ({"cell": 4, "cell_boundary": 4}, "has 4 along cell_boundary, not 5"),
        ({"mode": 3, "monomial": 10, "linear_monomial": 4}, None),
        ({"mode": 3, "monomial": 9}, "has 9 along monomial, not 10"),
        ({"mode": 3, "linear_monomial": 3}, "has 3 along linear_monomial, not 4"),
        ({"particle": 0}, "has none along particle"),
        ({"ghost": 0, "snapshot": 0}, None),
    ],
)
def test_lengths(lengths, problem) -> None:
    assert length_problem(lengths) == problem


def test_each_group_has_its_lengths() -> None:
    """Here of two bases, of which one lacks a boundary between its cells."""
    whole = {"cell_start": (5,), "condition_number": (4,)}
    cut = whole | {"cell_start": (4,)}
    found = {
        f"bases/{basis}/{name}": (shape, np.dtype("i8" if name == "cell_start" else "f8"))
        for basis, arrays in {"a": whole, "b": cut}.items()
        for name, shape in arrays.items()
    }
    required = SCHEMAS["sphrom/spline"].datasets
    some = tuple(field for field in required if field.name.rpartition("/")[2] in whole)
    schema = type(SCHEMAS["sphrom/spline"])("sphrom/spline", "", some)
    assert layout_problem(schema, found) == "bases/b has 4 along cell_boundary, not 5"
