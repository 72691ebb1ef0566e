"""Every kind of artifact is written from its declaration, read back, and known to xarray."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphrom.artifacts import open_artifact, read_record
from sphrom.artifacts.labelled import open_labelled
from sphrom.artifacts.records.reduced_models import Operators
from sphrom.artifacts.records.runs import Trajectory
from sphrom.declaration import DECLARED, Record, fields_of_record
from sphrom.errors import ArtifactError, CaseError
from sphrom.reduction.reduced_operators import MemoryOperators


def same(a: Any, b: Any) -> bool:
    if isinstance(a, Record):
        return type(a) is type(b) and all(
            same(getattr(a, name), getattr(b, name)) for name in fields_of_record(type(a))
        )
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(np.array_equal(a, b))


@pytest.mark.parametrize("whole", [True, False], ids=["whole", "least"])
@pytest.mark.parametrize("kind", DECLARED)
def test_record_comes_back_as_it_was(kind: str, whole: bool, written, invented) -> None:
    record = invented(DECLARED[kind], whole=whole)
    with open_artifact(written(record), kind, made_by="") as artifact:
        artifact.verify_content()
        assert same(read_record(artifact, DECLARED[kind]), record)


def test_record_of_one_group_is_read_alone(written, invented) -> None:
    record = invented(Operators)
    path = written(record)
    with open_artifact(path, "sphrom/operators", made_by="") as artifact:
        found = read_record(artifact, MemoryOperators, "bases/c0/memory/b0")
    assert same(found, record.bases["c0"].memory["b0"])


def test_what_is_not_there_is_named(written, invented) -> None:
    path = written(invented(Operators))
    with (
        open_artifact(path, "sphrom/operators", made_by="sphrom operators CASE") as artifact,
        pytest.raises(ArtifactError, match=r"no bases/d/memory/b/constant.* --force"),
    ):
        read_record(artifact, MemoryOperators, "bases/d/memory/b")


def test_labelled_run_is_selected_by_time_and_read_when_needed(
    tmp_path: Path, written, invented
) -> None:
    record = invented(Trajectory)
    path = written(record)
    with open_labelled(path) as run:
        assert run.velocity.dims == ("snapshot", "particle", "component")
        assert run.velocity.attrs["units"] == "m/s"
        assert run.velocity.attrs["long_name"] == "velocity"
        assert run.ghost_position.dims == ("ghost", "component")
        assert run.attrs["sound_speed"] == record.sound_speed
        assert not run.velocity.variable._in_memory
        at_two = run.velocity.sel(time=2.2, method="nearest")
        np.testing.assert_array_equal(at_two, record.velocity[2])
        backwards = run.pressure[::-2, [3, 1]]
        np.testing.assert_array_equal(backwards, record.pressure[::-2, [3, 1]])
        run.isel(snapshot=[0, 2]).to_netcdf(tmp_path / "y.nc", engine="h5netcdf")


def test_labelled_groups_are_opened_one_at_a_time(written, invented) -> None:
    kind = "sphrom/basis"
    record = invented(DECLARED[kind])
    path = written(record)
    with open_labelled(path) as shared, open_labelled(path, "bases/c0") as basis:
        assert shared.attrs["groups"] == ["bases/b0", "bases/c0", "lagrangian/b0", "lagrangian/c0"]
        assert "modes_velocity" not in shared
        assert basis.modes_velocity.dims == ("mode", "particle", "component")
        assert basis.volume.dims == ("particle",)
        assert basis.attrs["gram_error"] == 0.5
        np.testing.assert_array_equal(basis.modes_density, record.bases["c0"].density_modes)
    with pytest.raises(CaseError, match=r"no group bases/d; there are: bases/b0, "):
        open_labelled(path, "bases/d")
