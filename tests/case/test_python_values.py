"""Cases, and changes of their keys, as Python values."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest

import sphrom
from sphrom.case.loader import key_named, load_case, plain_values
from sphrom.case.schema import key_paths
from sphrom.errors import CaseError

CASE: dict[str, Any] = {
    "name": "vortex",
    "scene": {"kind": "taylor-green"},
    "rom": [{"name": "a"}, {"name": "b"}],
    "basis": {"subsets": {"low": {"reynolds": [100]}}},
}


LOOP: list[Any] = []
LOOP.append(LOOP)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("resolution", "discretization.resolution"),
        ("name", "name"),
        ("rom.1.n_modes", "rom.1.n_modes"),
        ("any.thing", "any.thing"),
    ],
)
def test_a_name_is_a_key_or_the_end_of_one(name, key):
    assert key_named(CASE, name) == key


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("evaluation", "may be rom.0.evaluation; name one, such as set="),
        ("kind", "may be scene.kind or psi.kind"),
        ("resolutoin", "the case has no such key; did you mean resolution?"),
        ("", "the case has no such key"),
    ],
)
def test_a_name_that_is_ambiguous_or_unknown(name, text):
    with pytest.raises(CaseError) as refused:
        key_named(CASE, name)
    assert text in str(refused.value)


def test_no_key_of_a_case_is_called_as_an_argument_of_a_study():
    own = {*inspect.signature(sphrom.Study).parameters} - {"keys"}
    assert own & {path[-1] for path in key_paths()} == set()


def test_values_become_what_yaml_would_give():
    given = {
        "a": np.float64(1.5),
        "b": np.arange(3),
        "c": (1, 2.0, "x", None, True),
        "d": range(2),
        "e": {"f": np.array(2)},
    }
    plain = plain_values(given, "case")
    assert plain == {
        "a": 1.5,
        "b": [0, 1, 2],
        "c": [1, 2.0, "x", None, True],
        "d": [0, 1],
        "e": {"f": 2},
    }
    assert type(plain["a"]) is float
    assert {type(value) for value in plain["b"]} == {int}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"a": {1, 2}}, "got set"),
        ({"a": [1, b"x"]}, "got bytes"),
        ({"a": np.array([1j])}, "got complex"),
        ({(1, 2): 2}, "keys must be"),
        (LOOP, "Circular"),
    ],
)
def test_other_values_are_refused(value, text):
    with pytest.raises(CaseError) as refused:
        plain_values(value, "case")
    assert text in str(refused.value)


def test_a_case_is_not_changed_by_loading_it():
    before = repr(CASE)
    case = load_case(CASE, {"resolution": np.int64(20), "rom.1.n_modes": 3})
    assert (case.discretization.resolution, case.rom[1].n_modes) == (20, 3)
    assert repr(CASE) == before


def test_problems_of_a_case_are_those_of_a_file():
    with pytest.raises(CaseError, match=r"case: tiem: unknown key; did you mean time\?"):
        load_case({**CASE, "tiem": {}})
    with pytest.raises(CaseError, match=r"--set: discretization\.resolution: must be a whole"):
        load_case(CASE, {"resolution": 50.5})
