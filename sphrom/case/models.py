"""The case file as one frozen pydantic model, and what follows from its keys.

A model checks each value by itself; what must hold between keys is in `sphrom.case.checks`. Use
`sphrom.case.loader.load_case` to have both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import PrivateAttr, ValidationInfo, model_validator

from sphrom.case.fields import SafeName, Section, key
from sphrom.case.fit import FitSection
from sphrom.case.full_model_sections import (
    DiscretizationSection,
    FluidSection,
    SnapshotSection,
    TimeSection,
)
from sphrom.case.parameters import GivenPoints, ParameterSection
from sphrom.case.points import REYNOLDS, ParameterPoint, Values, nearest_point
from sphrom.case.scenes import DEFAULTS, AnyScene, kind_of, with_defaults
from sphrom.case.sections import (
    ALL,
    AUTO,
    LOCAL,
    BasisSection,
    CompareSection,
    OperatorSection,
    ReducedModelSection,
    ReferenceSection,
    SplineSection,
    SubsetSection,
)
from sphrom.case.sweep import SweepSection
from sphrom.case.trade import TradeSection
from sphrom.case.training import TrainingSection
from sphrom.errors import CaseError
from sphrom.kernels import SUPPORT_RATIO
from sphrom.sph.box_domain import BoxDomain

ROUNDING = 1e-9
"""Slack for what is equal but for rounding."""
MLS_SMOOTHING_LENGTH_RATIO = 2.0
"""Smoothing length of moving least squares over the spacing: they need no wider support."""
MOST_MODELS = 100
"""Reduced models of one case; `trade` weighs others beside them."""
MODES_WITHOUT_ROM = 10
"""Modes to keep when no reduced model asks for any."""
MOST_CHOSEN = 20
"""Modes to keep when a reduced model asks for as many as are best."""


class Case(Section):
    """A case of sphrom: one flow, its full runs, and the reduced models made from them."""

    name: SafeName = key(..., "what its folder under runs/ is called")
    scene: AnyScene = key(
        ..., "geometry with initial and boundary conditions", discriminator="kind"
    )
    fluid: FluidSection = key(FluidSection(), "the fluid")
    discretization: DiscretizationSection = key(
        DiscretizationSection(), "how the fluid is cut into particles"
    )
    time: TimeSection = key(TimeSection(), "how long, and in which steps, the full model runs")
    snapshots: SnapshotSection = key(SnapshotSection(), "which instants are kept")
    parameters: ParameterSection = key(
        ParameterSection(), "values of the parameters to learn from and to predict"
    )
    reference: ReferenceSection = key(
        ReferenceSection(), "points that snapshots are mapped onto (Eq. 3.13-3.15)"
    )
    basis: BasisSection = key(BasisSection(), "the trial basis (Eq. 3.16)")
    psi: SplineSection = key(SplineSection(), "splines of the modes (Eq. 3.17-3.20)")
    operators: OperatorSection = key(
        OperatorSection(), "the projected operators of models on the reference points"
    )
    rom: tuple[ReducedModelSection, ...] = key(
        (ReducedModelSection(name="fast", evaluation="operators"),),
        f"reduced models to run and compare, at most {MOST_MODELS}",
        max_length=MOST_MODELS,
    )
    compare: CompareSection = key(
        CompareSection(), "how reduced and full runs are compared (Eq. 4.1-4.3)"
    )
    trade: TradeSection = key(
        TradeSection(), "the models that `sphrom trade` weighs, speed against accuracy"
    )
    sweep: SweepSection = key(
        SweepSection(), "the values at which `sphrom sweep` runs one model, one or thousands"
    )
    fit: FitSection = key(
        FitSection(), "the parameters that `sphrom fit` looks for, given measurements"
    )
    training: TrainingSection = key(
        TrainingSection(),
        "the region of parameters that `sphrom train` makes a model for; every other key is a "
        "parameter with its least and greatest value, such as reynolds: [50, 1000]",
    )

    _folder: Path = PrivateAttr(Path())

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, values: Any) -> Any:
        """Put the defaults of the kind of scene where no value is given."""
        return with_defaults(values, DEFAULTS.get(kind_of(values), {}))

    @model_validator(mode="after")
    def _with_folder(self, info: ValidationInfo) -> Case:
        # A process may change its own folder, and another one has its own.
        self._folder = Path((info.context or {}).get("folder", Path())).absolute()
        return self

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Case:
        """Return a copy with keys changed, that doesn't know what followed from the old ones."""
        copied = super().model_copy(update=update, deep=deep)
        for name, attribute in vars(Case).items():
            if isinstance(attribute, cached_property):
                copied.__dict__.pop(name, None)
        return copied

    def __eq__(self, other: object) -> bool:
        """Whether all keys have the same values, wherever the case's file is."""
        names = type(self).model_fields
        return type(self) is type(other) and all(
            getattr(self, name) == getattr(other, name) for name in names
        )

    @property
    def folder(self) -> Path:
        """The folder of the case's file, which files that it names are relative to."""
        return self._folder

    @property
    def particle_spacing(self) -> float:
        """dx [m]."""
        return self.scene.resolved_length / self.discretization.resolution

    @property
    def smoothing_length(self) -> float:
        """h [m]."""
        return self.discretization.smoothing_length_ratio * self.particle_spacing

    @property
    def packed(self) -> bool:
        """Whether particles are packed before they start, not on a lattice."""
        if self.discretization.initial_particles == "auto":
            return not self.walls_fit_lattice
        return self.discretization.initial_particles == "packed"

    @property
    def walls_fit_lattice(self) -> bool:
        """Whether the scene has walls that only a lattice of particles fits."""
        return isinstance(self.scene.domain, BoxDomain) and self.scene.domain.has_walls

    @property
    def n_wall_layers(self) -> int:
        """Layers of ghosts behind walls: as asked for, or as far as the kernel reaches."""
        reach = SUPPORT_RATIO * self.discretization.smoothing_length_ratio
        return self.discretization.walls.layers or math.ceil(reach * (1.0 - ROUNDING))

    @cached_property
    def largest_body_force(self) -> float:
        """What the body force's acceleration doesn't exceed in any run [m/s2]."""
        return max(
            self.scene.largest_body_force(self.time.final_time, values) for values in self._settings
        )

    @property
    def has_exact_solution(self) -> bool:
        """Whether an exact solution of the scene is known."""
        return self.scene.has_exact_solution

    @property
    def separate_mean_density(self) -> bool:
        """Whether the mean of the density fluctuation is carried apart from the basis."""
        if self.basis.mean_density != "auto":
            return self.basis.mean_density == "separate"
        closed = not any(self.scene.domain.periodic)
        steady = closed or self.discretization.fixed_volume
        return steady and self.basis.inner_product == "acoustic"

    @property
    def reference_lattice(self) -> bool:
        """Whether the reference points are a lattice."""
        points = self.reference.points
        return points == "lattice" or (points == "initial" and not self.packed)

    @property
    def lattice_splines(self) -> bool:
        """Whether modes are B-splines on a lattice, and not polyharmonic splines by cell."""
        if self.psi.kind != "auto":
            return self.psi.kind == "b-spline"
        return self.reference_lattice and self.scene.domain.fills_box

    @property
    def probe_line(self) -> float:
        """x of the vertical line that runs are compared along [m]."""
        return self.scene.probe_line if self.compare.line is None else self.compare.line

    @property
    def reference_smoothing_length(self) -> float:
        """h of the map onto the reference space [m]."""
        ratio = self.reference.smoothing_length_ratio
        if ratio is not None:
            return ratio * self.particle_spacing
        if self.reference.method == "mls":
            return MLS_SMOOTHING_LENGTH_RATIO * self.particle_spacing
        return self.smoothing_length

    @cached_property
    def max_speed(self) -> float:
        """The largest speed of the flow at any point: the reference, or that of a varied wall."""
        walls = (self.scene.largest_wall_speed(values) for values in self._settings if values)
        return max(self.fluid.reference_speed, *walls, 0.0)

    @property
    def sound_speed(self) -> float:
        """c0 [m/s], the same at all points."""
        return self.max_speed / self.fluid.mach_number

    def kinematic_viscosity(self, point: ParameterPoint) -> float:
        """nu [m2/s] at a parameter point."""
        return self.fluid.reference_speed * self.scene.length_scale / point.reynolds

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """The parameters that points have a value of, the Reynolds number first."""
        section = self.parameters
        return tuple(dict.fromkeys((REYNOLDS, *section.train.names, *section.test.names)))

    @property
    def driving(self) -> tuple[str, ...]:
        """What varies and moves walls or shapes the body force's field: operators have a part."""
        return self.scene.driving(self.parameter_names[1:])

    @property
    def own_values(self) -> dict[str, float]:
        """The values that parameters have where a point doesn't name them."""
        return {
            REYNOLDS: self.parameters.train.reynolds[0],
            **self.scene.parameters(self.fluid.reference_speed),
        }

    def point(self, values: Values) -> ParameterPoint:
        """Return the point of some values by name; others are the scene's own."""
        given = values if isinstance(values, dict) else {REYNOLDS: values}
        own = self.own_values
        reynolds, *others = (
            float(given.get(name, own.get(name, 0.0))) for name in self.parameter_names
        )
        return ParameterPoint(reynolds, tuple(zip(self.parameter_names[1:], others, strict=True)))

    def points_at(
        self, names: tuple[str, ...], rows: Sequence[tuple[float, ...]]
    ) -> tuple[ParameterPoint, ...]:
        """Return the points of many values, each row those of some names."""
        own, known = self.own_values, self.parameter_names
        places = [names.index(name) if name in names else None for name in known]
        values = [
            [float(own.get(name, 0.0) if k is None else row[k]) for row in rows]
            for name, k in zip(known, places, strict=True)
        ]
        others = known[1:]
        return tuple(
            ParameterPoint(reynolds, tuple(zip(others, rest, strict=True)))
            for reynolds, *rest in zip(*values, strict=True)
        )

    def _points_of(self, given: GivenPoints) -> tuple[ParameterPoint, ...]:
        if given.is_list and len(self.parameter_names) == 1:
            return tuple(map(ParameterPoint, given.reynolds))
        return tuple(self.point(v) for v in given.values(self.parameters.train.reynolds))

    @cached_property
    def _settings(self) -> list[dict[str, float]]:
        """What varies beside the viscosity, each combination once."""
        return [dict(others) for others in dict.fromkeys(point.others for point in self.points)]

    @cached_property
    def train_points(self) -> tuple[ParameterPoint, ...]:
        """Where the full model is run to learn from."""
        return self._points_of(self.parameters.train)

    @cached_property
    def test_points(self) -> tuple[ParameterPoint, ...]:
        """Where the full model is run only to check predictions."""
        return self._points_of(self.parameters.test)

    @cached_property
    def points(self) -> tuple[ParameterPoint, ...]:
        """Every point at which the full model is run."""
        return self.train_points + self.test_points

    @cached_property
    def bases(self) -> dict[str, tuple[ParameterPoint, ...]]:
        """The points that each basis learns from, by the basis' name."""
        subsets = {name: self._learnt(subset) for name, subset in self.basis.subsets.items()}
        return {ALL: self.train_points, **subsets}

    def _learnt(self, subset: SubsetSection) -> tuple[ParameterPoint, ...]:
        """Return the training points of a subset; those that aren't there stand for themselves."""
        trained = self.train_points
        if subset.box is not None:
            return tuple(point for point in trained if _in_box(point, subset.bounds))
        values = subset.reynolds or ()
        if len(self.parameter_names) == 1:
            return tuple(map(ParameterPoint, values))
        return tuple(point for point in trained if point.reynolds in values)

    @property
    def boxes(self) -> dict[str, dict[str, tuple[float, float]]]:
        """The ranges of parameters that each subset is the local basis of, by its name."""
        return {name: subset.bounds for name, subset in self.basis.subsets.items()}

    def local_bases(self, point: ParameterPoint) -> list[str]:
        """Return the subsets in whose boxes a point lies.

        Intervals are half-open, [low, high); those that end highest of all hold their end too.
        """
        top: dict[str, float] = {}
        for bounds in self.boxes.values():
            for name, (low, high) in bounds.items():
                if low < high:
                    top[name] = max(high, top.get(name, high))

        def within(bounds: Mapping[str, tuple[float, float]]) -> bool:
            return all(
                low <= value < high or low < value == high == top[name]
                for name, value in point.as_dict().items()
                if name in bounds
                for low, high in (bounds[name],)
            )

        return [name for name, bounds in self.boxes.items() if within(bounds)]

    @property
    def reference_bases(self) -> tuple[str, ...]:
        """The bases that some model on the reference points uses, by name."""
        models = [model for model in self.rom if model.from_operators]
        used = {self.basis_for(m, point) for m in models for point in self.rom_points(m)}
        return tuple(name for name in self.bases if name in used)

    @property
    def models_by_speed(self) -> tuple[ReducedModelSection, ...]:
        """The reduced models, those that are fast by their kind first."""
        return tuple(sorted(self.rom, key=lambda m: (not m.from_operators, m.on_particles)))

    @property
    def memory_models(self) -> tuple[tuple[str, int], ...]:
        """The basis and the modes of every APG model on the reference points, each once."""
        return tuple(
            sorted(
                {
                    (self.basis_for(model, point), model.size)
                    for model in self.rom
                    if model.from_operators and model.has_memory and model.n_modes != AUTO
                    for point in self.rom_points(model)
                }
            )
        )

    @property
    def taught_bases(self) -> tuple[str, ...]:
        """The bases to whose training runs some model is calibrated or corrected, by name.

        With forces, all on points: their calibration needs training runs too.
        """
        if self.scene.measured_walls:
            return self.reference_bases
        used = {
            self.basis_for(model, point)
            for model in self.rom
            for point in self.rom_points(model)
            if model.is_calibrated or self.is_corrected(model, self.basis_for(model, point))
        }
        return tuple(name for name in self.bases if name in used)

    @property
    def sized_bases(self) -> tuple[str, ...]:
        """The bases whose training runs choose the number of modes of some model, by name."""
        used = {
            self.basis_for(model, point)
            for model in self.rom
            if model.n_modes == AUTO
            for point in self.rom_points(model)
        }
        return tuple(name for name in self.bases if name in used)

    def is_corrected(self, model: ReducedModelSection, basis: str) -> bool:
        """Return whether a model's coordinates in a basis are corrected by its training runs."""
        if model.corrected == "auto":
            return model.from_operators and len(self.bases[basis]) > 1
        return model.corrected

    def basis_for(self, model: ReducedModelSection, point: ParameterPoint) -> str:
        """Return the name of the basis that a reduced model uses at a parameter point.

        Raises CaseError when it is to be the local one, and there isn't exactly one.
        """
        if model.basis != LOCAL:
            return model.basis
        found = self.local_bases(point)
        if len(found) != 1:
            raise CaseError(f"basis.subsets: {local_problem(point, found)}")
        return found[0]

    @property
    def n_modes(self) -> int:
        """Modes to keep of each basis, as far as its snapshots allow."""
        asked = (MOST_CHOSEN if m.n_modes == AUTO else m.size for m in self.rom)
        return self.basis.n_modes or max(asked, default=MODES_WITHOUT_ROM)

    def rom_points(self, model: ReducedModelSection) -> tuple[ParameterPoint, ...]:
        """Return the points at which a reduced model is run."""
        named = {"all": self.points, "train": self.train_points, "test": self.test_points}
        if isinstance(model.parameters, str):
            return named[model.parameters]
        return tuple(map(self.point, model.parameters))

    def start_point(self, point: ParameterPoint) -> ParameterPoint:
        """Return the point whose start a run has: its own, or of the nearest trained spin-up.

        A spin-up is run where the full model is; without one the scene is the start anywhere.
        """
        if self.time.spin_up == 0.0 or point in self.points:
            return point
        return nearest_point(point, self.train_points)


def _in_box(point: ParameterPoint, bounds: Mapping[str, tuple[float, float]]) -> bool:
    values = point.as_dict()
    return all(low <= values.get(name, low) <= high for name, (low, high) in bounds.items())


def local_problem(point: ParameterPoint, found: list[str]) -> str:
    """Return why there is no local basis at a point in the intervals of the subsets found."""
    if not found:
        return f"{point.label} lies in the interval of no subset, so it has no local basis"
    return f"{point.label} lies in the intervals of {' and '.join(found)}, so it has no local basis"
