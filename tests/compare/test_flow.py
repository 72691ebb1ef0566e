"""What a run's flow is like: figures of flows that were made up to have them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.measured import flow_row
from sphrom.models.stored_run import StoredRun
from sphrom.store.stored_run import probes_of, sample_run


def _row(case, trajectory):
    probes = probes_of(case)
    samples = sample_run(case, trajectory, probes.all)
    run = StoredRun(SimpleNamespace(case=case), trajectory, ParameterPoint(1.0))
    return flow_row(case, ParameterPoint(1.0), run, samples, probes)


def test_open_cavity_with_a_wave(case_of, made_up):
    case = case_of("open-cavity", compare={"grid": 40})

    def flow(position, time):
        x, y = position.T
        u = np.where(y > 0.1, 1.25, 0.0)
        v = 0.1 * np.sin(2.0 * np.pi * (4.65 * time - 2.5 * x)) * np.sin(np.pi * y / 0.2)
        return np.stack((u, v), axis=1), 3.0 * x + 2.0 * time

    row = _row(case, made_up(case, flow, 5.0 + np.linspace(0.0, 1.0, 101)))
    assert (row.from_time, row.to_time) == (5.0, 6.0)
    assert row.dominant_frequency == pytest.approx(4.65, rel=5e-3)
    assert row.bulk_velocity == pytest.approx(1.25, abs=0.02)
    assert row.largest_speed == pytest.approx(np.hypot(1.25, 0.1), abs=2e-3)
    # The cavity below the channel takes a third of the fluid, at rest but for the wave.
    assert row.kinetic_energy == pytest.approx(0.5 * 0.04 * 1.25**2, rel=0.01)
    assert row.mean_pressure_drift == pytest.approx(2.0)
    assert row.pressure_drift_ratio == pytest.approx(2.0 / row.pressure_deviation)


def test_bulk_velocity_where_points_fall_onto_edges(case_of, made_up):
    """With 50 points along the box a row lies on the channel's floor, and columns on the sides."""
    case = case_of("open-cavity", compare={"grid": 50})

    def flow(position, time):
        height = (position[:, 1] - 0.1) / 0.1
        u = np.where(height > 0.0, 6.0 * 1.25 * height * (1.0 - height), 0.0)
        return np.stack((u, np.zeros_like(u)), axis=1), position[:, 0]

    row = _row(case, made_up(case, flow, np.linspace(5.0, 6.0, 5)))
    assert row.bulk_velocity == pytest.approx(1.25, rel=0.01)


def test_bulk_velocity_of_a_channel_that_repeats(made_up):
    """The mean of a parabola is two thirds of its largest velocity; a closed box has none."""

    def bulk_velocity(periodic: list[str]) -> float | None:
        scene = {"kind": "custom", "box": {"upper": [2, 1], "periodic": periodic}}
        values = {"scene": scene, "discretization": {"resolution": 20}, "compare": {"grid": 40}}
        case = Case.model_validate({"name": "channel", **values})

        def flow(position, time):
            y = position[:, 1]
            return np.stack((6.0 * y * (1.0 - y), 0.0 * y), axis=1), position[:, 0]

        return _row(case, made_up(case, flow, np.linspace(0.0, 1.0, 5))).bulk_velocity

    assert bulk_velocity(["x"]) == pytest.approx(1.0, rel=0.01)
    assert bulk_velocity([]) is None
