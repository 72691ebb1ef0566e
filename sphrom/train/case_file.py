"""The case with the points that a training chose, as a file that other commands go on with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sphrom.case.edited import retrained
from sphrom.case.identity import resolved_yaml
from sphrom.case.loader import case_of_text
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.training_checks import train_values, trained_at
from sphrom.errors import ArtifactError, CaseError
from sphrom.plots.files import require_writable, write_whole


class CaseFile:
    """The case with the chosen points, as a file."""

    def __init__(
        self, case: Case, path: Path, source: Path | None, overrides: Sequence[str]
    ) -> None:
        """Name the file, and that of the user's case with the keys changed in it, if there is one.

        Without that the case is written with every default filled in.
        """
        self.path = path
        self._case, self._source, self._overrides = case, source, overrides

    def check(self, points: Sequence[ParameterPoint]) -> None:
        """Raise CaseError unless the case, trained at some points, can be read from there."""
        if not self.path.parent.is_dir():
            raise CaseError(f"--write-case: {self.path.parent} is no folder")
        try:
            require_writable(self.path)
        except ArtifactError as error:
            raise CaseError(f"--write-case: {error}") from error
        text = self._text(points)
        try:
            case_of_text(text, self.path.parent)
        except CaseError as error:
            raise CaseError(
                "--write-case: the case names files beside it, so name a file in "
                f"{self._case.folder}; in {self.path.parent} it can't be read"
            ) from error

    def _text(self, points: Sequence[ParameterPoint]) -> str:
        if self._source is None:
            return resolved_yaml(trained_at(self._case, points))
        values = train_values(self._case, points).model_dump(mode="json", exclude_defaults=True)
        return retrained(self._source, self._overrides, values)

    def write(self, points: Sequence[ParameterPoint]) -> None:
        """Write the case, trained at some points."""
        write_whole(self.path, self._text(points).encode())
