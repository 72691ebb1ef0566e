"""Steady states of models on the reference points, from where a run ended."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.reduction.polynomial import Polynomial, spectrum
from sphrom.reduction.polynomial_model import SteadyState, steady_state
from sphrom.stages.context import Reporter

Array = NDArray[np.float64]

N_TIMED = 5
"""Times that a steady state is looked for, to say what it takes."""


def seek_steady_state(
    artifact: ArtifactWriter,
    report: Reporter,
    run: str,
    polynomial: Polynomial,
    state: Array,
    amplitude: float = 0.0,
) -> None:
    """Look for a steady state by Newton's method, write it, and say what was found.

    Where none was found, the nearest to one is written, and called that. `amplitude` is that at the
    end of the run, from where on nothing changes.
    """
    found, seconds = _timed(polynomial, state, amplitude)
    growth = spectrum(polynomial.jacobian(found.coordinates, amplitude)).largest_real_part
    status = "converged" if found.converged else "not converged"
    artifact.write("steady/coordinates", found.coordinates)
    artifact.annotate("steady/status", status)
    artifact.annotate("steady/residual", found.residual)
    artifact.annotate("steady/n_steps", found.n_steps)
    artifact.annotate("steady/largest_real_part", growth)
    artifact.annotate("timing/steady", seconds)
    text = (
        f"{run}: steady state {status} in {found.n_steps} Newton steps, {1e3 * seconds:.3g} ms: "
        f"residual {found.residual:.2g}, largest real part {growth:.3g} 1/s"
    )
    if found.converged:
        report.info(text)
    else:
        report.warn(text)


def _timed(polynomial: Polynomial, state: Array, amplitude: float) -> tuple[SteadyState, float]:
    seconds = []
    for _ in range(N_TIMED):
        started = time.perf_counter()
        found = steady_state(polynomial, state, amplitude=amplitude)
        seconds.append(time.perf_counter() - started)
    return found, float(np.median(seconds))
