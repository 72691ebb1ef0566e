from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sphrom import __version__, errors
from sphrom.case.points import ParameterPoint
from sphrom.cli.cases import cases
from sphrom.cli.stage_commands import stages as studies

COMMANDS = ["fom", "map", "pod", "fit-psi", "operators", "rom", "compare", "trade", "sweep"]
EVERY_COMMAND = [
    *COMMANDS, "run", "case check", "case draw", "case show", "case new", "case schema"
]  # fmt: skip


def test_nothing_is_told_of_overflows(sphrom, stages, case_file, monkeypatch, recwarn):
    """Whoever writes a result refuses what isn't finite, by its name and place."""

    def overflow(context: object, **asked: object) -> None:
        assert np.isinf(np.square(np.array(1e300)) - np.float64(0.0))

    monkeypatch.setattr(sys.modules["sphrom.recorder_fom"], "run", overflow)
    assert sphrom("fom", case_file, code=0).stderr == ""
    assert not [warning for warning in recwarn if warning.category is RuntimeWarning]


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_runs_its_stage(sphrom, stages, case_file, tmp_path, command):
    sphrom(command, case_file, code=0)
    (context,) = stages[command]
    assert sum(map(len, stages.values())) == 1
    assert (context.case.name, context.out.as_posix()) == ("small", "runs/small")
    assert (context.force, context.threads, context.only) == (False, None, None)
    assert not (tmp_path / "runs").exists()
    options = ["--out", tmp_path / "here", "--set", "psi.order=2", "--force", "--quiet"]
    options += ["--threads", "2"] if command != "sweep" else []
    sphrom(command, case_file, *options, code=0)
    context = stages[command][-1]
    assert (context.out, context.case.psi.order) == (tmp_path / "here", 2)
    assert (context.force, context.threads) == (True, None if command == "sweep" else 2)


HOSTILE = "a\x1b[2J\x9b\x7f\u202e\u2066\u200b[red]b"


@pytest.mark.parametrize(
    ("text", "arguments", "code"),
    [
        ("", ("fom", HOSTILE), 2),
        ("", ("case", "new", "taylor-green", "-o", f"{HOSTILE}.yaml"), 0),
        ("", ("fom", "small.yaml", "--set", f"{HOSTILE}=1"), 2),
        ("name: !<%c2%9b31m> x\n", ("fom", "case.yaml"), 2),
        ('"\\x1b[2J\\u202e": 1\n', ("fom", "case.yaml"), 2),
        ("name: *\u202ex\n", ("fom", "case.yaml"), 2),
    ],
)
def test_what_is_given_is_shown_and_never_obeyed(sphrom, case_file, text, arguments, code):
    """Arguments, and the text of a case."""
    Path("case.yaml").write_text(text)
    result = sphrom(*arguments, code=code)
    assert result.output
    assert result.output.replace("\n", "").isprintable()


def test_a_name_that_is_no_text_can_be_shown(case_file):
    """Bytes of a file's name that are no UTF-8, also on the output, which is strict."""
    name = os.fsencode(case_file.parent) + b"/a\xff\x1b.yaml"
    command = [sys.executable, "-m", "sphrom", "case", "new", "taylor-green", "-o"]
    done = subprocess.run([*command, name], capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert rb"a\udcff\x1b.yaml" in done.stdout


UNSEEN = "--set=rom=[{name: fast, evaluation: operators, parameters: [100, 125]}]"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("fon", "Usage: "),
        ("fom", "Usage: "),
        ("fom small.yaml --threads 0", "Usage: "),
        ("pod small.yaml --resume", "No such option"),
        ("case check small.yaml --quiet", "No such option"),
        ("fom small.yaml --checkpoint-every nan", "--checkpoint-every"),
        ("sweep small.yaml --shard 3/2", "--shard"),
        ("fom small.yaml --set psi.order=0", "psi.order"),
        ("fom small.yaml --only mach=100", "reynolds=100, reynolds=200, reynolds=150"),
        ("fom small.yaml UNSEEN --only reynolds=125", "--only: got 'reynolds=125'"),
        ("rom small.yaml UNSEEN --only fats", "reynolds=125, fast"),
        ("case new taylor_green", "did you mean taylor-green?"),
        ("case new", "the kinds are"),
        ("case new taylor-green -o small.yaml", "--force"),
        ("fom no.yaml", "no.yaml: there is no such case file"),
    ],
)
def test_wrong_arguments(sphrom, stages, case_file, arguments, words):
    before = case_file.read_text()
    given = [UNSEEN if word == "UNSEEN" else word for word in arguments.split()]
    result = sphrom(*given)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert not any(stages.values())
    assert case_file.read_text() == before


def test_only(sphrom, stages, case_file):
    for command in ("fom", "map", "rom"):
        sphrom(command, case_file, "--only", "reynolds=1.5e2", "--only", "reynolds=100", code=0)
        (context,) = stages[command]
        assert context.only == (ParameterPoint(150.0), ParameterPoint(100.0))
    sphrom("rom", case_file, UNSEEN, "--only", "fast", "--only", "reynolds=125", code=0)
    context = stages["rom"][-1]
    assert context.only == (ParameterPoint(125.0),)
    assert [model.name for model in context.chosen_models] == ["fast"]


def test_only_of_what_trade_weighs(sphrom, stages, case_file):
    sphrom("trade", case_file, "--only", "reynolds=150", code=0)
    sphrom("trade", case_file, "--only", "reynolds=100", code=2)
    sphrom("trade", case_file, "--only", "reynolds=150", "--extremes", code=0)
    found = [context.only for stage in ("trade", "extremes") for context in stages[stage]]
    assert found == [(ParameterPoint(150.0),)] * 2


@pytest.mark.parametrize("command", ["fom --quiet", "case check"])
def test_force_insists_on_an_unstable_step(sphrom, stages, case_file, command):
    """And a warning is shown even when quiet."""
    arguments = (*command.split(), case_file, "--set", "time.step=0.02")
    assert "--force accepts it" in sphrom(*arguments, code=2).stderr
    insisted = sphrom(*arguments, "--force")
    assert (insisted.exit_code, insisted.stdout) == (0, "")
    assert "beyond the acoustic limit" in insisted.stderr
    (context,) = stages["fom"] + stages["check"]
    assert context.case.time.step == 0.02


@pytest.mark.parametrize(
    ("error", "code", "stderr"),
    [
        (errors.CaseError("one\ntwo"), 2, "error: one\nerror: two\n"),
        (errors.ArtifactError("no pod.h5"), 3, "error: no pod.h5\n"),
        (errors.UnstableError("at 0.3 s"), 4, "error: at 0.3 s\n"),
        (KeyboardInterrupt(), 130, "interrupted; finished artifacts and checkpoints are kept: `"),
        (MemoryError(), 5, "error: out of memory"),
        (PermissionError(errno.EACCES, "Denied", "runs/x"), 3, "error: runs/x: Denied\n"),
        (OSError(errno.ENOSPC, "No space", "runs/x"), 5, "error: runs/x: No space\n"),
    ],
)
def test_exit_codes(sphrom, stages, monkeypatch, case_file, error, code, stderr):
    def fail(context):
        raise error

    monkeypatch.setattr(sys.modules["sphrom.recorder_fom"], "run", fail)
    assert sphrom("fom", case_file, code=code).stderr.startswith(stderr)


def test_a_mistake_in_the_program_is_not_dressed_up(sphrom, stages, monkeypatch, case_file):
    def fail(context):
        raise ZeroDivisionError

    monkeypatch.setattr(sys.modules["sphrom.recorder_fom"], "run", fail)
    with pytest.raises(ZeroDivisionError):
        sphrom("fom", case_file)


@pytest.mark.parametrize("command", EVERY_COMMAND)
def test_help_shows_an_example_that_parses(sphrom, stages, command, monkeypatch, request):
    lines = sphrom(*command.split(), "--help", code=0).output.splitlines()
    examples = [line.split()[1:] for line in lines if line.startswith("    sphrom ")]
    assert command.split() in [example[: len(command.split())] for example in examples]
    monkeypatch.chdir(request.config.rootpath)
    for example in examples:
        if not {"-o", ">"} & set(example) and command != "case schema":
            sphrom(*example, code=0)


def test_help_fits_a_terminal(sphrom, monkeypatch):
    """No line is longer, no word is split, and no summary is cut."""
    monkeypatch.setenv("COLUMNS", "80")
    names = [c.name for c in studies.registered_commands]
    names += [f"case {c.name or c.callback.__name__}" for c in cases.registered_commands]
    for command in ("", "case", *names):
        for line in sphrom(*command.split(), "--help").output.splitlines():
            assert len(line) <= 80, (command, line)
            assert not line.endswith(("-", "...")) or "Usage" in line


def test_version(sphrom):
    assert sphrom("--version").output == f"sphrom {__version__}\n"


def test_new_case(sphrom, stages, tmp_path):
    printed = sphrom("case", "new", "taylor-green", code=0)
    written = sphrom("case", "new", "taylor-green", "-o", "mine.yaml")
    assert written.stdout.startswith("wrote mine.yaml; next: sphrom case check mine.yaml\n")
    assert (tmp_path / "mine.yaml").read_text() == printed.stdout
    sphrom("case", "check", "mine.yaml", code=0)
    named = printed.stdout.partition("\n")[0].removeprefix("# yaml-language-server: $schema=")
    sphrom("case", "schema", "--output", named, code=0)
    assert Path(named).read_text() == sphrom("case", "schema").stdout
    assert "discretization" in json.loads(Path(named).read_text())["properties"]
    sphrom("case", "schema", "--output", named, code=2)
    sphrom("case", "new", "taylor-green", "-o", "mine.yaml", "--force", code=0)


def test_the_log_is_beside_the_artifacts(sphrom, stages, case_file, monkeypatch):
    def say(context):
        context.report.details.info("a detail")
        raise errors.ArtifactError("no pod.h5")

    monkeypatch.setattr(sys.modules["sphrom.recorder_fom"], "run", say)
    Path("here").mkdir()
    result = sphrom("fom", case_file, "--out", "here")
    assert (result.exit_code, result.stdout) == (3, "")
    lines = [line.split("  ", 1)[1] for line in Path("here/sphrom.log").read_text().splitlines()]
    assert lines[0].startswith("$ sphrom")
    assert lines[1:] == ["a detail", "stopped: no pod.h5"]


@pytest.mark.parametrize("arguments", [["--help"], ["fom", "--help"], ["--version"]])
def test_help_imports_nothing_heavy(arguments, printed):
    program = (
        "import sys\n"
        "from sphrom.__main__ import main\n"
        f"sys.argv = ['sphrom', *{arguments!r}]\n"
        "try:\n    main()\n"
        "finally:\n    print('imported', *sys.modules)\n"
    )
    imported = set(printed(program).split("imported ", 1)[1].split())
    heavy = {"numpy", "numba", "scipy", "h5py", "matplotlib", "yaml", "sphrom.case.models"}
    assert not imported & heavy


@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
def test_reader_that_leaves_early_sees_no_traceback():
    command = f"{sys.executable} -m sphrom case schema | head -c 10"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=300)
    assert "Traceback" not in result.stderr
