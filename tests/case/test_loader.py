from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sphrom.case.loader import load_case
from sphrom.case.yaml_reader import dump_yaml, read_yaml
from sphrom.errors import CaseError

ANY_FILE = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-5", 1e-5), ("1E3", 1000.0), ("-1.5e+2", -150.0), (".5", 0.5), ("5.", 5.0),
        ("1_000", 1000), ("010", 10), ("-3", -3), ("0x10", "0x10"), ("1:30", "1:30"),
        ("true", True), ("FALSE", False), ("yes", "yes"), ("off", "off"), ("null", None),
        ("~", None), ("", None), ("2001-01-01", "2001-01-01"), ("'1e-5'", "1e-5"), ("1e", "1e"),
        ("inf", "inf"), ("-.inf", float("-inf")), ("[1, a]", [1, "a"]), ("{a: 1}", {"a": 1}),
    ],
)  # fmt: skip
def test_plain_values(text, value):
    read = read_yaml(text).value
    assert read == value
    assert type(read) is type(value)


def test_lines_of_keys_and_entries():
    lines = read_yaml("a: 1\nb:\n  - x: 1\n    y: 2\n  - 3\n").lines
    assert (lines["a",], lines["b", 0, "y"], lines["b", 1]) == (1, 4, 5)


def test_aliases_are_copies():
    value = read_yaml("a: &a {x: 1}\nb: *a\n").value
    assert value == {"a": {"x": 1}, "b": {"x": 1}}
    assert value["a"] is not value["b"]


plain_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@settings(deadline=None)
@given(plain_values)
def test_what_is_written_reads_back(value):
    assert read_yaml(dump_yaml(value)).value == value


def test_a_case_without_models_fits_its_snapshots(load):
    few = "time: {final_time: 0.1, step: 2.5e-3}\nsnapshots: {every: 20}\n"
    (model,) = load(few).rom
    assert (model.from_operators, model.n_modes) == (True, 3)  # of three snapshots
    (model,) = load("basis: {n_modes: 2}\n").rom
    assert model.n_modes == 2


def test_section_without_keys_keeps_its_defaults(load):
    assert load("fluid:\ntime:\n  # step: 1e-3\n") == load("")


def test_override(load):
    case = load(
        "time: {step: 1e-3}\nrom: [{name: a}, {name: b}]\n",
        "time.step=5e-4", "rom.1.n_modes=7", "basis.subsets.low.reynolds=[100]", "psi.order=5",
    )  # fmt: skip
    assert case.time.step == 5e-4
    assert [model.n_modes for model in case.rom] == [5, 7]
    assert case.basis.subsets["low"].reynolds == (100.0,)
    assert case.psi.order == 5


@ANY_FILE
@given(st.binary(max_size=200))
def test_any_bytes_are_refused_in_words(tmp_path, content):
    path = tmp_path / "case.yaml"
    path.write_bytes(content)
    with pytest.raises(CaseError):
        load_case(path)


@ANY_FILE
@given(st.text(max_size=100), st.lists(st.text(max_size=30), max_size=2))
def test_any_text_gives_a_case_or_an_error_in_words(tmp_path, text, overrides):
    path = tmp_path / "case.yaml"
    path.write_text(
        "name: x\nscene: {kind: taylor-green}\n" + text, encoding="utf-8", errors="surrogatepass"
    )
    with suppress(CaseError):
        load_case(path, overrides)


SECTIONS = [
    "name", "scene", "fluid", "discretization", "time", "snapshots", "parameters", "reference",
    "basis", "psi", "rom", "compare",
]  # fmt: skip
KEYS = [
    "kind", "length", "resolution", "smoothing_length_ratio", "final_time", "step", "every", "name",
    "train", "test", "reynolds", "n_modes", "subsets", "basis", "time_step", "parameters",
    "memory_length", "projection", "courant_number", "from_time", "spin_up", "interval", "walls",
    "layers", "line", "mean_density", "lid", "lid_ramp",
    "body_force", "magnitude", "sustained_share", "form",
]  # fmt: skip
KINDS = st.sampled_from(["taylor-green", "lid-driven-cavity", "open-cavity"])
numbers = st.sampled_from([0, 1, 5, 100, -1, 0.5, 1e-12, 1e12, 1e-300, float("inf"), 10**30])
scalars = (
    numbers
    | st.floats()
    | st.sampled_from(["auto", "all", "apg", "local", "remove", "open-cavity"])
)
values = st.recursive(
    st.none() | st.booleans() | scalars | st.text(max_size=3),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=5)
    ),
    max_leaves=10,
)


@ANY_FILE
@given(KINDS, st.dictionaries(st.sampled_from(SECTIONS), values, max_size=5))
def test_known_keys_with_any_values(tmp_path, kind, sections):
    path = tmp_path / "case.yaml"
    least = {"name": "x", "scene": {"kind": kind}}
    path.write_text(dump_yaml({**least, **sections}), encoding="utf-8")
    with suppress(CaseError):
        load_case(path)
