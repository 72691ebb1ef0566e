"""The keys in which two case texts differ."""

from __future__ import annotations

import yaml

from sphrom.artifacts.differences import case_differences

CASE = {
    "name": "demo",
    "fluid": {"reynolds": 100, "density": 1000.0},
    "rom": [{"method": "galerkin", "modes": 5}, {"method": "apg"}],
    "train": [100, 150],
}


def text(**changed: object) -> str:
    return yaml.safe_dump(CASE | changed, sort_keys=False)


def test_equal_cases_do_not_differ() -> None:
    assert case_differences(text(), text()) == ""


def test_changed_value_is_named_with_both() -> None:
    changed = text(fluid={"reynolds": 200, "density": 1000.0})
    assert case_differences(text(), changed) == "fluid.reynolds is 100 there, 200 here"


def test_items_of_lists_are_told_apart() -> None:
    changed = text(rom=[{"method": "galerkin", "modes": 10}, {"method": "apg"}], train=[100, 175])
    assert case_differences(text(), changed) == (
        "rom[0].modes is 5 there, 10 here; train[1] is 150 there, 175 here"
    )


def test_added_and_removed_keys_are_absent() -> None:
    changed = text(fluid={"reynolds": 100, "mach": 0.1})
    assert case_differences(text(), changed) == (
        "fluid.mach is absent there, 0.1 here; fluid.density is 1000.0 there, absent here"
    )


def test_sections_that_are_not_asked_about_do_not_count() -> None:
    asked = yaml.safe_dump({"train": [100, 175]})
    assert case_differences(text(name="other"), asked) == "train[1] is 150 there, 175 here"


def test_many_differences_are_cut_short() -> None:
    assert case_differences("", text()).endswith("and 4 more")


def test_long_values_are_cut() -> None:
    found = case_differences("a: " + 10_000 * "x", "a: y")
    assert found == f"a is {57 * 'x'}... there, y here"


def test_any_text_is_survived() -> None:
    assert case_differences("- - -\n:\n  : :\n\t{[", "}{\n- a\n - b: - c")
