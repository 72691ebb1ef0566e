"""The rows of a trade so far, kept after each model, so that a stopped trade can go on.

Times are measured: a trade that goes on keeps those that it has, and doesn't measure again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from sphrom.errors import ArtifactError
from sphrom.kernels.jit import source_hash
from sphrom.store.journal import digest_of, read_journal, write_journal
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace
from sphrom.trade.table import ModelRow, RunRow
from sphrom.whole_files import remove_whole

NAME = "progress.json"
Rows = tuple[ModelRow, list[RunRow]]


class Journal:
    """The rows of a trade that is not complete."""

    def __init__(
        self, workspace: Workspace, folder: str, made_from: Sequence[tuple[Workspace, Target]]
    ) -> None:
        """Find the rows that a stopped trade of the same case and artifacts left.

        Raises ArtifactError when there are some, but neither `resume` nor `force` is asked for.
        """
        self._path = workspace.folder(folder) / NAME
        self._key = _key(workspace, made_from)
        self._rows: dict[str, Any] = {}
        context = workspace.context
        known = read_journal(self._path)
        if known is None:
            return
        if known.get("key") != self._key or not isinstance(known["rows"], dict):
            context.report.warn(f"{self._path} is of another case or damaged: not used")
        elif context.resume:
            self._rows = known["rows"]
            context.report.info(f"trade: {len(self._rows)} rows are kept of the one that stopped")
        elif not context.force:
            raise ArtifactError(
                f"a trade was stopped after {len(known['rows'])} rows: `--resume` keeps them, "
                "`--force` starts anew"
            )

    def seconds(self, name: str, measure: Callable[[], float]) -> float:
        """Return the seconds that were measured before, or measure them."""
        if name not in self._rows:
            self._keep(name, measure())
        return float(self._rows[name])

    def rows(self, label: str, make: Callable[[], Rows]) -> Rows:
        """Return the rows that were made of a model before, or make them."""
        if label not in self._rows:
            row, runs = make()
            self._keep(label, {"model": asdict(row), "runs": [asdict(run) for run in runs]})
        known = self._rows[label]
        return ModelRow(**known["model"]), [RunRow(**run) for run in known["runs"]]

    def remove(self) -> None:
        """Remove it: the trade is complete."""
        remove_whole(self._path)

    def _keep(self, name: str, value: Any) -> None:
        self._rows[name] = value
        write_journal(self._path, self._key, self._rows)


def _key(workspace: Workspace, made_from: Sequence[tuple[Workspace, Target]]) -> str:
    """Return a digest of all that the rows depend on."""
    parts = [workspace.case_text, source_hash(), str(workspace.threads)]
    for place, target in made_from:
        with place.open(target) as artifact:
            parts.append(artifact.content_sha256)
    return digest_of(parts)
