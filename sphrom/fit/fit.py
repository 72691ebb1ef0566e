"""Command `fit`: parameters of a fast model from measured histories; what it shows and writes."""

from __future__ import annotations

import os
import re
from pathlib import Path

from sphrom.artifacts import write_record
from sphrom.case.fields import NAME_PATTERN
from sphrom.case.studies import fast_model, fit_ranges, fit_values, percent
from sphrom.console import Reporter
from sphrom.errors import CaseError
from sphrom.fit.estimates import MOST_SHOWN, Estimate, Fit, box_of, fit
from sphrom.fit.measurements import read_measurements
from sphrom.online.fast_model import FastModel
from sphrom.plots.tables import format_figure, write_csv
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.text import quoted

UNITS = {"kinematic_viscosity": "m2/s", "reynolds": "-"}
"""Of estimates; others are as the case has them."""
SHOWN_DIGITS = 5


def run(
    context: StageContext,
    measurements: str | os.PathLike[str] | None = None,
    noise: str | float | None = None,
    name: str | None = None,
) -> None:
    """Estimate parameters, show them, and write them with tables and a figure.

    Parameters
    ----------
    measurements : a CSV file, see `sphrom.fit.measurements`.
    noise : standard deviation over each history's range, such as `1%`; None is the case's.
    name : of the files; None is that of the measurements.

    Raises
    ------
    CaseError
        When the measurements can't be read, or the case has no model or no parameter to fit.
    ArtifactError
        When the operators are missing, or there is another fit of this name.
    UnstableError
        When the model is unstable at all starts.
    """
    if measurements is None:
        raise CaseError("measurements: a fit needs some; give the name of a CSV file")
    workspace, case = Workspace(context), context.case
    model = fast_model(case, case.fit.model)
    if model is None:
        raise CaseError("fit.model: no reduced model has evaluation: operators; add one to rom")
    share = case.fit.noise if noise is None else percent(noise, "--noise")
    data = read_measurements(Path(measurements), case, case.plan.model_steps(model), share)
    name = name or Path(data.source).stem
    if not re.fullmatch(NAME_PATTERN, name):
        raise CaseError(f"{quoted(name)} is no name for files; give one with --name")
    target = workspace.fit(name, data.digest, share)
    must_make = workspace.must_make(target)
    workspace.require(workspace.operators())
    box = box_of(fit_ranges(case, model), fit_values(case))
    found = fit(FastModel(workspace, model), box, data)
    if must_make:
        with workspace.create(target) as artifact:
            write_record(artifact, found)
        write_csv(target.path.with_suffix(".csv"), found.estimates)
        found.draw(target.path.with_suffix(".png"))
    show(context.report, found)
    context.report.info(f"a table and a figure are in {target.path.with_suffix('')}.csv, .png")


def show(report: Reporter, fit: Fit) -> None:
    """Show the estimates, their correlation, the histories, and what is wrong with them."""
    report.table(
        f"fit of {fit.model} to {fit.measurements}: 95 % intervals and standard deviations, of "
        "which the noise and the model's errors are parts",
        ("parameter", "value", "from", "to", "deviation", "noise", "model", "[%]", ""),
        [_shown(each) for each in fit.estimates],
    )
    if len(fit.free) > 1:
        rows = [
            (name, *(f"{value:.3f}" for value in row))
            for name, row in zip(fit.free, fit.correlation, strict=True)
        ]
        report.table("correlation", ("", *fit.free), rows)
    shown = fit.histories[:MOST_SHOWN]
    report.table(
        f"histories, {len(shown)} of {len(fit.histories)}",
        ("history", "units", "values", "noise", "residual over noise"),
        [
            (h.name, h.units, str(len(h.fitted)), *map(format_figure, (h.noise.mean(), h.residual)))
            for h in shown
        ],
    )
    dof = fit.degrees_of_freedom
    report.info(
        f"chi^2 per degree of freedom is {fit.chi_square / dof:.3g}; noise and the model's errors "
        f"explain up to {fit.expected_chi_square / dof:.3g}; {fit.starts_led_here} of {fit.starts} "
        "starts led here"
    )
    for problem in fit.problems:
        report.warn(problem)


def _shown(estimate: Estimate) -> tuple[str, ...]:
    unit = UNITS.get(estimate.parameter, "")
    name = f"{estimate.parameter} [{unit}]" if unit else estimate.parameter
    values = (estimate.value, estimate.low, estimate.high)
    parts = (estimate.standard_deviation, estimate.by_noise, estimate.by_model)
    share = 100.0 * estimate.standard_deviation / abs(estimate.value) if estimate.value else None
    return (
        name,
        *(format_figure(value, SHOWN_DIGITS) for value in values),
        *(format_figure(part, 2) for part in parts),
        format_figure(share, 2),
        estimate.remark,
    )
