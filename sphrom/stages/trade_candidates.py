"""Which reduced models a trade weighs, and at which values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

from sphrom.case.models import Case
from sphrom.case.plan import basis_size
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, LOCAL, ReducedModelSection
from sphrom.errors import CaseError

Frame = Literal["particles", "reference"]
Projection = Literal["galerkin", "apg"]

PROJECTIONS = {"galerkin": "Galerkin", "apg": "APG"}
"""What people call them."""
SIZES = (2, 5, 10, 20, 50)
"""Modes that are tried where a case doesn't say, as far as the basis goes."""


@dataclass(frozen=True)
class Candidate:
    """A reduced model to weigh."""

    model: ReducedModelSection
    step_factor: float
    """Its time step over the automatic one."""

    @property
    def label(self) -> str:
        """How tables call it."""
        projection = PROJECTIONS[self.model.projection]
        where = "" if self.model.frame == "reference" else ", particles"
        step = "" if self.step_factor == 1.0 else f", dt x{self.step_factor:g}"
        return f"{projection}, M = {self.model.n_modes}{where}{step}"


def trade_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the values at which models are weighed."""
    asked = case.trade.parameters
    if not isinstance(asked, str):
        return tuple(map(ParameterPoint, asked))
    named = {"all": case.points, "train": case.train_points, "test": case.test_points}
    named["auto"] = case.test_points or case.train_points
    return named[asked]


def candidates(case: Case) -> list[Candidate]:
    """Return every combination of reduced models that a case lists."""
    section = case.trade
    return [
        Candidate(_section(case, frame, projection, size), factor)
        for frame in dict.fromkeys(section.frames)
        for projection in dict.fromkeys(section.projections or _projections(case, frame))
        for size, factor in product(
            dict.fromkeys(_sizes(case, frame, projection)), dict.fromkeys(section.step_factors)
        )
    ]


def _sizes(case: Case, frame: Frame, projection: Projection) -> tuple[int, ...]:
    """Return the modes that models have; the closure's operators are there for some alone."""
    closed = _closed_sizes(case)
    if case.trade.n_modes is None and closed and (frame, projection) == ("reference", "apg"):
        return closed
    return case.trade.n_modes or default_sizes(case, SIZES)


def _closed_sizes(case: Case) -> tuple[int, ...]:
    """Return the modes of the case's APG models on the reference points."""
    return tuple(size for name, size in case.memory_models if name == basis_name(case))


def default_sizes(case: Case, sizes: Sequence[int]) -> tuple[int, ...]:
    """Return those of some sizes that the basis has modes for, and all that it has."""
    available = basis_size(case, basis_name(case))
    return (*(size for size in sizes if size < available), available)


def basis_name(case: Case) -> str:
    """Return the basis that the models of a trade use."""
    first = case.rom[0].basis if case.rom else ALL
    return case.trade.basis or (ALL if first == LOCAL else first)


def _projections(case: Case, frame: str) -> Sequence[Projection]:
    return [model.projection for model in case.rom if model.frame == frame] or ["galerkin"]


def _section(case: Case, frame: Frame, projection: Projection, n_modes: int) -> ReducedModelSection:
    return ReducedModelSection(
        name=f"{projection}-{frame}-{n_modes}",
        frame=frame,
        projection=projection,
        n_modes=n_modes,
        basis=basis_name(case),
    )


def with_operators(case: Case) -> Case:
    """Return the case, with a model on the reference points if it has none.

    Raises CaseError when the operators of a case that has some lack what the trade lists.
    """
    listed = [c.model for c in candidates(case) if c.model.frame == "reference"]
    if not listed:
        return case
    known = [model for model in case.rom if model.frame == "reference"]
    if not known:
        return case.model_copy(update={"rom": (*case.rom, *listed)})
    needed = basis_name(case)
    if needed not in case.reference_bases:
        raise CaseError(
            f"trade.basis: no reduced model of the case has frame: reference and basis {needed}, "
            f"so it has no operators; those of {', '.join(case.reference_bases)} are there"
        )
    wanted = {model.n_modes for model in listed if model.projection == "apg"}
    if missing := sorted(wanted.difference(_closed_sizes(case))):
        raise CaseError(
            "trade.projections: apg on the reference points has operators only where a model in "
            "rom has frame: reference, projection: apg and as many modes; there is none with "
            f"{', '.join(map(str, missing))}"
        )
    return case
