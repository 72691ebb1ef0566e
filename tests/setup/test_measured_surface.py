"""What is measured in a scene with a free surface: its height, dry places, the whole fluid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.metrics.measures import Quantities
from sphrom.metrics.quantities import MEASURABLE, Column
from sphrom.setup.particles import MeasuredParticles, functional, wall_forces
from sphrom.sph.fluid import fluctuation_of

Array = NDArray[np.float64]
GRAVITY, LEVEL, SPACING = 2.0, 0.5, 1.0 / 32


def tank(measure: dict[str, Any], **scene: Any) -> Case:
    own = {"kind": "custom", "fluid": {"level": LEVEL, "gravity": GRAVITY}, "slip": "free"}
    return load_case(
        {
            "name": "x",
            "scene": {**own, "measure": measure, **scene},
            "fluid": {"reference_density": 3.0, "reference_speed": 1.0},
            "discretization": {"resolution": 32, "smoothing_length_ratio": 2.0},
            "rom": [],
        }
    )


def at_rest(case: Case) -> tuple[Array, Array, Array]:
    """Return position, density fluctuation and velocity of the case's start."""
    flow, position = case.plan.flow(case.plan.points[0]), case.scene.fill(SPACING)
    density = fluctuation_of(flow.initial_pressure(position), case.plan.sound_speed)
    return position, density, np.zeros_like(position)


def measured(case: Case, *particles: Array) -> dict[str, Quantities]:
    found = MeasuredParticles.of(case, case.plan.points[0])
    assert found is not None
    return found(*particles)


def test_quantities_have_units_and_columns() -> None:
    case = tank({"gauge": {"elevation": 0.2}, "a": {"of_fluid": "energy"},
                 "b": {"of_fluid": "centre_of_mass"}})  # fmt: skip
    expected = {
        "gauge_elevation": "m", "a_kinetic_energy": "J/m", "a_potential_energy": "J/m",
        "b_centre_of_mass_x": "m", "b_centre_of_mass_y": "m",
    }  # fmt: skip
    assert {name: column.units for name, column in case.scene.columns.items()} == expected
    shapes = {
        q: v.shape for each in measured(case, *at_rest(case)).values() for q, v in each.items()
    }
    assert shapes.keys() <= MEASURABLE.keys()
    assert {q for q, shape in shapes.items() if shape == (2,)} == {"centre_of_mass"}
    assert Column.named("b", ["centre_of_mass"])["b_centre_of_mass_y"].component == 1


@pytest.mark.parametrize("hill", [False, True])
def test_a_tank_at_rest(hill: bool) -> None:
    solids = {"hill": {"rectangle": {"lower": [0.5, 0], "upper": [0.625, 0.25]}}} if hill else {}
    places = {"wall": [0.0, 0.2], "corner": [1.0, 0.0], "beside": [0.5, 0.1], "below": [0.2, 0.49],
              "above": [0.2, 0.51], "dry": [0.0, 0.6], "lid": [0.3, 1.0]}  # fmt: skip
    gauges = {"left": 0.0, "over": 0.55, "edge": 0.5}
    case = tank(
        {name: {"probe": at} for name, at in places.items()}
        | {name: {"elevation": x} for name, x in gauges.items()}
        | {"energy": {"of_fluid": "energy"}},
        solids=solids,
    )
    found = measured(case, *at_rest(case))
    for name, (_, y) in places.items():
        expected = 3.0 * GRAVITY * max(LEVEL - y, 0.0)
        np.testing.assert_allclose(found[name]["pressure"], expected, atol=1e-9, err_msg=name)
    for name in gauges:
        assert found[name]["elevation"] == pytest.approx(LEVEL, abs=1e-3)
    energies = found["energy"]
    assert energies["kinetic_energy"] == 0.0
    assert energies["potential_energy"] == pytest.approx(0.0, abs=1e-12)


def test_the_whole_fluid_of_some_particles_by_hand() -> None:
    case = tank({"e": {"of_fluid": "energy"}, "c": {"of_fluid": "centre_of_mass"}})
    position, density, velocity = at_rest(case)
    moved = position + np.array([0.1, 0.02])
    found, mass = measured(case, moved, density, velocity + np.array([3.0, 4.0])), 3.0 * LEVEL
    np.testing.assert_allclose(found["c"]["centre_of_mass"], (0.6, 0.27))
    assert found["e"]["kinetic_energy"] == pytest.approx(12.5 * mass)
    assert found["e"]["potential_energy"] == pytest.approx(mass * GRAVITY * 0.02)
    shape = {"rectangle": {"lower": [0.25, 0.5], "upper": [0.75, 0.75]}, "gravity": GRAVITY}
    case = tank({"e": {"of_fluid": "energy"}}, fluid=shape, box={"lower": [0, 0.125]})
    found = measured(case, *at_rest(case))
    assert found["e"]["potential_energy"] == pytest.approx(3.0 * 0.125 * GRAVITY * 0.5)


def test_elevation_is_that_of_the_fluid_on_the_floor() -> None:
    gauges = {f"at{i}": x for i, x in enumerate([0.0, 0.13, 0.5, 0.77, 1.0])}
    case = tank({name: {"elevation": x} for name, x in gauges.items()}
                | {"high": {"probe": [0.77, 0.8]}, "drop": {"probe": [0.13, 0.8]}})  # fmt: skip
    lattice = case.scene.domain.fill(SPACING)
    fluid = lattice[lattice[:, 1] < LEVEL]
    stretched = 1.0 + 0.2 * np.cos(math.pi * fluid[:, 0])
    fluid[:, 1] *= stretched
    drop = lattice[np.hypot(*(lattice - np.array([0.13, 0.8])).T) < 0.1]
    both = np.concatenate((fluid, drop))
    still = np.append(3.0 / stretched - 3.0, np.zeros(len(drop))), np.ones_like(both)
    found = measured(case, both, *still)
    for name, x in gauges.items():
        expected = LEVEL * (1.0 + 0.2 * math.cos(math.pi * x))
        assert found[name]["elevation"] == pytest.approx(expected, abs=0.1 * SPACING)
    np.testing.assert_allclose(found["drop"]["velocity"], [[1.0, 1.0]])
    assert not found["high"]["velocity"].any()
    left = both[:, 0] < 0.3
    found = measured(case, both[left], *(each[left] for each in still))
    assert [float(found[name]["elevation"]) for name in ("at2", "at4")] == [0.0, 0.0]


def test_fields_between_the_surface_and_a_wall_stay_within_those_of_particles() -> None:
    """Polynomials overshoot in a crest at a wall: by 16 times here."""
    case = tank({f"at{i}": {"probe": [0.0, LEVEL - i * SPACING / 4]} for i in range(8)})
    crest = case.scene.domain.fill(SPACING)
    crest = crest[crest[:, 1] < LEVEL - 1.5 * crest[:, 0]]
    random = np.random.default_rng(2)
    velocity, density = random.uniform(-1.0, 1.0, crest.shape), random.uniform(0, 1e-2, len(crest))
    found = measured(
        case, crest + random.uniform(-0.2, 0.2, crest.shape) * SPACING, density, velocity
    )
    pressure = np.array([each["pressure"] for each in found.values()]) / case.plan.sound_speed**2
    assert np.abs([each["velocity"] for each in found.values()]).max() <= 1.0
    assert 0.0 <= pressure.min() < pressure.max() <= 1e-2


def test_forces_on_the_walls_of_a_tank_at_rest() -> None:
    case = tank({name: {"force_on": name} for name in ("left", "bottom", "top")})
    point, (position, density, velocity) = case.plan.points[0], at_rest(case)
    forces = wall_forces(case, point, functional(case, point))
    assert forces is not None
    found = forces(np.vstack((position.T, density, velocity.T)), 0.0)
    loads = {name: each.sum(axis=0) for name, each in found.items()}
    push = 3.0 * GRAVITY * LEVEL**2 / 2  # at a third of the depth; torques about the box's centre
    # Of the lattice that a run starts with, 16 rows deep: 0.986, 0.91 and 0.95 of the exact ones.
    np.testing.assert_allclose(loads["left"][[0, 2]], [-push, -push / 3], rtol=0.1)
    assert loads["left"][0] == pytest.approx(-push, rel=0.02)
    np.testing.assert_allclose(loads["bottom"], [0.0, -3.0 * GRAVITY * LEVEL, 0.0], atol=0.18)
    assert not loads["top"].any()
