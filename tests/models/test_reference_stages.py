"""Map, basis and splines of scenes with walls: what is stored of walls and mean density."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.console import Reporter
from sphrom.errors import ArtifactError
from sphrom.models import fom, stages
from sphrom.models.reference.stored import read_basis, read_splines
from sphrom.reduction.mode_splines import basis_columns
from sphrom.reduction.trial_basis import mean_density_fluctuation, project, weighted_mean
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace

SECTIONS = {
    "time": {"spin_up": 0.0, "final_time": 0.004},
    "snapshots": {"every": 1},
    "rom": [{"name": "galerkin", "n_modes": 2}],
    "basis": {"lagrangian": True},
}


Made = tuple[Workspace, list[str]]


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory, case_of: Callable[..., Case]) -> Callable:
    """Take a small case of a scene through the stages up to the splines."""

    def run(kind: str, resolution: int, **sections: object) -> Made:
        notes: list[str] = []
        case = case_of(kind, resolution, **{**SECTIONS, **sections})
        folder = tmp_path_factory.mktemp(kind)
        context = StageContext(case, folder, False, 1, Reporter(write=notes.append))
        for stage in (fom.run, stages.map_runs, stages.make_basis, stages.fit_splines):
            stage(context)
        return Workspace(context), notes

    return run


@pytest.fixture(scope="module")
def closed(make: Callable) -> Made:
    return make("lid-driven-cavity", 16, time={"final_time": 0.2})


@pytest.fixture(scope="module")
def channel(make: Callable) -> Made:
    return make("open-cavity", 40)


def test_the_map_reports_a_round_trip(closed: Made) -> None:
    workspace, notes = closed
    with workspace.open(workspace.mapped(workspace.case.plan.points[0])) as mapped:
        for field in ("velocity", "pressure"):
            assert 0.0 < mapped.number(f"round_trip_error/{field}") < 100.0
    assert any("mapped there and back, loses" in line for line in notes)


class Unstable:
    """A full run that ended early."""

    path = "fom.h5"
    text = {"status": "unstable", "status_detail": "at t = 1 s"}.__getitem__


@pytest.mark.parametrize("points", ["lattice", "relaxed"])
def test_an_unstable_run_is_not_mapped(closed: Made, monkeypatch, case_of, points: str) -> None:
    workspace, _ = closed
    case = case_of("lid-driven-cavity", 16, **SECTIONS, reference={"points": points})
    monkeypatch.setattr(Workspace, "open", lambda *_: nullcontext(Unstable()))
    monkeypatch.setattr(Workspace, "must_make", lambda *_: True)
    monkeypatch.setattr(Workspace, "require", lambda *_: None)
    with pytest.raises(ArtifactError, match=r"became unstable \(at t = 1 s\)"):
        stages.map_runs(replace(workspace.context, case=case))


def test_reference_points_lie_in_the_fluid(channel: Made) -> None:
    workspace, _ = channel
    with workspace.open(workspace.basis()) as artifact:
        points, volume = artifact.read("reference_position"), artifact.read("volume")
    domain = workspace.case.scene.domain
    assert domain.contains(points).all()
    assert volume.sum() == pytest.approx(domain.area)


def test_a_closed_box_has_its_mean_density_apart(closed: Made) -> None:
    workspace, _ = closed
    assert workspace.case.plan.separate_mean_density
    basis = read_basis(workspace, "all")
    assert basis.separate_mean
    with (
        workspace.open(workspace.mapped(workspace.case.plan.points[0])) as mapped,
        workspace.open(workspace.basis()) as artifact,
    ):
        density, velocity = mapped.read("density_fluctuation"), mapped.read("velocity")
        stored = artifact.read("mean_density_fluctuation/reynolds100")
        lagrangian = artifact.read("lagrangian/all/modes/density")
    assert np.abs(stored).max() > 0.0
    # Volumes that keep filling the box leave next to no mean: it is held against the fluctuations.
    rounding = 1e-14 * float(np.abs(density).max())
    np.testing.assert_allclose(stored, density.mean(axis=1), rtol=1e-9, atol=rounding)
    np.testing.assert_allclose(
        mean_density_fluctuation(basis, density), stored, rtol=1e-12, atol=rounding
    )
    for modes in (basis.density_modes, lagrangian):
        assert np.abs(weighted_mean(modes, basis.weights)).max() < 1e-12 * np.abs(modes).max()
    np.testing.assert_allclose(
        project(basis, density + 1e-3, velocity), project(basis, density, velocity), atol=1e-12
    )


def test_an_open_channel_keeps_a_mean_density_that_may_change(make: Callable) -> None:
    workspace, _ = make(
        "open-cavity",
        40,
        discretization={"fixed_volume": False},
    )
    assert not read_basis(workspace, "all").separate_mean
    with workspace.open(workspace.basis()) as artifact:
        assert "mean_density_fluctuation/reynolds2400" not in artifact


def test_splines_come_back_with_the_cells_in_the_solid(channel: Made) -> None:
    workspace, notes = channel
    splines = read_splines(workspace, "all")
    empty = np.diff(splines.cell_start) == 0
    assert empty.any()
    assert any(f"{empty.sum()} more in solids" in line for line in notes)
    basis = read_basis(workspace, "all")
    with workspace.open(workspace.basis()) as artifact:
        points = artifact.read("reference_position")
    columns = basis_columns(basis)
    np.testing.assert_allclose(
        splines.values(points), columns, atol=1e-9 * float(np.abs(columns).max())
    )
