"""The functional with walls against the printed equations, summed over all pairs and ghosts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

NAMES = ["box", "lid", "forced box", "cavity", "forced cavity"]
AS_PRINTED = {
    "wall_kind": "printed",
    "viscosity": "pair",
    "shifting_as_printed": True,
    "shifting_transport": "paper",
}


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    assert actual.shape == expected.shape
    assert np.max(np.abs(actual - expected)) <= 1e-11 * np.max(np.abs(expected))


OPTIONS = {
    "default": {"acoustic_damping": 1.0, "fixed_volume": True},
    "normal": {"wall_kind": "normal", "shifting_transport": "paper", "acoustic_damping": 0.7},
    "printed-normal": {"wall_kind": "printed-normal"},
    "adami-as-fluid": {"wall_kind": "adami-as-fluid", "acoustic_damping": 0.7},
    "adami": {"wall_kind": "adami", "acoustic_damping": 1.0},
    "adami, pair": {"wall_kind": "adami", "shifting_transport": "paper", "viscosity": "pair"},
    "printed shifting": {"shifting_transport": "paper"},
    "as printed": AS_PRINTED,
    "neither": {"shifting": False, "diffusion_coefficient": 0.0, "viscosity": "pair"},
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("options", OPTIONS)
def test_equals_the_printed_sums(
    scenes: dict, wall_sums: Callable, name: str, options: str
) -> None:
    scene = scenes[name]
    wall_sums(scene.functional(**OPTIONS[options]), scene.state(seed=1)).check()


@pytest.mark.parametrize(
    "options",
    [{"acoustic_damping": 1.0}, {"wall_kind": "adami-as-fluid"}, {"viscosity": "pair"}],
    ids=str,
)
def test_walls_of_any_shape(scenes: dict, wall_sums: Callable, options: dict) -> None:
    scene = scenes["shapes"]
    functional, state = scene.functional(shifting=False, **options), scene.state(seed=1)
    assert functional.ghosts.walls.velocity.any()
    # Outlines are snapped to 1e-10 of the box, those of the sums are not.
    wall_sums(functional, state).check(tolerance=2e-9)


@pytest.mark.parametrize("name", ["lid", "forced cavity"])
@pytest.mark.parametrize("ratio", [1.5, 4.0])
@pytest.mark.parametrize("kind", ["adjoint", "adami-as-fluid"])
def test_any_support(scenes: dict, wall_sums: Callable, name: str, ratio: float, kind: str) -> None:
    """At h = 4 dx the kernel reaches right through the solid beside the cavity."""
    scene = scenes[name]
    functional = scene.functional(ratio, wall_kind=kind)
    wall_sums(functional, scene.state(seed=2)).check()


@pytest.mark.parametrize("kind", ["adjoint", "normal"])
def test_any_number_of_layers(scenes: dict, wall_sums: Callable, kind: str) -> None:
    """Fewer layers than the kernel reaches are fewer ghosts, nothing else; more change nothing."""
    scene = scenes["lid"]
    state = scene.state(seed=3)
    few, enough, more = (scene.functional(layers=layers, wall_kind=kind) for layers in (2, 4, 6))
    wall_sums(few, state).check()
    assert_close(more(state), enough(state))
    assert np.max(np.abs(few(state) - enough(state))) > 1e-3 * np.max(np.abs(enough(state)))


@pytest.mark.parametrize("kind", ["adjoint", "adami-as-fluid"])
def test_fluid_that_has_crossed_the_seam_still_feels_the_walls(
    scenes: dict, wall_sums: Callable, kind: str
) -> None:
    """Along the periodic axis particles leave the box between two builds of the list."""
    scene = scenes["forced cavity"]
    functional = scene.functional(wall_kind=kind)
    spacing = functional.discretization.particle_spacing
    (low, _), (high, _) = scene.domain.lower, scene.domain.upper
    state = scene.state(seed=4)
    x = state[0]
    x[x < low + spacing] = low + 0.1 * spacing
    x[x > high - spacing] = high - 0.1 * spacing
    functional(state)
    sources = functional.neighbourhood.sources
    for step in (0.29, -0.29):
        moved = state.copy()
        moved[0, (x < low + spacing) | (x > high - spacing)] += step * spacing
        assert np.count_nonzero((moved[0] < low) | (moved[0] > high)) == 6
        wall_sums(functional, moved).check()
        assert functional.neighbourhood.sources is sources


def test_whole_turns_along_the_periodic_axis_change_nothing(scenes: dict) -> None:
    state = scenes["cavity"].state(seed=5)
    turned = state.copy()
    turned[0] += np.random.default_rng(6).integers(-3, 4, state.shape[1]) * 1.0
    functional = scenes["cavity"].functional(shifting_transport="advective")
    expected = functional(state)
    assert_close(functional(turned), expected)


@pytest.mark.parametrize("name", ["lid", "cavity"])
@pytest.mark.parametrize("kind", ["adjoint", "adami", "printed"])
def test_advection_equals_the_printed_sums(
    scenes: dict, wall_sums: Callable, name: str, kind: str
) -> None:
    scene = scenes[name]
    functional, state = scene.functional(wall_kind=kind), scene.state(seed=7)
    density, velocity = wall_sums(functional, state).advection()
    carried = functional.advection(state[:2], state[2], state[3:])
    assert_close(carried[0], density)
    assert_close(carried[1:].T, velocity)


def test_ghosts_that_see_no_fluid_do_nothing(scenes: dict, wall_sums: Callable) -> None:
    """Where fluid is missing its ghosts have no weights: no 0/0, and nothing felt."""
    scene = scenes["lid"]
    state = scene.state(seed=8)
    state = np.ascontiguousarray(state[:, state[1] < 0.6])
    for options in ({}, {"wall_kind": "normal"}):
        functional = scene.functional(**options)
        assert np.isfinite(functional(state)).all()
        wall_sums(functional, state).check()


@pytest.mark.parametrize("name", ["lid", "forced cavity"])
def test_the_viscosity_alone(scenes: dict, wall_sums: Callable, name: str) -> None:
    """Large enough to be most of the acceleration, in both of its forms."""
    scene = scenes[name]
    for viscosity in ("laplacian", "pair"):
        functional = scene.functional(viscosity=viscosity)
        fluid = replace(functional.fluid, kinematic_viscosity=10.0)
        functional = scene.functional(fluid=fluid, viscosity=viscosity)
        wall_sums(functional, scene.state(seed=9)).check()
