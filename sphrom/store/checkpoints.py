"""Checkpoints of runs: when they are written, their files, and their use after a run was stopped.

Beside the unfinished artifact, `NAME.part-1`, `NAME.part-2`, ... hold the finished snapshots, each
file those since the one before. `NAME.checkpoint` holds the state and the number of parts that
belong to it. Parts never change once they are written, and are written before the state that refers
to them, which replaces the previous state as a whole: a killed process leaves both complete.

A finished run can be continued beyond its final time. Its last snapshot is the state, because the
neighbour list is reset there. The finished file stays until the longer one replaces it; until then
parts hold only the snapshots after its end.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from glob import escape
from pathlib import Path

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import ArtifactWriter, locked, read_record, write_record
from sphrom.artifacts.records.runs import Checkpoint
from sphrom.errors import ArtifactError, UnstableError
from sphrom.setup.cost import MOST_PENDING
from sphrom.sph.time_loop import Clock, Item, Model, RunState, TimeSteps, march
from sphrom.store.trajectory import TrajectoryWriter, snapshot_fields
from sphrom.store.workspace import Target, Workspace
from sphrom.version import __version__

LARGEST_SHARE = 0.015
"""Largest share of a run's time for checkpoints: if writing is slow, they are farther apart."""


@lru_cache(maxsize=1)
def computes_with() -> Mapping[str, str]:
    """Return the software and hardware on which the last bits of a run depend, by name."""
    # Runs with checkpoints have imported the kernels anyway, which takes long.
    from sphrom.kernels.jit import compiled_with

    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(source.read_bytes())
    program = f"{__version__} with sources {digest.hexdigest()[:8]}"
    return {"sphrom": program, **compiled_with()}


@dataclass(frozen=True)
class _Book:
    """The last checkpoint of a run, and the snapshots since then.

    It is one record that is replaced as a whole, so that an interrupt finds it consistent.
    """

    step: int = -1
    n_parts: int = 0
    pending: list[Item] = field(default_factory=list)


class Checkpoints:
    """The checkpoints of one run; its artifact is being written, and is therefore locked.

    Attributes
    ----------
    begin : the state to continue from; None if the run starts from the beginning.
    seconds : time that this process has spent on writing them [s].
    """

    def __init__(
        self,
        workspace: Workspace,
        target: Target,
        artifact: ArtifactWriter,
        shorter: Target | None = None,
    ) -> None:
        """Look for files of a stopped run; continue from them, discard them, or raise an error.

        Without such files, continue from the end of a `shorter` finished run, if there is one.

        Raises ArtifactError if there is a checkpoint but neither `resume` nor `force` is set, or if
        it cannot be continued.
        """
        self._workspace = workspace
        self._target = target
        self._artifact = artifact
        self._context = workspace.context
        self._name = target.path.name
        self._state = self._aside("checkpoint", "sphrom/checkpoint")
        self._shorter = shorter
        self._continued: str | None = None
        if shorter is not None:
            with workspace.open_intermediate(shorter) as run:
                self._continued = run.content_sha256
        kept = self._found()
        self._book = _Book()
        self.begin: RunState | None = None
        if kept is None:
            _remove(target)
            if shorter is not None:
                self.begin = self._end_of(shorter)
                self._book = _Book(self.begin.step)
        else:
            if kept.continued is None:
                self._shorter = self._continued = None
            state = kept.state if len(kept.state) > 1 else kept.state[0]
            self.begin = RunState(kept.step, state, kept.neighbours_at, kept.seconds)
            self._book = _Book(kept.step, kept.n_parts)
            artifact.add_time(kept.wall_seconds)
        self._reached: tuple[RunState, TimeSteps, int] | None = None
        self._pending_bytes = 0
        self._cost = self.seconds = 0.0
        self._since = time.monotonic()
        self._working = True

    def progress(
        self, description: str, n_steps: int
    ) -> AbstractContextManager[Callable[[int], None]]:
        """Show how many of the remaining steps are done, and the time left."""
        if self.begin is not None:
            description = f"{description}, from step {self.begin.step}"
            n_steps -= self.begin.step
        return self._context.report.progress(description, n_steps)

    def snapshots(self, names: Collection[str]) -> Iterator[Item]:
        """Read the snapshots of the stopped run, and of a finished run that it continues."""
        parts = [self._part(number) for number in range(1, 1 + self._book.n_parts)]
        for target in parts if self._shorter is None else (self._shorter, *parts):
            with self._workspace.open_intermediate(target) as part:
                for i in range(part.length("step")):
                    yield {name: part.dataset(name)[i] for name in names}

    def add(self, item: Item) -> None:
        """Add a snapshot to the next checkpoint."""
        if self._working:
            self._book.pending.append(item)
            self._pending_bytes += sum(values.nbytes for values in item.values())

    def reached(self, run_state: RunState, steps: TimeSteps) -> None:
        """Record the state of the run, and write a checkpoint if one is due.

        Raises ArtifactError if the unfinished artifact was removed.
        """
        self._reached = (run_state, steps, len(self._book.pending))
        waited = time.monotonic() - self._since
        every = self._context.checkpoint_every
        interval = max(every, self._cost / LARGEST_SHARE) if every > 0.0 else 0.0
        if self._working and (waited >= interval or self._pending_bytes >= MOST_PENDING):
            if self._artifact.removed:
                raise ArtifactError(f"{self._name} was removed while it was being written")
            self._write_or_warn()

    @contextmanager
    def kept_if_stopped(self) -> Iterator[None]:
        """Write a checkpoint if anything ends the block early, such as an interrupt or a full disk.

        An unstable run leaves no new checkpoint.
        """
        try:
            yield
        except UnstableError:
            raise
        except BaseException:
            if self._working and not self._artifact.removed:
                self._write_or_warn()
            if self._book.step >= 0 and not self._artifact.removed:
                self._context.report.note(
                    f"{self._name}: checkpoint at step {self._book.step}; `--resume` goes on there"
                )
            raise

    def _end_of(self, run: Target) -> RunState:
        """Return the state at the last snapshot of a finished run."""
        with self._workspace.open_intermediate(run) as artifact:
            last = artifact.length("step") - 1
            position, density, velocity = snapshot_fields(artifact, last)
            step, time = (artifact.dataset(name)[last] for name in ("step", "time"))
            self._artifact.add_time(artifact.number("wall_seconds"))
            self._context.report.note(
                f"{self._name}: continues from its end at step {step}, t = {time:.6g} s"
            )
            state = np.vstack((position.T, density, velocity.T))
            return RunState(int(step), state, None, artifact.number("timing/integration"))

    def _latest(self) -> Checkpoint:
        """Return the stored checkpoint. Raises ArtifactError unless it has all its parts."""
        with self._workspace.open_intermediate(self._state) as artifact:
            artifact.verify_content()
            kept = read_record(artifact, Checkpoint)
        if kept.continued not in (None, self._continued):
            path = self._target.path
            raise ArtifactError(
                f"{path} is no longer the run that was continued; `--force` starts over"
            )
        for number in range(1, kept.n_parts + 1):
            target = self._part(number)
            if not target.path.exists():
                raise ArtifactError(f"{target.path} is missing; `--force` starts over")
            with self._workspace.open_intermediate(target) as part:
                part.verify_content()
                if part.number("number") != number:
                    raise ArtifactError(f"{target.path} is another part; `--force` starts over")
        return kept

    def _part(self, number: int) -> Target:
        return self._aside(f"part-{number}", "sphrom/trajectory-part")

    def _aside(self, ending: str, schema: str) -> Target:
        path = self._target.path
        return replace(self._target, path=path.with_name(f"{path.name}.{ending}"), schema=schema)

    def _found(self) -> Checkpoint | None:
        """Return the checkpoint to continue from; None if the run starts from the beginning."""
        if not self._state.path.exists():
            return None
        context = self._context
        report = self._context.report
        try:
            kept = self._latest()
        except ArtifactError as error:
            if not context.force:
                raise
            report.warn(f"{self._name}: starts over; {error}")
            return None
        where = f"step {kept.step} of {kept.n_steps}, t = {kept.time:.6g} s"
        if not context.resume and not context.force:
            raise ArtifactError(
                f"{self._name} was stopped, and has a checkpoint: `--resume` continues it from "
                f"{where}; `--force` starts over"
            )
        if not context.resume:
            report.warn(f"{self._name}: starts over; its checkpoint at {where} is discarded")
            return None
        if differing := _computed_otherwise(kept):
            reason = f"{self._name}: its checkpoint was computed with {differing}"
            if context.bitwise:
                report.warn(f"{reason}; it starts over")
                return None
            if not context.force:
                raise ArtifactError(
                    f"{reason}; if it is continued, the last bits may differ from an uninterrupted "
                    "run: `--resume --force` continues anyway, `--force` alone starts over"
                )
            report.warn(f"{reason}; the last bits may differ from an uninterrupted run")
        report.note(f"{self._name}: goes on from its checkpoint at {where}")
        return kept

    def _write_or_warn(self) -> None:
        """Write a checkpoint; if that fails, warn, and let the run continue without it."""
        started = time.monotonic()
        try:
            self._write()
        except ArtifactError as error:
            self._context.report.warn(f"no checkpoint was written: {error}")
            if self._pending_bytes >= MOST_PENDING:
                self._working = False
                self._book.pending.clear()
        finally:
            self._since = time.monotonic()
            self._cost = self._since - started
            self.seconds += self._cost

    def _write(self) -> None:
        """Write the pending snapshots, then the state, if there is anything new."""
        book = self._book
        reached = self._reached
        if reached is None or reached[0].step == book.step:
            return
        run_state, steps, n_pending = reached
        n_parts = book.n_parts + (n_pending > 0)
        if n_pending:
            items = book.pending[:n_pending]
            target = self._part(n_parts)
            with self._workspace.create_intermediate(target, {"number": n_parts}) as artifact:
                for name in items[0]:
                    artifact.write(name, np.array([item[name] for item in items]))
        kept = Checkpoint(
            state=np.atleast_2d(run_state.state),
            neighbours_at=run_state.neighbours_at,
            step=run_state.step,
            n_steps=steps.n_steps,
            time=steps.time(run_state.step),
            n_parts=n_parts,
            computed_with="\n".join(map(": ".join, computes_with().items())),
            seconds=run_state.seconds,
            wall_seconds=self._artifact.age,
            continued=self._continued,
        )
        with self._workspace.create_intermediate(self._state) as artifact:
            write_record(artifact, kept)
        self._book = _Book(kept.step, n_parts, book.pending[n_pending:])
        self._pending_bytes = 0


def integrate(
    model: Model,
    state: Array,
    steps: TimeSteps,
    reference_density: float,
    trajectory: TrajectoryWriter,
    advance: Callable[[int], None],
    checkpoints: Checkpoints,
) -> UnstableError | None:
    """Take all steps of a run and write its snapshots; return the error that ended it, or None.

    A run that was stopped continues from its checkpoint; one that is stopped leaves one.
    """
    clock = Clock()
    failure: UnstableError | None = None
    for item in checkpoints.snapshots(trajectory.names):
        trajectory.write(item)
    begin = checkpoints.begin
    reached = checkpoints.reached
    with checkpoints.kept_if_stopped():
        try:
            for step, kept in march(
                model, state, steps, reference_density, clock, advance, begin, reached
            ):
                item = trajectory.append(steps.time(step), step, model.snapshot(kept))
                checkpoints.add(item)
        except UnstableError as error:
            failure = error
    trajectory.finish(failure, clock.seconds, checkpoints.seconds)
    return failure


def _computed_otherwise(kept: Checkpoint) -> str:
    """Return, in words, how this software and hardware differ from those of a checkpoint."""
    there = dict(line.partition(": ")[::2] for line in kept.computed_with.splitlines())
    return ", ".join(
        f"{name} {there.get(name, 'unknown')} there, {value} here"
        for name, value in computes_with().items()
        if there.get(name) != value
    )


def left(target: Target) -> list[Path]:
    """Return all paths with names of checkpoints or parts, valid or not; states first."""
    folder = target.path.parent
    name = escape(target.path.name)
    return [
        path
        for ending in ("checkpoint*", "part-*")
        for hidden in ("", ".")
        for path in folder.glob(f"{hidden}{name}.{ending}")
    ]


def _remove(target: Target) -> None:
    """Remove all files of a checkpoint, including those that a killed process was writing.

    The state goes first, as it refers to the parts. Raises ArtifactError for a folder of that name.
    """
    files = left(target)
    if folder := next(filter(Path.is_dir, files), None):
        raise ArtifactError(f"{folder} is a folder with the name of a checkpoint: remove it")
    for path in files:
        path.unlink(missing_ok=True)


def remove_checkpoints(target: Target) -> None:
    """Remove the checkpoints of a finished artifact, unless another process is writing it."""
    if left(target):
        with suppress(ArtifactError), locked(target.path):
            _remove(target)
