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
    layout_problem,
    valid_name,
)
from sphrom.declaration import PROVENANCE

ROOT = Path(sphrom.__file__).parents[1]
BASIS, TRAJECTORY = SCHEMAS["sphrom/basis"], SCHEMAS["sphrom/trajectory"]
FLOAT = np.dtype("float64")


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
        (basis("high", 6), "bases/high/gram_error is missing"),
        ({"volume": None}, "volume is missing"),
        ({"bases/low/train": None}, "bases/low/train is missing"),
        ({}, "None"),
        (basis("low", 4, particles=6), "has 5 along particle, but"),
        ({"bases/low/modes/velocity": ((3, 5, 2), FLOAT)}, "has 3 along mode, but"),
    ],
)
def test_artifacts_are_whole_and_their_datasets_fit_one_another(changed, problem: str) -> None:
    found = basis("low", 4) | changed
    found = {name: at for name, at in found.items() if at is not None}
    fields = (*PROVENANCE, *BASIS.attributes)
    given = dict.fromkeys((field.name.replace("*", "low") for field in fields), "given")
    assert problem in str(layout_problem(BASIS, found, given))


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
