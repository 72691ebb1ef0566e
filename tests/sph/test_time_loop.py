"""The watch over a run: what ends it, and what it says of the particle that did."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.errors import UnstableError
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.fluid import Discretization
from sphrom.sph.neighbourhood import Neighbourhood
from sphrom.sph.time_loop import (
    Clock,
    Snapshot,
    TimeSteps,
    check_position,
    check_snapshot,
    march,
    runge_kutta_step,
)
from sphrom.sph.watch import Watch

DENSITY = 2.0
BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (False, False))
PERIODIC = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
CHANNEL = BoxDomain(
    (0.0, 0.0),
    (0.4, 0.2),
    (True, False),
    (Rectangle((0.0, 0.1), (0.4, 0.2)), Rectangle((0.1, 0.0), (0.3, 0.1))),
)


def _snapshot(*positions, fluctuation=0.0, velocity=(0.5, -0.25)) -> Snapshot:
    """The first particle is in the fluid, the others where they are put."""
    position = np.array([(0.25, 0.15), *positions]).T
    n = position.shape[1]
    return Snapshot(position, np.full(n, fluctuation), np.tile(np.array([velocity]).T, n))


@pytest.mark.parametrize(
    ("domain", "position"),
    [
        (BOX, (0.02, 1.0007)),
        (BOX, (-1e-9, 0.5)),
        (BOX, (0.5, -0.3)),
        (BOX, (1.5, 0.5)),
        (CHANNEL, (0.2, 0.2001)),
        (CHANNEL, (0.2, -1e-6)),
        (CHANNEL, (0.0999, 0.05)),
        (CHANNEL, (0.3001, 0.0999)),
    ],
)
def test_a_particle_beyond_a_wall_ends_a_run(domain, position):
    x, y = position
    snapshot = _snapshot(position)
    refused = rf"step 7, t = 0.035 s: particle 1 at \({x:.6g}, {y:.6g}\) m is .*beyond a wall"
    with pytest.raises(UnstableError, match=refused):
        check_snapshot(snapshot, domain, DENSITY, step=7, time=0.035)


class _Drifting:
    """Particles that move up at 1 m/s."""

    domain = BOX

    def __init__(self) -> None:
        self.times: list[float] = []
        self.neighbourhood = Neighbourhood(BOX, Discretization(0.05, 0.05), n_fields=1)

    def position(self, state: np.ndarray) -> np.ndarray:
        return state[:2]

    def rates(self, state: np.ndarray, time: float) -> np.ndarray:
        self.times.append(time)
        rates = np.zeros_like(state)
        rates[1] = 1.0
        return rates

    def wrapped(self, state: np.ndarray) -> np.ndarray:
        return state

    def snapshot(self, state: np.ndarray) -> Snapshot:
        return Snapshot(state[:2], state[2], state[3:])

    def remedy(self, state: np.ndarray, time_step: float) -> str:
        return "stay below"


def _state(y: float) -> np.ndarray:
    return np.array([[0.5], [y], [0.0], [0.0], [1.0]])


def test_time_goes_on_from_where_a_run_starts():
    model, steps = _Drifting(), TimeSteps(0.1, 4, every=2, check_every=1, start_time=5.0)
    kept = list(march(model, _state(0.2), steps, DENSITY, Clock(), lambda _: None))
    assert [step for step, _ in kept] == [0, 2, 4]
    assert [steps.time(step) for step, _ in kept] == pytest.approx([5.0, 5.2, 5.4])
    assert [state[1, 0] for _, state in kept] == pytest.approx([0.2, 0.4, 0.6])
    assert model.times[0] == 5.0
    assert (min(model.times), max(model.times)) == pytest.approx((5.0, 5.4))


def test_positions_are_watched_at_every_step():
    """Fields, which a reduced run has to rebuild, are looked at with its snapshots."""
    steps = TimeSteps(0.1, 20, every=10, check_every=10)
    with pytest.raises(UnstableError, match=r"step 3, t = 0\.3 s: particle 0 at \(0\.5, 1\.05\) m"):
        list(march(_Drifting(), _state(0.75), steps, DENSITY, Clock(), lambda _: None))
    with pytest.raises(UnstableError, match=r"particle 1 at \(nan, 0\.5\) m is lost"):
        check_position(np.array([[0.5, np.nan], [0.5, 0.5]]), PERIODIC, 3, 0.3)


def test_a_run_stops_at_the_step_that_leads_beyond_a_wall():
    """Though only every tenth would be kept, or was looked at before it left."""
    steps = TimeSteps(0.1, 20, every=10, check_every=1, start_time=5.0)
    done: list[int] = []
    run = march(_Drifting(), _state(0.75), steps, DENSITY, Clock(), done.append)
    with pytest.raises(UnstableError, match=r"at step 3, t = 5\.3 s: .*beyond a wall; stay below"):
        list(run)
    assert sum(done) == 3


def integrate(functional, state: np.ndarray, time: float, n_steps: int) -> np.ndarray:
    step = time / n_steps
    for n in range(n_steps):
        state = runge_kutta_step(functional, state, n * step, step)
    return state


def fitted_order(functional, start: np.ndarray, exact: np.ndarray, time: float) -> float:
    counts = np.array([20, 40, 80, 160])
    errors = [np.max(np.abs(integrate(functional, start, time, n) - exact)) for n in counts]
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0])


def test_order_on_a_nonlinear_system() -> None:
    """A rotation whose rate depends on the radius, which stays what it is."""

    def functional(state: np.ndarray, _: float) -> np.ndarray:
        return np.sum(state * state, axis=0) * np.stack((-state[1], state[0]))

    start = np.array([[1.0, 0.5], [0.0, 0.9]])
    angle = 1.5 * np.sum(start * start, axis=0)
    exact = np.stack(
        (
            start[0] * np.cos(angle) - start[1] * np.sin(angle),
            start[0] * np.sin(angle) + start[1] * np.cos(angle),
        )
    )
    assert fitted_order(functional, start, exact, 1.5) == pytest.approx(4.0, abs=0.15)


def test_the_state_is_left_alone_and_seen_four_times() -> None:
    state, seen = np.array([1.0, 2.0]), []

    def functional(y: np.ndarray, time: float) -> np.ndarray:
        seen.append((y.copy(), time))
        return 0.1 * y

    runge_kutta_step(functional, state, 3.0, 1.0)
    assert np.array_equal(state, [1.0, 2.0])
    assert [time for _, time in seen] == [3.0, 3.5, 3.5, 4.0]
    assert np.array_equal(seen[0][0], state)


def test_order_where_time_decides() -> None:
    """dy/dt = -y tan t + 2 cos t, solved by y = (2 t + 1) cos t."""

    def functional(y: np.ndarray, time: float) -> np.ndarray:
        return -y * np.tan(time) + 2.0 * np.cos(time)

    order = fitted_order(functional, np.array([1.0]), np.array([3.0 * np.cos(1.0)]), 1.0)
    assert order == pytest.approx(4.0, abs=0.15)


N_WATCHED = 100
PLACES = np.random.default_rng(1).random((N_WATCHED, 2))
AT = np.linspace(0.0, 1.0, 21)


def found(watch: Watch, move, fluctuation=lambda time: np.zeros(N_WATCHED), times=AT) -> str:
    """Return the findings for fluid that moves as one, by its offset and velocity at times."""
    for time in times:
        offset, velocity = (np.array(each) for each in move(time))
        moved = np.tile(velocity, (N_WATCHED, 1))
        watch.see(time, PLACES + offset, moved, fluctuation(time))
    return "; ".join(watch.findings())


def falling(time: float, share: float = 1.0):
    return (0.0, -share * 5.0 * time**2), (0.0, -share * 10.0 * time)


def swung(time: float, rate: float, factor: float = 1.0):
    """The motion by a force cos(rate t) along x."""
    return (0.0, 0.0), (factor * np.sin(rate * time) / rate, 0.0)


def test_energy_is_that_of_work() -> None:
    def force(position, time):
        return np.outer([np.cos(3.0 * time), 0.0], np.ones(position.shape[1]))

    def weight(position, time):
        return np.outer([0.0, -10.0], np.ones(position.shape[1]))

    def watch(own=None, **about):
        return Watch(1.0, 100.0, 1.0, force=own, **about)

    assert found(watch(force), lambda t: swung(t, 3.0)) == ""
    assert "than the work done on it" in found(watch(force), lambda t: swung(t, 3.0, 2.5))
    assert found(watch(weight, gravity=10.0), falling) == ""
    assert "more energy" in found(watch(weight, gravity=10.0), lambda t: falling(t, 1.2))
    # A lid at 1 m/s may move fluid, but not all of it at twice its speed.
    assert found(watch(drive_speed=1.0), lambda t: ((0, 0), (0.9, 0))) == ""
    assert "more energy" in found(watch(drive_speed=1.0), lambda t: ((0, 0), (2.0 * t, 0)))


def test_forcing_between_snapshots_raises_no_doubt() -> None:
    """Snapshots that don't resolve a force can't tell its work."""

    def fast(position, time):
        return np.outer([100.0 * np.cos(300.0 * time), 0.0], np.ones(position.shape[1]))

    watch = Watch(1.0, 100.0, 1.0, force=fast)
    assert found(watch, lambda t: ((0, 0), (100.0 * np.sin(300.0 * t) / 300.0, 0.0))) == ""


def test_fluid_that_nothing_drives_stays_at_rest() -> None:
    still = found(Watch(1.0, 10.0, 1.0, is_driven=False), lambda t: ((0, 0), (0.005 * t, 0)))
    assert still == ""
    moving = found(Watch(1.0, 10.0, 1.0, is_driven=False), lambda t: ((0, 0), (0.02 * t, 0)))
    assert moving == (
        "nothing drives the fluid, but its root mean square speed is 0.02 m/s at t = 1 s"
    )


@pytest.mark.parametrize(
    ("share", "drift", "has_surface", "says"),
    [
        (0.009, 0.0, False, ""),
        (0.02, 0.0, False, "the density fluctuates by 2.00% (root mean square)"),
        (0.0, 4e-4, False, ""),
        (0.0, -6e-4, False, "the mean density changes by -0.06% until t = 1 s"),
        (0.0, 4e-3, True, ""),
        (0.0, 6e-3, True, "the mean density changes by +0.60%"),
    ],
)
def test_density_that_leaves_the_range_of_weak_compression(share, drift, has_surface, says) -> None:
    sign = np.where(np.arange(N_WATCHED) % 2, 1.0, -1.0)
    watch = Watch(2.0, 10.0, 1.0, has_surface=has_surface, look_every=2)
    # Energy of compression is at the limit of a speed of 10 m/s.
    text = found(
        watch, lambda t: ((0, 0), (0, 0)), lambda t: 2.0 * (share * sign + drift * t) * (t > 0)
    )
    assert says in text
    assert bool(says) == ("density" in text)
