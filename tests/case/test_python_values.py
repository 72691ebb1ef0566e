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
    ("call", "text"),
    [
        (lambda: key_named(CASE, "evaluation"), "may be rom.0.evaluation; name one, such as set="),
        (
            lambda: key_named(CASE, "kind"),
            "may be scene.kind or discretization.walls.kind or psi.kind",
        ),
        (lambda: key_named(CASE, "resolutoin"), "has no such key; did you mean resolution?"),
        (lambda: key_named(CASE, ""), "the case has no such key"),
        (lambda: plain_values({"a": {1, 2}}, "case"), "got set"),
        (lambda: plain_values({"a": [1, b"x"]}, "case"), "got bytes"),
        (lambda: plain_values({"a": np.array([1j])}, "case"), "got complex"),
        (lambda: plain_values({(1, 2): 2}, "case"), "keys must be"),
        (lambda: plain_values(LOOP, "case"), "Circular"),
        (lambda: load_case({**CASE, "tiem": {}}), "case: tiem: unknown key; did you mean time?"),
        (lambda: load_case(CASE, {"resolution": 50.5}), "--set: discretization.resolution: must"),
    ],
)
def test_what_is_refused(call, text):
    with pytest.raises(CaseError) as refused:
        call()
    assert text in str(refused.value)


def test_a_case_is_not_changed_by_loading_it():
    before = repr(CASE)
    case = load_case(CASE, {"resolution": np.int64(20), "rom.1.n_modes": 3})
    assert (case.discretization.resolution, case.rom[1].n_modes) == (20, 3)
    assert repr(CASE) == before
