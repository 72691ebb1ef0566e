"""The reduced models of a trade, and the parameter values at which they run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, LOCAL, ReducedModelSection
from sphrom.errors import CaseError
from sphrom.text import exact

Projection = Literal["galerkin", "apg"]
Evaluation = Literal["particles", "operators"]
Product = Literal["acoustic", "raw"]

PROJECTIONS = {"galerkin": "Galerkin", "apg": "APG"}
"""Their usual names."""
SIZES = (2, 5, 10, 20, 50)
"""Default numbers of modes, as far as the basis has as many."""
MOST_CLOSED_MODES = 20
"""The most modes of APG on the reference points by default: cost grows with their fourth power."""


@dataclass(frozen=True)
class Method:
    """A kind of reduced model, of any size."""

    evaluation: Evaluation
    inner_product: Product
    basis: str
    projection: Projection
    calibrated: bool


@dataclass(frozen=True)
class Candidate:
    """A reduced model to weigh."""

    method: Method
    family: str
    """The name of its method in tables."""
    n_modes: int
    step_factor: float
    """Its time step over the automatic one."""
    points: tuple[ParameterPoint, ...]
    """Where it is run."""

    @property
    def label(self) -> str:
        """How tables call it."""
        step = "" if self.step_factor == 1.0 else f", {exact(self.step_factor)} dt"
        return f"{self.family}, M = {self.n_modes}{step}"

    @property
    def model(self) -> ReducedModelSection:
        """The section of a case that asks for such a model; its time step is left out."""
        method = self.method
        kind = "calibrated" if method.calibrated else method.evaluation
        return ReducedModelSection(
            name=f"{kind}-{method.basis}-{method.projection}-m{self.n_modes}",
            projection=method.projection,
            n_modes=self.n_modes,
            basis=method.basis,
            evaluation=method.evaluation,
            calibrated=method.calibrated,
            parameters=tuple(point.given for point in self.points),
        )


def trade_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the values at which models are weighed."""
    asked = case.trade.parameters
    if not isinstance(asked, str):
        return tuple(map(case.plan.point, asked))
    plan = case.plan
    named = {"all": plan.points, "train": plan.train_points, "test": plan.test_points}
    named["auto"] = plan.test_points or plan.train_points
    return named[asked]


def candidates(case: Case, points: Sequence[ParameterPoint]) -> list[Candidate]:
    """Return every combination of reduced models that a case lists, at parameter points.

    Raises CaseError when a basis has fewer modes than are listed, or there is no local one.
    """
    listed = list(_methods(case))
    return [
        Candidate(method, _family(method, listed), size, factor, tuple(points))
        for method in listed
        for size, factor in product(
            dict.fromkeys(_sizes(case, method, points)), dict.fromkeys(case.trade.step_factors)
        )
    ]


def _methods(case: Case) -> Iterator[Method]:
    """Yield the listed combinations for which there are models."""
    section = case.trade
    products = section.inner_products or (case.basis.inner_product,)
    bases = section.bases or (case.rom[0].basis if case.rom else ALL,)
    for evaluation, inner_product, basis in product(
        dict.fromkeys(section.evaluations), dict.fromkeys(products), dict.fromkeys(bases)
    ):
        for projection in dict.fromkeys(section.projections or _projections(case, evaluation)):
            may_be = (evaluation, projection) == ("operators", "galerkin")
            for calibrated in dict.fromkeys(section.calibrated) if may_be else (False,):
                yield Method(evaluation, inner_product, basis, projection, calibrated)


def _projections(case: Case, evaluation: Evaluation) -> tuple[Projection, ...]:
    if evaluation == "operators":
        return ("galerkin",) if case.plan.driving else ("galerkin", "apg")
    return tuple(model.projection for model in case.rom if model.on_particles) or ("galerkin",)


def _family(method: Method, listed: Sequence[Method]) -> str:
    """Return the name of a method, with the properties in which the listed ones differ."""
    words = PROJECTIONS[method.projection]
    words += ", calibrated" if method.calibrated else ""
    words += ", on particles" if method.evaluation == "particles" else ""
    if len({other.basis for other in listed}) > 1:
        words += f", basis {method.basis}"
    if len({other.inner_product for other in listed}) > 1:
        words += f", {method.inner_product}"
    return words


def _sizes(case: Case, method: Method, points: Sequence[ParameterPoint]) -> Sequence[int]:
    """Return the modes that models of a method have."""
    model = ReducedModelSection(name=method.basis, basis=method.basis)
    available = min(case.plan.basis_size(case.plan.basis_for(model, point)) for point in points)
    if case.trade.n_modes is None:
        closed = (method.evaluation, method.projection) == ("operators", "apg")
        return default_sizes(min(available, MOST_CLOSED_MODES) if closed else available, SIZES)
    if (most := max(case.trade.n_modes)) > available:
        raise CaseError(
            f"trade.n_modes: the basis {method.basis} has {available} modes; got {most}"
        )
    return case.trade.n_modes


def default_sizes(available: int, sizes: Sequence[int]) -> tuple[int, ...]:
    """Return the sizes below the number of modes that a basis has, and that number."""
    return (*(size for size in sizes if size < available), available)


def global_basis(case: Case) -> str:
    """Return the one basis that models have at any value: the first that is listed, or all."""
    first = (*(case.trade.bases or ()), *(model.basis for model in case.rom), ALL)[0]
    return ALL if first == LOCAL else first


def extreme_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the values at which stability is mapped, from the least Reynolds number on.

    Other parameters are those of the training value with the greatest Reynolds number.
    """
    trained = case.plan.bases[global_basis(case)]
    low, high = min(trained).reynolds, max(trained)
    products = (
        f * (low if f < 1.0 else high.reynolds) for f in case.trade.extremes.reynolds_factors
    )
    # Without their rounding errors, which names would show: 220 of 1.1 * 200.
    values = {float(f"{value:.12g}") for value in products}
    return tuple(replace(high, reynolds=value) for value in sorted(values))
