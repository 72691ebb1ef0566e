"""The time loop of runs, with checks of the state and the choice of stored snapshots."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.errors import UnstableError
from sphrom.sph.domain import Domain, first_of
from sphrom.text import place_text

if TYPE_CHECKING:
    from sphrom.sph.neighbourhood import Neighbourhood

Item = Mapping[str, NDArray[Any]]
"""One snapshot: the values of each dataset of a trajectory."""

DENSITY_LIMIT = 0.1
"""Largest |rho - rho_0| / rho_0: ten times that of a weakly compressible flow."""


@dataclass(frozen=True)
class Snapshot:
    """The fields of one instant; positions and velocities are (n_dim, n_particles)."""

    position: Array
    density_fluctuation: Array
    velocity: Array
    coordinates: Array | None = None
    """(n_modes,) the generalized coordinates of a reduced run."""
    mean_density_fluctuation: float | None = None
    """The separate mean of a reduced run [kg/m3]."""


class Model(Protocol):
    """The interface of full and reduced models that the loop uses."""

    @property
    def domain(self) -> Domain:
        """The domain of the fluid."""

    def rates(self, state: Array, time: float) -> Array:
        """Return the rates of a state at a time [s]."""

    @property
    def neighbourhood(self) -> Neighbourhood:
        """The neighbour list of the sums in the rates."""

    def position(self, state: Array) -> Array:
        """Return the positions (n_dim, n_particles) of a state [m]."""

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles wrapped into the box; reset the neighbour list.

        A run that continues from a snapshot then has the same list as the original run.
        """

    def snapshot(self, state: Array) -> Snapshot:
        """Return the fields of a state."""

    def remedy(self, state: Array, time_step: float) -> str:
        """Return a suggestion for a run that became unstable in the step after a state."""


@dataclass(frozen=True)
class TimeSteps:
    """The time steps of a run, and its snapshots."""

    time_step: float
    """dt [s]."""
    n_steps: int
    """Number of steps after the start, which follows a spin-up if there is one."""
    every: int
    """Number of steps between snapshots."""
    start_time: float = 0.0
    """Time of the first snapshot, and of the state that the run starts from [s]."""
    check_every: int = 1
    """Number of steps between checks of the fields."""

    @property
    def n_spin_up_steps(self) -> int:
        """Number of steps before the start."""
        return round(self.start_time / self.time_step)

    @property
    def end_time(self) -> float:
        """Time of the last snapshot [s]."""
        return self.start_time + (self.n_snapshots - 1) * self.snapshot_interval

    @property
    def n_snapshots(self) -> int:
        """Number of snapshots of the run, including its start."""
        return self.n_steps // self.every + 1

    @property
    def snapshot_interval(self) -> float:
        """Time between snapshots [s]."""
        return self.every * self.time_step

    def time(self, step: int) -> float:
        """Return the time after a number of steps [s]."""
        return self.start_time + step * self.time_step


@dataclass(frozen=True)
class RunState:
    """The state of a run after a step, on which the next step depends."""

    step: int
    state: Array
    neighbours_at: Array | None
    """Positions (n_dim, n_particles) [m] at which the neighbour list was built; None before."""
    seconds: float
    """Time spent on the steps so far [s]."""


@dataclass
class Clock:
    """Adds up the time of the steps only, without compilation, checks or writing."""

    seconds: float = 0.0


def march(
    model: Model,
    state: Array,
    steps: TimeSteps,
    reference_density: float,
    clock: Clock,
    advance: Callable[[int], None],
    begin: RunState | None = None,
    reached: Callable[[RunState, TimeSteps], None] = lambda run_state, steps: None,
) -> Iterator[tuple[int, Array]]:
    """Take all steps of a run, and yield the numbers and states of stored snapshots.

    Parameters
    ----------
    begin : the state at which a run was stopped. It continues as if it had not been stopped, and
        only the remaining states are yielded.
    reached : called after each step with the state of the run.

    Raises UnstableError if a step fails, or its result is outside the validity of the model.
    """
    first = 0
    if begin is not None:
        state = begin.state
        clock.seconds = begin.seconds
        first = begin.step + 1
    # Everything that a model needs is compiled before the clock starts.
    with _explained("before the first step"):
        model.rates(state, steps.time(max(0, first - 1)))
    if begin is not None:
        model.neighbourhood.rebuild_at(begin.neighbours_at)
    for step in range(first, steps.n_steps + 1):
        keep, before = step % steps.every == 0, state
        try:
            if step > 0:
                started = time.perf_counter()
                state = watched_step(model.rates, state, steps, step)
                clock.seconds += time.perf_counter() - started
                advance(1)
            if keep:
                state = model.wrapped(state)
            if keep or step % steps.check_every == 0:
                snapshot = model.snapshot(state)
                check_snapshot(snapshot, model.domain, reference_density, step, steps.time(step))
            else:
                check_position(model.position(state), model.domain, step, steps.time(step))
        except UnstableError as error:
            remedy = model.remedy(before, steps.time_step)
            raise UnstableError(f"{error}; {remedy}") from error
        if keep:
            yield step, state
        reached(RunState(step, state, model.neighbourhood.built_at, clock.seconds), steps)


def watched_step(
    functional: Callable[[Array, float], Array], state: Array, steps: TimeSteps, step: int
) -> Array:
    """Take step number `step`; raise UnstableError if it fails."""
    with _explained(f"within step {step}, before t = {steps.time(step):.6g} s"):
        return runge_kutta_step(functional, state, steps.time(step - 1), steps.time_step)


@contextmanager
def _explained(when: str) -> Iterator[None]:
    """Turn errors caused by an invalid state into an UnstableError.

    Such a state can make the equations unsolvable, for example if particles are no longer spread
    out under a basis, or positions are no longer finite.
    """
    try:
        yield
    except (np.linalg.LinAlgError, ValueError, UnstableError) as error:
        raise UnstableError(f"unstable {when}: {error}") from error


def check_snapshot(
    snapshot: Snapshot, domain: Domain, reference_density: float, step: int, time: float
) -> None:
    """Raise UnstableError if fields are not those of a weakly compressible flow.

    A particle beyond a wall raises it too.
    """
    check_position(snapshot.position, domain, step, time)
    fluctuation = snapshot.density_fluctuation / reference_density
    # A comparison with NaN is false, so every bad particle is found.
    good = (np.abs(fluctuation) <= DENSITY_LIMIT) & np.isfinite(snapshot.velocity).all(0)
    if not good.all():
        bad = np.flatnonzero(~good)
        velocity = place_text(snapshot.velocity[:, bad[0]], ".3g")
        text = f"(rho - rho0)/rho0 = {fluctuation[bad[0]]:.3g} and velocity {velocity} m/s"
        raise _unstable(f"{first_of(bad, snapshot.position)} has {text}", step, time)


def check_position(position: Array, domain: Domain, step: int, time: float) -> None:
    """Raise UnstableError if a particle (n_dim, n_particles) is lost, or beyond a wall."""
    lost = ~np.isfinite(position).all(0)
    if domain.has_walls:
        lost |= ~domain.contains(position.T)
    if lost.any():
        where = first_of(np.flatnonzero(lost), position)
        raise _unstable(f"{where} is lost, or beyond a wall", step, time)


def _unstable(reason: str, step: int, time: float) -> UnstableError:
    return UnstableError(f"unstable at step {step}, t = {time:.6g} s: {reason}")


def runge_kutta_step(
    functional: Callable[[Array, float], Array], state: Array, time: float, time_step: float
) -> Array:
    """Return the state one step of `time_step` [s] after `time` [s] (Eq. 2.18)."""
    half = time + 0.5 * time_step
    first = functional(state, time)
    second = functional(state + 0.5 * time_step * first, half)
    third = functional(state + 0.5 * time_step * second, half)
    fourth = functional(state + time_step * third, time + time_step)
    return state + time_step / 6.0 * (first + 2.0 * (second + third) + fourth)
