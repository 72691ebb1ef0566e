"""Which snapshots of files a case takes, and snapshots between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange import instants
from sphrom.exchange.foreign_files import Stored
from sphrom.exchange.instants import Source, at_instants, find_sources, interpolated
from sphrom.exchange.meaning import Meaning
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.time_loop import Snapshot, TimeSteps

BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, False))
START = np.array([[0.95, 0.5], [0.2, 0.4]])
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


def test_particles_in_another_order_are_refused() -> None:
    first, last = at(0.1), at(0.2)
    slow = 0.01 * last.velocity
    swapped = Snapshot(last.position[:, ::-1], last.density_fluctuation, slow)
    near = [(0.1, Snapshot(first.position, first.density_fluctuation, slow)), (0.2, swapped)]
    with pytest.raises(CaseError, match="--sort-by"):
        interpolated(near, 0.15, BOX, 0.01)


@pytest.fixture
def stored(monkeypatch: pytest.MonkeyPatch):
    """Return a function that lets files, by name, hold one snapshot each at some times."""

    def hold(times: dict[str, float]) -> list[Path]:
        monkeypatch.setattr(instants, "snapshots_in", lambda path: [Stored(path, times[str(path)])])
        return [Path(name) for name in times]

    return hold


def test_snapshots_before_the_start_are_left_out_and_times_counted_from_it(stored) -> None:
    files = stored({"a_2": 20.0, "a_10": 30.0, "a_1": 10.0})
    found = find_sources(files, Meaning(start=20.0, units="time=ms"))
    assert [(str(source.path), source.time) for source in found] == [
        ("a_2", 0.0), ("a_10", pytest.approx(0.01)),
    ]  # fmt: skip


def test_a_time_step_counts_files_in_the_order_of_their_names(stored) -> None:
    files = stored({"a_10": 7.0, "a_9": 8.0, "b": 9.0})
    found = find_sources(files, Meaning(time_step=0.5))
    assert [(str(source.path), source.time) for source in found] == [
        ("a_9", 0.0), ("a_10", 0.5), ("b", 1.0),
    ]  # fmt: skip


def test_files_that_begin_later_than_the_case_say_how_to_begin_with_them(stored) -> None:
    with pytest.raises(CaseError, match=r"--start 5\.0 makes it begin with them"):
        find_sources(stored({"a": 5.0, "b": 6.0}), Meaning())
    with pytest.raises(ArtifactError, match="is of the same time, 5"):
        find_sources(stored({"a": 5.0, "b": 5.0}), Meaning())


def test_the_nearest_snapshots_are_taken_where_all_instants_have_one() -> None:
    steps = TimeSteps(time_step=0.1, n_steps=4, every=2)
    sources = [Source(Path(f"{k}"), time) for k, time in enumerate((0.0, 0.1, 0.201, 0.3, 0.4))]
    assert at_instants(sources, steps) == [sources[0], sources[2], sources[4]]
    assert at_instants(sources[:4], steps) is None
