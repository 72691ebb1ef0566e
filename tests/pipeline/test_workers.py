"""Stages whose runs several processes make, with the artifacts, lines and errors of one process.

Most tests let this process take the place of the others, which start slowly.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import pytest
import yaml

from sphrom import kernels
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.console import SilentReporter
from sphrom.kernels import code_cache
from sphrom.kernels.ahead import KERNELS
from sphrom.models import fom
from sphrom.setup.context import StageContext
from sphrom.store import tasks, workers
from sphrom.store.tasks import Task
from sphrom.store.workspace import Workspace

RE = (100, 200, 150)


@pytest.fixture
def told(monkeypatch) -> list[Task]:
    """The tasks that this process does in place of workers."""
    done: list[Task] = []

    class Here(workers.Workers):
        def done(self, asked, do, needs):
            done.extend(asked)
            yield from super().done(asked, do, needs)

    @contextmanager
    def start(number, scheduler, report) -> Iterator[Here]:
        yield Here(1, report)

    monkeypatch.setattr(workers, "start_workers", start)
    return done


@pytest.fixture
def asked(monkeypatch) -> Callable[..., Task]:
    """Return the task of the full run at Re 100, without doing it."""

    def ask(workspace: Workspace, number: int, *threads: int | None) -> Task:
        found: list[Task] = []

        def nothing(self, asked, do, needs) -> Iterator[None]:
            found.extend(asked)
            yield from ()

        monkeypatch.setattr(workers.Workers, "done", nothing)
        some = [((ParameterPoint(100.0),), "")]
        here = workers.Workers(number, SilentReporter())
        here.run("runs", workspace, some, fom.make_run, lambda _: (), *threads)
        return found[0]

    return ask


@pytest.mark.slow
def test_several_processes_make_what_one_makes(sphrom, empty, digests):
    alone = sphrom("fom", "tiny.yaml", "--out", "alone", code=0)
    several = sphrom("fom", "tiny.yaml", "--workers", "2", code=0)
    assert digests(empty) == digests(Path("alone"))
    lines = [line for line in alone.stdout.splitlines() if line.startswith("reynolds=")]
    assert len(lines) == 3
    assert set(lines) <= set(several.stdout.splitlines())


def test_each_run_is_a_task(sphrom, empty, case_text, told, digests):
    Path("tiny.yaml").write_text(case_text(rom=[{"name": "galerkin", "n_modes": 3}]))
    sphrom("run", "tiny.yaml", "--out", "alone", code=0)
    assert told == []
    sphrom("run", "tiny.yaml", "--workers", "2", code=0)
    assert [(task.model, *task.points) for task in told] == [
        (model, ParameterPoint(reynolds)) for model in ("", "", "galerkin") for reynolds in RE
    ]
    assert digests(empty) == digests(Path("alone"))
    sphrom("fom", "tiny.yaml", "--workers", "2", "--only", "reynolds=100", code=0)
    assert len(told) == 9


def test_force_makes_each_run_again_once(sphrom, empty, told):
    command = ("fom", "tiny.yaml", "--workers", "2")
    sphrom(*command, code=0)
    before = {path.name: path.stat().st_mtime_ns for path in empty.glob("*.h5")}
    said = sphrom(*command, "--force", code=0).stdout
    after = {path.name: path.stat().st_mtime_ns for path in empty.glob("*.h5")}
    assert [name for name in before if after[name] == before[name]] == ["packing.h5"]
    assert said.count("wrote ") == 3


def test_a_stopped_run_is_continued_only_if_asked(sphrom, empty, told, stop_at, digests):
    sphrom("fom", "tiny.yaml", "--out", "alone", code=0)
    stop_at(5)
    sphrom("fom", "tiny.yaml", "--only", "reynolds=100", code=130)
    refused = sphrom("fom", "tiny.yaml", "--workers", "2", code=3)
    assert "was stopped, and has a checkpoint: `--resume` continues it" in refused.stderr
    assert [task.points[0].reynolds for task in told] == [200.0, 150.0]
    resumed = sphrom("fom", "tiny.yaml", "--workers", "2", "--resume", "--verbose", code=0)
    assert "fom-reynolds100.h5: goes on from its checkpoint at step 4" in resumed.stdout
    assert digests(empty) == digests(Path("alone"))


def test_an_unstable_spin_up_is_not_tried_twice(sphrom, empty, told, monkeypatch):
    tried = []
    spin_up = fom._spin_up
    monkeypatch.setattr(fom, "_spin_up", lambda *of: (tried.append(of[1]), spin_up(*of)))
    fast = ("--force", "--set", "time.step=0.04", "--set", "snapshots.every=1")
    times = ("--set", "time.spin_up=0.4", "--set", "time.final_time=0.8")
    result = sphrom("fom", "tiny.yaml", "--workers", "2", *fast, *times, code=4)
    assert re.search(r"error: reynolds=100, spin-up: unstable at step \d+", result.stderr)
    assert len(tried) == len(told) == 3


def test_a_failed_run_is_named(sphrom, empty, told, monkeypatch):
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(fom, "_run_point", fail)
    result = sphrom("fom", "tiny.yaml", "--workers", "2", code=5)
    assert [f"error: reynolds={re}: out of memory" in result.stderr for re in RE] == [True] * 3
    assert not list(empty.glob("fom-*.h5"))


@pytest.mark.parametrize(("cores", "number", "threads"), [(8, 2, 4), (8, 3, 2), (2, 3, 1)])
def test_processes_share_the_cores(empty, asked, monkeypatch, cores, number, threads):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(cores))
    context = StageContext(load_case("tiny.yaml"), empty, False, None, SilentReporter())
    assert asked(Workspace(context), number, None).threads == threads


def test_tables_of_a_case_come_with_a_run(empty, sphrom, asked, monkeypatch, tmp_path, digests):
    """A worker sees neither the folder of the artifacts nor that of the case."""
    Path("data").mkdir()
    Path("data/pump.csv").write_text("time,push\n0,0\n0.2,1\n")
    histories = {"pump": {"file": "data/pump.csv"}}
    scene = {
        "kind": "custom", "box": {"upper": [1, 1], "periodic": ["x", "y"]},
        "histories": histories, "body_force": ["pump(t)*sin(2*pi*y)", 0],
    }  # fmt: skip
    case = yaml.safe_load(Path("tiny.yaml").read_text()) | {"scene": scene, "rom": []}
    Path("tiny.yaml").write_text(yaml.safe_dump(case))
    sphrom("fom", "tiny.yaml", "--only", "reynolds=100", code=0)
    context = StageContext(load_case("tiny.yaml"), empty, False, 1, SilentReporter())
    workspace = Workspace(context)
    point = ParameterPoint(100.0)
    expected = digests(empty)["fom-reynolds100.h5"]
    (empty / "fom-reynolds100.h5").unlink()
    task = asked(workspace, 1)
    run = workspace.full_run(point)
    files = workers._contents(task, lambda _: tasks.files_of(workspace, run))
    assert "case/data/pump.csv" in files
    Path("data/pump.csv").unlink()
    monkeypatch.setattr(tasks, "_scratch", lambda: tmp_path / "scratch")
    answer = tasks.do_elsewhere(fom.make_run, task, files)
    assert [type(line) for line in answer.told] == [tasks.Line] * len(answer.told)
    assert list(answer.files) == ["fom-reynolds100.h5"]
    Path("there").mkdir()
    Path("there/fom.h5").write_bytes(answer.files["fom-reynolds100.h5"])
    assert digests(Path("there")) == {"fom.h5": expected}
    assert not list((tmp_path / "scratch").iterdir())


@pytest.mark.parametrize(("threads", "number"), [(1, 0), (2, 2)])
def test_processes_that_compile_ahead_end_with_their_block(
    monkeypatch, threads: int, number: int
) -> None:
    started: list[Popen[bytes]] = []

    def start(*words: Any, **streams: Any) -> Popen[bytes]:
        started.append(Popen(*words, **streams))
        return started[-1]

    monkeypatch.setattr(workers, "Popen", start)
    monkeypatch.setattr("sphrom.kernels.jit.threads_for", lambda count: threads)
    with workers.compiled_ahead():
        assert not started
        for call in kernels.when_compiling:
            call()
        assert len(started) == number
    assert all(process.returncode is not None for process in started)
    assert not kernels.when_compiling


def test_a_process_that_compiles_ahead_ends_with_its_parent(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphrom.kernels.ahead", "1", "0"]
    nothing_kept = os.environ | {code_cache.VARIABLES[0]: str(tmp_path)}
    with Popen(command, stdin=PIPE, env=nothing_kept) as process:
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(60.0) == 0
    last = KERNELS[-1][0].__name__
    assert not list(tmp_path.rglob(f"*.{last}-*.nbc"))  # it has not compiled all


def test_a_command_goes_on_where_no_process_can_be_started(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sphrom.kernels.jit.threads_for", lambda count: 2)
    for program in (None, str(tmp_path / "none")):
        monkeypatch.setattr(sys, "executable", program)
        with workers.compiled_ahead():
            for call in kernels.when_compiling:
                call()
