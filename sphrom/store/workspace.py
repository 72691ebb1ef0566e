"""The artifacts of one case: whether they are valid; opened and created, checked."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from sphrom.artifacts import (
    Artifact,
    ArtifactWriter,
    Identity,
    create_artifact,
    open_artifact,
    probe,
)
from sphrom.case.models import resolved_yaml
from sphrom.errors import ArtifactError
from sphrom.kernels import ask_for_threads
from sphrom.setup.context import StageContext
from sphrom.store.targets import Target, Targets


class Workspace(Targets):
    """The folder of a case's artifacts: which are valid, to be read, and written."""

    def __init__(self, context: StageContext) -> None:
        super().__init__(context.case, context.out, context.folders)
        self.context = context
        ask_for_threads(context.threads)
        self.case_text = resolved_yaml(self.case)
        self._texts: dict[frozenset[str], str] = {}
        self._reasons = context.known.reasons
        self._identities = context.known.identities

    @property
    def threads(self) -> int:
        """How many threads kernels use, which are loaded to tell."""
        from sphrom.kernels.jit import threads_for

        return threads_for(self.context.threads)

    def _text(self, target: Target) -> str:
        """Return those sections of the case that an artifact depends on."""
        if target.sections not in self._texts:
            self._texts[target.sections] = resolved_yaml(self.case, target.sections)
        return self._texts[target.sections]

    def reason_to_make(self, target: Target) -> str | None:
        """Return why an artifact has to be made, or None when it is there and valid."""
        if target.path not in self._reasons:
            self._reasons[target.path] = self._reason_to_make(target)
        return self._reasons[target.path]

    def _reason_to_make(self, target: Target) -> str | None:
        if not target.path.exists():
            return "is missing"
        for parent in target.parents.values():
            if parent.path.exists() and (reason := self.reason_to_make(parent)) is not None:
                return f"was made from {parent.path.name}, which {reason}"
        return probe(
            target.path,
            target.schema,
            inputs_digest=target.inputs_digest,
            case_text=self._text(target),
            lineage=self._lineage(target),
            at_least=target.at_least,
        )

    def must_make(self, target: Target) -> bool:
        """Return whether a stage is to make an artifact, and say why not.

        Raises ArtifactError when it is there but not valid, and may not be overwritten.
        """
        if target.path.is_dir():
            raise ArtifactError(f"{target.path} is a folder where an artifact has to be: remove it")
        if self.context.force and not self.context.keep_valid:
            return True
        reason = self.reason_to_make(target)
        if reason is None:
            self.context.report.info(f"{target.path.name}: there, and of this case: kept")
            return False
        if target.path.exists() and not self.context.force:
            self._require_parents(target)
            raise ArtifactError(f"{target.path} {reason}; `--force` makes it anew")
        if target.path.exists():
            self.context.report.note(f"{target.path.name}: made again, because it {reason}")
        return True

    def require(self, target: Target) -> None:
        """Raise ArtifactError, naming the first cause, unless an artifact is there and valid."""
        if (reason := self.reason_to_make(target)) is not None:
            self._require_parents(target)
            remedy = (
                f"make it with `{target.made_by}`, or all that is missing with `sphrom run CASE`"
            )
            if target.path.exists():
                remedy = f"make it again with `{target.made_by} --force`"
            raise ArtifactError(f"{target.path} {reason}; {remedy}")

    def _require_parents(self, target: Target) -> None:
        """Raise ArtifactError when an input that is still there is not valid."""
        for parent in target.parents.values():
            if parent.path.exists():
                self.require(parent)

    @contextmanager
    def open(self, target: Target) -> Iterator[Artifact]:
        """Open an artifact for reading, checked against the case and its inputs.

        Raises ArtifactError when it is missing, damaged, or no longer valid.
        """
        self.require(target)
        with self.open_aside(target) as artifact:
            if target.n_snapshots and artifact.attributes.get("status") != "unstable":
                artifact.require(snapshot=target.n_snapshots)
            yield artifact

    def open_aside(self, target: Target) -> AbstractContextManager[Artifact]:
        """Open a file that is no result itself, such as a checkpoint, with the same checks."""
        return open_artifact(
            target.path,
            target.schema,
            made_by=target.made_by,
            inputs_digest=target.inputs_digest,
            case_text=self._text(target),
            lineage=self._lineage(target),
        )

    @contextmanager
    def create(
        self, target: Target, attributes: Mapping[str, object] | None = None
    ) -> Iterator[ArtifactWriter]:
        """Write an artifact, made from its parents as they are now."""
        for parent in target.parents.values():
            self.require(parent)
        make_folder(target.path.parent)
        with self._create(target, attributes, self.context.force) as artifact:
            yield artifact
        self.context.known.forget(target.path)
        self.context.report.info(f"wrote {target.path}")

    def create_aside(
        self, target: Target, attributes: Mapping[str, object]
    ) -> AbstractContextManager[ArtifactWriter]:
        """Write a file that is no result itself; replace an older one, and print no message."""
        return self._create(target, attributes, force=True)

    def _create(
        self, target: Target, attributes: Mapping[str, object] | None, force: bool
    ) -> AbstractContextManager[ArtifactWriter]:
        return create_artifact(
            target.path,
            target.schema,
            stage=target.stage,
            case_text=self.case_text,
            case_digest=hashlib.sha256(self.case_text.encode()).hexdigest(),
            inputs_digest=target.inputs_digest,
            lineage=self._lineage(target),
            threads=self.threads,
            force=force,
            attributes=attributes,
        )

    def folder(self, name: str = "") -> Path:
        """Return the folder of artifacts, or one in it, made if need be."""
        path = self.out / name
        make_folder(path)
        return path

    def _lineage(self, target: Target) -> dict[str, Identity]:
        """Return the identities of those parents that are still there."""
        return {
            role: self._identity(parent)
            for role, parent in target.parents.items()
            if parent.path.exists()
        }

    def _identity(self, target: Target) -> Identity:
        if target.path not in self._identities:
            with open_artifact(target.path, target.schema, made_by=target.made_by) as artifact:
                self._identities[target.path] = artifact.identity
        return self._identities[target.path]


def make_folder(path: Path, option: str = "--out") -> None:
    """Make a folder. Raises ArtifactError, naming the option that chooses another one."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArtifactError(
            f"{path} can't be made: {error.strerror}; choose another folder with `{option}`"
        ) from error
