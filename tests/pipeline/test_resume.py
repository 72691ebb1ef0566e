"""A run that is stopped, however, goes on to the artifact that it would have made."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from sphrom.case.loader import load_case
from sphrom.console import Reporter
from sphrom.errors import ArtifactError
from sphrom.models import fom
from sphrom.setup.context import StageContext
from sphrom.sph import time_loop
from sphrom.store import checkpoints
from sphrom.store.checkpoints import Checkpoints, computes_with

TINY = ("tiny.yaml", "--threads", "1")
FULL = "fom-reynolds100.h5"
KINDS = {
    "full": (("fom", "--only", "reynolds=100"), FULL),
    "galerkin": (("rom", "--only", "reynolds=150"), "rom-galerkin-reynolds150.h5"),
    "apg": (("rom", "--only", "reynolds=150"), "rom-apg-reynolds150.h5"),
}
"""What is run to make an artifact."""


@pytest.fixture
def again(sphrom) -> Callable[..., Any]:
    """Make the artifact of a kind."""
    return lambda kind, *options, code=None: sphrom(*KINDS[kind][0], *TINY, *options, code=code)


def leftovers(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if ".h5." in path.name)


@pytest.fixture
def killed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that is stopped has no time for a checkpoint, as after SIGKILL."""

    def nothing(_: object) -> Iterator[None]:
        yield

    monkeypatch.setattr(Checkpoints, "kept_if_stopped", contextmanager(nothing))


@pytest.mark.parametrize(
    ("kind", "step"), [("full", 1), ("full", 6), ("galerkin", 5), ("apg", 6), ("apg", 1)]
)
def test_an_interrupted_run_goes_on_to_the_same_bits(
    place, again, digests, stop_at, kind, step
) -> None:
    before = digests(place)
    name = KINDS[kind][1]
    (place / name).unlink()
    stop_at(step)
    stopped = again(kind)
    assert (stopped.exit_code, stopped.stderr.partition(";")[0]) == (130, "interrupted")
    assert f"{name}: checkpoint at step {step - 1}; `--resume` goes on there" in stopped.stdout
    assert not (place / name).exists()
    resumed = again(kind, "--resume", code=0)
    assert f"{name}: goes on from its checkpoint at step {step - 1} of " in resumed.stdout
    assert f", from step {step - 1}: " in resumed.stdout
    assert digests(place) == before
    assert leftovers(place) == []


@pytest.mark.parametrize(("every", "step"), [(0, 7), (1000, 2)])
def test_a_killed_run_goes_on_from_its_last_checkpoint(
    place, again, digests, stop_at, killed, every, step
) -> None:
    before = digests(place)
    (place / FULL).unlink()
    stop_at(step)
    again("full", "--checkpoint-every", every, code=130)
    assert (leftovers(place) == []) == (every == 1000)
    assert (f"at step {step - 1} of" in again("full", "--resume", code=0).stdout) == (every == 0)
    assert digests(place) == before
    assert leftovers(place) == []


def test_a_checkpoint_is_neither_used_nor_lost_unasked(
    place, again, sphrom, digests, stop_at
) -> None:
    before = digests(place)
    (place / FULL).unlink()
    stop_at(5)
    again("full")
    kept = leftovers(place)
    for stage in ("fom", "run"):
        result = sphrom(stage, *TINY, code=3)
        assert result.stderr.startswith(
            f"error: {FULL} was stopped, and has a checkpoint: `--resume` continues it from step 4"
        )
    assert leftovers(place) == kept
    anew = again("full", "--force", code=0)
    assert f"warning: {FULL}: starts over; its checkpoint at step 4 of" in anew.stderr
    assert digests(place) == before
    assert leftovers(place) == []


def test_what_a_killed_process_was_writing_is_removed(place, again, digests) -> None:
    """Parts that no state counts on, and files that never came to their names."""
    before = digests(place)
    litter = (f"{FULL}.part-3", f".{FULL}.part-4.tmp", f".{FULL}.checkpoint.tmp")
    for name in litter:
        (place / name).write_bytes(b"half")
    again("full", code=0)  # the artifact is there: they are of no use
    assert not any((place / name).exists() for name in litter)
    (place / FULL).unlink()
    for name in litter:
        (place / name).write_bytes(b"half")
    again("full", code=0)
    assert not any((place / name).exists() for name in litter)
    assert digests(place) == before


def test_run_passes_resume_on(empty, sphrom, digests, finished, stop_at) -> None:
    """To whatever was running: here it is stopped in the first full run, and in the second."""
    for step in (9, 3):
        stop_at(step)
        sphrom("run", *TINY, "--resume", code=130)
    sphrom("run", *TINY, "--resume", code=0)
    assert digests(empty) == digests(finished[0] / "runs" / "tiny")
    assert leftovers(empty) == []


@pytest.mark.parametrize(
    ("ending", "damage"),
    [("part-1", "flipped"), ("part-1", "removed"), ("checkpoint", "flipped")],
)
def test_damaged_checkpoints_are_never_gone_on_from(
    place, again, digests, stop_at, flip, ending, damage
) -> None:
    before = digests(place)
    (place / FULL).unlink()
    stop_at(8)
    again("full")
    (flip if damage == "flipped" else Path.unlink)(place / f"{FULL}.{ending}")
    refused = again("full", "--resume", code=3)
    assert f"{FULL}.{ending} is " in refused.stderr
    assert "--force" in refused.stderr
    assert "warning: " in again("full", "--resume", "--force", code=0).stderr
    assert digests(place) == before
    assert leftovers(place) == []


def test_a_checkpoint_of_another_case(place, again, stop_at) -> None:
    (place / FULL).unlink()
    stop_at(5)
    again("full")
    refused = again("full", "--resume", "--set", "fluid.mach_number=0.09", code=3)
    assert "was made with another case (fluid.mach_number is 0.1 there, 0.09 here" in refused.stderr


@pytest.fixture
def stopped_elsewhere(place, again, stop_at, monkeypatch) -> Callable[[str], None]:
    """Leave a checkpoint that another version, or a processor of another kind, computed."""

    def leave(name: str) -> None:
        (place / FULL).unlink()
        stop_at(5)
        with monkeypatch.context() as elsewhere:
            other = {**computes_with(), name: "other"}
            elsewhere.setattr("sphrom.store.checkpoints.computes_with", lambda: other)
            again("full", code=130)

    return leave


@pytest.mark.parametrize("name", ["numba", "processor"])
def test_a_checkpoint_of_another_version_or_processor(
    place, again, digests, stopped_elsewhere, name
) -> None:
    before = digests(place)
    stopped_elsewhere(name)
    kept = leftovers(place)
    (line,) = again("full", "--resume", code=3).stderr.splitlines()
    assert f"computed with {name} other there, {computes_with()[name]} here;" in line
    assert "`--resume --force` continues anyway" in line
    assert leftovers(place) == kept
    insisted = again("full", "--resume", "--force", code=0)
    assert f"{FULL}: goes on from its checkpoint at step 4 of" in insisted.stdout
    assert f"computed with {name} other there" in insisted.stderr
    assert digests(place) == before


def test_runs_that_nobody_can_insist_on_start_anew(place, digests, stopped_elsewhere) -> None:
    """Those of sweeps and trades."""
    before = digests(place)
    stopped_elsewhere("numba")
    case, report = load_case(Path("tiny.yaml"), (), False), Reporter()
    fom.run(StageContext(case, place, False, 1, report, resume=True, bitwise=True))
    assert digests(place) == before
    assert leftovers(place) == []


@pytest.mark.parametrize("most_pending", [0, 2**26])
def test_a_disk_that_is_full_at_a_checkpoint_does_not_end_a_run(
    place, again, digests, monkeypatch, most_pending
) -> None:
    """A warning says so; snapshots that no checkpoint takes are not kept in memory."""
    tried = []

    def refuse(*_: object) -> None:
        tried.append(True)
        raise ArtifactError("the disk is full")

    before = digests(place)
    (place / FULL).unlink()
    monkeypatch.setattr(checkpoints, "write_record", refuse)
    monkeypatch.setattr(checkpoints, "MOST_PENDING", most_pending)
    result = again("full", "--checkpoint-every", 0, code=0)
    assert result.stderr.count("no checkpoint was written: the disk is full") == len(tried)
    assert (len(tried) == 1) == (most_pending == 0)
    assert digests(place) == before


def test_what_waits_for_a_checkpoint_is_bounded(
    place, again, digests, stop_at, killed, monkeypatch
):
    """Many snapshots bring it forward."""
    monkeypatch.setattr(checkpoints, "MOST_PENDING", 40_000)
    before = digests(place)
    (place / FULL).unlink()
    stop_at(9)
    again("full", "--checkpoint-every", 1000)
    assert leftovers(place)
    again("full", "--resume", code=0)
    assert digests(place) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
def test_signals_leave_a_checkpoint(empty, wait_for, number, code, word) -> None:
    long = ("--set", "time.final_time=40", "--threads", "1", "--only", "reynolds=100")
    process = subprocess.Popen(
        [sys.executable, "-m", "sphrom", "fom", "tiny.yaml", *long, "--checkpoint-every", "0.1"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        wait_for(process, lambda: list(empty.glob(f"{FULL}.checkpoint*")))
        process.send_signal(number)
        out, errors = process.communicate(timeout=300)
    finally:
        process.kill()
    assert (process.returncode, errors.partition(";")[0]) == (code, word)
    assert "--checkpoint-every 0.1 --resume` continues from them" in errors
    assert f"{FULL}: checkpoint at step " in out
    assert all(name.startswith(f"{FULL}.") for name in leftovers(empty))
    shutil.rmtree(empty)


def test_a_folder_that_is_removed_while_a_run_writes_stays_removed(
    empty, sphrom, monkeypatch
) -> None:
    step_taken, folder = time_loop.watched_step, empty.resolve()

    def removed(rates: Any, state: Any, steps: Any, step: int) -> Any:
        if step == 5:
            shutil.rmtree(folder)
        return step_taken(rates, state, steps, step)

    monkeypatch.setattr(time_loop, "watched_step", removed)
    result = sphrom("fom", *TINY, "--only", "reynolds=100", "--checkpoint-every", 0, code=3)
    assert result.stderr.count("\n") == 1
    assert "was removed " in result.stderr
    assert not list(empty.parent.rglob("*.part-*"))
    assert not list(empty.parent.rglob("*.checkpoint*"))


@pytest.mark.parametrize(
    ("ending", "options"), [("checkpoint", ("--resume", "--force")), ("part-1", ())]
)
def test_a_folder_where_a_checkpoint_has_to_be(place, again, ending, options) -> None:
    folder = place / f"{FULL}.{ending}"
    folder.mkdir()
    (folder / "kept").write_text("of somebody")
    again("full", code=0)
    (place / FULL).unlink()
    assert f"error: {folder} is a folder with the name" in again("full", *options, code=3).stderr
    assert (folder / "kept").read_text() == "of somebody"


@pytest.fixture
def longer(place, sphrom, digests, case_text) -> tuple[list[str], dict[str, str]]:
    """Options that double the time of the full run with its steps, and the bits of such a run."""
    step = load_case(place.parents[1] / "tiny.yaml").plan.steps.time_step
    options = ["--set", f"time.step={step!r}", "--set", "time.final_time=0.16"]
    sphrom(*KINDS["full"][0], *TINY, *options, "--out", place.parent / "anew", code=0)
    return options, digests(place.parent / "anew")


@pytest.mark.parametrize("stops", [(), (13, 18)])
def test_a_finished_run_goes_on_to_the_bits_of_a_longer_one(
    place, again, digests, stop_at, killed, longer, stops
) -> None:
    """Also if the longer run is killed, once or twice: the finished one stays until the end."""
    options, anew = longer
    before = digests(place)
    at_end = load_case(place.parents[1] / "tiny.yaml").plan.steps.n_steps
    for step in stops:
        stop_at(step)
        again("full", *options, "--resume", "--checkpoint-every", 0, code=130)
        assert digests(place) == before
    unasked = again("full", *options, code=3).stderr
    assert "ends at 0.08 s: `--resume` continues it, `--force` makes it again" in unasked
    result = again("full", *options, "--resume", code=0).stdout
    if not stops:
        assert f"{FULL}: continues from its end at step {at_end}, t = 0.08 s" in result
    assert digests(place)[FULL] == anew[FULL]
    assert leftovers(place) == []


def test_only_the_same_run_is_continued(place, again, digests, longer, monkeypatch) -> None:
    """Neither with other steps, nor another flow, nor a run of another version or of damage."""
    options, before = longer[0], digests(place)
    steps = again("full", "--set", "time.final_time=0.161", "--resume", code=3).stderr
    assert "ends at 0.08 s, and can't be continued: the step is " in steps
    assert f"`--set {options[1]}` keeps it" in steps
    other = ("--set", "fluid.mach_number=0.09", "--resume")
    flow = again("full", *options, *other, code=3).stderr
    assert "fluid.mach_number is 0.1 there, 0.09 here" in flow
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr("sphrom.store.workspace.__version__", "0.0.0")
        version = again("full", *options, "--resume", code=3).stderr
        assert "the version of sphrom is " in version
    shorter = again("full", "--set", "time.final_time=0.04", "--resume", code=3).stderr
    assert "time.final_time is 0.08 there, 0.04 here" in shorter
    assert digests(place) == before


def test_a_checkpoint_needs_the_run_that_it_continues(place, again, stop_at, longer) -> None:
    options = longer[0]
    stop_at(15)
    again("full", *options, "--resume", code=130)
    (place / FULL).unlink()
    gone = again("full", *options, "--resume", code=3).stderr
    assert f"{FULL} is no longer the run that was continued; `--force` starts over" in gone
    again("full", *options, "--resume", "--force", code=0)


CHANNEL = {
    "name": "channel",
    "scene": {"kind": "open-cavity"},
    "discretization": {"resolution": 40},
    "time": {"final_time": 0.02, "spin_up": 0.012},
    "snapshots": {"every": 5},
    "rom": [],
}


def test_a_spin_up_goes_on_too(tmp_path, sphrom, digests, stop_at) -> None:
    """Between walls, and with no snapshot at which the list of neighbours is built anew."""
    case = tmp_path / "channel.yaml"
    case.write_text(json.dumps(CHANNEL))
    run = ("fom", case, "--threads", 1)
    sphrom(*run, "--out", tmp_path / "whole", code=0)
    out = tmp_path / "stopped"
    for step in (7, 23, 3):
        stop_at(step)
        sphrom(*run, "--out", out, "--resume", code=130)
        (name,) = {left.partition(".h5")[0] for left in leftovers(out)}
        assert name.startswith("fom-" if (out / "spin-up-reynolds2400.h5").exists() else "spin-up-")
    sphrom(*run, "--out", out, "--resume", code=0)
    assert digests(out) == digests(tmp_path / "whole")
    assert leftovers(out) == []
