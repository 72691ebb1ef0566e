"""The stages of a training, kept on disk, so that the same command goes on where it was stopped.

The file is JSON: the stages, a digest of all that they depend on, and a digest of the stages, so
that damage is noticed. It is there as a whole or not at all.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.case.identity import resolved_yaml
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.console import Reporter
from sphrom.kernels.jit import source_hash
from sphrom.whole_files import write_whole

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

    def __init__(
        self,
        case: Case,
        model: ReducedModelSection,
        folder: Path,
        report: Reporter,
        *,
        anew: bool,
    ) -> None:
        """Find the stages that an earlier training of the same region left, unless `anew`."""
        self._path, self._key = folder / NAME, _key(case, model)
        self.stages: list[Stage] = []
        if anew or not self._path.exists():
            return
        rows = self._rows()
        if rows is None:
            report.warn(f"{self._path} is of another case or damaged: not used")
            return
        self.stages = list(map(_stage, rows))
        n_stages = len(self.stages)
        report.info(f"training goes on: {n_stages} stage{'s' * (n_stages != 1)} are there")

    def _rows(self) -> Sequence[Any] | None:
        """Return the rows of the file, None where it is of another case or damaged."""
        try:
            known = json.loads(self._path.read_text(encoding="utf-8"))
            rows, digests = known["rows"], (known["key"], known["rows_sha256"])
        except (OSError, ValueError, RecursionError, TypeError, KeyError):
            return None
        return rows if digests == (self._key, _digest([json.dumps(rows)])) else None

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
        rows = json.dumps([asdict(stage) for stage in self.stages], default=np.ndarray.tolist)
        whole = {"key": self._key, "rows_sha256": _digest([rows]), "rows": json.loads(rows)}
        write_whole(self._path, json.dumps(whole, indent=1).encode())


def _stage(row: Mapping[str, Any]) -> Stage:
    held_out = [
        HeldOut(
            point=_point(run["point"]),
            failure=run["failure"],
            **{name: np.array(run[name]) for name in ("estimate", "error", "floor")},
        )
        for run in row["held_out"]
    ]
    points = tuple(map(_point, row["points"]))
    return Stage(points, np.array(row["estimates"]), np.array(row["floor"]), tuple(held_out))


def _point(row: Mapping[str, Any]) -> ParameterPoint:
    return ParameterPoint(row["reynolds"], tuple((name, value) for name, value in row["others"]))


def _key(case: Case, model: ReducedModelSection) -> str:
    """Return a digest of all that stages depend on; the tolerance and the budget may change."""
    section = case.training
    asked = section.ranges, section.candidates, section.seed
    sections = set(type(case).model_fields) - ELSEWHERE
    about = (resolved_yaml(case, sections), repr(asked), model.model_dump_json())
    return _digest((*about, str(case.plan.n_modes), source_hash()))


def _digest(parts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
