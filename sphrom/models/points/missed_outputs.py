"""The parts of measurements that bases miss, from training runs that are left out of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.reduced_models import TrainedMeasure, WallForce
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import of_loads
from sphrom.models.points.stored import snapshot_times
from sphrom.reduction import held_out
from sphrom.reduction.error_calibration import compared_snapshots, field_of
from sphrom.reduction.held_out import OutputShares, SnapshotProducts
from sphrom.setup.assembly import amplitude_of, scaled_parameters


def output_shares(
    case: Case,
    trained: Sequence[ParameterPoint],
    snapshots: SnapshotProducts,
    forces: Mapping[str, WallForce],
    measures: Mapping[str, TrainedMeasure],
    walls_driven: bool,
    n_modes: int,
) -> dict[str, OutputShares]:
    """Return the shares that bases miss of all measurements, by the name of the measurement.

    Parameters
    ----------
    snapshots : products of the `compared_snapshots` of the training runs.
    walls_driven : whether walls move with the amplitude.
    n_modes : largest number of modes.
    """
    compared = compared_snapshots(case.plan.steps.n_snapshots)
    outputs: dict[tuple[str, str], Array] = {}
    for name, measure in measures.items():
        for quantity, terms in measure.quantities.items():
            values = measure.training[f"training_{quantity}"][:, compared]
            offset = terms[..., 0] + np.multiply.outer(snapshots.means, terms[..., 1])
            outputs[name, quantity] = values.reshape(offset.shape) - offset
    for name, force in forces.items():
        loads = _direct_loads(case, trained, force, snapshots.means, walls_driven)
        of_force = of_loads(loads, case.scene.domain.n_dim)
        outputs |= {(name, quantity): values for quantity, values in of_force.items()}
    if not outputs:
        return {}
    flat = [values.reshape(len(values), -1) for values in outputs.values()]
    widths = [values.shape[1] for values in flat]
    shares = held_out.output_shares(
        snapshots,
        np.concatenate(flat, axis=1),
        np.repeat([field_of(quantity) for _, quantity in outputs], widths),
        scaled_parameters(case, trained),
        n_modes,
    )
    found: dict[str, dict[str, Array]] = {}
    parts = np.split(shares, np.cumsum(widths)[:-1], axis=1)
    for (name, quantity), part in zip(outputs, parts, strict=True):
        shape = len(part), *outputs[name, quantity].shape[1:]
        found.setdefault(name, {})[quantity] = part.reshape(shape)
    return {name: OutputShares(quantities=each) for name, each in found.items()}


def _direct_loads(
    case: Case, trained: Sequence[ParameterPoint], force: WallForce, means: Array, driven: bool
) -> Array:
    """Return recorded loads (n_snapshots, 3) at one viscosity, minus the part without a flow.

    They are zero if they follow from the balance of momentum, which weights errors over the whole
    fluid: errors at the wall then do not count.
    """
    compared = compared_snapshots(case.plan.steps.n_snapshots)
    times = snapshot_times(case)[compared]
    still = np.zeros((len(times), force.n_modes))
    viscosities = [case.plan.kinematic_viscosity(point) for point in trained]
    found = []
    for k, (point, viscosity) in enumerate(zip(trained, viscosities, strict=True)):
        amplitude = amplitude_of(case, point)
        pushes = np.zeros(len(times)) if amplitude is None else amplitude(times)
        local = replace(force, own=None).at(viscosity, driven, point.factors)
        mean = means.reshape(len(trained), -1)[k]
        loads = force.training_loads[k, compared] - local.at(times, still, still, pushes, mean)
        found.append(loads[:, 0] + loads[:, 1] * viscosities[0] / viscosity)
    follows = 0 if force.balance is None else force.balance.follows
    return np.asarray(np.concatenate(found) * (1 - follows))
