"""Flow rates, probes and lines of exact fields, measured from particles."""

from __future__ import annotations

from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.errors import UnstableError
from sphrom.metrics.measures import FlowRate, errors_of, mean_square, of_a_run, statistics
from sphrom.setup.particles import MeasuredFields, MeasuredParticles
from sphrom.sph.time_loop import Snapshot
from sphrom.store.trajectory import TrajectoryWriter

HALF = {"flow_rate": {"from": [0.25, 0], "to": [0.25, 1]}}
SLANTED = {"flow_rate": {"from": [0.1, 0.2], "to": [0.8, 0.9]}}
MEASURE: dict[str, Any] = {
    "across": HALF,
    "back": {"flow_rate": {"from": [0.25, 1], "to": [0.25, 0]}},
    "slanted": SLANTED,
    "along": {"integral": {"from": [0.1, 0.2], "to": [0.9, 0.8]}},
    "middle": {"probe": [0.4, 0.7]},
    "corner": {"probe": [0.95, 0.95]},
    "profile": {"line": {"from": [0.5, 0.05], "to": [0.5, 0.95], "points": 5}},
}


def case_of(**scene: Any) -> Case:
    given = {"kind": "custom", "box": {"upper": [1, 1]}, "measure": MEASURE, **scene}
    return load_case({"name": "x", "scene": given, "discretization": {"resolution": 20}})


def fields_of(case: Case) -> MeasuredFields:
    found = MeasuredFields.of(case)
    assert found is not None
    return found


def particles_of(case: Case) -> np.ndarray:
    """Return particles that stand in no order."""
    spacing, random = case.plan.particle_spacing, np.random.default_rng(3)
    points = case.scene.domain.fill(spacing)
    return points + random.uniform(-0.2, 0.2, points.shape) * spacing


def linear(at: np.ndarray) -> np.ndarray:
    x, y = at.T
    return np.stack((1.0 + 2.0 * x - 3.0 * y, 0.5 - x + 4.0 * y), axis=1)


def quadratic(at: np.ndarray) -> np.ndarray:
    x, y = at.T
    return linear(at) + np.stack((x * y - y**2, 2.0 * x**2 + x * y), axis=1)


def exact_flow_rate(velocity: Any, start: tuple[float, float], end: tuple[float, float]) -> float:
    """Return the integral of u dy - v dx from start to end, by a rule of its own."""
    along = (np.arange(20_000) + 0.5)[:, None] / 20_000
    u, v = velocity(np.array(start) + along * np.subtract(end, start)).mean(axis=0)
    return float(u * (end[1] - start[1]) - v * (end[0] - start[0]))


@pytest.mark.parametrize("velocity", [linear, quadratic])
def test_fields_up_to_the_second_degree_are_measured_exactly(velocity: Any) -> None:
    case = case_of()
    place = particles_of(case)
    density = 1e-3 * (2.0 * place[:, 0] - place[:, 1])
    found = fields_of(case)(place, density, velocity(place))
    across = exact_flow_rate(velocity, (0.25, 0.0), (0.25, 1.0))
    assert found["across"]["flow_rate"] == pytest.approx(across, rel=1e-7)
    assert found["back"]["flow_rate"] == pytest.approx(-across, rel=1e-7)
    slanted = exact_flow_rate(velocity, (0.1, 0.2), (0.8, 0.9))
    assert found["slanted"]["flow_rate"] == pytest.approx(slanted, rel=1e-7)
    for name, at in {"middle": [(0.4, 0.7)], "corner": [(0.95, 0.95)]}.items():
        np.testing.assert_allclose(found[name]["velocity"], velocity(np.array(at)), atol=1e-9)
    nodes, weights = np.polynomial.legendre.leggauss(4)  # exact for these fields, length 1
    at = np.array([0.1, 0.2]) + 0.5 * (1.0 + nodes)[:, None] * np.array([0.8, 0.6])
    whole = 0.5 * weights @ velocity(at)
    np.testing.assert_allclose(found["along"]["velocity_integral"], whole, rtol=1e-9)
    whole = 0.5e-3 * case.plan.sound_speed**2 * weights @ (2.0 * at[:, 0] - at[:, 1])
    np.testing.assert_allclose(found["along"]["pressure_integral"], whole, rtol=1e-9)
    line = np.stack((np.full(5, 0.5), np.linspace(0.05, 0.95, 5)), axis=1)
    np.testing.assert_allclose(found["profile"]["velocity"], velocity(line), rtol=1e-9, atol=1e-9)
    pressure = 1e-3 * case.plan.sound_speed**2 * (2.0 * line[:, 0] - line[:, 1])
    np.testing.assert_allclose(found["profile"]["pressure"], pressure, rtol=1e-9, atol=1e-12)


def test_the_flow_rate_of_poiseuille_flow_is_exact_in_every_section() -> None:
    """Q = G H^3 / (12 nu), with u = G y (H - y) / (2 nu), from particles in no order."""
    sections = {
        f"at{i}": {"flow_rate": {"from": [x, 0], "to": [end, 1]}}
        for i, (x, end) in enumerate([(0.0, 0.0), (0.3, 0.3), (0.2, 0.9)])
    }
    case = case_of(box={"upper": [1, 1], "periodic": ["x"]}, measure=sections)
    place = particles_of(case)
    velocity = np.stack((3.0 * place[:, 1] * (1.0 - place[:, 1]), np.zeros(len(place))), axis=1)
    found = fields_of(case)(place, np.zeros(len(place)), velocity)
    rates = [float(quantities["flow_rate"]) for quantities in found.values()]
    assert rates == pytest.approx([0.5] * 3, rel=1e-9)


def test_a_flow_rate_is_what_the_stream_function_grows_by() -> None:
    """Of fields beyond the polynomials that the fit holds; an incompressible one conserves it."""
    case = case_of(measure={"across": HALF, "slanted": SLANTED}, box={"upper": [1, 1]})
    place = particles_of(case)

    def stream(x: Any, y: Any) -> Any:
        return np.sin(2.0 * x) * np.cos(1.5 * y)

    x, y = place.T
    velocity = np.stack(
        (-1.5 * np.sin(2.0 * x) * np.sin(1.5 * y), -2.0 * np.cos(2.0 * x) * np.cos(1.5 * y)), axis=1
    )
    found = fields_of(case)(place, np.zeros(len(place)), velocity)
    across = stream(0.25, 1.0) - stream(0.25, 0.0)
    slanted = stream(0.8, 0.9) - stream(0.1, 0.2)
    assert found["across"]["flow_rate"] == pytest.approx(across, rel=1e-3)
    assert found["slanted"]["flow_rate"] == pytest.approx(slanted, rel=1e-3)


def test_on_walls_fluid_has_their_velocity() -> None:
    """A thin layer beside a lid; where its speed varies, fluid alone is extrapolated."""
    line, wrong = {"from": [0.5, 0], "to": [0.5, 1], "points": 161}, []
    scene = {"kind": "custom", "box": {"upper": [1, 1], "periodic": ["x"]}}
    scene |= {"walls": {"top": {"velocity": [1, 0]}}, "measure": {"profile": {"line": line}}}
    for train in ({"reynolds": [100]}, {"reynolds": [100], "top": [1, 2]}):
        given = {"name": "x", "scene": scene, "parameters": {"train": train}}
        case = load_case({**given, "discretization": {"resolution": 20}})
        place, y = particles_of(case), np.linspace(0.0, 1.0, 161)
        velocity = np.stack((np.sinh(10.0 * place[:, 1]), np.zeros(len(place))), axis=1)
        found = fields_of(case)(place, np.zeros(len(place)), velocity / np.sinh(10.0))
        exact = np.stack((np.sinh(10.0 * y) / np.sinh(10.0), np.zeros(161)), axis=1)
        wrong.append(np.hypot(*(found["profile"]["velocity"] - exact).T))
    known, varied = wrong
    assert max(known[0], known[-1]) < 1e-12
    assert varied[-1] == varied.max() > 0.015
    assert known.max() < 0.6 * varied.max()


def test_a_void_at_a_probe_ends_a_run() -> None:
    case = case_of(measure={"middle": {"probe": [0.5, 0.5]}})
    place = particles_of(case)
    far = np.hypot(*(place - 0.5).T) > 0.25
    fields = np.zeros(far.sum()), np.zeros((far.sum(), 2))
    told = r"where fields are measured \(middle\): too few .* \(0\.5, 0\.5\) to interpolate there"
    with pytest.raises(UnstableError, match=f"{told}$"):
        fields_of(case)(place[far], *fields)
    measured = MeasuredParticles(case, case.plan.points[0])
    writer = TrajectoryWriter(Mock(), 1, far.sum(), 10.0, fields=measured)
    with pytest.raises(UnstableError, match=r"there, at t = 0\.25 s$"):
        writer.append(0.25, 1, Snapshot(place[far].T, fields[0], fields[1].T))


def test_a_section_is_summed_up_within_its_ends() -> None:
    measure = FlowRate(np.array([[0.0, 0.0], [0.0, 1.0]]), longest=0.3)
    assert len(measure.position) == 12
    unit = np.broadcast_to([1.0, 0.0], (12, 2))
    assert measure.of(unit, unit[:, 0])["flow_rate"] == pytest.approx(1.0, abs=1e-15)
    assert 0.0 < measure.position[:, 1].min() < measure.position[:, 1].max() < 1.0


def test_statistics_over_time() -> None:
    series = np.array([[[1.0, 0.0]], [[3.0, 0.0]], [[2.0, 6.0]]])
    of_one = of_a_run({"velocity": series, "pressure": series[..., 0]})
    every = np.ones(len(next(iter(of_one.values()))), dtype=bool)
    found = statistics({name: values[None] for name, values in of_one.items()}, every)
    assert found["velocity_x_last"] == 2.0
    assert found["velocity_x_mean"] == 2.0
    assert found["velocity_y_fluctuation"] == pytest.approx(np.sqrt(8.0))
    assert (found["pressure_least"], found["pressure_greatest"]) == (1.0, 3.0)
    line = of_a_run({"velocity": np.ones((3, 5, 2)), "pressure": np.ones((3, 5))})
    assert line["final_velocity"].shape == (5, 2)
    assert statistics(line, every) == {}


def test_errors_are_over_the_size_of_the_whole_quantity() -> None:
    reference = np.array([[3.0, 4.0], [3.0, 4.0]])
    run = reference + np.array([[0.0, 0.0], [0.0, 0.5]])
    size = mean_square("velocity", reference)
    overall, worst = errors_of("velocity", run, reference, size)
    assert overall == pytest.approx(100.0 * 0.1 / np.sqrt(2.0))
    assert worst == pytest.approx(10.0)
    assert errors_of("velocity", run, reference, 0.0) == (None, None)
