"""Limits of models on the reference space: the map, and the best states of a basis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sphrom.artifacts import Artifact
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Probes, Samples
from sphrom.models.contract import (
    ALONE,
    Ability,
    Limit,
    Measured,
    basis_used,
    best_name,
    family_of,
)
from sphrom.models.reference.stored import expand, read_values, read_whole
from sphrom.models.stored_run import OWN_PRESSURE
from sphrom.reduction.mode_splines import Values
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.reduction.trial_basis import TrialBasis, mean_density_fluctuation, project, reconstruct
from sphrom.setup.particles import MeasuredFields, sampler
from sphrom.sph.fluid import pressure_of
from sphrom.store.workspace import Workspace

LEAST_SHARE = 1e-10
"""Relative size of a combination of modes that contains nothing of a field."""


def limits(
    workspace: Workspace,
    models: Sequence[ReducedModelSection],
    point: ParameterPoint,
    probes: Probes,
) -> Iterator[Limit]:
    """Yield the mapped snapshots, and the best states in each basis."""
    case = workspace.case
    with workspace.open(workspace.mapped(point)) as mapped:
        samples = sample_mapped(case, mapped, sampler(case, probes.all))
        yield Limit("map", samples, measured=measured_of_map(case, mapped))
        used: dict[tuple[str, int], ReducedModelSection | None] = {}
        with_own = set()
        for model in models:
            key = basis_used(workspace, model, point)
            with workspace.open(workspace.reduced_run(model, point)) as run:
                if OWN_PRESSURE in run:
                    with_own.add(key)
            # Models with equations compute measurements from their coordinates.
            if family_of(case, model).can(Ability.EQUATIONS) and case.scene.measure:
                used[key] = model
            used.setdefault(key, None)
        for (name, size), measuring in sorted(used.items(), key=lambda pair: pair[0]):
            own = (name, size) in with_own
            whole = read_whole(workspace, name, size, own_pressure=own)
            values = read_values(workspace, name, size, own_pressure=own)
            both, alone = sample_best(case, mapped, whole, values, probes, size)
            measured = None
            if measuring is not None:
                measured = measured_of_best(workspace, measuring, point, mapped)
            yield Limit(best_name(name, size), both, name, size, measured)
            yield Limit(f"{ALONE}, {name} M={size}", alone, name, size)


def measured_at(workspace: Workspace, point: ParameterPoint) -> Measured:
    """Return no measurements, because there are none besides those of the case."""
    return {}


def sample_mapped(case: Case, mapped: Artifact, sample: ReferenceMap) -> Samples:
    """Sample mapped snapshots; they contain only the error of the map."""
    position = mapped.read("reference_position")
    snapshots = zip(mapped.dataset("density_fluctuation"), mapped.dataset("velocity"), strict=True)
    fields = [sample(position, density, velocity) for density, velocity in snapshots]
    density, velocity = map(np.array, zip(*fields, strict=True))
    return Samples(mapped.read("time"), velocity, pressure_of(density, case.plan.sound_speed))


def sample_best(
    case: Case,
    mapped: Artifact,
    whole: TrialBasis,
    values: Values,
    probes: Probes,
    n_modes: int,
) -> tuple[Samples, Samples]:
    """Sample the best approximations of mapped snapshots in a basis: of states, and of each field.

    The first result is the projection of states in the inner product of the basis. A model's own
    pressure modes represent the pressure that the projection lacks. In the second result each field
    has coordinates of its own, so no state with these modes is closer in either field.

    Parameters
    ----------
    whole : `n_modes` modes, then those of the pressure alone, which are orthonormal.
    values : of these modes.
    """
    densities = mapped.dataset("density_fluctuation")
    velocities = mapped.dataset("velocity")
    snapshots = zip(densities, velocities, strict=True)
    # Where modes hold the mean density, a state of none has coordinates too: they count once.
    rest = project(whole, 0.0 * densities[0], 0.0 * velocities[0])
    parts = [(project(whole, d, 0.0 * v), project(whole, 0.0 * d, v) - rest) for d, v in snapshots]
    by_density, by_velocity = (np.array(part) for part in zip(*parts, strict=True))
    share = (whole.density_modes * whole.weights) @ whole.density_modes.T
    moving = np.zeros_like(share)
    moving[:n_modes, :n_modes] = np.eye(n_modes) - share[:n_modes, :n_modes]
    alone = [
        np.linalg.lstsq(gram, part.T, LEAST_SHARE)[0].T
        for gram, part in ((share, by_density), (moving, by_velocity))
    ]
    nearest = by_density + by_velocity
    nearest[:, n_modes:] -= nearest[:, :n_modes] @ share[:n_modes, n_modes:]
    means = np.array([mean_density_fluctuation(whole, density) for density in densities])
    times = mapped.read("time")
    both, density, velocity = (
        expand(case, whole, values, probes.all, times, coordinates, means)
        for coordinates in (nearest, *alone)
    )
    return both, replace(density, velocity=velocity.velocity)


def measured_of_map(case: Case, mapped: Artifact) -> Measured:
    """Measure the fields of mapped snapshots, which have no forces."""
    measure = MeasuredFields.of(case)
    if measure is None:
        return {}
    position = mapped.read("reference_position")
    states = zip(mapped.dataset("density_fluctuation"), mapped.dataset("velocity"), strict=True)
    snapshots = [measure(position, *map(np.asarray, state)) for state in states]
    return {
        name: {quantity: np.array([one[name][quantity] for one in snapshots]) for quantity in first}
        for name, first in snapshots[0].items()
    }


def measured_of_best(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint, mapped: Artifact
) -> Measured:
    """Measure the states of a model's basis nearest to the mapped ones, with its operators."""
    from sphrom.models.points.fast_model import FastModel
    from sphrom.models.points.quantities import quantities_of

    fast = FastModel(workspace, model)
    time = mapped.read("time")
    reduced = fast.at(point)
    density = mapped.read("density_fluctuation")
    coordinates = project(reduced.basis, density, mapped.read("velocity"))
    mean = mean_density_fluctuation(reduced.basis, density)
    whole = fast.at_point(point).whole
    missed = density - reconstruct(reduced.basis, coordinates, mean)[0]
    own = project(whole, missed, np.zeros((*missed.shape, whole.n_dim)))[:, reduced.basis.n_modes :]
    return quantities_of(workspace.case, reduced, time, coordinates, mean, own)
