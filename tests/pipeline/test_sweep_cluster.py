"""Sweeps on a Dask cluster of real processes: a scheduler, and workers with nannies."""

from __future__ import annotations

import errno
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from sphrom.artifacts import open_artifact
from sphrom.case.points import ParameterPoint
from sphrom.console import SilentReporter
from sphrom.store import workers as sweep_workers
from sphrom.store.tasks import Task

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("distributed") is None,
        reason="needs the library distributed: pip install 'sphrom[cluster]'",
    ),
]

FAST = {"name": "fast", "evaluation": "operators", "n_modes": 3, "calibrated": True}
N_WORKERS = 3
QUIET = {"OMP_WAIT_POLICY": "passive", "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "30s"}


def started(*command: str, cwd: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, **QUIET, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [sys.executable, "-m", *command], cwd=cwd, env=environment, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def kill_busy_worker(client):
    """Kill a worker of a cluster, one that has a task if there is any."""
    pids = client.run(os.getpid)
    busy = [name for name, tasks in client.processing().items() if tasks]
    os.kill(pids[next(iter(busy or pids))], signal.SIGKILL)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory) -> Path:
    """The folder in which workers keep temporary files."""
    return tmp_path_factory.mktemp("cluster")


@pytest.fixture(scope="module")
def address(scratch) -> Iterator[str]:
    """The address of a scheduler on this machine whose workers are processes of their own."""
    folder = scratch
    scheduler = started(
        "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
        cwd=folder,
    )  # fmt: skip
    workers = None
    try:
        assert scheduler.stderr is not None
        found = None
        while found is None:
            line = scheduler.stderr.readline()
            assert line, "the scheduler ended"
            found = re.search(r"tcp://127\.0\.0\.1:\d+", line)
        workers = started(
            "distributed.cli.dask_worker", found[0], "--nworkers", str(N_WORKERS), "--nthreads",
            "1", "--no-dashboard", "--local-directory", str(folder), "--memory-limit", "0",
            cwd=folder,
        )  # fmt: skip
        yield found[0]
    finally:
        for process in filter(None, (workers, scheduler)):
            os.killpg(process.pid, signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=20)
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


@pytest.fixture
def client(address):
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(N_WORKERS, timeout=300)
        yield client


def test_reduced_runs_are_the_same_there(
    sphrom, empty, case_text, address, client, monkeypatch, content
):
    monkeypatch.setattr("sphrom.sweep.sweep.SMALLEST_BATCH", 4)
    Path("tiny.yaml").write_text(case_text(rom=[FAST]))
    for command in ("fom", "map", "pod", "fit-psi", "operators"):
        sphrom(command, "tiny.yaml", "--quiet", code=0)
    values = ("--set", "sweep.reynolds={low: 100, high: 200, count: 30}")
    sphrom("sweep", "tiny.yaml", *values, "--scheduler", address, code=0)
    there = content(empty / "sweep-fast.h5")
    # In processes of their own, too: one that has just compiled a loop may differ in the last bits.
    sphrom("sweep", "tiny.yaml", *values, "--force", "--workers", "2", code=0)
    assert content(empty / "sweep-fast.h5") == there


def test_training_makes_several_runs_at_once_there(
    sphrom, empty, case_text, address, client, digests
):
    region = {"reynolds": [50, 400], "budget": 5, "tolerance": "0.06%"}
    model = {"time__final_time": 0.2, "rom": [{**FAST, "n_modes": 8}], "parameters": {}}
    Path("tiny.yaml").write_text(case_text(**model, training=region))
    sphrom("train", "tiny.yaml", "--scheduler", address, code=0)
    stages = json.loads((empty / "training" / "training.json").read_text())["stages"]
    assert 1 < [row["full_runs"] for row in stages].count(2) <= N_WORKERS
    ends = "parameters.train.reynolds=[50,400]"
    sphrom("fom", "tiny.yaml", "--out", "here", "--set", ends, code=0)
    there, here = digests(empty), digests(Path("here"))
    assert here.items() <= there.items()


def test_a_worker_killed_in_the_middle_loses_nothing(empty, case_text, address, client, wait_for):
    count = 12
    Path("tiny.yaml").write_text(case_text(rom=[], time__final_time=0.4))
    process = started(
        "sphrom", "sweep", "tiny.yaml", "--set",
        f"sweep.reynolds={{low: 100, high: 200, count: {count}}}", "--scheduler", address,
        cwd=Path.cwd(),
    )  # fmt: skip
    try:
        wait_for(process, lambda: list((empty / "sweep-full").glob("part-*.h5")))
        kill_busy_worker(client)
        _, stderr = process.communicate(timeout=600)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate(timeout=20)
    assert process.returncode == 0, stderr
    with open_artifact(empty / "sweep-full.h5", "sphrom/sweep", made_by="") as artifact:
        assert artifact.read("status").tolist() == [0] * count
    assert len(list(empty.glob("fom-*.h5"))) == count
    assert not (empty / "sweep-full").exists()


def test_a_task_that_kills_its_workers_is_given_up(address, client, monkeypatch):
    # A function that ends its process takes the place of the one that does tasks.
    task = Task("", "", "", (ParameterPoint(1.0),), 1, False, "")
    monkeypatch.setattr(sweep_workers, "_attempt_there", lambda *_: os._exit(9))
    ((_, (told,)),) = sweep_workers.Workers(1, SilentReporter(), client).done([task], os._exit)
    assert "its process was lost" in told.reason
    client.wait_for_workers(N_WORKERS, timeout=300)


@pytest.mark.parametrize("library", [True, False])
def test_a_scheduler_that_is_not_there(sphrom, empty, monkeypatch, library):
    monkeypatch.setattr(sweep_workers, "PATIENCE", 0.5)
    if not library:
        monkeypatch.setitem(sys.modules, "distributed", None)
    full = ("--set", "sweep={model: full, reynolds: [100]}")
    result = sphrom("sweep", "tiny.yaml", *full, "--scheduler", "tcp://127.0.0.1:1", code=2)
    said = "no scheduler answers at tcp://127.0.0.1:1; start" if library else "needs the library"
    assert f"error: --scheduler: {said}" in result.stderr


class Hidden:
    """A plugin of workers, for which a folder is on another machine."""

    name = "hidden"

    def __init__(self, folder: Path) -> None:
        self.folder = str(folder)

    def setup(self, worker: object) -> None:
        self.stat = os.stat

        def stat(path, *arguments, **options):
            if str(path).startswith(self.folder):
                raise FileNotFoundError(errno.ENOENT, "hidden")
            return self.stat(path, *arguments, **options)

        os.stat = stat

    def teardown(self, worker: object) -> None:
        os.stat = self.stat


@pytest.fixture
def apart(client, tmp_path) -> Iterator[None]:
    """Hide the folder of a test from all workers, also from those that are started again."""
    from distributed import WorkerPlugin

    plugin = type("Plugin", (Hidden, WorkerPlugin), {})(tmp_path)
    client.register_plugin(plugin)
    yield
    client.unregister_worker_plugin("hidden")


@pytest.fixture
def carried(monkeypatch) -> list[set[str]]:
    """The names of the files that each task carries to a worker."""
    names: list[set[str]] = []
    contents = sweep_workers._contents

    def carry(task, needs):
        files = contents(task, needs)
        names.append(set(files))
        return files

    monkeypatch.setattr(sweep_workers, "_contents", carry)
    return names


def test_artifacts_come_back_from_folders_of_workers(
    sphrom, empty, case_text, address, apart, digests, scratch, carried
):
    rom = [{"name": "galerkin", "n_modes": 3}, FAST]
    Path("tiny.yaml").write_text(case_text(rom=rom, time__spin_up=0.02))
    sweep = ("sweep", "tiny.yaml", "--set", "sweep.reynolds=[110,120]")
    sphrom("run", "tiny.yaml", "--scheduler", address, code=0)
    sphrom(*sweep, "--scheduler", address, code=0)
    runs = {"packing.h5", *(f"spin-up-reynolds{re}.h5" for re in (100, 150, 200))}
    assert carried[:3] == [{"packing.h5"}] * 3
    assert all("pod.h5" not in names and names & runs for names in carried[3:6])
    assert [names - runs for names in carried[6:]] == [{"pod.h5", "psi.h5"}] * 3 + [
        {"pod.h5", "operators.h5"}
    ]
    sphrom("run", "tiny.yaml", "--out", "here", code=0)
    there = digests(empty)
    with open_artifact(empty / "sweep-fast.h5", "sphrom/sweep", made_by="") as artifact:
        assert artifact.read("status").tolist() == [0, 0]
    del there["sweep-fast.h5"]
    assert len([name for name in there if name.startswith("spin-up")]) == 3
    assert there == digests(Path("here"))
    assert not list(scratch.rglob("sphrom-*"))
    assert not list(empty.glob(".*"))


def test_a_killed_worker_continues_in_its_own_folder(
    sphrom, empty, case_text, address, client, apart, wait_for, digests, scratch
):
    Path("tiny.yaml").write_text(case_text(rom=[], time__final_time=0.5))
    command = ("sphrom", "fom", "tiny.yaml", "--scheduler", address, "--checkpoint-every", "0")
    process = started(*command, cwd=Path.cwd())
    try:
        wait_for(process, lambda: list(scratch.rglob("sphrom-*/*.checkpoint")))
        kill_busy_worker(client)
        _, stderr = process.communicate(timeout=120)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate(timeout=20)
    assert process.returncode == 0, stderr
    sphrom("fom", "tiny.yaml", "--out", "here", code=0)
    assert digests(empty) == digests(Path("here"))
    assert not list(scratch.rglob("sphrom-*"))
