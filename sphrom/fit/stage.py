"""Command `fit`: parameters of a fast model from measured histories."""

from __future__ import annotations

import os
import re
from pathlib import Path

from sphrom.case.fields import NAME_PATTERN
from sphrom.case.messages import show as shown
from sphrom.case.models import Case
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import fit_model, fit_ranges, fit_values, percent
from sphrom.errors import CaseError
from sphrom.fit.estimates import box_of, fit
from sphrom.fit.measurements import read_measurements
from sphrom.fit.report import draw, show, write_fit, write_tables
from sphrom.online.fast_model import FastModel
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace


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
    model = required_model(case)
    share = case.fit.noise if noise is None else percent(noise, "--noise")
    data = read_measurements(Path(measurements), case, case.plan.model_steps(model), share)
    target = workspace.fit(_file_name(name or Path(data.source).stem), data.digest, share)
    must_make = workspace.must_make(target)
    workspace.require(workspace.operators())
    box = box_of(fit_ranges(case, model), fit_values(case))
    found = fit(FastModel(workspace, model), box, data)
    if must_make:
        with workspace.create(target) as artifact:
            write_fit(artifact, found)
        write_tables(workspace, found, target.path)
        draw(found, target.path.with_suffix(".png"))
    show(context.report, found)
    context.report.info(
        f"tables and a figure are in {target.path.with_suffix('')}.csv, .json, .png"
    )


def required_model(case: Case) -> ReducedModelSection:
    """Return the model of a case's fit. Raises CaseError where there is none."""
    model = fit_model(case)
    if model is None:
        raise CaseError("fit.model: no reduced model has evaluation: operators; add one to rom")
    return model


def _file_name(name: str) -> str:
    """Return the name of the files of a fit. Raises CaseError where it is none."""
    if not re.fullmatch(NAME_PATTERN, name):
        raise CaseError(f"{shown(name)} is no name for files; give one with --name")
    return name
