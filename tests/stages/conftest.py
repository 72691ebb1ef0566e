"""Cases of scenes with walls, and trajectories of flows that were made up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.sph.packing import lattice
from sphrom.stages import assembly

Flow = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]
"""Velocity (N, 2) and pressure (N,) at positions (N, 2) and a time."""


class MadeUp:
    """A trajectory of particles that stay on a lattice, as stages read one."""

    def __init__(self, case: Case, flow: Flow, times: np.ndarray) -> None:
        position = lattice(assembly.domain(case), case.particle_spacing)
        fields = [flow(position, float(time)) for time in times]
        pressure = np.array([p for _, p in fields])
        self._data = {
            "time": times,
            "position": np.repeat(position[None], len(times), axis=0),
            "velocity": np.array([u for u, _ in fields]),
            "pressure": pressure,
            "density_fluctuation": pressure / case.sound_speed**2,
        }
        self._mass = case.fluid.reference_density * case.particle_spacing**2

    def dataset(self, name: str) -> np.ndarray:
        return self._data[name]

    def read(self, name: str) -> np.ndarray:
        return self._data[name]

    def number(self, name: str) -> float:
        assert name == "mass"
        return self._mass

    def text(self, name: str) -> str:
        assert name == "status"
        return "complete"


@pytest.fixture(scope="session")
def made_up() -> type[MadeUp]:
    """Make a trajectory of a case, a flow and times."""
    return MadeUp


@pytest.fixture(scope="session")
def case_of() -> Callable[..., Case]:
    """Make a case of a kind of scene; sections may be given."""

    def make(kind: str, resolution: int = 40, **sections: Any) -> Case:
        scene = {"kind": kind, **sections.pop("scene", {})}
        discretization = {"resolution": resolution, **sections.pop("discretization", {})}
        return Case.model_validate(
            {"name": "made-up", "scene": scene, "discretization": discretization, **sections}
        )

    return make
