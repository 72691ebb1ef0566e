"""Every way a case file can be wrong: a line each, with file, line, key and what is allowed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sphrom.case.hints import case_warnings
from sphrom.case.loader import MAX_BYTES, load_case
from sphrom.case.models import Case
from sphrom.errors import CaseError

KINDS = "one of taylor-green, lid-driven-cavity, open-cavity, custom"


def refusal_of(path: Path) -> str:
    with pytest.raises(CaseError) as caught:
        load_case(path)
    return str(caught.value)


def test_missing_file(tmp_path):
    assert refusal_of(tmp_path / "no.yaml") == f"{tmp_path}/no.yaml: there is no such case file"


def test_directory(tmp_path):
    assert "is a directory" in refusal_of(tmp_path)


def test_name_with_a_null_character():
    assert "can't be read" in refusal_of(Path("a\0b"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_unreadable_file(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_text("name: x")
    path.chmod(0)
    assert "Permission denied" in refusal_of(path)


def test_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert "is not a regular file" in refusal_of(tmp_path / "pipe")


def test_huge_file(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_bytes(b"#" * (MAX_BYTES + 1))
    assert "larger than a case file may be" in refusal_of(path)


@pytest.mark.parametrize("content", [b"name: x\n\xff\n", "name: x\n".encode("utf-16")])
def test_text_in_another_encoding(tmp_path, content):
    path = tmp_path / "case.yaml"
    path.write_bytes(content)
    assert "is not UTF-8 text" in refusal_of(path)


def test_byte_order_mark_is_no_part_of_the_text(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: x\nscene: {kind: taylor-green}\n")
    assert load_case(path).name == "x"


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n", "---\n", "null"])
def test_empty(refusal, text):
    (line,) = refusal(text, base="")
    assert line.startswith("case.yaml: is empty; `sphrom case new")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: [1\nb: 2\n", "case.yaml:2: not valid YAML: "),
        ("a: b: c", "case.yaml:1: not valid YAML: mapping values are not allowed here"),
        ("a:\n\tb: 1", "case.yaml:2: not valid YAML: found character"),
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


@pytest.mark.parametrize("text", ["[1, 2]", "just text", "42"])
def test_not_a_mapping(refusal, text):
    (line,) = refusal(text, base="")
    assert line.startswith("case.yaml: must be a mapping of keys; got ")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name: other\n", "case.yaml:4: name: appears twice, first in line 1"),
        (
            "time:\n  step: 1e-3\n  final_time: 1\n  step: 2e-3\n",
            "case.yaml:7: time.step: appears twice, first in line 5",
        ),
        (
            "rom:\n  - name: x\n    'name': y\n",
            "case.yaml:6: rom.0.name: appears twice, first in line 5",
        ),
    ],
)
def test_duplicate_keys(refusal, text, expected):
    assert refusal(text) == [expected]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("tiem: 3\n", "case.yaml:4: tiem: unknown key; did you mean time?"),
        (
            "discretization:\n  resolutoin: 50\n",
            "case.yaml:5: discretization.resolutoin: unknown key; did you mean resolution?",
        ),
        (
            "resolution: 50\n",
            "case.yaml:4: resolution: unknown key; did you mean discretization.resolution?",
        ),
        (
            "rom:\n- name: x\n  mode: 5\n",
            "case.yaml:6: rom.0.mode: unknown key; did you mean n_modes?",
        ),
        (
            "snapshots: {qqq: 1}\n",
            "case.yaml:4: snapshots.qqq: unknown key; known: every",
        ),
        ("1: 2\n", "case.yaml:4: '1': unknown key; known: name, scene, fluid, "),
        ("? [a]\n: 1\n", "case.yaml:4: a key must be text"),
        ("<<: {name: y}\n", "case.yaml:4: '<<': unknown key; known: name, "),
    ],
)
def test_unknown_keys(refusal, text, expected):
    (line,) = refusal(text)
    assert line.startswith(expected.replace("'1'", "1"))


def test_thousands_of_unknown_keys_are_not_all_explained(refusal, monkeypatch):
    """Each explanation takes a millisecond."""
    explained = []
    monkeypatch.setattr("sphrom.case.messages._nearest_key", lambda *path: explained.append(path))
    lines = refusal("".join(f"key{i}: 1\n" for i in range(9000)))
    assert len(explained) == 20
    assert lines[-1].endswith("case.yaml: and 8980 more problems")


def test_bases_are_put_together_once_for_all_subsets(tmp_path, monkeypatch):
    """As many times as there are subsets, thousands took minutes."""
    asked = []
    whole = Case.bases.fget
    monkeypatch.setattr(Case, "bases", property(lambda case: (asked.append(1), whole(case))[1]))
    subsets = "".join(f"    s{i}: {{reynolds: [100]}}\n" for i in range(500))
    path = tmp_path / "case.yaml"
    path.write_text(f"name: x\nscene: {{kind: taylor-green}}\nbasis:\n  subsets:\n{subsets}")
    load_case(path)
    assert len(asked) < 10


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("fluid: 3\n", "4: fluid: must be a mapping of keys (reference_density, "),
        ("rom: {name: x}\n", "4: rom: must be a list of mappings; got "),
        ("rom: [5]\n", "4: rom.0: must be a mapping of keys (name, "),
        ("discretization: {resolution: 50.5}\n", "resolution: must be a whole number from 8 to "),
        ("discretization: {resolution: '50'}\n", "resolution: must be a whole number from 8 to "),
        ("discretization: {resolution: true}\n", "; got true"),
        ("fluid: {mach_number: true}\n", "fluid.mach_number: must be a number from 0.001 to 0.3;"),
        ("fluid: {mach_number: '0.1'}\n", "; got '0.1'"),
        ("fluid: {mach_number: [0.1]}\n", "; got [0.1]"),
        ("fluid: {mach_number: null}\n", "; got null"),
        ("time: {step: true}\n", "time.step: must be a number above zero (1e-12 to 1e12) or auto;"),
        ("time: {step: fast}\n", "; got 'fast'"),
        ("compare: {plots: 1}\n", "compare.plots: must be true or false; got 1"),
        ("compare: {plots: yes}\n", "compare.plots: must be true or false; got 'yes'"),
        ("psi: {order: 8}\n", "psi.order: must be a whole number from 1 to 7; got 8"),
        ("basis: {n_modes: ten}\n", "must be a whole number from 1 to 10000 or null; got 'ten'"),
        ("reference: {method: msl}\n", "reference.method: must be one of mls, shepard; got 'msl'"),
        ("parameters: {train: {reynolds: 100}}\n", "must be a list of one or more numbers above"),
        ("parameters: {train: {reynolds: []}}\n", "train.reynolds: must be a list of one or more"),
        ("parameters: {train: {reynolds: [1, a]}}\n", "train.reynolds.1: must be a number above"),
        ("rom: [{n_modes: 5}]\n", "4: rom.0.name: is missing; it must be a name of at most 64"),
        ("rom: [{name: x, parameters: some}]\n", "must be one of all, train, test or a list of"),
        ("rom: [{name: x, parameters: [9, -1]}]\n", "rom.0.parameters.1: must be a number above"),
        (
            "rom: [{name: x, evaluation: lattice}]\n",
            "evaluation: must be one of particles, operators, points; got 'lattice'",
        ),
        ("basis: {subsets: {a/b: {reynolds: [100]}}}\n", "basis.subsets.'a/b': must be a name of"),
        (
            "basis: {subsets: {half: }}\n",
            "basis.subsets.half: must be a mapping of keys (reynolds, interval, box)",
        ),
    ],
)
def test_wrong_types(refusal, text, expected):
    (line,) = refusal(text)
    assert line.startswith("case.yaml:4: ")
    assert expected in line


@pytest.mark.parametrize(
    ("base", "expected"),
    [
        ("name: x\n", "case.yaml:1: scene: is missing; it must be a mapping of keys (kind, "),
        ("name: x\nscene: {}\n", f"case.yaml:2: scene.kind: is missing; it must be {KINDS}"),
        ("name: x\nscene:\n", f"case.yaml:2: scene.kind: is missing; it must be {KINDS}"),
        ("name: x\nscene: {length: 1}\n", f"scene.kind: is missing; it must be {KINDS}"),
        ("name: x\nscene: 3\n", "case.yaml:2: scene: must be a mapping of keys (kind, length, "),
        ("name: x\nscene: [1]\n", "case.yaml:2: scene: must be a mapping of keys (kind, length, "),
        ("scene: {kind: taylor-green}\n", "case.yaml:1: name: is missing; it must be a name of"),
        ("name: 2024\nscene: {kind: taylor-green}\n", "case.yaml:1: name: must be a name of"),
        ("name: ../x\nscene: {kind: taylor-green}\n", "begin with - or .; got '../x'"),
        ("name: -x\nscene: {kind: taylor-green}\n", "begin with - or .; got '-x'"),
        ("name: x\nscene: {kind: 3}\n", f"scene.kind: must be {KINDS}; got 3"),
        (
            "name: x\nscene: {kind: open_cavity}\n",
            f"scene.kind: must be {KINDS}; got 'open_cavity'; did you mean open-cavity?",
        ),
    ],
)
def test_least_that_a_case_needs(refusal, base, expected):
    (line,) = refusal("", base=base)
    assert expected in line


@pytest.mark.parametrize("value", [".nan", ".inf", "-.inf", "1e400", "9" * 390])
@pytest.mark.parametrize(
    "key", ["time.final_time", "time.step", "fluid.mach_number", "compare.from_time"]
)
def test_not_a_number_and_infinities(refusal, key, value):
    section, name = key.split(".")
    (line,) = refusal(f"{section}:\n  {name}: {value}\n")
    assert line.startswith(f"case.yaml:5: {key}: must be a number ")


def test_number_too_long_to_mean_anything(refusal):
    assert refusal(f"snapshots: {{every: {'9' * 5000}}}\n") == [
        "case.yaml:4: snapshots.every: a number has at most 400 digits"
    ]


@pytest.mark.parametrize("value", ["0", "-1", "-2.5", "1e-300", "1e300"])
@pytest.mark.parametrize(
    "key",
    [
        "scene.length", "fluid.reference_density", "fluid.reference_speed", "fluid.mach_number",
        "discretization.resolution", "discretization.smoothing_length_ratio", "time.final_time",
        "time.step", "time.courant_number", "snapshots.every", "compare.grid", "psi.order",
    ],
)  # fmt: skip
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
    assert line.endswith("; --force insists on it")
    assert [w for w in case_warnings(load(text, force=True)) if limit in w]


def test_step_at_its_limit_is_allowed(load):
    told = case_warnings(load("time: {step: 6.0e-3, final_time: 0.6}\n"))
    assert not [warning for warning in told if "time.step" in warning]


def test_final_time_that_is_not_a_whole_number_of_steps(refusal):
    assert refusal("time: {step: 3.0e-3}\n") == [
        "case.yaml:4: time.step: 1 s is not a whole number of steps of 0.003 s; "
        "the nearest step is 0.003003003003, or end at 0.999 s"
    ]


def test_more_steps_than_anyone_means(refusal):
    (line,) = refusal("time: {step: 1.0e-12, final_time: 1.0e+12}\n")
    assert line == "case.yaml:4: time: a run of 1e+24 steps; at most 1e+09 are allowed"


def test_snapshots_further_apart_than_the_run_is_long(refusal):
    assert refusal("snapshots:\n  every: 1001\ntime: {step: 1.0e-3}\n") == [
        "case.yaml:5: snapshots.every: must be at most the number of steps, 1000; got 1001"
    ]


SHORT = "time: {step: 1.0e-3, final_time: 0.02}\n"  # 3 snapshots


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "rom: [{name: x, n_modes: 4}]\n",
            "5: rom.0.n_modes: must be at most the number of snapshots of basis all, "
            "3 (1 run of 3); got 4",
        ),
        (
            "basis: {n_modes: 4}\nrom: []\n",
            "5: basis.n_modes: must be at most the number of snapshots of basis all, "
            "3 (1 run of 3); got 4",
        ),
        (
            "parameters: {train: {reynolds: [100, 200]}}\nbasis: {subsets: {a: {reynolds: [100]}}}"
            "\nrom: [{name: y, n_modes: 6}, {name: x, n_modes: 4, basis: a}]\n",
            "7: rom.1.n_modes: must be at most the number of snapshots of basis a, "
            "3 (1 run of 3); got 4",
        ),
        (
            "basis: {n_modes: 2}\nrom: [{name: x, n_modes: 3}]\n",
            "6: rom.0.n_modes: must be at most basis.n_modes, 2; got 3",
        ),
    ],
)
def test_more_modes_than_snapshots(refusal, text, expected):
    assert refusal(SHORT + text) == [f"case.yaml:{expected}"]


def test_parameters_outside_of_the_trained_range_are_warned_of(load):
    values = "parameters: {train: {reynolds: [100, 200]}, test: {reynolds: [99, 150, 201]}}\n"
    assert case_warnings(load(values)) == [
        f"parameters.test: reynolds={value} is outside of the trained range, 100 to 200: "
        "a reduced model extrapolates there"
        for value in (99, 201)
    ]


def test_support_larger_than_the_periodic_box(refusal, load):
    text = "discretization: {resolution: 15}\n"
    assert refusal(text) == [
        "case.yaml:4: discretization.smoothing_length_ratio: a support of radius 0.533333 m is "
        "larger than half of the periodic box of 1 m; use at most 3.75, or a resolution of at "
        "least 16"
    ]
    assert load(text, "discretization.resolution=16").discretization.resolution == 16
    (line,) = refusal("reference: {smoothing_length_ratio: 8}\n", "discretization.resolution=31")
    assert line.startswith("case.yaml:4: reference.smoothing_length_ratio: a support of radius")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "parameters: {train: {reynolds: [100, 1e2]}}\n",
            "parameters.train.reynolds: reynolds=100 stands more than once",
        ),
        (
            "parameters: {test: {reynolds: [7, 7.0]}}\n",
            "parameters.test.reynolds: reynolds=7 stands more than once",
        ),
        (
            "parameters: {train: {reynolds: [100]}, test: {reynolds: [100]}}\n",
            "parameters.test.reynolds: reynolds=100 is trained on; test elsewhere",
        ),
        (
            "basis: {subsets: {a: {reynolds: [101]}}}\n",
            "basis.subsets.a.reynolds: reynolds=101 is not trained on; the nearest is reynolds=100",
        ),
        (
            "basis: {subsets: {a: {reynolds: [100.0000001]}}}\n",
            "basis.subsets.a.reynolds: reynolds=100.0000001 is not trained on; "
            "the nearest is reynolds=100",
        ),
        (
            "basis: {subsets: {a: {reynolds: [100]}}}\n"
            "parameters: {train: {reynolds: [50, 100.0000001]}}\n",
            "basis.subsets.a.reynolds: reynolds=100 is not trained on; "
            "the nearest is reynolds=100.0000001",
        ),
        (
            "basis: {subsets: {a: {reynolds: [100, 100]}}}\n",
            "basis.subsets.a.reynolds: reynolds=100 stands more than once",
        ),
        (
            "basis: {subsets: {All: {reynolds: [100]}}}\n",
            "basis.subsets: the name all is taken",
        ),
        (
            "rom: [{name: x, basis: al}]\n",
            "rom.0.basis: no basis has the name al; did you mean all?",
        ),
        (
            "rom: [{name: x}, {name: X}]\n",
            "rom: two reduced models have the name x",
        ),
        (
            "rom: [{name: x, memory_length: 1e-4}]\n",
            "rom.0.memory_length: is only for projection: apg",
        ),
        (
            "rom: [{name: x, jacobian_step: 1e-4}]\n",
            "rom.0.jacobian_step: is only for projection: apg",
        ),
        (
            "rom: [{name: x, parameters: [100, 125]}]\n",
            "rom.0.parameters: reynolds=125 is in neither parameters.train nor parameters.test; "
            "the nearest is reynolds=100",
        ),
        (
            "rom: [{name: x, parameters: [100.0000001]}]\n",
            "rom.0.parameters: reynolds=100.0000001 is in neither parameters.train nor "
            "parameters.test; the nearest is reynolds=100",
        ),
        (
            "rom: [{name: x, parameters: [100, 100]}]\n",
            "rom.0.parameters: reynolds=100 stands more than once",
        ),
        (
            "rom: [{name: x, parameters: test}]\n",
            "rom.0.parameters: there are no test values",
        ),
        (
            "compare: {from_time: 1}\n",
            "compare.from_time: must be before time.final_time, 1 s; got 1",
        ),
    ],
)
def test_keys_that_do_not_fit_each_other(refusal, text, expected):
    assert refusal(text) == [f"case.yaml:4: {expected}"]


@pytest.mark.parametrize("name", ["full", "map", "exact", "best", "best-possible-all-M5", "Full"])
def test_names_of_rows_of_the_comparison(refusal, name):
    (line,) = refusal(f"rom: [{{name: x}}, {{name: {name}}}]\n")
    assert line == (
        "case.yaml:4: rom.1.name: the comparison has rows of its own that are called full, map, "
        f"exact or begin with best; choose another name than {name}"
    )


@pytest.mark.parametrize("name", ["full-5", "mapped", "thebest"])
def test_names_that_only_look_like_rows(load, name):
    assert load(f"rom: [{{name: {name}}}]\n").rom[0].name == name


def test_a_mach_number_that_is_not_weakly_compressible(refusal, load):
    (line,) = refusal("fluid: {mach_number: 0.31}\n")
    assert line.endswith("fluid.mach_number: must be a number from 0.001 to 0.3; got 0.31")
    assert load("fluid: {mach_number: 0.3}\n").fluid.mach_number == 0.3


def test_cells_whose_systems_are_too_large(refusal):
    (line,) = refusal("psi: {cell_width_ratio: 17}\n")
    assert "must be a number from 1 to 16" in line


def test_reduced_step_that_misses_the_snapshots(refusal, load):
    steps = "time: {step: 1.0e-3}\n"  # snapshots every 10 ms
    assert refusal(steps + "rom: [{name: x, time_step: 4e-3}]\n") == [
        "case.yaml:5: rom.0.time_step: the 0.01 s between snapshots is not a whole number of "
        "steps of 0.004 s; the nearest step is 0.005"
    ]
    assert load(steps + "rom: [{name: x, time_step: 5e-3}]\n").rom[0].time_step == 5e-3


@pytest.mark.parametrize(
    "text",
    [
        "x: !!python/object/apply:os.system ['true']\n",
        "x: !!python/name:os.system\n",
        "x: !local {a: 1}\n",
        "x: !!binary aGVsbG8=\n",
        "x: !!float hello\n",
        "x: !!timestamp 2001-99-99\n",
    ],
)
def test_tags(refusal, text):
    (line,) = refusal(text)
    assert line.startswith("case.yaml:4: x: tags are not allowed; got ")


def test_aliases_that_grow_without_end(refusal):
    bomb = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
        for before, name in zip("abcdefg", "bcdefgh", strict=True)
    )
    (line,) = refusal(bomb)
    assert "holds more than 10000 values" in line


def test_alias_of_itself(refusal):
    (line,) = refusal("a: &a [*a]\n")
    assert line == "case.yaml:4: nests deeper than 20 levels"


def test_text_that_is_not_unicode(refusal):
    assert refusal('x: "\\ud800"\n') == ["case.yaml:4: x: is not Unicode text"]
    assert refusal('"\\ud800": 1\n') == ["case.yaml:4: a key must be text"]


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
    ("text", "expected"),
    [
        (
            "psi: {kind: b-spline}\n",
            "psi.kind: B-splines are for points of a lattice, and with reference.points: initial "
            "these are not; set reference.points: lattice",
        ),
        (
            "psi: {kind: b-spline}\nreference: {points: relaxed}\n"
            "discretization: {initial_particles: lattice}\n",
            "with reference.points: relaxed these are not; set reference.points: lattice",
        ),
        (
            "psi: {kind: b-spline, order: 5}\nreference: {points: lattice}\n",
            "psi.order: is only for kind: polyharmonic",
        ),
        (
            "psi: {order: 5}\nreference: {points: lattice}\n",
            "psi.order: is only for kind: polyharmonic, and auto means b-spline here",
        ),
    ],
)
def test_b_splines_need_a_lattice(refusal, text, expected):
    (line,) = refusal(text)
    assert expected in line


def test_b_splines_are_for_fluid_that_fills_a_box(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_text("name: x\nscene: {kind: open-cavity}\npsi: {kind: b-spline}\n")
    assert "psi.kind: B-splines are for fluid that fills a box, and the open-cavity's does not" in (
        refusal_of(path)
    )
    path.write_text("name: x\nscene: {kind: lid-driven-cavity}\npsi: {kind: b-spline}\n")
    assert load_case(path).psi.kind == "b-spline"


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
def test_splines_are_of_the_kind_that_fits_the_points(tmp_path, scene, more, expected):
    path = tmp_path / "case.yaml"
    path.write_text(f"name: x\nscene: {{kind: {scene}}}\n{more}")
    assert load_case(path).lattice_splines is expected
