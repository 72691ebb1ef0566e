"""The outputs of a sweep as arrays of all runs, with the model's estimated errors.

The estimates are root mean squares over the fluid, of the velocity e_u and of the pressure. At a
probe, and along a line, they stand for the error there. A flow rate is off by the section's length
times e_u. With U the root mean square of the velocity and M the mass, the kinetic energy
M U^2 / 2 is off by at most M (U e_u + e_u^2 / 2). No error of forces is estimated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.metrics.measures import UNITS, components
from sphrom.store.sweep import RunResult

Array = NDArray[np.float64]

FINAL = "final_"
"""What begins the names of quantities along lines, at the end of runs."""
TIME, LINE = "time", "line"


@dataclass(frozen=True)
class Output:
    """What all runs give, over time or along a line at their end."""

    name: str
    unit: str
    along: str
    """TIME or LINE."""
    values: Array
    """(n_runs, n_instants)."""
    errors: Array | None
    """(n_runs, n_instants) estimated, None where no error is known."""


@dataclass(frozen=True)
class _Errors:
    """Estimated errors of velocity and pressure (n_runs, n_snapshots), None without."""

    velocity: Array | None
    pressure: Array | None

    def of(self, quantity: str) -> Array | None:
        return {"velocity": self.velocity, "pressure": self.pressure}.get(quantity)


def outputs_of(case: Case, results: Sequence[RunResult]) -> list[Output]:
    """Return the outputs of complete runs: kinetic energy, probes, and what the case measures."""
    found = [result.errors.over_time for result in results if result.errors is not None]
    over_time = [each for each in found if each is not None]
    errors = _Errors(None, None)
    if len(over_time) == len(results):
        stacked = np.stack(over_time)
        errors = _Errors(stacked[:, 0], stacked[:, 1])
    return [
        *_energies(case, results, errors),
        *_probes(results, errors),
        *_measured(case, results, errors),
    ]


def _energies(case: Case, results: Sequence[RunResult], errors: _Errors) -> Iterator[Output]:
    energies = [result.energies for result in results if result.energies is not None]
    if len(energies) < len(results):
        return
    values, wrong = np.stack(energies), None
    if errors.velocity is not None:
        mass = case.plan.mass * case.plan.n_particles
        speed = np.sqrt(2.0 * values / mass)
        wrong = mass * (speed * errors.velocity + 0.5 * errors.velocity**2)
    yield Output("kinetic_energy", "J/m", TIME, values, wrong)


def _probes(results: Sequence[RunResult], errors: _Errors) -> Iterator[Output]:
    velocities = [r.probe_velocity for r in results if r.probe_velocity is not None]
    pressures = [r.probe_pressure for r in results if r.probe_pressure is not None]
    if len(velocities) < len(results) or len(pressures) < len(results):
        return
    velocity, pressure = np.stack(velocities), np.stack(pressures)
    for k in range(pressure.shape[2]):
        name = f"probe{k + 1}"
        for i, component in enumerate("uv"):
            yield Output(f"{name}_{component}", "m/s", TIME, velocity[:, :, k, i], errors.velocity)
        yield Output(f"{name}_pressure", "Pa", TIME, pressure[:, :, k], errors.pressure)


def _measured(case: Case, results: Sequence[RunResult], errors: _Errors) -> Iterator[Output]:
    for name, section in case.scene.measure.items():
        if not all(name in result.measured for result in results):
            continue
        length = 0.0
        if section.flow_rate is not None:
            length = math.dist(section.flow_rate.start, section.flow_rate.end)
        for quantity in results[0].measured[name]:
            stacked = np.stack([result.measured[name][quantity] for result in results])
            kind = quantity.removeprefix(FINAL)
            along = LINE if quantity.startswith(FINAL) else TIME
            wrong = errors.of(kind)
            if kind == "flow_rate" and errors.velocity is not None:
                wrong = length * errors.velocity
            for component, values in components(kind, stacked).items():
                if along == LINE and wrong is not None:
                    wrong = np.broadcast_to(wrong[:, -1:], values.shape)
                head = FINAL if along == LINE else ""
                yield Output(f"{name}_{head}{component}", UNITS[kind], along, values, wrong)
