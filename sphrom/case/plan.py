"""The plan of a case, `case.plan`: the quantities that follow from its keys, each computed once.

Each part depends only on those before it: the parameter points (`plan_points`), the particles and
flows (`plan_flows`), the time steps (`plan_times`), and here the bases and reduced models. A
quantity is computed at its first use, so checks of a case can use quantities that do not depend on
a wrong key.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property

from sphrom.arrays import Array
from sphrom.case.model_sections import ALL, AUTO, LOCAL, ReducedModelSection
from sphrom.case.plan_times import TimesPlan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import SubsetSection
from sphrom.errors import CaseError
from sphrom.metrics.grids import midpoints
from sphrom.reduction.stream_functions import StreamSpace

MOST_COLUMNS, ROWS_OF_FLUID, LEAST_CELL = 16, 9, 2
"""Splines of a tank: cells along it and along the depth, and smallest cell in spacings."""
COLUMNS_A_CELL = 4
"""Number of columns in each cell of the splines in which the surface is searched."""
HIGHEST_CREST = 1.6
"""The height of the splines' box relative to the depth."""
MOST_TRIED = 12
"""The largest number of modes that `n_modes: auto` tries where the fluid has a free surface."""
MODES_WITHOUT_ROM = 10
"""Number of modes to keep without reduced models."""
MOST_CHOSEN = 20
"""Number of modes to keep when a reduced model chooses its number."""
LEAST_SNAPSHOTS = 3
"""Fewest snapshots per training run for a calibration."""
MOST_ESTIMATED_MODES = 30
"""Largest basis with error estimates by default; their work grows with its fourth power."""


class Plan(TimesPlan):
    """The quantities that follow from the keys of one case."""

    @cached_property
    def bases(self) -> dict[str, tuple[ParameterPoint, ...]]:
        """The training points of each basis, by name."""
        subsets = self._case.basis.subsets
        return {ALL: self.train_points, **{n: self._training_points(s) for n, s in subsets.items()}}

    def _training_points(self, subset: SubsetSection) -> tuple[ParameterPoint, ...]:
        """Return the training points of a subset, including listed ones without a full run."""
        trained = self.train_points
        if subset.box is not None:
            bounds = subset.bounds.items()
            rows = zip(trained, (point.as_dict() for point in trained), strict=True)
            return tuple(p for p, row in rows if all(a <= row[n] <= b for n, (a, b) in bounds))
        values = subset.reynolds or ()
        if len(self.parameter_names) == 1:
            return tuple(map(ParameterPoint, values))
        return tuple(point for point in trained if point.reynolds in values)

    def local_bases(self, point: ParameterPoint) -> list[str]:
        """Return the subsets whose boxes contain a point.

        Intervals are half-open, [low, high); only those with the highest end include their end.
        """
        boxes = {name: subset.bounds for name, subset in self._case.basis.subsets.items()}
        ends = (end for bounds in boxes.values() for end in bounds.items())
        # In sorted order, the highest end of each name comes last.
        top = dict(sorted((name, high) for name, (low, high) in ends if low < high))
        at = point.as_dict()
        return [
            subset
            for subset, bounds in boxes.items()
            if all(
                low <= at[name] < high or low < at[name] == high == top[name]
                for name, (low, high) in bounds.items()
            )
        ]

    @cached_property
    def n_modes(self) -> int:
        """Number of modes to keep of each basis, unless it has fewer snapshots."""
        asked = (MOST_CHOSEN if m.n_modes == AUTO else m.size for m in self._case.rom)
        return self._case.basis.n_modes or max(asked, default=MODES_WITHOUT_ROM)

    def basis_size(self, name: str) -> int:
        """Return the number of modes of a basis, which is limited by its snapshots."""
        return min(self.n_modes, self.n_basis_snapshots(name))

    def n_basis_snapshots(self, name: str) -> int:
        """Return the number of training snapshots of a basis."""
        return len(self.bases[name]) * self.steps.n_snapshots

    def family(self, model: ReducedModelSection | None = None) -> str:
        """Return the name of a reduced model's family; without one, that of the case's stages."""
        if self._scene.has_surface:
            return "surface"
        return "points" if model is None else model.family

    def has_error_estimate(self, name: str) -> bool:
        """Return whether the errors of a basis's models on the reference points are estimated."""
        wanted = self._case.operators.error_estimate
        if self._scene.has_surface:  # others predict each training run
            return wanted is not False and len(self.train_points) > 1
        if wanted == "auto":
            return self.basis_size(name) <= MOST_ESTIMATED_MODES
        return wanted

    def basis_for(self, model: ReducedModelSection, point: ParameterPoint) -> str:
        """Return the name of the basis that a reduced model uses at a parameter point.

        Raises CaseError unless a model with a local basis has exactly one there.
        """
        if model.basis != LOCAL:
            return model.basis
        names = self.local_bases(point)
        if len(names) != 1:
            where = f"the intervals of {' and '.join(names)}" if names else "no subset's interval"
            raise CaseError(f"{point.label} lies in {where}, so it has no unique local basis")
        return names[0]

    def bases_for(self, model: ReducedModelSection) -> list[str]:
        """Return the names of the bases that a reduced model uses at its points, each once."""
        return list(dict.fromkeys(self.basis_for(model, point) for point in self.rom_points(model)))

    def is_corrected(self, model: ReducedModelSection, basis: str) -> bool:
        """Return whether training runs correct a model's coordinates in a basis."""
        if model.corrected == "auto":
            several = len(self.bases[basis]) > 1
            return model.from_operators and several and not model.settles_on_cycles
        return model.corrected

    @cached_property
    def _used(self) -> list[tuple[ReducedModelSection, str]]:
        """All pairs of a reduced model and a basis that it uses."""
        return [(model, basis) for model in self._case.rom for basis in self.bases_for(model)]

    def _in_order(self, used: Iterable[str]) -> tuple[str, ...]:
        names = set(used)
        return tuple(name for name in self.bases if name in names)

    @cached_property
    def reference_bases(self) -> tuple[str, ...]:
        """The names of the bases of models on the reference points."""
        return self._in_order(basis for model, basis in self._used if model.from_operators)

    @cached_property
    def models_by_speed(self) -> tuple[ReducedModelSection, ...]:
        """The reduced models, with those of the faster kind first."""
        return tuple(sorted(self._case.rom, key=lambda model: not model.from_operators))

    @cached_property
    def memory_models(self) -> tuple[tuple[str, int], ...]:
        """The basis and number of modes of all APG models on the reference points, each once."""
        pairs = {
            (basis, model.size)
            for model, basis in self._used
            if model.from_operators and model.has_memory and model.n_modes != AUTO
        }
        return tuple(sorted(pairs))

    @cached_property
    def corrected_bases(self) -> tuple[str, ...]:
        """The names of the bases with a model that their training runs calibrate or correct.

        With measured forces these are all bases on the reference points: forces need them too.
        """
        if self._scene.measured_walls:
            return self.reference_bases
        return self._in_order(
            basis
            for model, basis in self._used
            if model.is_calibrated or self.is_corrected(model, basis)
        )

    @cached_property
    def sized_bases(self) -> tuple[str, ...]:
        """The names of the bases with a model whose number of modes their training runs choose."""
        return self._in_order(basis for model, basis in self._used if model.n_modes == AUTO)

    @cached_property
    def surface_sizes(self) -> tuple[int, ...]:
        """The numbers of modes of models with a free surface, which are trained."""
        models = [m for m in self._case.rom if m.from_operators] * self._scene.has_surface
        auto = range(2, min(self.basis_size(ALL), MOST_TRIED) + 1)
        asked = (auto if model.n_modes == AUTO else (model.size,) for model in models)
        return tuple(sorted({size for sizes in asked for size in sizes}))

    @cached_property
    def stream_space(self) -> StreamSpace:
        """The splines of stream functions in a tank, the same for all runs.

        Their rows resolve the shallowest fluid, and their box holds crests above the deepest.
        """
        domain = self._scene.domain
        depths = [self.depth(point) for point in self.points]
        left, bottom, right, top = (*domain.lower, *domain.upper)
        height = min((right - left) / MOST_COLUMNS, min(depths) / ROWS_OF_FLUID)
        n_rows = math.ceil(min(top - bottom, HIGHEST_CREST * max(depths)) / height)
        n_columns = int((right - left) / (LEAST_CELL * self.particle_spacing))
        return StreamSpace(
            left=left,
            right=right,
            bottom=bottom,
            top=min(top, bottom + n_rows * height),
            n_columns=min(MOST_COLUMNS, n_columns),
            n_rows=n_rows,
        )

    @property
    def map_settings(self) -> dict[str, object]:
        """The settings of maps of full runs that are not keys of the case."""
        return {"space": vars(self.stream_space)} if self._scene.has_surface else {}

    @property
    def relaxed_points(self) -> bool:
        """Whether the points of the reference space are the last particles of a full run."""
        return self._case.reference.points == "relaxed" and not self._scene.has_surface

    @cached_property
    def surface_columns(self) -> Array:
        """The midpoints (n_columns,) [m] of the columns where surfaces are looked for."""
        space = self.stream_space
        return midpoints(space.left, space.right, COLUMNS_A_CELL * space.n_columns)
