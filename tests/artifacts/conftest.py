"""A small trajectory and records of random values, and ways to write and to refuse them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphrom.artifacts import Origin, create_artifact, open_artifact, probe, write_record
from sphrom.declaration import DECLARED, Field, Record, fields_of_record
from sphrom.errors import ArtifactError

PHYSICS = {
    "status": "complete",
    "reference_density": 1000.0,
    "sound_speed": 10.0,
    "kinematic_viscosity": 0.01,
    "particle_spacing": 0.1,
    "smoothing_length": 0.2,
    "time_step": 1e-3,
    "mass": 10.0,
    "box_length": (1.0, 1.0),
    "parameters/reynolds": 100.0,
}
ORIGIN = Origin("inputs", "name: demo\nfluid:\n  reynolds: 100\n", ("name", "fluid"))
MADE_BY = "sphrom fom CASE"
LENGTHS = {
    "component": 2, "snapshot": 4, "particle": 7, "viscosity_power": 3, "iteration": 1, "field": 2,
    "linear_monomial": 4, "monomial": 10, "cell_boundary": 4,
}  # fmt: skip
"""Of axes of invented records; all others have three entries."""
RANDOM = np.random.default_rng(5)

Fields = dict[str, np.ndarray]
Write = Callable[..., Path]


def snapshots(n: int, seed: int = 0) -> Fields:
    generator = np.random.default_rng(seed)
    return {
        "position": generator.random((3, n, 2)),
        "velocity": generator.random((3, n, 2)),
        "density_fluctuation": generator.random((3, n)),
        "pressure": generator.random((3, n)),
    }


@pytest.fixture
def fields() -> Fields:
    """Three snapshots of five particles."""
    return {"time": np.array([0.0, 0.5, 1.0]), "step": np.array([0, 500, 1000]), **snapshots(5)}


@pytest.fixture
def arguments() -> dict[str, object]:
    """The arguments with which `create_artifact` writes a trajectory."""
    return {"stage": "fom", "origin": ORIGIN, "attributes": PHYSICS}


@pytest.fixture
def write_trajectory(tmp_path: Path, fields: Fields, arguments: dict[str, object]) -> Write:
    """Write the trajectory to a file, with changed fields, arguments or lineage."""

    def write(
        path: Path | None = None,
        changed: Fields | None = None,
        lineage: Any = None,
        **other: object,
    ) -> Path:
        path = path or tmp_path / "fom.h5"
        other["origin"] = replace(ORIGIN, lineage=lineage or {})
        with create_artifact(path, "sphrom/trajectory", **(arguments | other)) as artifact:
            for name, array in (fields | (changed or {})).items():
                artifact.write(name, array)
        return path

    return write


@pytest.fixture
def write_large(write_trajectory) -> Callable[[], Path]:
    """Write a trajectory with data too large to be verified on opening."""
    large = snapshots(70_000, 1)
    return lambda: write_trajectory(changed=large)


@pytest.fixture
def refusal() -> Callable[..., str]:
    """Return why a file is refused, having checked the message and `probe` along the way."""

    def refused(path: Path, schema: str = "sphrom/trajectory", **changed: Any) -> str:
        origin = replace(ORIGIN, **changed)
        with (
            pytest.raises(ArtifactError) as caught,
            open_artifact(path, schema, made_by=MADE_BY, origin=origin),
        ):
            pass
        reason = probe(path, schema, origin)
        assert reason is not None
        assert str(caught.value).startswith(f"{path} {reason}; make it ")
        assert f"`{MADE_BY}" in str(caught.value)
        return reason

    return refused


@pytest.fixture
def invented() -> Callable[..., Record]:
    """Return a record of random values, without what is optional unless it is to be whole."""
    return _invented


def _invented(record: type[Record], *, whole: bool = True, **given: Any) -> Record:
    fields = fields_of_record(record).items()
    made = {name: _value(field) for name, field in fields if whole or field.required}
    return record(**(made | given))


def _value(field: Field) -> Any:
    if not field.is_mapping:
        return _one(field)
    if field.names:
        given = {name: d if isinstance(d, dict) else {} for name, d in field.names.items()}
        return {name: _one(replace(field, **declared)) for name, declared in given.items()}
    keys = ["/".join(f"{part}{i}" for i in range(field.name.count("*"))) for part in ("b", "c")]
    return {key: _one(field) for key in keys}


def _one(field: Field) -> Any:
    if field.record:
        return _invented(field.record)
    if field.allowed:
        return field.allowed[0]
    shape = [LENGTHS.get(axis, 3) for axis in field.axes]
    if field.kind == "tensors":
        n_first = len(shape) - len(field.names)
        return tuple(RANDOM.random(shape[: n_first + d + 1]) for d in range(len(field.names)))
    if field.axes == ("snapshot",) and field.symbol in ("t", "n"):  # they rise
        return np.arange(shape[0], dtype=field.kind)
    if field.kind == "int64":
        return RANDOM.integers(1, 4, shape)
    plain = {"float": 0.5, "floats": (1.0, 2.0), "int": 3, "text": "text"}
    return plain[field.kind] if field.kind in plain else RANDOM.random(shape)


@pytest.fixture
def written(tmp_path: Path) -> Callable[[Record], Path]:
    """Write a record as an artifact of its kind."""

    def write(record: Record) -> Path:
        path = tmp_path / "x.h5"
        path.unlink(missing_ok=True)
        kind = next(kind for kind, declared in DECLARED.items() if declared is type(record))
        with create_artifact(path, kind, stage="test", origin=ORIGIN) as artifact:
            write_record(artifact, record)
        return path

    return write
