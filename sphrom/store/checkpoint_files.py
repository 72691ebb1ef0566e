"""The files of a run's checkpoints: written whole or not at all, checked, and read back.

Beside the artifact in the making, `NAME.part-1`, `NAME.part-2`, ... hold the snapshots that are
done, each file those since the one before, and `NAME.checkpoint-a` and `NAME.checkpoint-b`, written
by turns, hold the state and say which parts belong to it. Parts never change once they are written,
and come before the state that counts on them: whenever a process is killed, one of the two states
is whole, and so are its parts.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, read_record, write_record
from sphrom.artifacts.records import Checkpoint
from sphrom.errors import ArtifactError
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
