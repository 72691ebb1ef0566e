"""Boxes whose sides are no multiples of one spacing: lattices, masses, pressures and waves."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.optimize import curve_fit

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.errors import CaseError
from sphrom.sph.box_domain import BoxDomain

DEPTH, WAVE = 0.2, 0.005
FRONT = {"rectangle": {"lower": [0.4, 0.0], "upper": [0.7, 0.08]}}


def tank(width: float, height: float, rows: int, **scene: Any) -> dict[str, Any]:
    """Return a case of a tank with a standing wave, that passes the level at the start."""
    k = math.pi / width
    omega = math.sqrt(k * math.tanh(k * DEPTH))
    speed = WAVE * omega / math.sinh(k * DEPTH)
    return {
        "name": "tank",
        "scene": {
            "kind": "custom",
            "box": {"upper": [width, height]},
            "fluid": {"level": DEPTH, "gravity": 1.0},
            "slip": "free",
            "initial": {
                "u": f"{speed!r}*cosh({k!r}*y)*sin({k!r}*x)",
                "v": f"-{speed!r}*sinh({k!r}*y)*cos({k!r}*x)",
            },
            "measure": {
                "gauge": {"elevation": 0.05},
                "middle": {"elevation": width / 2},
                "below": {"probe": [width / 2, 0.05]},
            },
            "reference_length": 2.0 * DEPTH,
            **scene,
        },
        "fluid": {"reference_density": 1.0, "reference_speed": 0.45},
        "discretization": {"resolution": rows},
        "time": {"final_time": 7.0},
        "snapshots": {"every": 5},
        "parameters": {"train": {"reynolds": [500]}},
        "rom": [],
    }


def wave(time: np.ndarray, omega: float, a: float, b: float, damping: float, level: float):
    """Return the height of a damped standing wave."""
    return level + np.exp(-damping * time) * (a * np.sin(omega * time) + b * np.cos(omega * time))


def load(folder: Path, case: dict[str, Any]):
    path = folder / f"{case['name']}.yaml"
    path.write_text(yaml.safe_dump(case))
    return load_case(path)


@pytest.fixture
def measured(tmp_path: Path, sphrom):
    """Return frequency over that of linear theory, mean level and pressure, and the mass."""

    def figures(width: float, height: float) -> np.ndarray:
        load(tmp_path, tank(width, height, 10))
        out = tmp_path / f"{width}"
        sphrom("fom", tmp_path / "tank.yaml", "--out", out, "--threads", 1, code=0)
        with open_artifact(out / "fom-reynolds500.h5", "sphrom/trajectory", made_by="fom") as run:
            time, gauge = run.read("time"), run.read("measure/gauge/elevation")
            middle, pressure = (
                run.read("measure/middle/elevation"),
                run.read("measure/below/pressure"),
            )
            mass = run.number("mass") * run.read("position").shape[1]
        k = math.pi / width
        linear = math.sqrt(k * math.tanh(k * DEPTH))
        begin = np.array([linear, WAVE, 0.0, 0.0, DEPTH])
        (omega, *_), _ = curve_fit(wave, time, gauge, begin)
        half = len(time) // 2
        return np.array(
            [omega / linear, middle[half:].mean(), pressure[half:].mean(), mass / width]
        )

    return figures


@pytest.mark.slow
def test_a_tank_is_as_accurate_as_one_that_fits(measured) -> None:
    """1.237 x 0.413 m beside 1.24 x 0.4 m; of the second, mass over width is exactly the depth."""
    fits, found = measured(1.24, 0.4), measured(1.237, 0.413)
    np.testing.assert_allclose(found, fits, rtol=1e-3)
    assert found[3] == pytest.approx(DEPTH, rel=1e-12)
    # At 5 rows, 0.9678 and 0.9670 of linear theory; at 10 rows and over 20 s, 0.99738 and 0.99737.
    assert found[0] == pytest.approx(1.0, abs=0.05)
    assert found[2] == pytest.approx(0.15, rel=0.05)


def test_the_fluid_of_a_tank_with_a_solid_ends_at_any_level(tmp_path) -> None:
    """By the number of particles to within half of one, and with rows that end at the level."""
    case = load(tmp_path, tank(1.237, 0.413, 40, solids={"front": FRONT}, initial={}, measure={}))
    points, spacing = case.scene.fill(case.plan.particle_spacing), case.plan.particle_spacing
    assert abs(len(points) - (1.237 * DEPTH - 0.3 * 0.08) / spacing**2) <= 0.5
    assert points[:, 1].max() == pytest.approx(DEPTH - 0.5 * spacing, abs=0.3 * spacing)
    high = {"high": {"rectangle": {"lower": [0.4, 0.3], "upper": [0.8, 0.413]}}}
    case = load(tmp_path, tank(1.237, 0.413, 43, solids=high, initial={}, measure={}))
    assert len(case.scene.fill(spacing)) == round(1.237 * DEPTH / spacing**2)


@pytest.mark.parametrize("periodic", [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize(("sides", "number"), [((1.237, 0.413), 60), ((3.713, 0.29), 499)])
def test_a_lattice_fills_a_box_exactly(periodic, sides, number) -> None:
    upper = (0.1 + sides[0], sides[1] - 0.2)
    domain = BoxDomain((0.1, -0.2), upper, periodic)
    assert domain.fits_lattice(sides[0] / number)
    spacing = domain.lattice_spacing(sides[0] / number)
    points, pitches = domain.fill(spacing), np.array(domain.pitches(spacing))
    assert len(points) * spacing**2 == pytest.approx(math.prod(sides), rel=1e-12)
    np.testing.assert_allclose(points.min(axis=0), domain.lower + 0.5 * pitches, rtol=1e-9)
    np.testing.assert_allclose(points.max(axis=0), upper - 0.5 * pitches, rtol=1e-9)
    ghosts = domain.ghosts(spacing, 3).position
    assert domain.n_ghosts(spacing, 3) == len(ghosts)
    if not periodic[1]:
        above = ghosts[(ghosts[:, 1] > upper[1]) & (np.abs(ghosts[:, 0] - points[0, 0]) < 1e-9)]
        layers = upper[1] + (np.arange(3) + 0.5) * pitches[1]
        np.testing.assert_allclose(np.sort(above[:, 1]), layers, rtol=1e-9)


def test_more_than_half_a_percent_is_refused_with_a_resolution_that_fits(tmp_path) -> None:
    with pytest.raises(CaseError, match=r"to 0\.5 %; \d+ and 21 do") as refused:
        load(tmp_path, {**tank(1.237, 0.413, 20, fluid=None, reference_length=None, measure={})})
    assert "a spacing of 0.06185 m doesn't divide all lengths of the scene" in str(refused.value)
    ok = tank(1.237, 0.413, 21, fluid=None, reference_length=None, measure={})
    assert load(tmp_path, {**ok, "discretization": {"resolution": 42}}).plan.n_particles == 42 * 14


def test_particles_that_miss_the_area_of_their_shape_are_told(tmp_path, sphrom) -> None:
    """A rectangle of fluid whose height lies half a row above the lattice."""
    block = {"rectangle": {"lower": [0, 0], "upper": [0.3, 0.21]}}
    case = tank(1.0, 0.6, 10, fluid=block, initial={}, measure={})
    (tmp_path / "tank.yaml").write_text(yaml.safe_dump(case))
    told = sphrom("case", "check", tmp_path / "tank.yaml", code=0).stderr
    assert "its particles have an area of 0.056 m2, and its shape 0.063 m2" in told
