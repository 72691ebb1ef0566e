"""Estimated errors against true ones: the effectivity, estimate over error, of reduced runs.

True errors are root mean squares over the grid of `compare`, of velocities and of pressures less
their mean. The first tenth of a run is left out, as in what estimates are fitted to, and what is
before `compare.from_time`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.metrics.discrepancy import without_mean
from sphrom.reduction.error_calibration import FIELDS, LEFT_OUT
from sphrom.store.sampling import Probes, Samples

Array = NDArray[np.float64]

PERCENT = {"unit": "%"}
TIME_TOLERANCE = 1e-9
"""Times that differ by less are one [s]."""


@dataclass(frozen=True)
class EstimateRow:
    """What was estimated of one reduced run, and what turned out, over time.

    Errors are root mean squares over time too, relative to the full run's field.
    """

    compared: str
    parameters: str
    role: str
    """`trained` where the parameter was trained on, `predicted` between trained ones, and
    `extrapolated` outside of them."""
    velocity_estimate: float = field(metadata=PERCENT)
    velocity_error: float = field(metadata=PERCENT)
    velocity_effectivity_mean: float
    velocity_effectivity_min: float
    velocity_effectivity_max: float
    pressure_estimate: float = field(metadata=PERCENT)
    pressure_error: float = field(metadata=PERCENT)
    pressure_effectivity_mean: float
    pressure_effectivity_min: float
    pressure_effectivity_max: float


def estimate_row(
    artifact: Artifact,
    run: Samples,
    reference: Samples,
    probes: Probes,
    *,
    from_time: float,
    compared: str,
    parameters: str,
    role: str,
) -> EstimateRow | None:
    """Return how good a run's estimates are; None where it has none, or nothing to hold against."""
    if "error_estimate/velocity" not in artifact:
        return None
    estimates = np.stack([artifact.read(f"error_estimate/{name}") for name in FIELDS], axis=1)
    if artifact.text("error_estimate/training") == "outside":
        role = "extrapolated"
    figures = effectivity(estimates, run, reference, probes, from_time=from_time)
    return None if figures is None else EstimateRow(compared, parameters, role, **figures)


def effectivity(
    estimates: Array, run: Samples, reference: Samples, probes: Probes, *, from_time: float
) -> dict[str, float] | None:
    """Return how good estimates (n_snapshots, 2) are: the figures of an `EstimateRow`, by name.

    Estimates are root mean squares of velocity [m/s] and pressure [Pa]. None where there is nothing
    to hold them against.
    """
    errors, sizes = _errors(run, reference, probes)
    time = reference.time
    start = max(from_time, time[0] + LEFT_OUT * (time[-1] - time[0]))
    kept = (time >= start - TIME_TOLERANCE) & (errors > 0.0).all(axis=1)
    if not kept.any():
        return None
    figures: dict[str, float] = {}
    for k, name in enumerate(FIELDS):
        figures |= _figures(name, estimates[kept, k], errors[kept, k], sizes[kept, k])
    return figures


def _figures(name: str, estimate: Array, error: Array, size: Array) -> dict[str, float]:
    """Return the figures of one field, of root mean squares (n_snapshots,) over the points."""
    scale = 100.0 / float(np.linalg.norm(size))
    effectivity = estimate / error
    return {
        f"{name}_estimate": scale * float(np.linalg.norm(estimate)),
        f"{name}_error": scale * float(np.linalg.norm(error)),
        f"{name}_effectivity_mean": float(effectivity.mean()),
        f"{name}_effectivity_min": float(effectivity.min()),
        f"{name}_effectivity_max": float(effectivity.max()),
    }


def _errors(run: Samples, reference: Samples, probes: Probes) -> tuple[Array, Array]:
    """Return root mean squares (n_snapshots, 2) of a run's errors, and of the fields themselves."""
    grid = probes.on_grid
    velocities = run.velocity[:, grid], reference.velocity[:, grid]
    pressures = (without_mean(samples.pressure[:, grid]) for samples in (run, reference))
    errors, sizes = [], []
    for found, expected in (velocities, pressures):
        errors.append(_rms(found - expected))
        sizes.append(_rms(expected))
    return np.stack(errors, axis=1), np.stack(sizes, axis=1)


def _rms(fields: Array) -> Array:
    """Return root mean squares over points (n_snapshots,), of a velocity's magnitude."""
    squares = fields**2 if fields.ndim == 2 else np.sum(fields**2, axis=2)
    return np.asarray(np.sqrt(squares.mean(axis=1)))
