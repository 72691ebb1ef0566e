"""Sizes of measured quantities and of their components, and statistics over time."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.measures import (
    FieldMeasure,
    FlowRate,
    Integral,
    of_loads,
    shares,
    statistics,
    variations,
    with_coefficients,
)
from sphrom.metrics.quantities import Column

TIME = np.linspace(0.0, 10.0, 200)
NOISE = np.random.default_rng(4).normal(size=(200, 2))


def test_each_component_has_the_size_of_its_own_change() -> None:
    force = np.stack((3.0 + 0.0 * TIME, -0.1 + 0.01 * np.sin(TIME)), axis=1)
    sizes = variations("force", force)
    squares = dict.fromkeys(sizes, 0.0004)
    assert shares(squares, sizes)["force_x"] == pytest.approx(100.0 * 0.02 / 3.0)
    assert shares(squares, sizes)["force_y"] == pytest.approx(20.0, rel=0.02)
    assert sizes["force"] == pytest.approx(sizes["force_x"] + sizes["force_y"])
    # Where fluid has weight, loads change about their mean.
    weighed = variations("force", force + np.array([1000.0, 0.0]), with_weight=True)
    assert weighed["force_y"] == pytest.approx(np.var(force[:, 1]))


@pytest.mark.parametrize(
    ("lift", "known"),
    [(0.1 * NOISE[:, 1], False), (0.1 * np.sin(TIME) + 0.01 * NOISE[:, 1], True),
     (-0.03 + 0.0 * TIME, True), (1e-4 + 0.0 * TIME, False), (0.0 * TIME, False)],
    ids=["noise", "oscillates", "constant", "negligible", "zero"],
)  # fmt: skip
def test_a_component_with_only_noise_has_no_size(lift, known) -> None:
    sizes = variations("force", np.stack((np.ones(200), lift), axis=1))
    assert (sizes["force_y"] > 0.0, sizes["force_x"] > 0.0) == (known, True)
    assert (shares({"force_y": 1.0}, sizes)["force_y"] is None) is not known


def test_a_vector_of_noise_has_no_size() -> None:
    assert set(variations("force", NOISE).values()) == {0.0}


def test_statistics_count_some_snapshots() -> None:
    series = {"torque": np.array([[5.0, 1.0, 3.0]])}
    found = statistics(series, np.array([False, True, True]))
    assert {name: each.item() for name, each in found.items()} == {
        "torque_last": 3.0, "torque_mean": 2.0, "torque_fluctuation": 1.0, "torque_least": 1.0,
        "torque_greatest": 3.0,
    }  # fmt: skip
    assert [*statistics(series, np.zeros(3, dtype=bool))] == ["torque_last"]


def test_a_coefficient_is_a_factor_of_the_force() -> None:
    measured = {"drag": {"force": np.array([[2.0, 0.5]])}, "wake": {"pressure": np.ones(1)}}
    found = with_coefficients(measured, {"drag": 20.0})
    assert found["drag"]["coefficient"].tolist() == [[40.0, 10.0]]
    assert "coefficient" not in found["wake"]


@pytest.mark.parametrize("axis", range(3))
def test_a_flow_rate_in_space_is_exact_for_polynomials(axis) -> None:
    ends = np.array([[0.5, 3.0, -1.0], [2.0, 1.0, 1.0]])
    ends[:, axis] = 0.25
    measure = FlowRate.through(ends, 0.7)
    a, b = (measure.position[:, k] for k in range(3) if k != axis)
    velocity = np.zeros_like(measure.position)
    velocity[:, axis] = a**5 * b**2
    low, high = np.sort(np.delete(ends, axis, axis=1), axis=0)
    exact = np.diff([low[0] ** 6, high[0] ** 6]) / 6.0 * np.diff([low[1] ** 3, high[1] ** 3]) / 3.0
    rate = measure.of(velocity, np.zeros(len(a)))["flow_rate"]
    np.testing.assert_allclose(rate, exact[0], rtol=1e-13)


def test_lines_and_integrals_in_space() -> None:
    ends = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 2.0]])
    line = FieldMeasure.line(ends, 5)
    np.testing.assert_allclose(line.position[2], [0.5, 1.0, 1.0])
    along = Integral(ends, 0.4)
    pressure = along.position[:, 2] ** 2
    found = along.of(along.position, pressure)
    np.testing.assert_allclose(found["pressure_integral"], 3.0 * 4.0 / 3.0)
    np.testing.assert_allclose(found["velocity_integral"], [1.5, 3.0, 3.0])


def test_vectors_in_space_have_three_components_and_units_of_space() -> None:
    columns = Column.named("lid", ("force", "torque", "flow_rate"), 3)
    assert [*columns] == ["lid_force_x", "lid_force_y", "lid_force_z", "lid_flow_rate"]
    assert (columns["lid_force_z"].units, columns["lid_flow_rate"].units) == ("N", "m3/s")
    sizes = variations("force", np.stack((TIME, 0.5 * TIME, 2.0 + TIME), axis=1))
    assert [*sizes] == ["force", "force_x", "force_y", "force_z"]
    loads = np.array([3.0, 5.0, 7.0])
    assert [*of_loads(loads, 3)] == ["force"]
    np.testing.assert_array_equal(of_loads(loads, 3)["force"], loads)
    assert of_loads(loads, 2)["torque"] == 7.0
