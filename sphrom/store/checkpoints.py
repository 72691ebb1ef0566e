"""When a run keeps a checkpoint, and what happens with those that a stopped run left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field

from sphrom.artifacts import ArtifactWriter, locked
from sphrom.errors import ArtifactError, UnstableError
from sphrom.setup.cost import MOST_PENDING
from sphrom.sph.time_loop import Item, RunState
from sphrom.store.checkpoint_files import NO_PARTS, CheckpointFiles, StoredState, computes_with
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace

LARGEST_SHARE = 0.015
"""Of a run's time that goes into checkpoints: where writing takes long they are farther apart."""


@dataclass(frozen=True)
class _Book:
    """What is written of a run, and the snapshots that aren't yet.

    One record, replaced as a whole: an interrupt finds it consistent.
    """

    step: int = -1
    generation: int = 0
    n_parts: int = 0
    parts_sha256: str = NO_PARTS
    pending: list[Item] = field(default_factory=list)


class Checkpoints:
    """The checkpoints of one run, made while its artifact is written and so locked.

    Attributes
    ----------
    begin : where the run goes on from; None where it starts anew.
    seconds : what writing them has taken in this process [s].
    """

    begin: RunState | None
    seconds: float

    def __init__(self, workspace: Workspace, target: Target, artifact: ArtifactWriter) -> None:
        """Find what a stopped run left, and go on from it, give it up, or refuse to.

        Raises ArtifactError when a checkpoint is there, but neither `resume` nor `force` is asked
        for, or it can't be continued.
        """
        self._context = workspace.context
        self._name = target.path.name
        self._artifact = artifact
        self._files = CheckpointFiles(workspace, target)
        self._kept = self._found()
        self._book = _Book()
        self.begin = None
        if self._kept is not None:
            kept = self._kept
            self.begin = kept.run_state
            self._book = _Book(
                kept.run_state.step, kept.generation, kept.n_parts, kept.parts_sha256
            )
            artifact.add_time(kept.wall_seconds)
        self._reached: tuple[RunState, float, int, int] | None = None
        self._pending_bytes = 0
        self._cost = self.seconds = 0.0
        self._since = time.monotonic()
        self._working = True

    def progress(
        self, description: str, n_steps: int
    ) -> AbstractContextManager[Callable[[int], None]]:
        """Show how many of the steps are done that are still to be taken, and the time left."""
        if self.begin is not None:
            description = f"{description}, from step {self.begin.step}"
        left = n_steps if self.begin is None else n_steps - self.begin.step
        return self._context.report.progress(description, left)

    def snapshots(self) -> Iterator[Item]:
        """Read back the snapshots that were done before."""
        if self._kept is not None:
            yield from self._files.snapshots(self._kept)

    def add(self, item: Item) -> None:
        """Take a snapshot that the next checkpoint has to hold."""
        if self._working:
            self._book.pending.append(item)
            self._pending_bytes += sum(values.nbytes for values in item.values())

    def reached(self, run_state: RunState, time_reached: float, n_steps: int) -> None:
        """Take where the run stands, and write a checkpoint if one is due.

        Raises ArtifactError when somebody has removed what is being written.
        """
        self._reached = (run_state, time_reached, n_steps, len(self._book.pending))
        waited = time.monotonic() - self._since
        every = self._context.checkpoint_every
        apart = max(every, self._cost / LARGEST_SHARE) if every > 0.0 else 0.0
        if self._working and (waited >= apart or self._pending_bytes >= MOST_PENDING):
            if self._artifact.removed:
                raise ArtifactError(f"{self._name} was removed while it was being written")
            self._write_or_warn()

    @contextmanager
    def kept_if_stopped(self) -> Iterator[None]:
        """Write a checkpoint when anything ends the block early: an interrupt, a full disk.

        An unstable run leaves none: it could not go on.
        """
        try:
            yield
        except UnstableError:
            raise
        except BaseException:
            if self._artifact.removed:
                raise  # and so is all that a checkpoint would belong to
            if self._working:
                self._write_or_warn()
            if self._book.step >= 0:
                self._context.report.note(
                    f"{self._name}: checkpoint at step {self._book.step}; `--resume` goes on there"
                )
            raise

    def _found(self) -> StoredState | None:
        self._files.refuse_folders()
        if not self._files.there:
            self._files.remove()  # parts that no state counts on
            return None
        report = self._context.report
        try:
            kept = self._files.latest()
        except ArtifactError as error:
            if not self._context.force:
                raise
            report.warn(f"{self._name}: starts anew; {error}")
            self._files.remove()
            return None
        where = f"step {kept.run_state.step} of {kept.n_steps}, t = {kept.time:.6g} s"
        if self._context.resume and self._may_continue(kept):
            report.note(f"{self._name}: goes on from its checkpoint at {where}")
            return kept
        if not self._context.resume and not self._context.force:
            raise ArtifactError(
                f"{self._name} was stopped, and has a checkpoint: `--resume` continues it from "
                f"{where}; `--force` starts anew"
            )
        report.warn(f"{self._name}: starts anew; its checkpoint at {where} is given up")
        self._files.remove()
        return None

    def _may_continue(self, kept: StoredState) -> bool:
        """Return whether a run goes on from a checkpoint that may have been computed otherwise.

        Raises ArtifactError when that is not to be decided here.
        """
        context, here = self._context, computes_with()
        differing = ", ".join(
            f"{name} {kept.computed_with.get(name, 'unknown')} there, {value} here"
            for name, value in here.items()
            if kept.computed_with.get(name) != value
        )
        if not differing:
            return True
        if context.bitwise:
            context.report.warn(f"{self._name}: its checkpoint was computed with {differing}")
            return False
        if not context.force:
            raise ArtifactError(
                f"{self._name}: its checkpoint was computed with {differing}; going on from it may "
                "differ in the last bits from a run that was never stopped: `--resume --force` "
                "insists, `--force` alone starts anew"
            )
        context.report.warn(
            f"{self._name}: may differ in the last bits from a run that was never stopped; "
            f"its checkpoint was computed with {differing}"
        )
        return True

    def _write_or_warn(self) -> None:
        """Write a checkpoint; a run goes on without where that can't be done."""
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
        """Write the snapshots that wait, then the state, if there is anything new."""
        book, reached = self._book, self._reached
        if reached is None or reached[0].step == book.step:
            return
        run_state, time_reached, n_steps, n_pending = reached
        n_parts, digest = book.n_parts, book.parts_sha256
        if n_pending:
            n_parts += 1
            digest = self._files.write_part(n_parts, book.pending[:n_pending], digest)
        generation, age = book.generation + 1, self._artifact.age
        found = run_state, n_steps, time_reached, generation, n_parts, digest, age
        self._files.write(StoredState(*found, computes_with()))
        left = book.pending[n_pending:]
        self._book = _Book(run_state.step, generation, n_parts, digest, left)
        self._pending_bytes = 0


def remove_checkpoints(workspace: Workspace, target: Target) -> None:
    """Remove the checkpoints of an artifact that is complete, unless somebody makes it anew."""
    files = CheckpointFiles(workspace, target)
    if files.left:
        with suppress(ArtifactError), locked(target.path):
            files.remove()


def last_good(workspace: Workspace, target: Target) -> str:
    """Say in words where the last checkpoint of a run that became unstable is; nothing if none."""
    files = CheckpointFiles(workspace, target)
    if not files.there:
        return ""
    try:
        kept = files.latest()
    except ArtifactError:
        return ""
    return (
        f"; the last good checkpoint is of step {kept.run_state.step}, t = {kept.time:.6g} s: "
        f"{target.path.name}.checkpoint-*"
    )
