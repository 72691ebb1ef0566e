"""The artifacts in one folder: whether each is valid, and reading and writing them.

An artifact depends on some sections of the case, which are compared by a digest, and on other
artifacts, which are compared by their content. `sphrom.artifacts` reads and writes single files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from sphrom.artifacts import (
    Artifact,
    ArtifactWriter,
    Identity,
    Origin,
    create_artifact,
    open_artifact,
    probe,
)
from sphrom.artifacts.contents import Fault, inspect, open_file
from sphrom.case.loader import case_of_text
from sphrom.case.models import Case
from sphrom.errors import ArtifactError, CaseError
from sphrom.kernels import ask_for_threads
from sphrom.setup.context import StageContext


@dataclass(frozen=True)
class Target:
    """One artifact of a case: its file, and the case and inputs that it must be made with."""

    path: Path
    schema: str
    stage: str
    made_by: str
    inputs_digest: str
    parents: Mapping[str, Target]
    sections: frozenset[str]
    """The sections of the case that it or a parent depends on, wholly or in part."""
    at_least: Mapping[str, int]
    """Minimum lengths of its datasets; longer ones are valid too."""

    @property
    def existing_parents(self) -> dict[str, Target]:
        """The parents whose files exist, by role."""
        return {role: each for role, each in self.parents.items() if each.path.exists()}


class ArtifactFolder:
    """The folder of a case's artifacts: validity, reading and writing."""

    def __init__(self, context: StageContext) -> None:
        self.context = context
        self.case = context.case
        self.out = context.out
        self._reasons = context.known.reasons
        self._identities = context.known.identities
        ask_for_threads(context.threads)

    @property
    def threads(self) -> int:
        """Number of threads of the kernels; imports them."""
        from sphrom.kernels.jit import threads_for

        return threads_for(self.context.threads)

    def folder(self, name: str = "") -> Path:
        """Return the folder of artifacts, or one in it, made if necessary."""
        return make_folder(self.out / name)

    def reason_to_make(self, target: Target) -> str | None:
        """Return why an artifact has to be made, or None if it exists and is valid."""
        if target.path not in self._reasons:
            self._reasons[target.path] = self._reason_to_make(target)
        return self._reasons[target.path]

    def _reason_to_make(self, target: Target) -> str | None:
        if not target.path.exists():
            return "is missing"
        for parent in target.existing_parents.values():
            if (reason := self.reason_to_make(parent)) is not None:
                return f"was made from {parent.path.name}, which {reason}"
        return probe(target.path, target.schema, self._origin(target), target.at_least)

    def must_make(self, target: Target) -> bool:
        """Return whether a stage has to make an artifact, and report if it does not.

        Each reason why artifacts are made again is told once. Raises ArtifactError if the artifact
        exists, is not valid, and must not be overwritten, as imported ones never are.
        """
        is_imported = self._import_command(target) is not None
        if self.context.force and not self.context.keep_valid and not is_imported:
            self._require_no_folder(target)
            return True
        reason = self.require_replaceable(target)
        if reason is None:
            self.context.report.info(f"{target.path.name}: up to date, kept")
            return False
        if target.path.exists():
            known = self.context.known.told
            tell = self.context.report.info if reason in known else self.context.report.note
            tell(f"{target.path.name}: made again, because it {reason}")
            known.add(reason)
        return True

    def require_replaceable(self, target: Target) -> str | None:
        """Return why an artifact has to be made, or None, after checking that this is allowed.

        Raises ArtifactError if the artifact exists, is not valid, and must not be overwritten.
        """
        self._require_no_folder(target)
        reason = self.reason_to_make(target)
        if reason is not None and self._import_command(target) is not None:
            self.require(target)
        if reason is not None and target.path.exists() and not self.context.force:
            self._require_parents(target)
            raise ArtifactError(f"{target.path} {reason}; `--force` makes it again")
        return reason

    def _require_no_folder(self, target: Target) -> None:
        if target.path.is_dir():
            raise ArtifactError(f"{target.path} is a folder where a file has to be: remove it")

    def require(self, target: Target) -> None:
        """Raise ArtifactError that names the first cause, unless an artifact is valid."""
        reason = self.reason_to_make(target)
        if reason is None:
            return
        self._require_parents(target)
        lacks, again = ("out of date", " --force") if target.path.exists() else ("missing", "")
        remedy = (
            f"make it with `{target.made_by}{again}`, or everything that is {lacks} with "
            f"`sphrom run {self.context.words}{again}`"
        )
        if command := self._import_command(target):
            remedy = f"a simulation can't replace an import: import again with `{command}`"
        raise ArtifactError(f"{target.path} {reason}; {remedy}")

    def _require_parents(self, target: Target) -> None:
        """Raise ArtifactError if an existing input is not valid."""
        for parent in target.existing_parents.values():
            self.require(parent)

    def imported(self, target: Target) -> dict[str, str]:
        """Return the import attributes of an artifact; empty if it was made here or is damaged."""
        attributes = self.attributes(target).items()
        return {name: str(value) for name, value in attributes if name.startswith("imported/")}

    def attributes(self, target: Target) -> Mapping[str, object]:
        """Return the attributes of an artifact, unchecked; none if it is missing or damaged."""
        with suppress(Fault), open_file(target.path) as file:
            return inspect(file).attributes
        return {}

    def _import_command(self, target: Target) -> str | None:
        """Return the command that imports a full run again; None if a stage makes the artifact."""
        attributes = self.imported(target) if target.stage == "fom" else {}
        files = attributes.get("imported/files")
        return files and f"sphrom import {self.context.words} {files} --force"

    def open(self, target: Target) -> AbstractContextManager[Artifact]:
        """Open an artifact for reading, after checking it against the case and its inputs.

        Raises ArtifactError if it is missing, damaged, or no longer valid.
        """
        self.require(target)
        return self.open_intermediate(target)

    def open_intermediate(self, target: Target) -> AbstractContextManager[Artifact]:
        """Open an intermediate file, such as a checkpoint, after checking that file only."""
        return open_artifact(
            target.path, target.schema, made_by=target.made_by, origin=self._origin(target)
        )

    @contextmanager
    def create(
        self, target: Target, attributes: Mapping[str, object] | None = None, *, over: bool = False
    ) -> Iterator[ArtifactWriter]:
        """Write an artifact made from its parents' state; with `over` or `force`, over another."""
        for parent in target.parents.values():
            self.require(parent)
        make_folder(target.path.parent)
        force = self.context.force or over
        with self.create_intermediate(target, attributes, force=force) as artifact:
            yield artifact
        self.context.known.forget(target.path)
        self.context.report.info(f"wrote {target.path}")

    def create_intermediate(
        self, target: Target, attributes: Mapping[str, object] | None = None, *, force: bool = True
    ) -> AbstractContextManager[ArtifactWriter]:
        """Write an intermediate file, such as a checkpoint, without a message."""
        return create_artifact(
            target.path,
            target.schema,
            stage=target.stage,
            origin=self._origin(target),
            threads=self.threads,
            force=force,
            attributes=attributes,
        )

    def _origin(self, target: Target) -> Origin:
        """Return the case and the existing parents of an artifact."""
        return Origin(
            target.inputs_digest,
            self.case.text,
            target.sections,
            lambda text: self._consequences(target, text),
            {role: self._identity(parent) for role, parent in target.existing_parents.items()},
            self.case.scene.domain.n_dim,
        )

    def _consequences(self, target: Target, text: str) -> str:
        """Return, in words, the derived values that differ for another case, given as YAML."""
        with suppress(CaseError):
            there, here = map(_derived_values, (case_of_text(text), self.case))
            different = [name for name in here if here[name] != there[name]]
            if "time" in target.sections and different:
                name = different[0]
                return (
                    f"the {name} is {there[name]} there, {here[name]} here: it depends on the "
                    "lowest Reynolds number of all points, and on their speeds"
                )
        return ""

    def _identity(self, target: Target) -> Identity:
        if target.path not in self._identities:
            with open_artifact(target.path, target.schema, made_by=target.made_by) as artifact:
                self._identities[target.path] = artifact.identity
        return self._identities[target.path]


def _derived_values(case: Case) -> dict[str, str]:
    """Return the values that follow from all points of a case, in words."""
    return {
        "step": f"{case.plan.steps.time_step:.6g} s",
        "speed of sound": f"{case.plan.sound_speed:.6g} m/s",
    }


def make_folder(path: Path, option: str = "--out") -> Path:
    """Return a folder, made if necessary. Raises ArtifactError that names the option."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArtifactError(
            f"{path} can't be made: {error.strerror}; choose another folder with `{option}`"
        ) from error
    return path
