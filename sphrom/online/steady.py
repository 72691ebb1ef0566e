"""Steady states of models on the reference points, from where a run ended.

Where the rates of a model vanish, the flow need not be steady. So a steady state comes with its
distance from the nearest state of the training runs, or interpolated between them, with the
residual of the full rates there, and with an estimate of its errors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter, write_record
from sphrom.artifacts.records.coordinates import Converged, Steady, SteadyMeasured
from sphrom.metrics.measures import UNITS, Quantities, components
from sphrom.plots.tables import format_figure
from sphrom.reduction.polynomial import Polynomial, spectrum
from sphrom.reduction.polynomial_model import SteadyState, steady_state
from sphrom.setup.context import Reporter

Array = NDArray[np.float64]

N_TIMED = 5
"""Repetitions of the search for a steady state, to time it."""


FAR = 0.05
"""Distance from the nearest training state over the state's norm, beyond which to warn."""


@dataclass(frozen=True)
class SteadyErrors:
    """The estimated errors of a steady state."""

    residual: float
    """Norm of the part of the rates that the basis leaves out [/s]."""
    errors: Array
    """(2,) root mean squares of the velocity's [m/s] and the pressure's [Pa]."""
    relative: Array
    """(2,) the same over the fields' own root mean squares."""
    distance: float
    """From the nearest state between training runs, as `distance_from` measures it."""


def seek_steady_state(
    artifact: ArtifactWriter,
    report: Reporter,
    run: str,
    polynomial: Polynomial,
    state: Array,
    amplitude: float = 0.0,
    *,
    trained: Array,
    estimated: Callable[[Array], SteadyErrors | None] = lambda state: None,
    measured: Callable[[Array], Mapping[str, Quantities]] = lambda state: {},
) -> None:
    """Look for a steady state by Newton's method, write and report it.

    If none is found, the state with the smallest residual is written as not converged.

    Parameters
    ----------
    amplitude : at the end of the run, from where on nothing changes.
    trained : (n_states, n_modes) coordinates of training states.
    estimated : returns the estimated errors of a steady state (n_modes,).
    measured : returns what is measured in states (n_states, n_modes), by name.
    """
    found, seconds = _timed(polynomial, state, amplitude)
    growth = spectrum(polynomial.jacobian(found.coordinates, amplitude)).largest_real_part
    status: Converged = "converged" if found.converged else "not converged"
    stored = Steady.of(found, status=status, largest_real_part=growth)
    artifact.annotate("timing/steady", seconds)
    text = (
        f"{run}: steady state {status} in {found.n_steps} Newton steps, {1e3 * seconds:.3g} ms: "
        f"residual {found.residual:.2g}, largest real part {growth:.3g} 1/s"
    )
    if not found.converged:
        write_record(artifact, stored, "steady")
        report.warn(text)
        return
    report.info(text)
    distance = distance_from(trained, found.coordinates)
    errors = estimated(found.coordinates)
    if errors is not None:
        distance = min(distance, errors.distance)
        stored = replace(
            stored,
            residual_left_out=errors.residual,
            velocity_error_estimate=float(errors.errors[0]),
            pressure_error_estimate=float(errors.errors[1]),
        )
    quantities = measured(found.coordinates[None])
    there = {name: _at_once(each) for name, each in quantities.items()}
    write_record(artifact, replace(stored, training_distance=distance, measure=there), "steady")
    text = f"{run}: the steady state is {format_figure(100.0 * distance)} % of its norm away from "
    text += "the nearest state of the training runs, or between them"
    if errors is not None:
        velocity, pressure = (f"{format_figure(100.0 * each)} %" for each in errors.relative)
        text += f"; estimated errors: velocity {velocity}, pressure {pressure}"
    for name, each in quantities.items():
        if figures := _figures(each):
            report.info(f"{run}: {name} in the steady state: {figures}")
    if distance > FAR:
        report.warn(f"{text}: no such flow was trained, and the basis may not hold it")
    else:
        report.info(text)


def _at_once(quantities: Quantities) -> SteadyMeasured:
    """Return what is measured in one state (1, ...)."""
    given: dict[str, Any] = {
        name: float(v[0]) if v.ndim == 1 else v[0] for name, v in quantities.items()
    }
    return SteadyMeasured(**given)


def _figures(quantities: Quantities) -> str:
    """Return what is measured in one state in words; of a line nothing."""
    return ", ".join(
        f"{component.replace('_', ' ')} {format_figure(float(values.item()))} {UNITS[quantity]}"
        for quantity, vectors in quantities.items()
        for component, values in components(quantity, vectors).items()
        if values.size == 1
    )


def distance_from(states: Array, state: Array) -> float:
    """Return the distance of a state (n_modes,) from the nearest of some, over its norm."""
    nearest = float(np.linalg.norm(states - state, axis=1).min())
    size = float(np.linalg.norm(state))
    return nearest / size if size > 0.0 else float(nearest > 0.0)


def _timed(polynomial: Polynomial, state: Array, amplitude: float) -> tuple[SteadyState, float]:
    seconds = []
    for _ in range(N_TIMED):
        started = time.perf_counter()
        found = steady_state(polynomial, state, amplitude=amplitude)
        seconds.append(time.perf_counter() - started)
    return found, float(np.median(seconds))
