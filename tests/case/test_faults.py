"""Every way a case file can be wrong: a line each, with file, line, key and what is allowed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sphrom.case.hints import case_warnings
from sphrom.case.loader import MAX_BYTES, load_case
from sphrom.case.plan import Plan
from sphrom.errors import CaseError


def refusal_of(path: Path) -> str:
    with pytest.raises(CaseError) as caught:
        load_case(path)
    return str(caught.value)


def test_missing_file(tmp_path):
    assert "is a directory" in refusal_of(tmp_path)
    assert refusal_of(tmp_path / "no.yaml") == f"{tmp_path}/no.yaml: there is no such case file"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_unreadable_file(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_text("name: x")
    path.chmod(0)
    assert "Permission denied" in refusal_of(path)


def test_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert "is not a file" in refusal_of(tmp_path / "pipe")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"#" * (MAX_BYTES + 1), "larger than the limit of 256 KiB"),
        (b"name: x\n\xff\n", "is not UTF-8 text"),
        ("name: x\n".encode("utf-16"), "is not UTF-8 text"),
    ],
)
def test_files_that_hold_no_text(tmp_path, content, words):
    (tmp_path / "case.yaml").write_bytes(content)
    assert words in refusal_of(tmp_path / "case.yaml")


def test_byte_order_mark_is_no_part_of_the_text(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: x\nscene: {kind: taylor-green}\n")
    assert load_case(path).name == "x"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: [1\nb: 2\n", "case.yaml:2: not valid YAML: "),
        ("a: 1\n---\nb: 2\n", "case.yaml:2: not valid YAML: but found another document"),
        ("a: *b", "case.yaml:1: not valid YAML: found undefined alias"),
        ("a: 1\nb: \x01", "case.yaml:2: not valid YAML: character #x0001 is not allowed"),
        (r'a: "\UFFFFFFFF"', "case.yaml: not valid YAML: an escaped character does not exist"),
        ("[" * 5000, "case.yaml:1: nests deeper than 20 levels"),
    ],
)
def test_not_yaml(refusal, text, expected):
    (line,) = refusal(text, base="")
    assert line.startswith(expected)


def test_thousands_of_unknown_keys_are_not_all_explained(refusal, monkeypatch):
    """Each explanation takes a millisecond."""
    explained = []
    monkeypatch.setattr("sphrom.case.schema._reason", lambda *path: explained.append(path) or "")
    lines = refusal("".join(f"key{i}: 1\n" for i in range(9000)))
    assert len(explained) == 20
    assert lines[-1].endswith("case.yaml: and 8980 more problems")


def test_bases_are_put_together_once_for_all_subsets(load, monkeypatch):
    """As many times as there are subsets, thousands took minutes."""
    asked = []
    learnt = Plan._training_points
    monkeypatch.setattr(Plan, "_training_points", lambda *a: (asked.append(1), learnt(*a))[1])
    subsets = "".join(f"    s{i}: {{reynolds: [100]}}\n" for i in range(500))
    load(f"basis:\n  subsets:\n{subsets}")
    assert len(asked) == 500


@pytest.mark.parametrize("value", [".nan", "-.inf", "1e400", "9" * 390])
@pytest.mark.parametrize("key", ["time.step", "compare.from_time"])
def test_not_a_number_and_infinities(refusal, key, value):
    section, name = key.split(".")
    (line,) = refusal(f"{section}:\n  {name}: {value}\n")
    assert line.startswith(f"case.yaml:5: {key}: must be a number ")


@pytest.mark.parametrize("value", ["0", "-2.5", "1e-300", "1e300"])
@pytest.mark.parametrize(
    "key", ["scene.length", "fluid.mach_number", "discretization.resolution", "time.step"]
)
def test_negative_zero_and_absurd_sizes(refusal, key, value):
    lines = refusal("", f"{key}={value}")
    assert len(lines) == 1
    assert lines[0].startswith(f"--set: {key}: must be a")


@pytest.mark.parametrize(
    ("text", "limit"),
    [
        ("time: {step: 1.0e-2}\n", "acoustic limit of 0.006 s (1.5 h / c0, Eq. 2.19)"),
        (
            "time: {step: 1.0e-3}\nparameters: {train: {reynolds: [1, 100]}}\n",
            "viscous limit of 0.0002 s (0.125 h^2 / nu, beside walls",
        ),
    ],
)
def test_step_beyond_a_limit(refusal, load, text, limit):
    (line,) = refusal(text)
    assert line.startswith("case.yaml:4: time.step: ")
    assert limit in line
    assert line.endswith("; --force accepts it")
    assert [w for w in case_warnings(load(text, force=True)) if limit in w]


def test_aliases_that_grow_without_end(refusal):
    bomb = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
        for before, name in zip("abcdefg", "bcdefgh", strict=True)
    )
    (line,) = refusal(bomb)
    assert "has more than 10000 values" in line


def test_control_characters_stay_out_of_the_message(refusal):
    (line,) = refusal('"a\\n\\e[31m": "\\e]0;x\\a"\n')
    assert line.isprintable()


def test_all_problems_are_told_at_once(refusal):
    assert refusal("fluid: {mach_number: 2}\ntime:\n  step: -1\ncompere: 1\n") == [
        "case.yaml:4: fluid.mach_number: must be a number from 0.001 to 0.3; got 2",
        "case.yaml:6: time.step: must be a number above zero (1e-12 to 1e12) or auto; got -1",
        "case.yaml:7: compere: unknown key; did you mean compare?",
    ]
    assert len(refusal("".join(f"key{i}: 1\n" for i in range(50)))) == 21


@pytest.mark.parametrize(
    ("scene", "more", "expected"),
    [
        ("taylor-green", "", False),  # packed
        ("taylor-green", "reference: {points: lattice}\n", True),
        ("taylor-green", "discretization: {initial_particles: lattice}\n", True),
        ("lid-driven-cavity", "", True),
        ("lid-driven-cavity", "reference: {points: relaxed}\n", False),
        ("lid-driven-cavity", "psi: {kind: polyharmonic}\n", False),
        ("open-cavity", "", False),  # does not fill its box
        ("open-cavity", "reference: {points: lattice}\n", False),
    ],
)
def test_splines_are_of_the_kind_that_fits_the_points(load, scene, more, expected):
    case = load(more, base=f"name: x\nscene: {{kind: {scene}}}\n")
    assert case.plan.lattice_splines is expected
