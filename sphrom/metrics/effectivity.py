"""Estimated errors against true ones: the effectivity, estimate over error, of reduced runs.

True errors are root mean squares over the grid, of velocities and of pressures less their mean.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.metrics.discrepancy import without_mean
from sphrom.metrics.histories import QUANTITIES, TIME_TOLERANCE
from sphrom.metrics.samples import Probes, Samples

Array = NDArray[np.float64]

EFFECTIVITY = {
    f"{quantity}_{name}": unit
    for quantity in QUANTITIES
    for name, unit in {
        "estimate": "%",
        "error": "%",
        "effectivity_mean": None,
        "effectivity_min": None,
        "effectivity_max": None,
    }.items()
}
"""Figures and their units: estimate and error over time, relative to the field; their ratio."""


def effectivity(
    estimates: Array,
    run: Samples,
    reference: Samples,
    probes: Probes,
    *,
    from_time: float,
    left_out: float,
) -> dict[str, float] | None:
    """Return how good estimates (n_snapshots, 2) are, by EFFECTIVITY.

    Estimates are root mean squares of velocity [m/s] and pressure [Pa]. Instants before `from_time`
    [s], and a share `left_out` of the run from its start, don't count. None where there is no error
    to compare with.
    """
    errors, sizes = _errors(run, reference, probes)
    time = reference.time
    start = max(from_time, time[0] + left_out * (time[-1] - time[0]))
    kept = (time >= start - TIME_TOLERANCE) & (errors > 0.0).all(axis=1)
    if not kept.any():
        return None
    figures: dict[str, float] = {}
    for k, name in enumerate(QUANTITIES):
        figures |= _figures(name, estimates[kept, k], errors[kept, k], sizes[kept, k])
    return figures


def _figures(name: str, estimate: Array, error: Array, size: Array) -> dict[str, float]:
    """Return the figures of one field, of root mean squares (n_snapshots,) over the points."""
    scale = 100.0 / float(np.linalg.norm(size))
    ratio = estimate / error
    return {
        f"{name}_estimate": scale * float(np.linalg.norm(estimate)),
        f"{name}_error": scale * float(np.linalg.norm(error)),
        f"{name}_effectivity_mean": float(ratio.mean()),
        f"{name}_effectivity_min": float(ratio.min()),
        f"{name}_effectivity_max": float(ratio.max()),
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
