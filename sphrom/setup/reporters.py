"""Reporters for runs that are a means only, and around those that others wrote."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager

from sphrom.setup.context import PlainReporter, Reporter


class AllAlike:
    """Tells a plain reporter details, notes and results as it does anything else."""

    def __init__(self, report: PlainReporter) -> None:
        self._report = report
        self.info = self.note = self.result = report.info
        self.warn, self.table, self.progress = report.warn, report.table, report.progress

    @property
    def details(self) -> AllAlike:
        """Who is told details: the same."""
        return self

    def __getattr__(self, name: str) -> object:
        """Return what else the plain reporter has."""
        return getattr(self._report, name)


class BriefReporter:
    """Passes warnings on, behind a label, and progress if asked; drops the rest."""

    def __init__(
        self, report: Reporter | None = None, *, label: str = "", progress: bool = False
    ) -> None:
        """Report to `report`; None is to nobody."""
        self._report = report
        self._label = f"{label}: " if label else ""
        self._progress = progress

    @property
    def details(self) -> BriefReporter:
        """Who is told details: nobody."""
        return self

    def info(self, text: str) -> None:
        """Drop it."""

    def note(self, text: str) -> None:
        """Drop it."""

    def result(self, text: str) -> None:
        """Drop it."""

    def warn(self, text: str) -> None:
        """Warn the user in one line."""
        if self._report is not None:
            self._report.warn(self._label + text)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Drop it."""

    def progress(
        self, description: str, total: int
    ) -> AbstractContextManager[Callable[[int], None]]:
        """Show progress, if asked for."""
        if self._report is not None and self._progress:
            return self._report.progress(description, total)
        return _unseen()


@contextmanager
def _unseen() -> Iterator[Callable[[int], None]]:
    yield lambda done: None
