"""The stages of a training, kept on disk, so that the same command goes on where it was stopped."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.case.identity import resolved_yaml
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import Region
from sphrom.console import Reporter
from sphrom.kernels.jit import source_hash
from sphrom.store.journal import digest_of, read_journal, write_journal

Array = NDArray[np.float64]

NAME = "progress.json"
ELSEWHERE = {"training", "trade", "sweep", "fit", "rom"}
"""Sections of a case that don't tell on their own what a training finds."""


@dataclass(frozen=True)
class HeldOut:
    """A full run that a model predicted before it learnt from it; errors are [%]."""

    point: ParameterPoint
    estimate: Array
    """(2,) of velocity and pressure, before any correction; infinite where there is none."""
    error: Array
    """(2,), infinite where the model's run diverged."""
    floor: Array
    """(2,) of the best approximation in the basis."""
    failure: str | None = None
    """Why there is no full run to learn from; it then has no errors."""


@dataclass(frozen=True)
class Stage:
    """What a model gave that was trained at some points."""

    points: tuple[ParameterPoint, ...]
    estimates: Array
    """(n_candidates, 2) [%], infinite where there are none."""
    floor: Array
    """(2,) largest errors of the best approximations of the training runs [%]."""
    held_out: tuple[HeldOut, ...] = field(default=())
    """Chosen next; none while their full runs are not there."""


class Journal:
    """The stages so far."""

    def __init__(self, path: Path, key: str, region: Region) -> None:
        self._path, self._key, self._region = path, key, region
        self.stages: list[Stage] = []

    @classmethod
    def of(
        cls,
        case: Case,
        model: ReducedModelSection,
        region: Region,
        folder: Path,
        report: Reporter,
        *,
        anew: bool,
    ) -> Journal:
        """Find the stages that an earlier training of the same region left, unless `anew`."""
        found = cls(folder / NAME, _key(case, model), region)
        known = None if anew else read_journal(found._path)
        if known is None:
            return found
        if known.get("key") != found._key:
            report.warn(f"{found._path} is of another case or damaged: not used")
            return found
        found.stages = [found._read(row) for row in known["rows"]]
        n_stages = len(found.stages)
        report.info(f"training goes on: {n_stages} stage{'s' * (n_stages != 1)} are there")
        return found

    def add(self, stage: Stage) -> None:
        """Add a stage."""
        self.stages.append(stage)
        self._write()

    def complete(self, held_out: Sequence[HeldOut]) -> None:
        """Add the runs that the last stage chose."""
        self.stages[-1] = replace(self.stages[-1], held_out=tuple(held_out))
        self._write()

    @property
    def held_out(self) -> list[HeldOut]:
        """All runs that were predicted before they were learnt from."""
        return [run for stage in self.stages for run in stage.held_out]

    def _write(self) -> None:
        write_journal(self._path, self._key, [_row(stage) for stage in self.stages])

    def _read(self, row: Mapping[str, Any]) -> Stage:
        return Stage(
            tuple(map(self._point, row["points"])),
            _figures(row["estimates"]),
            _figures(row["floor"]),
            tuple(
                HeldOut(
                    point=self._point(each["point"]),
                    estimate=_figures(each["estimate"]),
                    error=_figures(each["error"]),
                    floor=_figures(each["floor"]),
                    failure=each["failure"],
                )
                for each in row["held_out"]
            ),
        )

    def _point(self, values: Mapping[str, float]) -> ParameterPoint:
        reynolds, *others = ((name, values[name]) for name in self._region.names)
        return ParameterPoint(reynolds[1], tuple(others))


def _key(case: Case, model: ReducedModelSection) -> str:
    """Return a digest of all that stages depend on; the tolerance and the budget may change."""
    section = case.training
    asked = section.ranges, section.candidates, section.seed
    sections = set(type(case).model_fields) - ELSEWHERE
    about = (resolved_yaml(case, sections), repr(asked), model.model_dump_json())
    return digest_of((*about, str(case.n_modes), source_hash()))


def _row(stage: Stage) -> dict[str, Any]:
    return {
        "points": [point.as_dict() for point in stage.points],
        "estimates": _plain(stage.estimates),
        "floor": _plain(stage.floor),
        "held_out": [
            {
                "point": run.point.as_dict(),
                "estimate": _plain(run.estimate),
                "error": _plain(run.error),
                "floor": _plain(run.floor),
                "failure": run.failure,
            }
            for run in stage.held_out
        ],
    }


def _plain(figures: Array) -> Any:
    """Return figures as lists, None for what is infinite."""
    if figures.ndim > 1:
        return [_plain(each) for each in figures]
    return [value if math.isfinite(value) else None for value in figures.tolist()]


def _figures(given: Sequence[Any]) -> Array:
    found = np.array(given, dtype=float)
    return np.where(np.isnan(found), np.inf, found)
