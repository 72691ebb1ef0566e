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
from sphrom.case.template import scene_kinds
from sphrom.stages import STAGES

COMMANDS = {
    "fom": "fom",
    "map": "map",
    "pod": "pod",
    "fit-psi": "fit_psi",
    "operators": "operators",
    "rom": "rom",
    "compare": "compare",
    "trade": "trade",
    "run": "pipeline",
    "sweep": "sweep",
    "case check": "check",
}
EVERY_COMMAND = [*COMMANDS, "case draw", "case show", "case new", "case schema"]


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=60)


def test_nothing_is_told_of_overflows(sphrom, stages, case_file, monkeypatch, recwarn):
    """Whoever writes a result refuses what isn't finite, by its name and place."""

    def overflow(context: object, **asked: object) -> None:
        assert np.isinf(np.square(np.array(1e300)) - np.float64(0.0))

    monkeypatch.setattr(sys.modules["sphrom.offline.fom"], "run", overflow)
    result = sphrom("fom", case_file)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    assert not [warning for warning in recwarn if warning.category is RuntimeWarning]


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_runs_its_stage(sphrom, stages, case_file, tmp_path, command):
    result = sphrom(*command.split(), case_file)
    assert result.exit_code == 0, result.output
    (context,) = stages[COMMANDS[command]]
    assert sum(map(len, stages.values())) == 1
    assert context.case.name == "small"
    assert context.out.as_posix() == "runs/small"
    assert (context.force, context.threads, context.only) == (False, None, None)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "command", [name for name in COMMANDS if name not in ("case check", "sweep")]
)
def test_options_reach_the_stage(sphrom, stages, case_file, tmp_path, command):
    result = sphrom(
        *command.split(), case_file, "--out", tmp_path / "here", "--set", "psi.order=5",
        "--set", "psi.polynomial_degree=2", "--force", "--threads", "2", "--quiet",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    (context,) = stages[COMMANDS[command]]
    assert context.out == tmp_path / "here"
    assert (context.case.psi.order, context.case.psi.polynomial_degree) == (5, 2)
    assert (context.force, context.threads) == (True, 2)


def test_options_of_a_sweep(sphrom, stages, case_file, tmp_path, monkeypatch):
    asked = []
    stage = sys.modules["sphrom.sweep.sweep"]
    monkeypatch.setattr(stage, "run", lambda context, **others: asked.append((context, others)))
    result = sphrom(
        "sweep", case_file, "--out", tmp_path / "here", "--workers", "3", "--shard", "2/8",
        "--scheduler", "tcp://node:8786", "--collect", "--set", "sweep.reynolds=[100]",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    ((context, others),) = asked
    assert (context.out, context.case.sweep.reynolds) == (tmp_path / "here", (100.0,))
    assert others == {
        "workers": 3, "scheduler": "tcp://node:8786", "shard": (2, 8), "collect": True,
    }  # fmt: skip


HOSTILE = "a\x1b[2J\x9b\x7f\u202e\u2066\u200b[red]b"
SHOWN = r"a\x1b[2J\x9b\x7f\u202e\u2066\u200b[red]b"


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("fom", HOSTILE), 2),
        (("fom", "small.yaml", HOSTILE), 2),
        (("fom", "small.yaml", f"--{HOSTILE}"), 2),
        ((f"--{HOSTILE}",), 2),
        ((HOSTILE,), 2),
        (("case", HOSTILE), 2),
        (("case", "new", HOSTILE), 2),
        (("case", "new", "taylor-green", "-o", f"{HOSTILE}.yaml"), 0),
        (("fom", "small.yaml", "--only", HOSTILE), 2),
        (("fom", "small.yaml", "--only", f"{HOSTILE}=1"), 2),
        (("fom", "small.yaml", "--set", HOSTILE), 2),
        (("fom", "small.yaml", "--set", f"{HOSTILE}=1"), 2),
        (("fom", "small.yaml", "--set", f"name={HOSTILE}"), 2),
        (("fom", "small.yaml", "--threads", HOSTILE), 2),
        (("sweep", "small.yaml", "--shard", HOSTILE), 2),
        (("export", f"{HOSTILE}.h5"), 3),
        (("import", "small.yaml", f"{HOSTILE}.npz", "--only", "reynolds=100"), 3),
    ],
)
def test_arguments_are_shown_and_never_obeyed(sphrom, case_file, arguments, code):
    result = sphrom(*arguments)
    assert result.exit_code == code, result.output
    assert result.output.replace("\n", "").isprintable()


@pytest.mark.parametrize(
    "text",
    [
        'name: x\nscene: !<\x1b> {kind: taylor-green}\n',
        'name: !<%1b[2J> x\n',
        'name: !<%c2%9b31m> x\n',
        'name: !<%e2%80%ae> x\n',
        '"\\x1b[2J\\u202e": 1\n',
        'name: "\\x9b\\u2066"\n',
        'name: x\nscene: {kind: "\\e[2J"}\n',
        'name: *\u202ex\n',
        'name: x\nrom: [{name: "\\e"}]\n',
    ],
)  # fmt: skip
def test_texts_of_a_case_are_shown_and_never_obeyed(sphrom, tmp_path, text):
    (tmp_path / "case.yaml").write_text(text)
    result = sphrom("fom", "case.yaml")
    assert result.exit_code == 2, result.output
    assert result.stderr
    assert result.output.replace("\n", "").isprintable()


def test_a_name_that_is_no_text_can_be_shown(case_file):
    """Bytes of a file's name that are no UTF-8, also on the output, which is strict."""
    name = os.fsencode(case_file.parent) + b"/a\xff\x1b.yaml"
    command = [sys.executable, "-m", "sphrom", "case", "new", "taylor-green", "-o"]
    done = subprocess.run([*command, name], capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert rb"a\udcff\x1b.yaml" in done.stdout


@pytest.mark.parametrize("shard", ["0/2", "3/2", "2", "a/b", "1/", "-1/2"])
def test_shards_that_are_none(sphrom, stages, case_file, shard):
    result = sphrom("sweep", case_file, "--shard", shard)
    assert result.exit_code == 2
    assert result.stderr == f"error: --shard: must be like 1/8, up to 8/8; got {shard!r}\n"
    assert stages["sweep"] == []


@pytest.mark.parametrize("command", ["fom", "rom", "run"])
def test_stages_of_runs_can_go_on(sphrom, stages, case_file, command):
    assert sphrom(command, case_file).exit_code == 0
    assert sphrom(command, case_file, "--resume", "--checkpoint-every", "5").exit_code == 0
    contexts = stages[COMMANDS[command]]
    assert [(c.resume, c.checkpoint_every) for c in contexts] == [(False, 60.0), (True, 5.0)]
    for bad in ("-1", "nan", "often"):
        assert sphrom(command, case_file, "--checkpoint-every", bad).exit_code == 2
    assert sphrom("pod", case_file, "--resume").exit_code == 2


def test_a_check_has_only_the_options_that_act(sphrom, stages, case_file, tmp_path):
    arguments = ("case", "check", case_file, "--set", "time.step=0.02", "--out", tmp_path / "here")
    assert sphrom(*arguments).exit_code == 2
    assert sphrom(*arguments, "--force").exit_code == 0
    (context,) = stages["check"]
    assert (context.out, context.case.time.step) == (tmp_path / "here", 0.02)
    for option in (("--quiet",), ("--threads", "2"), ("--only", "reynolds=100")):
        assert "No such option" in sphrom("case", "check", case_file, *option).stderr


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("pod", "Write over artifacts; insist on a step beyond its limit."),
        ("rom", "Write over artifacts; insist on a step beyond its limit."),
        ("run", "Make again what no longer belongs to the case, and only that;"),
        ("case check", "Insist on a step beyond its limit, as stages do."),
    ],
)
def test_help_says_what_force_does(sphrom, command, words):
    text = " ".join(sphrom(*command.split(), "--help").stdout.split())
    assert words in text
    assert text.count("Write over") == (command in ("pod", "rom"))


@pytest.mark.parametrize("command", ["fom", "map", "rom"])
def test_only(sphrom, stages, case_file, command):
    result = sphrom(command, case_file, "--only", "reynolds=1.5e2", "--only", "reynolds=100")
    assert result.exit_code == 0, result.output
    (context,) = stages[command]
    assert context.only == (ParameterPoint(150.0), ParameterPoint(100.0))


@pytest.mark.parametrize(
    ("only", "message"),
    [
        ("reynolds=99", "the case has no reynolds=99; it has reynolds=100, reynolds=200, "),
        ("mach=100", "the case has no mach=100; it has reynolds=100, "),
        ("reynolds=nan", "the case has no reynolds=nan"),
        ("reynolds", "must be like reynolds=100; got 'reynolds'"),
        ("reynolds=fast", "must be like reynolds=100; got 'reynolds=fast'"),
    ],
)
def test_only_what_the_case_has(sphrom, stages, case_file, only, message):
    result = sphrom("fom", case_file, "--only", only)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"error: --only: {message}")
    assert stages["fom"] == []


UNSEEN = "rom=[{name: fast, evaluation: operators, parameters: [100, 125]}]"


def test_only_a_value_that_a_reduced_model_alone_is_run_at(sphrom, stages, case_file):
    result = sphrom("rom", case_file, "--set", UNSEEN, "--only", "reynolds=125")
    assert result.exit_code == 0, result.output
    (context,) = stages["rom"]
    assert context.only == (ParameterPoint(125.0),)


@pytest.mark.parametrize("command", ["fom", "map", "trade"])
def test_only_where_the_command_runs(sphrom, stages, case_file, command):
    result = sphrom(command, case_file, "--set", UNSEEN, "--only", "reynolds=125")
    assert result.exit_code == 2
    assert result.stderr.startswith(
        "error: --only: this command doesn't run at reynolds=125, though others do; it runs at "
        "reynolds=1"
    )
    assert stages[command] == []


def test_only_of_what_trade_weighs(sphrom, stages, case_file):
    assert sphrom("trade", case_file, "--only", "reynolds=150").exit_code == 0
    assert sphrom("trade", case_file, "--only", "reynolds=100").exit_code == 2
    listed = ("--set", "trade.parameters=all", "--only", "reynolds=100")
    assert sphrom("trade", case_file, *listed).exit_code == 0
    assert sphrom("trade", case_file, "--only", "reynolds=2000", "--extremes").exit_code == 0
    assert sphrom("trade", case_file, "--only", "reynolds=2000").exit_code == 2
    found = [context.only for stage in ("trade", "extremes") for context in stages[stage]]
    assert found == [(ParameterPoint(value),) for value in (150.0, 100.0, 2000.0)]


@pytest.mark.parametrize("command", COMMANDS)
def test_invalid_case(sphrom, stages, tmp_path, command):
    (tmp_path / "bad.yaml").write_text(
        "name: bad\nscene: {kind: taylor-green}\ntime: {step: -1}\nfluid: {mach: 1}\n"
    )
    result = sphrom(*command.split(), "bad.yaml")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.splitlines() == [
        "error: bad.yaml:4: fluid.mach: unknown key; did you mean mach_number?",
        "error: bad.yaml:3: time.step: must be a number above zero (1e-12 to 1e12) or auto; got -1",
    ]
    assert not any(stages.values())


def test_invalid_override(sphrom, stages, case_file):
    result = sphrom("run", case_file, "--set", "psi.order=0")
    assert result.exit_code == 2
    assert result.stderr == ("error: --set: psi.order: must be a whole number from 1 to 7; got 0\n")


def test_warnings_are_shown_even_when_quiet(sphrom, stages, case_file):
    result = sphrom("fom", case_file, "--quiet", "--set", "parameters.test.reynolds=[300]")
    assert result.exit_code == 0
    assert result.stdout == ""
    assert result.stderr.startswith("warning: parameters.test: reynolds=300 is outside of the")


def test_force_insists_on_an_unstable_step(sphrom, stages, case_file):
    arguments = ("fom", case_file, "--set", "time.step=0.02")
    refused = sphrom(*arguments)
    assert refused.exit_code == 2
    assert "--force insists on it" in refused.stderr
    insisted = sphrom(*arguments, "--force")
    assert insisted.exit_code == 0
    assert "beyond the acoustic limit of 0.006 s" in insisted.stderr
    assert stages["fom"][0].case.time.step == 0.02


@pytest.mark.parametrize(
    ("error", "code", "stderr"),
    [
        (errors.CaseError("one\ntwo"), 2, "error: one\nerror: two\n"),
        (errors.ArtifactError("no pod.h5"), 3, "error: no pod.h5\n"),
        (errors.UnstableError("at 0.3 s"), 4, "error: at 0.3 s\n"),
        (errors.ResourceError("needs 9 TB"), 5, "error: needs 9 TB\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
        (MemoryError(), 5, "error: out of memory; `sphrom case check` tells what a case needs\n"),
        (
            PermissionError(errno.EACCES, "Permission denied", "runs/x"),
            3,
            "error: runs/x: Permission denied\n",
        ),
        (
            OSError(errno.ENOSPC, "No space left on device", "runs/x"),
            5,
            "error: runs/x: No space left on device\n",
        ),
    ],
)
@pytest.mark.parametrize("command", ["fom", "case check"])
def test_exit_codes(sphrom, stages, monkeypatch, case_file, command, error, code, stderr):
    def fail(context):
        raise error

    monkeypatch.setattr(sys.modules[f"sphrom.{STAGES[COMMANDS[command]]}"], "run", fail)
    result = sphrom(*command.split(), case_file)
    assert (result.exit_code, result.stderr) == (code, stderr)


def test_a_mistake_in_the_program_is_not_dressed_up(sphrom, stages, monkeypatch, case_file):
    def fail(context):
        raise ZeroDivisionError

    monkeypatch.setattr(sys.modules["sphrom.offline.fom"], "run", fail)
    assert isinstance(sphrom("fom", case_file).exception, ZeroDivisionError)


@pytest.mark.parametrize(
    "arguments",
    [
        ["fon"], ["fom"], ["fom", "a", "b"], ["fom", "a", "--thread", "x"], ["pod", "a", "--only"],
        ["fom", "a", "--threads", "0"], ["fom", "a", "--threads", "many"],
    ],
)  # fmt: skip
def test_wrong_usage(sphrom, stages, arguments):
    result = sphrom(*arguments)
    assert result.exit_code == 2
    assert "Usage: " in result.stderr


@pytest.mark.parametrize("command", EVERY_COMMAND)
def test_help_shows_an_example_that_parses(sphrom, stages, command, monkeypatch, request):
    result = sphrom(*command.split(), "--help")
    assert result.exit_code == 0
    example = next(
        line.split()[1:] for line in result.output.splitlines() if line.startswith("    sphrom ")
    )
    assert example[: len(command.split())] == command.split()
    monkeypatch.chdir(request.config.rootpath)
    if not {"-o", ">"} & set(example) and command != "case schema":
        example_result = sphrom(*example)
        assert example_result.exit_code == 0, example_result.output


def test_version(sphrom):
    assert sphrom("--version").output == f"sphrom {__version__}\n"


def test_new_case(sphrom, stages, tmp_path):
    printed = sphrom("case", "new", "taylor-green")
    assert printed.exit_code == 0
    written = sphrom("case", "new", "taylor-green", "-o", "mine.yaml")
    assert written.stdout.splitlines() == [
        "wrote mine.yaml; next: sphrom case check mine.yaml",
        "for completion and checks in an editor: sphrom case schema -o sphrom.schema.json",
    ]
    assert (tmp_path / "mine.yaml").read_text() == printed.stdout
    assert sphrom("case", "check", "mine.yaml").exit_code == 0


def test_new_case_never_writes_over_a_file_by_itself(sphrom, case_file):
    before = case_file.read_text()
    result = sphrom("case", "new", "taylor-green", "-o", case_file)
    assert result.exit_code == 2
    assert result.stderr == f"error: {case_file}: is there already; --force writes over it\n"
    assert case_file.read_text() == before
    assert sphrom("case", "new", "taylor-green", "-o", case_file, "--force").exit_code == 0
    assert case_file.read_text() != before


@pytest.mark.parametrize("target", ["no/such/folder.yaml", "."])
def test_new_case_where_nothing_can_be_written(sphrom, target):
    result = sphrom("case", "new", "taylor-green", "-o", target, "--force")
    assert result.exit_code == 2
    assert result.stderr.startswith(f"error: {target}: can't be written: ")


def test_new_case_of_an_unknown_kind(sphrom):
    result = sphrom("case", "new", "taylor_green")
    assert result.exit_code == 2
    assert "did you mean taylor-green?" in result.stderr


def test_new_case_without_a_kind_lists_them(sphrom):
    result = sphrom("case", "new")
    assert (result.exit_code, result.stdout) == (2, "")
    first, *kinds = result.stderr.splitlines()
    assert first == "error: KIND: is missing; the kinds are"
    assert [line.split()[1] for line in kinds] == list(scene_kinds())


def test_out_means_the_folder_of_artifacts_everywhere(sphrom):
    for command in (*EVERY_COMMAND, "import", "export", "run", "sweep", "trade"):
        text = " ".join(sphrom(*command.split(), "--help").output.split())
        assert "--out FILE" not in text
        if "--out DIR" in text:
            assert "runs/<name of the case>" in text


UNKNOWN_MODEL = "error: --only: must be a model of the case, or like reynolds=100; got 'fats'; did"


def test_only_models(sphrom, stages, case_file):
    models = ("--set", "rom=[{name: slow}, {name: fast, evaluation: operators}]")
    result = sphrom("rom", case_file, *models, "--only", "fast", "--only", "reynolds=150")
    assert result.exit_code == 0, result.output
    (context,) = stages["rom"]
    assert context.only == (ParameterPoint(150.0),)
    assert [model.name for model in context.chosen_models] == ["fast"]
    wrong = sphrom("rom", case_file, *models, "--only", "fats")
    assert (wrong.exit_code, wrong.stderr.startswith(UNKNOWN_MODEL)) == (2, True)
    elsewhere = sphrom("map", case_file, *models, "--only", "fast")
    assert elsewhere.exit_code == 2
    assert "can't be limited to a model, fast; rom can" in elsewhere.stderr


def test_quiet_contradicts_verbose(sphrom, stages, case_file):
    result = sphrom("run", case_file, "--quiet", "--verbose")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == "error: --quiet: contradicts --verbose; choose one\n"


def test_log_is_where_it_is_asked_for(sphrom, stages, case_file, monkeypatch):
    def say(context):
        context.report.details.info("a detail")
        raise errors.ArtifactError("no pod.h5")

    monkeypatch.setattr(sys.modules["sphrom.offline.fom"], "run", say)
    result = sphrom("fom", case_file, "--log", "my.log")
    assert (result.exit_code, result.stdout) == (3, "")
    lines = [line.split("  ", 1)[1] for line in Path("my.log").read_text().splitlines()]
    assert lines[0].startswith("$ sphrom")
    assert lines[1:] == ["a detail", "stopped: no pod.h5"]
    refused = sphrom("fom", case_file, "--log", "no/such/folder.log")
    assert refused.exit_code == 2
    assert refused.stderr.startswith("error: --log: no/such/folder.log can't be written: ")


def test_schema(sphrom):
    printed = sphrom("case", "schema").stdout
    schema = json.loads(printed)
    assert schema["$schema"].startswith("https://json-schema.org/")
    assert "discretization" in schema["properties"]
    assert sphrom("case", "schema", "-o", "s.json").stdout == "wrote s.json\n"
    assert Path("s.json").read_text() == printed
    assert sphrom("case", "schema", "-o", "s.json").exit_code == 2
    assert sphrom("case", "schema", "-o", "s.json", "--force").exit_code == 0


def test_a_new_case_names_the_schema_that_an_editor_reads(sphrom, tmp_path):
    assert sphrom("case", "new", "taylor-green", "-o", "mine.yaml").exit_code == 0
    first = Path("mine.yaml").read_text().splitlines()[0]
    named = first.removeprefix("# yaml-language-server: $schema=")
    assert sphrom("case", "schema", "--output", named).exit_code == 0
    again = sphrom("case", "new", "taylor-green", "-o", "another.yaml")
    assert "editor" not in again.stdout


@pytest.mark.parametrize("arguments", [["--help"], ["fom", "--help"], ["--version"]])
def test_help_imports_nothing_heavy(arguments):
    program = (
        "import sys\n"
        "from sphrom.__main__ import main\n"
        f"sys.argv = ['sphrom', *{arguments!r}]\n"
        "try:\n    main()\n"
        "finally:\n    print('imported', *sys.modules)\n"
    )
    result = python("-c", program)
    assert result.returncode == 0, result.stderr
    imported = set(result.stdout.split("imported ", 1)[1].split())
    heavy = {"numpy", "numba", "scipy", "h5py", "matplotlib", "yaml", "sphrom.case.models"}
    assert not imported & heavy


def test_module_runs_and_reports_without_a_traceback(tmp_path):
    result = python("-m", "sphrom", "fom", str(tmp_path / "no.yaml"))
    assert result.returncode == 2
    assert result.stderr == f"error: {tmp_path}/no.yaml: there is no such case file\n"


@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
def test_reader_that_leaves_early_sees_no_traceback():
    command = f"{sys.executable} -m sphrom case schema | head -c 10"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=60)
    assert "Traceback" not in result.stderr
