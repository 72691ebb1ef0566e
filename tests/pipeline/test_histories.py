"""Runs whose walls and forces follow measured histories, against solutions known otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import sphrom
from sphrom.errors import CaseError

TIMES = np.linspace(0.0, 0.6, 7)
TABLE = np.round(np.sin(np.pi * TIMES) ** 2, 3)
VISCOSITY = 0.1


@pytest.fixture
def study(tmp_path: Path):
    """A case between walls 1 m apart, with the table of a history and more keys of its scene."""
    rows = "".join(f"{t:g},{u:g}\n" for t, u in zip(TIMES, TABLE, strict=True))
    (tmp_path / "slide.csv").write_text(f"s,u\n{rows}")

    def made(rom: list[dict[str, Any]], **scene: Any) -> sphrom.Study:
        scene |= {
            "kind": "custom",
            "reference_length": 1.0,
            "box": {"upper": [0.5, 1], "periodic": ["x"]},
            "histories": {"slide": {"file": str(tmp_path / "slide.csv"), "scale": 2.0}},
        }
        case = {
            "name": "x",
            "scene": scene,
            "discretization": {"resolution": 16},
            "time": {"final_time": float(TIMES[-1])},
            "snapshots": {"every": 2},
            "parameters": {"train": {"reynolds": [1.0 / VISCOSITY]}},
            "rom": rom,
        }
        return sphrom.Study(case, out=tmp_path / "out", threads=1, quiet=True)

    return made


def exact(heights: np.ndarray, bottom: float, top: float | None, push: float | None) -> np.ndarray:
    """Return u at the end, by finite differences. None means a force or a wall as the table says.

    `bottom` is a factor of the table.
    """
    y, u = np.linspace(0.0, 1.0, 51), np.zeros(51)
    times = np.linspace(0.0, TIMES[-1], 2001)
    tables = 2.0 * np.interp(times, TIMES, TABLE)
    for time, table in zip(times[1:], tables[1:], strict=True):
        force = table if push is None else push * min(2.0 * time, 1.0)
        u[1:-1] += times[1] * (VISCOSITY * np.diff(u, 2) / y[1] ** 2 + force)
        u[0], u[-1] = bottom * table, table if top is None else top
    return np.interp(heights, y, u)


def test_walls_and_a_force_that_change_differently(study) -> None:
    """Of a full run. Measured: 0.017 m/s off, of 2 m/s."""
    run = study(
        [],
        walls={"bottom": {"velocity": ["slide(t)", 0]}, "top": {"velocity": [-1, 0]}},
        body_force=["interp(t, 0, 0, 0.5, 3)", 0],
    )
    run.run_stage("fom")
    with sphrom.open(next(run.folder.glob("fom-*.h5"))) as stored:
        y, u = stored.position.values[-1, :, 1], stored.velocity.values[-1, :, 0]
    assert u == pytest.approx(exact(y, 1.0, -1.0, 3.0), abs=0.025)


def test_a_fast_model_of_walls_and_a_force_that_follow_one_table(study) -> None:
    """Measured: 0.007 m/s off, of 2 m/s. The table ends with the run."""
    run = study(
        [{"name": "fast", "evaluation": "operators", "n_modes": 4}],
        walls={"bottom": {"velocity": ["-slide(t)", 0]}, "top": {"velocity": ["slide(t)", 0]}},
        body_force=["slide(t)", 0],
    )
    for stage in ("fom", "map", "pod", "fit-psi", "operators"):
        run.run_stage(stage)
    model = run.model("fast", reynolds=1.0 / VISCOSITY)
    y = np.linspace(0.1, 0.9, 9)
    fields = model.run().fields(np.stack((np.full(9, 0.2), y), axis=1))
    u = fields.velocity.values[-1, :, 0]
    assert u == pytest.approx(exact(y, -1.0, None, None), abs=0.015)
    with pytest.raises(CaseError, match=r"slide: .* from 0 to 0.6 s, but 0.7 s"):
        model.run(final_time=0.7)


KNOTS = ("a", "b", "c")


@pytest.fixture(scope="module")
def scheduled(tmp_path_factory: pytest.TempPathFactory) -> sphrom.Model:
    """A fast model of a channel whose driving is a schedule, trained at two of them."""
    schedules = [(0.5, 1.0, 1.0), (1.0, 0.0, -0.5)]
    points = [
        {"reynolds": 1.0 / VISCOSITY, **dict(zip(KNOTS, values, strict=True))}
        for values in schedules
    ]
    knots = {"times": [0, 0.2, 0.4, 0.6], "values": [0, *KNOTS], "interpolation": "cubic"}
    scene = {
        "kind": "custom",
        "reference_length": 1.0,
        "box": {"upper": [0.5, 1], "periodic": ["x"]},
        "constants": dict.fromkeys(KNOTS, 1.0),
        "histories": {"push": knots},
        "body_force": ["push(t)", 0],
        "measure": {
            "flux": {"flow_rate": {"from": [0.2, 0], "to": [0.2, 1]}},
            "floor": {"force_on": "bottom"},
        },
    }
    case = {
        "name": "x",
        "scene": scene,
        "discretization": {"resolution": 16},
        "time": {"final_time": 0.6},
        "snapshots": {"every": 2},
        "parameters": {"train": {"points": points}},
        "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 4}],
    }
    run = sphrom.Study(case, out=tmp_path_factory.mktemp("knots"), threads=1, quiet=True)
    run.run("operators")
    return run.model("fast")


def test_two_schedules_train_a_model_for_others(scheduled: sphrom.Model) -> None:
    """The equations are affine in the amplitude. Measured: 0.3 % off."""
    wanted = {"a": 0.7, "b": 0.8, "c": -0.2}
    run = scheduled.at(**wanted).run()
    y, u = np.linspace(0.0, 1.0, 51), np.zeros(51)
    times = np.linspace(0.0, 0.6, 2001)
    push = CubicSpline([0.0, 0.2, 0.4, 0.6], [0.0, *wanted.values()])(times)
    for force in push[1:]:
        u[1:-1] += times[1] * (VISCOSITY * np.diff(u, 2) / y[1] ** 2 + force)
    flux = run.measures.flux_flow_rate.values[-1]
    assert flux == pytest.approx(np.trapezoid(u, y), rel=0.01)


def test_sensitivities_by_each_knot_are_differences_of_runs(scheduled: sphrom.Model) -> None:
    at = {"a": 0.7, "b": 0.8, "c": -0.2}
    slopes = scheduled.at(**at).sensitivities(*KNOTS)
    step = 1e-4
    for name in KNOTS:
        low, high = (
            scheduled.at(**{**at, name: at[name] + change}).run() for change in (-step, step)
        )
        for quantity in ("flux_flow_rate", "floor_force"):
            change = (high.measures[quantity] - low.measures[quantity]) / (2.0 * step)
            found = slopes.measures[quantity].sel(parameter=name)
            largest = float(np.abs(change).max())
            np.testing.assert_allclose(found, change, atol=1e-5 * largest)


def test_a_knot_near_zero_has_the_sensitivity_of_one_at_zero(scheduled: sphrom.Model) -> None:
    for quantity in ("flux_flow_rate", "floor_force"):
        zero, near = (
            scheduled.at(a=0.7, b=0.8, c=c).sensitivities("c").measures[quantity].values
            for c in (0.0, 1e-14)
        )
        np.testing.assert_allclose(near, zero, rtol=1e-6, atol=1e-6 * np.abs(zero).max())
    f = scheduled.at(a=0.7, b=0.8).function(["c"], ["flux_flow_rate_greatest"])
    np.testing.assert_allclose(f.jacobian([1e-14]), f.jacobian([0.0]), rtol=1e-6)
