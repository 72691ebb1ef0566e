"""What is found against what the schema says."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.artifacts import SCHEMAS
from sphrom.artifacts.layout import (
    attribute_value,
    attributes_problem,
    find_field,
    layout_problem,
    matches,
    valid_name,
)
from sphrom.artifacts.schema import PROVENANCE, AttributeField

BASIS, TRAJECTORY = SCHEMAS["sphrom/basis"], SCHEMAS["sphrom/trajectory"]

FLOAT = np.dtype("float64")


def basis(name: str, modes: int, particles: int = 5) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    return {
        "reference_position": ((5, 2), FLOAT),
        "volume": ((5,), FLOAT),
        f"bases/{name}/modes/density": ((modes, particles), FLOAT),
        f"bases/{name}/modes/velocity": ((modes, particles, 2), FLOAT),
        f"bases/{name}/singular_values": ((7,), FLOAT),
        f"bases/{name}/train": ((2, 1), FLOAT),
    }


def test_star_stands_for_one_group() -> None:
    assert matches("bases/*/train", "bases/low/train")
    assert not matches("bases/*/train", "bases/low/more/train")
    assert not matches("bases/*/train", "bases/train")


def test_exact_name_comes_before_star() -> None:
    fields = (AttributeField("a/*", "float", "", ""), AttributeField("a/b", "text", "", ""))
    assert find_field(fields, "a/b") is fields[1]
    assert find_field(fields, "a/c") is fields[0]
    assert find_field(fields, "c") is None


def test_each_basis_has_its_own_number_of_modes() -> None:
    assert layout_problem(BASIS, basis("low", 4) | basis("high", 6)) is None


def test_particles_are_the_same_in_every_basis() -> None:
    problem = layout_problem(BASIS, basis("low", 4, particles=6))
    assert problem is not None
    assert "6 along particle" in problem or "5 along particle" in problem


def test_modes_of_one_basis_agree() -> None:
    found = basis("low", 4) | {"bases/low/modes/velocity": ((3, 5, 2), FLOAT)}
    assert "along mode" in str(layout_problem(BASIS, found))


@pytest.mark.parametrize("gone", ["volume", "bases/low/train"])
def test_missing_dataset_is_named(gone: str) -> None:
    found = basis("low", 4)
    del found[gone]
    assert layout_problem(BASIS, found) == f"dataset {gone} is missing"


def test_there_is_at_least_one_basis() -> None:
    found = {name: at for name, at in basis("low", 4).items() if "bases" not in name}
    assert "bases/*" in str(layout_problem(BASIS, found))


def test_type_and_number_of_axes_are_checked() -> None:
    assert "float32" in str(
        layout_problem(BASIS, basis("low", 4) | {"volume": ((5,), np.dtype("float32"))})
    )
    assert "2 axes" in str(layout_problem(BASIS, basis("low", 4) | {"volume": ((5, 1), FLOAT)}))


def test_missing_attribute_of_a_group_is_named() -> None:
    texts = {
        field.name: "text" for field in (*PROVENANCE, *BASIS.attributes) if field.kind == "text"
    }
    numbers = {"wall_seconds": 1.0, "threads": 1, "reference_density": 1.0, "sound_speed": 1.0}
    problem = attributes_problem(BASIS, texts | numbers, basis("low", 4))
    assert problem == "attribute bases/low/gram_error is missing"
    assert (
        attributes_problem(BASIS, texts | numbers | {"bases/low/gram_error": 0.0}, basis("low", 4))
        is None
    )


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
    field = find_field(TRAJECTORY.attributes, name)
    assert field is not None
    with pytest.raises(ValueError, match=name):
        attribute_value(field, value)


@pytest.mark.parametrize("name", ["", "a//b", "/a", "../a", "a/.b", "a b", "a/*"])
def test_names_that_tools_misread_are_invalid(name: str) -> None:
    assert not valid_name(name)


def test_names_of_parameters_are_valid() -> None:
    assert valid_name("series/galerkin-5/reynolds=1.5e+02,mach=0.1/time")
