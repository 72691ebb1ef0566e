"""Maps of the extremes of a model: where it is stable, and where it is accurate.

`sphrom trade --extremes` writes the ranges; runs, comparisons and trades read them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sphrom.case.model_sections import AUTO, ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.models.contract import basis_used, family_of
from sphrom.plots.tables import format_figure, read_json
from sphrom.reduction.polynomial_model import EXPONENTIAL, RUNGE_KUTTA
from sphrom.sph.fluid import ROUNDING
from sphrom.store.workspace import Workspace

FILE = "trade/extremes.json"
STEP, TIME, MEMORY = "time step", "time", "memory length"
"""Varied quantities in addition to the parameters and properties of the full model."""
UNITS = {STEP: " s", TIME: " s", MEMORY: " s"}
MOST_ERROR = 2.0
"""Largest error of an accurate run, relative to that of the default."""


@dataclass(frozen=True, kw_only=True)
class StableRange:
    """The ranges of one varied quantity in which a model is stable, and in which it is accurate."""

    varied: str
    kind: str
    projection: str
    n_modes: int | None
    steps: str
    right_from: float | None
    """None if it is accurate nowhere; steps, times and memory lengths are in seconds."""
    right_to: float | None
    stable_from: float | None
    """None if the default is unstable."""
    stable_to: float | None
    least: float
    """The least value that was tried."""
    greatest: float
    below: str
    """The cause of errors or instability below the range; empty if there was none."""
    above: str
    predicted: float | None
    """The largest stable or accurate value by formula, eigenvalue or estimate, if there is one."""
    predicted_by: str

    @property
    def is_unstable(self) -> bool:
        """Whether it is unstable anywhere between the least and the greatest value."""
        return (self.stable_from, self.stable_to) != (self.least, self.greatest)

    @property
    def words(self) -> str:
        """The range of accuracy as part of a sentence."""
        return f"right {self._span(self.right_from, self.right_to)}"

    def _span(self, low: float | None, high: float | None) -> str:
        if low is None or high is None:
            return f"at no {self.varied}"
        ends = f"{format_figure(low)} to {format_figure(high)}"
        return f"for a {self.varied} from {ends}{UNITS.get(self.varied, '')}"

    def says(self, value: float) -> str:
        """Return, in words, why a run at a value may be unstable or inaccurate; else empty."""
        stable, right = (self.stable_from, self.stable_to), (self.right_from, self.right_to)
        for verb, (low, high) in {"stable": stable, "right": right}.items():
            if low is None or high is None:
                return f"according to its map it is {verb} {self._span(low, high)}"
            if not low * (1.0 - ROUNDING) <= value <= high * (1.0 + ROUNDING):
                cause = self.below if value < low else self.above
                tried = f"; beyond: {cause}" if cause else ", and was not tried beyond"
                return f"according to its map it is {verb} {self._span(low, high)}{tried}"
        return ""


def stable_ranges(workspace: Workspace) -> list[StableRange]:
    """Return the ranges of the case's maps; empty without maps, or if they are of another basis.

    Raises ArtifactError if the file is damaged.
    """
    path, made_by = workspace.out / FILE, f"sphrom trade {workspace.context.words} --extremes"
    if not path.is_file():
        return []
    document = read_json(path, made_by, {"ranges": StableRange})
    is_of_basis = document["about"].get("basis") == workspace.basis().inputs_digest
    return list(document["ranges"]) if is_of_basis else []


def against(
    workspace: Workspace, section: ReducedModelSection, point: ParameterPoint
) -> Iterator[str]:
    """Yield the warnings of maps about a run of a model at a parameter point."""
    plan = workspace.case.plan
    n_modes = section.n_modes
    if not (ranges := stable_ranges(workspace)):
        return
    if n_modes == AUTO:
        n_modes = basis_used(workspace, section, point)[1]
    asked = {**point.as_dict(), TIME: plan.model_steps(section).end_time}
    for name, value in ((STEP, section.time_step), (MEMORY, section.memory_length)):
        if isinstance(value, float):
            asked[name] = value
    kind = family_of(workspace.case, section).kind
    for stable in ranges:
        method = RUNGE_KUTTA if stable.varied == STEP else EXPONENTIAL
        applies = stable.kind == kind and stable.projection == section.projection
        applies &= stable.n_modes == n_modes and stable.steps in ("", method)
        if applies and stable.varied in asked and (text := stable.says(asked[stable.varied])):
            yield text
