"""The table of what artifacts hold, its documentation, and what can't be stored."""

from __future__ import annotations

from pathlib import Path

import pytest

import sphrom
from sphrom.artifacts.layout import attribute_value, valid_name
from sphrom.artifacts.records import SCHEMAS


@pytest.mark.parametrize("name", SCHEMAS)
def test_fields_are_described_once_and_completely(name: str) -> None:
    schema = SCHEMAS[name]
    assert len({field.name for field in schema.datasets}) == len(schema.datasets)
    for field in schema.datasets:
        assert field.axes
        assert field.units
        assert field.meaning
        assert valid_name(field.name.replace("*", "any"))
        assert not field.equation or field.equation.startswith(("Eq. ", "Alg. "))


def test_published_documentation_is_that_of_the_table(script) -> None:
    """`python scripts/artifacts_page.py > sphrom/artifacts.md` writes it anew."""
    published = Path(sphrom.__file__).with_name("artifacts.md").read_text(encoding="utf-8")
    assert published == script("artifacts_page").schemas_as_markdown()


@pytest.mark.parametrize("name", ["", "a//b", "../a", "a b", "a/*"])
def test_names_that_tools_misread_are_invalid(name: str) -> None:
    assert not valid_name(name)
    assert valid_name("series/galerkin-5/reynolds=1.5e+02,mach=0.1/time")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("status", "finished"),
        ("mass", float("nan")),
        ("box_length", 1.0),
        ("box_length", (1.0, float("inf"))),
    ],
)
def test_attribute_of_another_kind_is_refused(name: str, value: object) -> None:
    with pytest.raises((ValueError, TypeError)):
        attribute_value(SCHEMAS["sphrom/trajectory"].attribute(name), value)
