"""The files of a run's checkpoints: written whole or not at all, checked, and read back.

Beside the artifact in the making, `NAME.part-1`, `NAME.part-2`, ... hold the snapshots that are
done, each file those since the one before, and `NAME.checkpoint-a` and `NAME.checkpoint-b`, written
by turns, hold the state and say which parts belong to it. Parts never change once they are written,
and come before the state that counts on them: whenever a process is killed, one of the two states
is whole, and so are its parts.

When a run keeps a checkpoint, and what happens with those that a stopped run left.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter, locked, read_record, write_record
from sphrom.artifacts.records import Checkpoint
from sphrom.errors import ArtifactError, UnstableError
from sphrom.setup.cost import MOST_PENDING
from sphrom.sph.time_loop import Item, RunState
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace
from sphrom.version import __version__

Array = NDArray[np.float64]

SLOTS = ("a", "b")
NO_PARTS = ""
"""The digest of no parts at all."""


@dataclass(frozen=True)
class StoredState:
    """What the files of one checkpoint hold."""

    run_state: RunState
    n_steps: int
    """Of the whole run."""
    time: float
    """Of the state [s]."""
    generation: int
    n_parts: int
    parts_sha256: str
    wall_seconds: float
    """What the artifact has taken so far [s]."""
    computed_with: Mapping[str, str]
    """What its last bits depend on besides the case, by name."""


@lru_cache(maxsize=1)
def computes_with() -> Mapping[str, str]:
    """Return what the last bits of a run depend on besides its case, by name."""
    # Runs that leave checkpoints have loaded the kernels, which takes others long.
    from sphrom.kernels.jit import compiled_with

    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(source.read_bytes())
    program = f"{__version__} with sources {digest.hexdigest()[:8]}"
    return {"sphrom": program, **compiled_with()}


class CheckpointFiles:
    """The files of one target's checkpoints."""

    def __init__(self, workspace: Workspace, target: Target) -> None:
        self._workspace = workspace
        self._target = target

    @property
    def there(self) -> bool:
        """Whether there is a checkpoint, valid or not."""
        return any(self._slot(slot).path.exists() for slot in range(len(SLOTS)))

    @property
    def left(self) -> bool:
        """Whether there is any file, of use or not."""
        return bool(self._files())

    def refuse_folders(self) -> None:
        """Raise ArtifactError where a folder has the name of a checkpoint: it is not removed."""
        for path in filter(_is_folder, self._named()):
            raise ArtifactError(f"{path} is a folder where a checkpoint has to be: remove it")

    def latest(self) -> StoredState:
        """Return the last checkpoint that is whole, with all its parts.

        Raises ArtifactError, for the first fault found, when none is.
        """
        states: list[StoredState] = []
        errors: list[ArtifactError] = []
        for slot in filter(lambda slot: slot.path.exists(), map(self._slot, range(len(SLOTS)))):
            try:
                states.append(self._read(slot))
            except ArtifactError as error:
                errors.append(error)
        for kept in sorted(states, key=lambda kept: kept.generation, reverse=True):
            try:
                self._verify_parts(kept)
            except ArtifactError as error:
                errors.append(error)
            else:
                return kept
        raise errors[0]

    def write(self, kept: StoredState) -> None:
        """Write a state, over the one before the last. Raises ArtifactError."""
        run_state = kept.run_state
        stored = Checkpoint.of(
            kept,
            state=np.atleast_2d(run_state.state),
            neighbours_at=run_state.neighbours_at,
            step=run_state.step,
            seconds=run_state.seconds,
            computed_with="\n".join(map(": ".join, kept.computed_with.items())),
        )
        slot = self._slot(kept.generation % len(SLOTS))
        with self._workspace.create_aside(slot, {}) as artifact:
            write_record(artifact, stored)

    def write_part(self, number: int, items: Sequence[Item], before: str) -> str:
        """Write snapshots, and return the digest of all parts from that of those before."""
        part = self._part(number)
        with self._workspace.create_aside(part, {"number": number}) as artifact:
            for name, first in items[0].items():
                stream = artifact.stream(name, np.shape(first), len(items))
                for item in items:
                    stream.append(item[name])
        with self._workspace.open_aside(part) as written:
            return _chained(before, written)

    def snapshots(self, kept: StoredState) -> Iterator[Item]:
        """Read the snapshots of a checkpoint back, one after the other."""
        for number in range(1, kept.n_parts + 1):
            with self._workspace.open_aside(self._part(number)) as part:
                for i in range(len(part.dataset("step"))):
                    yield {name: part.dataset(name)[i] for name in part.datasets}

    def remove(self) -> None:
        """Remove all checkpoints: the states first, as they count on the parts.

        What a process left that was killed while it wrote one goes too.
        """
        for path in self._files():
            path.unlink(missing_ok=True)

    def _files(self) -> list[Path]:
        return [path for path in self._named() if not _is_folder(path)]

    def _named(self) -> list[Path]:
        folder, name = self._target.path.parent, _escaped(self._target.path.name)
        endings = ("checkpoint-*", "part-*")
        return [
            path
            for ending in endings
            for hidden in ("", ".")
            for path in folder.glob(f"{hidden}{name}.{ending}")
        ]

    def _slot(self, slot: int) -> Target:
        return self._aside(f"checkpoint-{SLOTS[slot]}", "sphrom/checkpoint")

    def _part(self, number: int) -> Target:
        return self._aside(f"part-{number}", "sphrom/trajectory-part")

    def _aside(self, ending: str, schema: str) -> Target:
        path = self._target.path
        return replace(self._target, path=path.with_name(f"{path.name}.{ending}"), schema=schema)

    def _read(self, slot: Target) -> StoredState:
        with self._workspace.open_aside(slot) as artifact:
            artifact.verify_content()
            stored = read_record(artifact, Checkpoint)
        state = stored.state if len(stored.state) > 1 else stored.state[0]
        return StoredState(
            RunState(stored.step, state, stored.neighbours_at, stored.seconds),
            n_steps=stored.n_steps,
            time=stored.time,
            generation=stored.generation,
            n_parts=stored.n_parts,
            parts_sha256=stored.parts_sha256,
            wall_seconds=stored.wall_seconds,
            computed_with=_by_name(stored.computed_with),
        )

    def _verify_parts(self, kept: StoredState) -> None:
        digest = NO_PARTS
        for target in map(self._part, range(1, kept.n_parts + 1)):
            if not target.path.exists():
                raise ArtifactError(f"{target.path} is missing; `--force` starts anew")
            with self._workspace.open_aside(target) as part:
                part.verify_content()
                digest = _chained(digest, part)
        if digest != kept.parts_sha256:
            raise ArtifactError(
                f"{self._target.path}: the snapshots beside a checkpoint are not its own; "
                "`--force` starts anew"
            )


def _by_name(lines: str) -> Mapping[str, str]:
    parts = (line.partition(": ") for line in lines.splitlines())
    return {name: value for name, _, value in parts}


def _chained(before: str, part: Artifact) -> str:
    return hashlib.sha256(f"{before} {part.content_sha256}".encode()).hexdigest()


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _escaped(name: str) -> str:
    """Return a file's name as a pattern that matches it alone."""
    return "".join(f"[{character}]" if character in "*?[" else character for character in name)


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
