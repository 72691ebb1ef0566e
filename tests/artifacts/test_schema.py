"""The table of schemas, and its documentation."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sphrom.artifacts import SCHEMAS, documentation
from sphrom.artifacts.documentation import schemas_as_markdown
from sphrom.artifacts.layout import valid_name


@pytest.mark.parametrize("name", SCHEMAS)
def test_documentation_names_every_field(name: str) -> None:
    section = schemas_as_markdown().split(f"## {name}\n")[1].split("\n## ")[0]
    fields = (*SCHEMAS[name].datasets, *SCHEMAS[name].attributes)
    assert all(f"`{field.name}`" in section and field.meaning in section for field in fields)


@pytest.mark.parametrize("name", SCHEMAS)
def test_fields_are_described_once_and_completely(name: str) -> None:
    datasets = SCHEMAS[name].datasets
    assert len({field.name for field in datasets}) == len(datasets)
    for field in datasets:
        assert field.axes
        assert field.units
        assert field.meaning
        assert np.dtype(field.dtype).kind in "fi"
        assert valid_name(field.name.replace("*", "any"))
        assert not field.equation or field.equation.startswith(("Eq. ", "Alg. "))


def test_documentation_is_a_table_with_equal_columns() -> None:
    lines = schemas_as_markdown().splitlines()
    for above, below in pairwise(lines):
        if above.startswith("|") and below.startswith("|"):
            assert above.count("|") == below.count("|")


def test_published_documentation_is_that_of_the_table() -> None:
    """`python -m sphrom.artifacts.documentation > sphrom/artifacts.md` writes it anew."""
    published = Path(documentation.__file__).parents[1] / "artifacts.md"
    assert published.read_text(encoding="utf-8") == schemas_as_markdown()


@pytest.mark.parametrize("name", SCHEMAS)
def test_what_there_may_be_several_of_there_is_at_least_one_of(name: str) -> None:
    """A basis without modes fits patterns alone."""
    schema = SCHEMAS[name]
    groups = {f.name.rpartition("/")[0] for f in schema.datasets if f.required and "*" in f.name}
    assert {group for group in groups if group == "bases/*"} <= set(schema.at_least_one)
