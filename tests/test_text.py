from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphrom.text import exact, quoted, shortened, visible


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (100.0, "100"), (12.5, "12.5"), (1e6, "1e+06"), (1e-5, "1e-05"), (1234567.0, "1234567"),
        (100.0000001, "100.0000001"), (0.1 + 0.2, "0.30000000000000004"), (-3.0, "-3"),
    ],
)  # fmt: skip
def test_numbers_have_the_digits_that_they_need(value, text):
    assert exact(value) == text
    assert float(text) == value


@given(st.text())
def test_nothing_is_left_that_a_terminal_obeys(text):
    shown = visible(text)
    assert shown.isprintable()
    assert visible(shown) == shown
    assert visible(text, keep="\n").replace("\n", "").isprintable()
    shown.encode()


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[2Jgone", "\\x1b[2Jgone"),
        ("\x9b31m", "\\x9b31m"),
        ("a\x7f\x08b\rc\td\ne", "a\\x7f\\x08b\\rc\\td\\ne"),
        ("gpj.\u202eexe", "gpj.\\u202eexe"),
        ("\u2066a\u2069 b\u200bc\u2028d", "\\u2066a\\u2069 b\\u200bc\\u2028d"),
        ("bytes \udcff that are no text", "bytes \\udcff that are no text"),
        ("[red]ν = 1e-3 m²/s – Größe × 漢字", "[red]ν = 1e-3 m²/s – Größe × 漢字"),
    ],
)
def test_what_is_escaped(text, shown):
    assert visible(text) == shown


def test_a_long_list_of_numbers_is_cut_between_them() -> None:
    times = ", ".join(f"{0.02 * k:.6g}" for k in range(26))
    shown = shortened(times, 60)
    begin, end = shown.split(" ... ")
    assert times.startswith(f"{begin} ")
    assert times.endswith(f" {end}")
    assert len(shown) <= 65
    assert len(shown) > 50
    assert shortened("x" * 100, 20) == f"{'x' * 10} ... {'x' * 10}"
    assert quoted([0.125] * 20) == f"[{'0.125, ' * 7}0.125,..."
