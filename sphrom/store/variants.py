"""Variants of a case: other values of its keys, and the artifacts that follow from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

from sphrom.case.models import Case
from sphrom.setup.context import KnownArtifacts, StageContext
from sphrom.store.workspace import Workspace

Stage = Callable[[StageContext], None]


@dataclass(frozen=True)
class Variant:
    """A case made from that of a context, with artifacts of its own or in the same folder.

    Its valid artifacts are kept. In a folder of its own, invalid artifacts are made again without
    --force, all of them with --force, and stopped runs continue.
    """

    origin: StageContext
    case: Case
    folder: str = ""
    """Folder of its artifacts, within that of the origin; empty for the same."""
    shared: tuple[str, ...] = ()
    """Kinds of artifacts that it takes from the origin's folder."""
    only: tuple[str, ...] = ()
    """The only kinds of artifacts in its folder; by default all that are not shared."""

    @cached_property
    def context(self) -> StageContext:
        """The context of the stages that make its artifacts."""
        origin = self.origin
        own = origin.out / self.folder
        return replace(
            origin,
            case=self.case,
            out=origin.out if self.only else own,
            folders=dict.fromkeys(self.only, own) | dict.fromkeys(self.shared, origin.out),
            only=None,
            force=origin.force or bool(self.folder),
            keep_valid=not (origin.force and self.folder),
            resume=not origin.force,
            bitwise=True,
            known=KnownArtifacts(),
            report=origin.report.brief(progress=True),
        )

    @property
    def workspace(self) -> Workspace:
        """The artifacts of the variant."""
        return Workspace(self.context)

    def made(self, stages: Iterable[Stage]) -> Workspace:
        """Make its artifacts by some stages, in order, and return them."""
        for stage in stages:
            stage(self.context)
        return self.workspace
