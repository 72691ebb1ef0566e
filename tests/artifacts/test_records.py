"""Every kind of artifact is written from its declaration, read back, and known to xarray."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args, get_origin

import h5py
import numpy as np
import pytest
import xarray

from sphrom.artifacts import create_artifact, open_artifact
from sphrom.artifacts.declaration import DECLARED, Record, slots, stored_bytes
from sphrom.artifacts.labelled import open_labelled
from sphrom.artifacts.record_values import read_record, write_record
from sphrom.artifacts.records import SCHEMAS, Operators, Trajectory
from sphrom.artifacts.records.operators import Memory
from sphrom.artifacts.scales import Axes
from sphrom.errors import ArtifactError, CaseError

LENGTHS = {
    "component": 2, "snapshot": 4, "particle": 7, "viscosity_power": 3, "iteration": 1, "field": 2,
    "linear_monomial": 4, "monomial": 10, "cell_boundary": 4,
}  # fmt: skip
"""Of axes; all others have three entries."""
RANDOM = np.random.default_rng(5)


def invented(record: type[Record], *, whole: bool = True) -> Record:
    """Return a record of random values, without what is optional unless it is to be whole."""
    return record(**{s.name: value(s) for s in slots(record) if whole or not s.optional})


def value(slot: Any) -> Any:
    if not slot.is_mapping:
        return one(slot)
    if slot.told.names:
        return {name: one(slot) for name in slot.told.names}
    keys = ["/".join(f"{part}{i}" for i in range(slot.path.count("*"))) for part in ("b", "c")]
    return {key: one(slot) for key in keys}


def one(slot: Any) -> Any:
    if slot.record:
        return invented(slot.record)
    if slot.is_attribute:
        if get_args(slot.item):
            return (1.0, 2.0) if get_origin(slot.item) is tuple else get_args(slot.item)[0]
        return {float: 0.5, int: 3, str: "text"}[slot.item]
    shape = [LENGTHS.get(axis, 3) for axis in slot.told.axes]
    if slot.is_tensors:
        n_first = len(shape) - len(slot.told.names)
        return tuple(RANDOM.random(shape[: n_first + d + 1]) for d in range(len(slot.told.names)))
    if slot.told.symbol in ("t", "n"):
        return np.arange(shape[0]).astype(float if slot.told.symbol == "t" else int)
    if "int64" in str(slot.item):
        return RANDOM.integers(1, 4, shape)
    return RANDOM.random(shape)


def same(a: Any, b: Any) -> bool:
    if isinstance(a, Record):
        return type(a) is type(b) and all(
            same(getattr(a, s.name), getattr(b, s.name)) for s in slots(type(a))
        )
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(np.array_equal(a, b))


def written(path: Path, kind: str, record: Record) -> Path:
    with create_artifact(
        path, kind, stage="test", case_text="name: x\n", case_digest="a", inputs_digest="b"
    ) as artifact:
        write_record(artifact, record)
    return path


@pytest.mark.parametrize("whole", [True, False], ids=["whole", "least"])
@pytest.mark.parametrize("kind", DECLARED)
def test_record_comes_back_as_it_was(kind: str, whole: bool, tmp_path: Path) -> None:
    record = invented(DECLARED[kind], whole=whole)
    with open_artifact(written(tmp_path / "x.h5", kind, record), kind, made_by="") as artifact:
        artifact.verify_content()
        assert same(read_record(artifact, DECLARED[kind]), record)


def test_record_of_one_group_is_read_alone(tmp_path: Path) -> None:
    record = invented(Operators)
    path = written(tmp_path / "x.h5", "sphrom/operators", record)
    with open_artifact(path, "sphrom/operators", made_by="") as artifact:
        found = read_record(artifact, Memory, "bases/c0/memory/b0")
    assert same(found, record.bases["c0"].memory["b0"])


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "x.h5", "sphrom/operators", invented(Operators))
    with (
        open_artifact(path, "sphrom/operators", made_by="sphrom operators CASE") as artifact,
        pytest.raises(ArtifactError, match=r"no bases/d/memory/b/constant.* --force"),
    ):
        read_record(artifact, Memory, "bases/d/memory/b")


def test_size_of_what_has_given_lengths() -> None:
    lengths = {"snapshot": 4, "particle": 7, "component": 2, "ghost": 5}
    snapshots = 4 * (1 + 1 + 1 + 6 * 7)  # time, step, the mean carried apart, and six arrays
    assert stored_bytes(Trajectory, **lengths) == 8 * (snapshots + 2 * 2 * 5)


@pytest.mark.parametrize("whole", [True, False], ids=["whole", "least"])
@pytest.mark.parametrize("kind", DECLARED)
def test_xarray_knows_every_axis_by_its_name(kind: str, whole: bool, tmp_path: Path) -> None:
    path = written(tmp_path / "x.h5", kind, invented(DECLARED[kind], whole=whole))
    with open_artifact(path, kind, made_by="") as artifact:
        datasets = artifact.datasets
    for group in {name.rpartition("/")[0] for name in datasets}:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            opened = xarray.open_dataset(path, engine="h5netcdf", group=group or None)
        with opened:
            for name, variable in opened.variables.items():
                declared = variable.attrs.get("axes", "").split(",")
                named = [axis.rpartition("_")[0] or axis for axis in variable.dims]
                assert variable.ndim == 0 or len(declared) == len(variable.dims), name
                for axis, dim, short in zip(declared, variable.dims, named, strict=False):
                    assert axis in (dim, short), name
            assert all(name in datasets or name == "case" for name in opened.variables) or group


@pytest.mark.parametrize("kind", SCHEMAS)
def test_no_axis_has_the_name_of_something_else(kind: str) -> None:
    schema = SCHEMAS[kind]
    axes = Axes(schema)
    named = {
        path
        for field in schema.datasets
        for path in axes.paths(field.name.replace("*", "x"), field, (3,) * len(field.axes))
    }
    taken = {field.name for field in (*schema.datasets, *schema.attributes)}
    taken |= {name.rpartition("/")[0] for name in taken}
    assert not named & {name.replace("*", "x") for name in taken}


def test_run_that_became_unstable_has_the_axis_that_it_reached(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    whole = invented(Trajectory)
    with create_artifact(
        path, "sphrom/trajectory", stage="t", case_text="", case_digest="", inputs_digest=""
    ) as artifact:
        for slot in slots(Trajectory):
            value = getattr(whole, slot.name)
            if slot.is_attribute and not slot.is_mapping and slot.name != "status":
                artifact.annotate(slot.path, value)
            elif slot.told.axes[:1] == ("snapshot",):
                artifact.stream(slot.path, value.shape[1:], 4).extend(value[:2])
        artifact.annotate("status", "unstable")
    with xarray.open_dataset(path, engine="h5netcdf") as opened:
        assert opened.sizes["snapshot"] == 2
        assert h5py.h5ds.is_scale(h5py.File(path)["snapshot"].id)


def test_labelled_run_is_selected_by_time_and_read_when_needed(tmp_path: Path) -> None:
    record = invented(Trajectory)
    path = written(tmp_path / "x.h5", "sphrom/trajectory", record)
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


def test_labelled_groups_are_opened_one_at_a_time(tmp_path: Path) -> None:
    kind = "sphrom/basis"
    record = invented(DECLARED[kind])
    path = written(tmp_path / "x.h5", kind, record)
    with open_labelled(path) as shared, open_labelled(path, "bases/c0") as basis:
        assert shared.attrs["groups"] == ["bases/b0", "bases/c0", "lagrangian/b0", "lagrangian/c0"]
        assert "modes_velocity" not in shared
        assert basis.modes_velocity.dims == ("mode", "particle", "component")
        assert basis.volume.dims == ("particle",)
        assert basis.attrs["gram_error"] == 0.5
        np.testing.assert_array_equal(basis.modes_density, record.bases["c0"].modes.density)
    with pytest.raises(CaseError, match=r"no group bases/d; there are: bases/b0, "):
        open_labelled(path, "bases/d")


def test_labelled_tensors_have_an_axis_each(tmp_path: Path) -> None:
    path = written(tmp_path / "x.h5", "sphrom/operators", invented(Operators))
    with open_labelled(path, "bases/b0") as operators:
        assert operators.inertia_quadratic.dims == ("mode", "mode_2", "mode_3")


def test_labelled_values_that_changed_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "x.h5", "sphrom/trajectory", invented(Trajectory))
    with h5py.File(path, "r+") as file:
        file["velocity"][1, 2, 0] += 1.0
    with pytest.raises(ArtifactError, match="velocity is not what was written"):
        open_labelled(path)


def test_older_files_without_scales_are_read(tmp_path: Path) -> None:
    path = written(tmp_path / "x.h5", "sphrom/trajectory", invented(Trajectory))
    with h5py.File(path, "r+") as file:
        for name in ("velocity", "position", "pressure", "density_fluctuation"):
            del file[name].attrs["DIMENSION_LIST"]
        for name in ("snapshot", "particle", "component", "ghost/ghost"):
            del file[name]
        file.attrs["schema_version"] = np.bytes_("1.0")
    with open_artifact(path, "sphrom/trajectory", made_by="") as artifact:
        artifact.verify_content()
    with open_labelled(path) as run:
        assert run.velocity.dims == ("snapshot", "particle", "component")
