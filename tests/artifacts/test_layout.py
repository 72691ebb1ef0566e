"""The table of what artifacts hold, its documentation, and what is found against it."""

from __future__ import annotations

import importlib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import sphrom
from sphrom.artifacts import SCHEMAS
from sphrom.artifacts.layout import (
    attribute_value,
    attributes_problem,
    layout_problem,
    length_problem,
    valid_name,
)
from sphrom.declaration import PROVENANCE

ROOT = Path(sphrom.__file__).parents[1]
BASIS, TRAJECTORY = SCHEMAS["sphrom/basis"], SCHEMAS["sphrom/trajectory"]
FLOAT = np.dtype("float64")
GHOSTS = {"ghost/position": np.zeros((4, 2)), "ghost/wall_velocity": np.ones((4, 2))}
REDUCED = {"generalized_coordinates": np.zeros((3, 2)), "mean_density_fluctuation": np.zeros(3)}


@pytest.fixture
def markdown(monkeypatch) -> str:
    """The page of the schemas, as the script draws it."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return str(importlib.import_module("artifacts_page").schemas_as_markdown())


@pytest.mark.parametrize("name", SCHEMAS)
def test_fields_are_described_once_and_completely(markdown: str, name: str) -> None:
    schema = SCHEMAS[name]
    section = markdown.split(f"## {name}\n")[1].split("\n## ")[0]
    for field in (*schema.datasets, *schema.attributes):
        assert f"`{field.name}`" in section
        assert field.meaning in section
    assert len({field.name for field in schema.datasets}) == len(schema.datasets)
    for field in schema.datasets:
        assert field.axes
        assert field.units
        assert field.meaning
        assert valid_name(field.name.replace("*", "any"))
        assert not field.equation or field.equation.startswith(("Eq. ", "Alg. "))


def test_published_documentation_is_that_of_the_table(markdown: str) -> None:
    """`python scripts/artifacts_page.py > sphrom/artifacts.md` writes it anew."""
    assert (ROOT / "sphrom" / "artifacts.md").read_text(encoding="utf-8") == markdown
    for above, below in pairwise(markdown.splitlines()):
        if above.startswith("|") and below.startswith("|"):
            assert above.count("|") == below.count("|")


@pytest.mark.parametrize("name", ["", "a//b", "/a", "../a", "a/.b", "a b", "a/*"])
def test_names_that_tools_misread_are_invalid(name: str) -> None:
    assert not valid_name(name)
    assert valid_name("series/galerkin-5/reynolds=1.5e+02,mach=0.1/time")


def basis(name: str, modes: int, particles: int = 5) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    return {
        "reference_position": ((5, 2), FLOAT),
        "volume": ((5,), FLOAT),
        f"bases/{name}/modes/density": ((modes, particles), FLOAT),
        f"bases/{name}/modes/velocity": ((modes, particles, 2), FLOAT),
        f"bases/{name}/singular_values": ((7,), FLOAT),
        f"bases/{name}/train": ((2, 1), FLOAT),
    }


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        (basis("high", 6), "None"),
        ({"volume": None}, "dataset volume is missing"),
        ({"bases/low/train": None}, "dataset bases/low/train is missing"),
        ({name: None for name in basis("low", 4) if "bases" in name}, "group bases/* is missing"),
        (basis("low", 4, particles=6), "has 5 along particle, but"),
        ({"bases/low/modes/velocity": ((3, 5, 2), FLOAT)}, "has 3 along mode, but"),
        ({"volume": ((5,), np.dtype("float32"))}, "of type float32, not float64"),
        ({"volume": ((5, 1), FLOAT)}, "has 2 axes, not 1"),
    ],
)
def test_datasets_are_whole_and_fit_one_another(changed, problem: str) -> None:
    found = basis("low", 4) | changed
    found = {name: at for name, at in found.items() if at is not None}
    assert problem in str(layout_problem(BASIS, found))


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        (GHOSTS, "None"),
        (REDUCED, "None"),
        (GHOSTS | REDUCED, "None"),
        (GHOSTS | {"ghost/wall_velocity": np.zeros((3, 2))}, "along ghost"),
        ({"mean_density_fluctuation": np.zeros(2)}, "along snapshot"),
    ],
)
def test_a_trajectory_may_have_ghosts_and_a_mean_density(fields, changed, problem: str) -> None:
    found = {name: (array.shape, array.dtype) for name, array in (fields | changed).items()}
    assert problem in str(layout_problem(TRAJECTORY, found))


def test_missing_attribute_of_a_group_is_named() -> None:
    found = {f.name: "text" for f in (*PROVENANCE, *BASIS.attributes) if f.kind == "text"}
    found |= {"wall_seconds": 1.0, "threads": 1, "reference_density": 1.0, "sound_speed": 1.0}
    problem = attributes_problem(BASIS, found, basis("low", 4))
    assert problem == "attribute bases/low/gram_error is missing"
    found["bases/low/gram_error"] = 0.0
    assert attributes_problem(BASIS, found, basis("low", 4)) is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("status", "finished"),
        ("status", 1),
        ("mass", "1"),
        ("mass", True),
        ("mass", float("nan")),
        ("mass", (1.0, 2.0)),
        ("box_length", 1.0),
        ("box_length", (1.0, float("inf"))),
    ],
)
def test_attribute_of_another_kind_is_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        attribute_value(TRAJECTORY.attribute(name), value)


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
    schema = SCHEMAS["sphrom/spline"]
    lengths = {"component": 2, "term": 3}
    found = {
        field.name.replace("*", basis): (
            tuple(
                lengths.get(a, 5 if (basis, a) == ("a", "cell_boundary") else 4) for a in field.axes
            ),
            np.dtype(field.kind),
        )
        for basis in ("a", "b")
        for field in schema.datasets
    }
    assert layout_problem(schema, found) == "bases/b has 4 along cell_boundary, not 5"
