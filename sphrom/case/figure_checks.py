"""What the figures of a case show, and whether it is there."""

from __future__ import annotations

from collections.abc import Iterator

from sphrom.case.figures import FULL, ErrorFigure, FieldFigure, ModeFigure, OfModes, OfRuns
from sphrom.case.messages import nearest
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.schema import Path
from sphrom.case.sections import ReducedModelSection
from sphrom.case.yaml_reader import Problem
from sphrom.text import exact

Row = tuple[tuple[ReducedModelSection | None, ...], tuple[ParameterPoint, ...]]
"""The models of a row of panels, None for the full one, and the points at which all are run."""


def rows_of(case: Case, figure: OfRuns) -> list[Row]:
    """Return the models of each row, None for the full one, and the points of its panels."""
    models = {model.name: model for model in case.rom}
    rows = []
    for names in figure.runs:
        row = tuple(None if name == FULL else models[name] for name in names)
        made = [case.points if model is None else case.rom_points(model) for model in row]
        points = tuple(p for p in case.points if all(p in some for some in made))
        if figure.reynolds is not None:
            points = tuple(p for p in points if p.reynolds in figure.reynolds)
        rows.append((row, points))
    return rows


def check_figures(case: Case) -> Iterator[Problem]:
    """Check that what figures show is there."""
    names = [figure.name.casefold() for figure in case.compare.figures]
    for i, figure in enumerate(case.compare.figures):
        path = ("compare", "figures", i)
        if figure.name.casefold() in names[:i]:
            yield Problem((*path, "name"), f"two figures have the name {figure.name}")
        check = _check_modes if isinstance(figure, OfModes) else _check_runs
        yield from check(case, figure, path)  # type: ignore[arg-type]


def _check_modes(case: Case, figure: OfModes, path: Path) -> Iterator[Problem]:
    if figure.basis not in case.bases:
        hint = nearest(figure.basis, list(case.bases))
        yield Problem((*path, "basis"), f"no basis has the name {figure.basis}; {hint}")
    if isinstance(figure, ModeFigure) and max(figure.modes) > case.n_modes:
        yield Problem(
            (*path, "modes"),
            f"must be at most basis.n_modes, {case.n_modes}; got {max(figure.modes)}",
        )


def _check_runs(case: Case, figure: OfRuns, path: Path) -> Iterator[Problem]:
    known = [model.name for model in case.rom]
    if isinstance(figure, FieldFigure):
        known.append(FULL)
    unknown = {name: None for row in figure.runs for name in row if name not in known}
    for name in unknown:
        yield Problem((*path, "runs"), f"no run has the name {name}; {nearest(name, known)}")
    if not unknown:
        yield from _check_values(case, figure, path)
    if not isinstance(figure, ErrorFigure):
        start, end = case.time.spin_up, case.time.final_time
        if not start <= figure.time <= end:
            yield Problem(
                (*path, "time"),
                f"must be within what is recorded, {exact(start)} s to {exact(end)} s; "
                f"got {exact(figure.time)}",
            )


def _check_values(case: Case, figure: OfRuns, path: Path) -> Iterator[Problem]:
    for names, (_, points) in zip(figure.runs, rows_of(case, figure), strict=True):
        runs = " and ".join(names)
        known = {point.reynolds for point in points}
        for value in figure.reynolds or ():
            if value not in known:
                yield Problem(
                    (*path, "reynolds"), f"{runs}: not run at {exact(value)} beside a full run"
                )
        if not figure.reynolds and not points:
            yield Problem((*path, "runs"), f"{runs}: not run at a value beside a full run")
