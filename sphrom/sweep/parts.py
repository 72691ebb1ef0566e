"""The files of a sweep: parts with the runs of one task each, and the whole that they become."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.figures import FULL
from sphrom.case.studies import sweep_model, sweep_name
from sphrom.errors import ArtifactError
from sphrom.store.sweep import RunRecord, write_records
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace


def probe_places(workspace: Workspace) -> NDArray[np.float64]:
    """Return where a sweep keeps velocity and pressure (n_probes, 2) [m]."""
    return np.array(workspace.case.sweep.probes, dtype=float).reshape(-1, 2)


def require_folder(workspace: Workspace) -> None:
    """Raise ArtifactError when somebody has removed the folder of the artifacts meanwhile."""
    if not workspace.out.is_dir():
        raise ArtifactError(f"{workspace.out} was removed while the sweep ran")


def parts_folder(workspace: Workspace) -> Path:
    """Return the folder of the parts of a sweep."""
    return workspace.out / f"sweep-{sweep_name(workspace.case)}"


def part(workspace: Workspace, path: Path) -> Target:
    """Return a part of a sweep: made with the same and from the same as the whole."""
    return replace(workspace.sweep(), path=path)


def write_part(workspace: Workspace, records: Sequence[RunRecord]) -> None:
    """Write a part, named by its points."""
    require_folder(workspace)
    text = "\n".join(record.point.label for record in records)
    name = f"part-{hashlib.sha256(text.encode()).hexdigest()[:16]}.h5"
    write_sweep(workspace, part(workspace, parts_folder(workspace) / name), records)


def write_sweep(
    workspace: Workspace,
    target: Target,
    records: Sequence[RunRecord],
    statistics: Statistics | None = None,
) -> None:
    """Write runs of a sweep, over an earlier file."""
    model = sweep_model(workspace.case)
    over = Workspace(replace(workspace.context, force=True))
    with over.create(target) as artifact:
        name = FULL if model is None else model.name
        write_records(artifact, name, records, probe_places(workspace), statistics)
