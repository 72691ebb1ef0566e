"""The context of a stage: the case, the folder of its artifacts, options, and the reporter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.console import Reporter

if TYPE_CHECKING:
    from sphrom.artifacts import Identity


@dataclass(frozen=True)
class KnownArtifacts:
    """The known state of artifacts, by path, so that stages of one command check them once."""

    reasons: dict[Path, str | None] = field(default_factory=dict)
    """Why an artifact has to be made; None if it is valid."""
    identities: dict[Path, Identity] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)
    """The artifacts that were written, in order."""
    told: set[str] = field(default_factory=set)
    """The reasons why artifacts are made again, of which each is reported once."""

    def forget(self, path: Path) -> None:
        """Forget the states that writing an artifact may change: its own, and all invalid ones."""
        for known, reason in list(self.reasons.items()):
            if reason is not None or known == path:
                del self.reasons[known]
        self.identities.pop(path, None)
        self.written.append(path)


@dataclass(frozen=True)
class StageContext:
    """The case, the options and the reporter that a stage receives."""

    case: Case
    out: Path
    """The folder of the case's artifacts."""
    force: bool
    """Whether to overwrite artifacts, and to override checks that allow it."""
    threads: int | None
    """Number of threads; None for all cores."""
    report: Reporter
    only: tuple[ParameterPoint, ...] | None = None
    """The parameter points to run; None for all."""
    models: tuple[str, ...] | None = None
    """The reduced models to run, by name; None for all."""
    keep_valid: bool = False
    """With `force`, whether to keep artifacts that are still valid."""
    resume: bool = False
    """Whether runs that were stopped continue from their checkpoints."""
    checkpoint_every: float = 60.0
    """Seconds between checkpoints of a run, or more if writing them is slow.

    Zero writes one after every step, however slow.
    """
    workers: int | None = None
    """Number of processes that make independent runs at the same time; None for this one alone.

    A sweep chooses it if it is None, and so does a training for its first runs.
    """
    scheduler: str | None = None
    """Address of a Dask scheduler, whose workers make such runs instead."""
    bitwise: bool = False
    """With `resume`, whether to restart runs that would not continue with the same bits."""
    known: KnownArtifacts = field(default_factory=KnownArtifacts)
    words: str = "CASE"
    """The command-line arguments with which another command finds the same artifacts."""
    folders: Mapping[str, Path] = field(default_factory=dict)
    """Folders of the kinds of artifacts, such as `operators`, that are not in `out`."""

    def chosen(self, points: Sequence[ParameterPoint]) -> tuple[ParameterPoint, ...]:
        """Return the points that are also in `only`, if it is set."""
        return tuple(point for point in points if self.only is None or point in self.only)

    @property
    def chosen_models(self) -> tuple[ReducedModelSection, ...]:
        """The reduced models that are also in `models`, if it is set."""
        return tuple(m for m in self.case.rom if self.models is None or m.name in self.models)
