"""Which snapshots of files a case takes, and snapshots between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sphrom.errors import CaseError
from sphrom.exchange import instants
from sphrom.exchange.foreign_files import Source
from sphrom.exchange.import_options import ImportOptions
from sphrom.exchange.instants import choose, find_sources, interpolated, interval
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.time_loop import Snapshot, TimeSteps

BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, False))
START = np.array([[0.95, 0.5], [0.6, 0.5]])
RATES = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 2, 2))


def at(time: float) -> Snapshot:
    """Return two particles that move by a cubic polynomial in time, the first across the edge."""
    way = sum(rate * time ** (k + 1) for k, rate in enumerate(RATES))
    velocity = sum((k + 1) * rate * time**k for k, rate in enumerate(RATES))
    position = BOX.wrap((START + way).T).T
    return Snapshot(np.ascontiguousarray(position), 1.0 + time**3 * np.ones(2), 3.0 * velocity)


@pytest.mark.parametrize("time", [0.13, 0.25, 0.29])
def test_motion_by_a_cubic_polynomial_is_exact_across_periodic_edges(time: float) -> None:
    near = [(node, at(node)) for node in (0.1, 0.2, 0.3, 0.4)]
    found, expected = interpolated(near, time, BOX, 0.1), at(time)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-12)
    np.testing.assert_allclose(found.velocity, expected.velocity, rtol=1e-12)
    np.testing.assert_allclose(found.density_fluctuation, expected.density_fluctuation, rtol=1e-12)


def test_particles_that_interpolation_takes_out_of_the_box_are_refused() -> None:
    y = {0.0: 0.9, 0.6: 0.02, 1.2: 0.97, 2.0: 0.97}
    near = [(t, Snapshot(np.full((2, 2), y[t]), np.ones(2), np.ones((2, 2)))) for t in y]
    with pytest.raises(CaseError, match=r"files 0\.8 s apart moves 2 particles out of the scene"):
        interpolated(near, 1.6, BOX, 0.1)


def test_interval_is_that_of_the_files_where_some_are_missing() -> None:
    times = [round(k / 30.0, 4) for k in range(101) if k not in (3, 4, 7, 20, 50, 51, 60, 61, 95)]
    assert interval([Source(Path(), time) for time in times]) == pytest.approx(1 / 30, rel=1e-5)


@pytest.fixture
def hold(monkeypatch: pytest.MonkeyPatch):
    """Return a function that lets files, by name, hold one snapshot each at some times."""

    def hold(times: dict[str, float]) -> list[Path]:
        monkeypatch.setattr(instants, "snapshots_in", lambda path: [Source(path, times[str(path)])])
        return [Path(name) for name in times]

    return hold


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"start": 20.0, "units": "time=ms"}, [("a_2", 0.0), ("a_10", 0.01)]),
        ({"time_step": 0.5}, [("a_1", 0.0), ("a_2", 0.5), ("a_10", 1.0)]),
    ],
)
def test_times_are_counted_from_the_start_in_the_unit_of_the_files(hold, options, expected) -> None:
    files = hold({"a_2": 20.0, "a_10": 30.0, "a_1": 10.0})
    found = find_sources(files, ImportOptions(**options))
    assert [str(source.path) for source in found] == [name for name, _ in expected]
    assert [source.time for source in found] == pytest.approx([time for _, time in expected])


def test_the_nearest_snapshots_are_taken_or_four_around_an_instant() -> None:
    steps = TimeSteps(time_step=0.1, n_steps=4, every=2)
    sources = [Source(Path(f"{k}"), time) for k, time in enumerate((0.0, 0.1, 0.201, 0.3, 0.4))]
    assert choose(sources, steps, ImportOptions()) == [
        (0.0, [sources[0]]), (0.201, [sources[2]]), (0.4, [sources[4]]),
    ]  # fmt: skip
    uneven = [Source(Path(f"{k}"), 0.09 * k) for k in range(6)]
    times, nodes = zip(*choose(uneven, steps, ImportOptions()), strict=True)
    assert times == pytest.approx((0.0, 0.2, 0.4))
    assert nodes == ([uneven[0]], uneven[1:5], uneven[2:6])
    # Where others are interpolated, only the same time to rounding is taken as it is.
    for late, n_nodes in ((5e-13, 1), (5e-12, 4)):
        files = [Source(Path(), time) for time in (0.0, 0.0004, 0.001 + late, 0.0017, 0.002)]
        choices = choose(files, TimeSteps(5e-4, n_steps=4, every=1), ImportOptions())
        assert len(choices[2][1]) == n_nodes
    for too_few in (sources[:4], [sources[0], sources[4]]):
        with pytest.raises(CaseError, match="--write-case"):
            choose(too_few, TimeSteps(0.1, n_steps=4, every=1), ImportOptions())
