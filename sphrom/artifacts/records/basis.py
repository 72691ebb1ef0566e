"""Trial bases."""

from __future__ import annotations

from collections.abc import Mapping

from sphrom.artifacts.declaration import Array, Record, attribute, dataset, part
from sphrom.artifacts.records.trajectory import Medium

STATE_UNIT = "of the inner product's state"


class Modes(Record):
    """The modes of one basis."""

    density: Array = dataset(
        "mode particle", STATE_UNIT, "density part of the modes", "Phi", "Eq. 3.16"
    )
    velocity: Array = dataset(
        "mode particle component", STATE_UNIT, "velocity part of the modes", "Phi", "Eq. 3.16"
    )


class Offset(Record):
    """What was taken out before the decomposition."""

    density: Array = dataset(
        "particle", STATE_UNIT,
        "mean of the state's first field, taken out before the decomposition",
    )
    velocity: Array = dataset(
        "particle component", "m/s", "mean velocity that was taken out before the decomposition"
    )


class OneBasis(Record):
    """One basis, learnt from some training runs."""

    modes: Modes = part()
    offset: Offset | None = part(default=None)
    singular_values: Mapping[str, Array] = dataset(
        "singular_value", "of the inner product", "singular values, descending, by part", "sigma",
        "Eq. 3.16", default_factory=dict,
    )
    train: Array = dataset(
        "training_run parameter", "of the parameters", "parameter values of the training runs",
        "mu", "Eq. 2.17",
    )
    gram_error: float = attribute("1", "largest departure from orthonormality")


class LagrangianBasis(Record):
    """One basis of the snapshots on the moving particles."""

    modes: Modes = part()
    singular_values: Mapping[str, Array] = dataset(
        "singular_value", "of the inner product",
        "singular values of the snapshots on the moving particles", "sigma", "Eq. 3.13",
        default_factory=dict,
    )


class Basis(Medium, kind="sphrom/basis"):
    """Trial bases and their singular values."""

    reference_position: Array = dataset(
        "particle component", "m", "points of the reference space", "x_G", "Eq. 3.14"
    )
    volume: Array = dataset("particle", "m2", "area that each point stands for", "V", "Eq. 3.15")
    mean_density_fluctuation: Mapping[str, Array] = dataset(
        "snapshot",
        "kg/m3",
        "spatial mean of each snapshot of a training run, taken out before the decomposition where "
        "it is carried apart",
        default_factory=dict,
    )
    bases: Mapping[str, OneBasis] = part(at_least_one=True)
    lagrangian: Mapping[str, LagrangianBasis] = part(default_factory=dict)
    lagrangian_position: Array | None = dataset(
        "particle component", "m", "where the particles of the Lagrangian modes started", "x",
        "Eq. 3.13", default=None,
    )
    inner_product: str = attribute("", "inner product of the modes")
