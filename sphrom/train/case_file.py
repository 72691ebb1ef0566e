"""The case with the points that a training chose, as a file that other commands go on with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sphrom.case.identity import resolved_yaml
from sphrom.case.loader import case_of_text
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import trained_at
from sphrom.errors import ArtifactError, CaseError
from sphrom.whole_files import require_writable, write_whole


def check_case_path(path: Path) -> None:
    """Raise CaseError unless a file can be written there."""
    if not path.parent.is_dir():
        raise CaseError(f"--write-case: {path.parent} is no folder")
    try:
        require_writable(path)
    except ArtifactError as error:
        raise CaseError(f"--write-case: {error}") from error


def check_case_file(path: Path, case: Case, points: Sequence[ParameterPoint]) -> None:
    """Raise CaseError unless a case, trained at some points, can be read there."""
    try:
        case_of_text(resolved_yaml(trained_at(case, points)), path.parent)
    except CaseError as error:
        raise CaseError(
            "--write-case: the case names files beside it, so name a file in "
            f"{case.folder}; in {path.parent} it can't be read"
        ) from error


def write_case_file(path: Path, case: Case, points: Sequence[ParameterPoint]) -> None:
    """Write a case, trained at some points, with every default filled in."""
    write_whole(path, resolved_yaml(trained_at(case, points)).encode())
