"""Reduced runs that store coordinates alone, with their fields: computed when they are read.

Such a run reads as one that stores `output: snapshots` does, one snapshot at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, DatasetReader
from sphrom.artifacts.layout import Shape
from sphrom.artifacts.vtk_files import Fields, Rows
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.online.rebuilt_run import RebuiltRun
from sphrom.sph import state_equation
from sphrom.store.bases import read_points
from sphrom.store.workspace import Workspace

POINTS = "reference_position"


@dataclass(frozen=True)
class Computed:
    """A field of floats, computed snapshot by snapshot."""

    shape: Shape
    at: Callable[[int], NDArray[np.float64]]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the values."""
        return np.dtype(np.float64)

    def __len__(self) -> int:
        """Return the number of snapshots."""
        return self.shape[0]

    def __getitem__(self, selection: int | EllipsisType) -> NDArray[np.float64]:
        """Return one snapshot, or all of them."""
        if isinstance(selection, int):
            return self.at(selection)
        return np.array([self.at(snapshot) for snapshot in range(len(self))]).reshape(self.shape)


class WithFields:
    """The datasets of an open run, and those that its coordinates give in addition."""

    def __init__(self, run: Artifact, added: dict[str, Rows]) -> None:
        self.path = run.path
        self.text = run.text
        self._run = run
        self._added = added

    @property
    def datasets(self) -> list[str]:
        """The names of the datasets, sorted."""
        return sorted({*self._run.datasets, *self._added})

    def dataset(self, name: str) -> Rows | DatasetReader:
        """Return a dataset that is read by slices."""
        return self._added[name] if name in self._added else self._run.dataset(name)


def with_fields(
    workspace: Workspace, run: Artifact, model: ReducedModelSection, point: ParameterPoint
) -> Fields:
    """Return an open run on the reference points that has its fields."""
    if POINTS in run:
        return run
    points = read_points(workspace)
    state = lru_cache(maxsize=1)(RebuiltRun.of(workspace, run, model, point).state)
    n_snapshots, (n_points, n_dim) = run.length("time"), points.shape
    sound_speed = workspace.case.sound_speed
    scalars: Shape = (n_snapshots, n_points)
    return WithFields(
        run,
        {
            POINTS: points,
            "density_fluctuation": Computed(scalars, lambda i: state(i)[0]),
            "velocity": Computed((*scalars, n_dim), lambda i: state(i)[1]),
            "pressure": Computed(
                scalars, lambda i: state_equation.pressure(state(i)[0], sound_speed)
            ),
        },
    )


@contextmanager
def open_with_fields(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> Iterator[Fields]:
    """Open a reduced run of the case, on particles or on the reference points.

    Raises ArtifactError when it or its basis is missing, damaged, or of another case.
    """
    with workspace.open(workspace.reduced_run(model, point)) as run:
        yield run if model.on_particles else with_fields(workspace, run, model, point)
