"""What a stage is given: the case, where its artifacts are, and whom to report to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.console import Reporter

if TYPE_CHECKING:
    from sphrom.artifacts import Identity


@dataclass(frozen=True)
class KnownArtifacts:
    """What is known of artifacts, by path, so that stages of one command need not look again."""

    reasons: dict[Path, str | None] = field(default_factory=dict)
    """Why an artifact has to be made; None where it is valid."""
    identities: dict[Path, Identity] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)
    """What has been written, in order."""

    def forget(self, path: Path) -> None:
        """Forget what the writing of an artifact can have changed: what was not valid, and it."""
        for known, reason in list(self.reasons.items()):
            if reason is not None or known == path:
                del self.reasons[known]
        self.identities.pop(path, None)
        self.written.append(path)


@dataclass(frozen=True)
class StageContext:
    """All that a stage needs to know."""

    case: Case
    out: Path
    """The folder of the case's artifacts."""
    force: bool
    """Whether to write over artifacts, and to insist where a check can be overruled."""
    threads: int | None
    """Threads to compute on; None is all cores."""
    report: Reporter
    only: tuple[ParameterPoint, ...] | None = None
    """The parameter points to run; None is all."""
    models: tuple[str, ...] | None = None
    """The reduced models to run, by name; None is all."""
    keep_valid: bool = False
    """With `force`, whether artifacts that are still valid are kept all the same."""
    resume: bool = False
    """Whether runs that were stopped go on from their checkpoints."""
    checkpoint_every: float = 60.0
    """Seconds from one checkpoint of a run to the next, or more where writing takes long.

    Zero is after every step, whatever that takes.
    """
    bitwise: bool = False
    """With `resume`, whether runs start anew that would not go on to the same bits."""
    known: KnownArtifacts = field(default_factory=KnownArtifacts)
    words: str = "CASE"
    """The arguments by which another command finds the same artifacts."""
    folders: Mapping[str, Path] = field(default_factory=dict)
    """Of the kinds of artifacts, such as `operators`, that are not in `out`."""

    def chosen(self, points: Sequence[ParameterPoint]) -> tuple[ParameterPoint, ...]:
        """Return the points that `only` leaves."""
        return tuple(point for point in points if self.only is None or point in self.only)

    @property
    def chosen_models(self) -> tuple[ReducedModelSection, ...]:
        """The reduced models that `models` leaves."""
        return tuple(m for m in self.case.rom if self.models is None or m.name in self.models)
