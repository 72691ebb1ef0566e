"""Checks of the section `trade` against the rest of a case."""

from __future__ import annotations

from collections.abc import Iterator

from sphrom.case.discretization_checks import check_geometry, check_support
from sphrom.case.messages import nearest
from sphrom.case.models import Case
from sphrom.case.sections import LOCAL
from sphrom.case.yaml_reader import Problem


def check_trade(case: Case) -> Iterator[Problem]:
    """Check that the models to be weighed exist in the case."""
    section = case.trade
    if not isinstance(section.parameters, str):
        for point in map(case.point, section.parameters):
            if point not in case.points:
                yield Problem(
                    ("trade", "parameters"),
                    f"{point.label} is in neither parameters.train nor parameters.test, "
                    "so there is no full run to compare with",
                )
    elif section.parameters == "test" and not case.test_points:
        yield Problem(("trade", "parameters"), "there are no test values")
    if case.driving and "apg" in (section.projections or ()) and "operators" in section.evaluations:
        reason = "apg has operators for the viscosity alone"
        yield Problem(("trade", "projections"), f"{reason}, and {case.driving[0]} varies too")
    for name in section.bases or ():
        if name not in (LOCAL, *case.bases):
            hint = nearest(name, (*case.bases, LOCAL))
            yield Problem(("trade", "bases"), f"no basis has the name {name}; {hint}")
    if section.measure is not None and section.measure not in case.scene.measure:
        known = tuple(case.scene.measure)
        hint = nearest(section.measure, known) if known else "scene.measure is empty"
        reason = f"nothing measured has the name {section.measure}; {hint}"
        yield Problem(("trade", "measure"), reason)
    for size in section.n_modes or ():
        if size > case.n_modes:
            reason = f"the basis keeps {case.n_modes} modes; got {size}; basis.n_modes keeps more"
            yield Problem(("trade", "n_modes"), reason)
    for resolution in section.resolutions or ():
        coarser = at_resolution(case, resolution)
        for problem in (*check_geometry(coarser), *check_support(coarser)):
            yield Problem(("trade", "resolutions"), f"{resolution}: {problem.reason}")


def at_resolution(case: Case, resolution: int) -> Case:
    """Return a case with another resolution."""
    section = case.discretization.model_copy(update={"resolution": resolution})
    return case.model_copy(update={"discretization": section})


def coarser_resolution(case: Case) -> int | None:
    """Return half the resolution, or None where particles would not fit the scene then."""
    half = case.discretization.resolution // 2
    if half < 8:
        return None
    coarser = at_resolution(case, half)
    fits = not any((*check_geometry(coarser), *check_support(coarser)))
    return half if fits else None
