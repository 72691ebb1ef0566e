"""Command `fit`: estimates of a fast model's parameters from measured histories, with intervals."""

from __future__ import annotations

import math
import os
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sphrom.arguments import checked
from sphrom.arrays import Array
from sphrom.artifacts import write_record
from sphrom.artifacts.records import fit as records
from sphrom.artifacts.records.fit import FittedHistory
from sphrom.case import studies
from sphrom.case.fields import NAME_PATTERN
from sphrom.case.points import REYNOLDS
from sphrom.console import Reporter
from sphrom.errors import CaseError, UnstableError
from sphrom.fit.forward_model import (
    FittedModel,
    TrainingDifferences,
    box_of,
    fitted_model,
)
from sphrom.fit.measurements import Measurements, read_measurements
from sphrom.metrics.draws import Z
from sphrom.metrics.estimation import (
    Minimum,
    Uncertainty,
    Weights,
    history_variance,
    minima,
    nearly_as_good,
    uncertainty,
    undetermined_shares,
)
from sphrom.metrics.series import NO_OSCILLATION
from sphrom.models.contract import Ability, Model, family_of, model_of
from sphrom.plots.panels import FORMATS, Curve, Panel, draw_grid, save
from sphrom.plots.tables import format_figure, write_csv
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.text import counted, exact, nearest, quoted

VISCOSITY = "kinematic_viscosity"
UNITS = {VISCOSITY: "m2/s", "reynolds": "-"}
"""Units of estimates; those of other parameters are the case's."""
SHOWN_DIGITS = 5
SURE = 0.999
"""Probability that chi^2 of a correct model and noise stays below the limit for a warning."""
TRUSTED = 4.0
"""Largest part of chi^2 beyond noise, relative to the part that the estimated errors explain."""
MOST_MINIMA = 5
"""Largest number of minima that the search refines with the model's errors."""
WHOLLY = 0.99
"""Share of a parameter in undetermined directions above which it is undetermined."""
SHOWN_SHARE = 0.01
"""The same share, above which it belongs to an undetermined combination."""
MOST_SHOWN = 12
"""Largest number of histories in the terminal and in the figure."""
COLUMNS = 2
"""Columns of panels in the figure."""
NUMBERS = ("value", "standard_deviation", "by_noise", "by_model", "low", "high")
"""The numbers of an estimate, in the order of `Estimate`."""


@dataclass(frozen=True)
class Estimate:
    """The estimate of one parameter, with its 95 % interval from `low` to `high`."""

    parameter: str
    value: float
    standard_deviation: float
    by_noise: float
    """Part of the standard deviation due to noise."""
    by_model: float
    """Part of the standard deviation due to the model's errors."""
    low: float
    high: float
    remark: str
    """The reason why the interval is not valid; empty if it is."""


class Fit(records.Fit):
    """Parameters estimated from measurements, returned by `Model.fit` and stored by `sphrom fit`.

    Arrays of estimates (n_estimates,) follow the order of the free parameters; the Reynolds number
    is followed by the kinematic viscosity [m2/s]. The Fisher matrix is for parameters over their
    ranges, with the logarithm of the Reynolds number.
    """

    def __repr__(self) -> str:
        values = ", ".join(
            f"{e.parameter}={e.value:.5g}±{e.standard_deviation:.2g}" for e in self.estimates
        )
        return f"Fit({self.model!r}, {values}, {counted(len(self.problems), 'problem')})"

    @property
    def free(self) -> tuple[str, ...]:
        """The free parameters, in the order of the rows and columns of matrices."""
        return tuple(self.parameter_names.split(","))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """All estimates, each with its interval."""
        remarks = self.remarks.split(",")
        return tuple(
            Estimate(name, **{n: float(getattr(self, n)[k]) for n in NUMBERS}, remark=remarks[k])
            for k, name in enumerate(self.estimate_names.split(","))
        )

    def __getitem__(self, parameter: str) -> Estimate:
        """Return the estimate of a parameter. Raises CaseError if there is none."""
        known = {estimate.parameter: estimate for estimate in self.estimates}
        if not isinstance(parameter, str) or parameter not in known:
            hint = nearest(str(parameter), known)
            raise CaseError(f"{quoted(parameter)}: is not estimated; {hint}")
        return known[parameter]

    @property
    def histories(self) -> tuple[FittedHistory, ...]:
        """The measured and the fitted histories, in the order of the measurements."""
        return tuple(self.history[str(k)] for k in range(len(self.history)))

    @property
    def problems(self) -> tuple[str, ...]:
        """Warnings about the estimates and their intervals."""
        return tuple(self.warnings.splitlines())

    @checked
    def draw(self, path: str | os.PathLike[str], place: int = 0) -> None:
        """Draw data, fit and interval of every history into a .png or .svg file.

        `place` is the index of the model in the case, which determines its colour.

        Raises CaseError for another kind of file, ArtifactError when it can't be written.
        """
        if Path(path).suffix.lower() not in FORMATS:
            raise CaseError(f"path: must end in {' or '.join(FORMATS)}; got {quoted(str(path))}")
        panels = []
        for history in self.histories[:MOST_SHOWN]:
            curve = history.curve
            ends = np.stack([curve - history.half_width, curve + history.half_width])
            fitted = "fitted model and 95 % interval"
            curves = [
                Curve(fitted, self.time, curve, interval=ends, place=place),
                Curve("measured", history.instant, history.measured, "reference"),
            ]
            panels.append(Panel(history.name, "time [s]", f"[{history.units}]", curves))
        rows = [panels[k : k + COLUMNS] for k in range(0, len(panels), COLUMNS)]
        title = f"{self.model} fitted to {self.measurements}"
        if len(self.history) > MOST_SHOWN:
            title += f", {MOST_SHOWN} of {len(self.history)} histories"
        notes = [textwrap.fill(problem.partition(". ")[0], 100) for problem in self.problems]
        save(draw_grid(rows, title="\n".join([title, *notes])), Path(path))


def run(
    context: StageContext,
    measurements: str | os.PathLike[str] | Mapping[str, ArrayLike] | None = None,
    noise: str | float | None = None,
    name: str | None = None,
) -> None:
    """Estimate parameters, show them, and write them with tables and a figure.

    Parameters
    ----------
    measurements : a CSV file or its columns by name, see `sphrom.fit.measurements`.
    noise : standard deviation over each history's range, such as `1%`; by default the case's.
    name : name of the results; by default that of the measurements.

    Raises CaseError when the measurements can't be read, or the case has no model or no parameter
    to fit, ArtifactError when the operators are missing or another fit has this name, UnstableError
    when the model is unstable at all starts.
    """
    if measurements is None:
        raise CaseError("measurements: are missing; give the name of a CSV file")
    workspace = Workspace(context)
    case = context.case
    model = studies.fast_section(case, case.fit.model)
    if model is None:
        raise CaseError("fit.model: no reduced model has evaluation: operators; add one to rom")
    family_of(case, model).require(Ability.RUNS_ALONE, "fit", model.name)
    share = case.fit.noise if noise is None else studies.percent(noise, "--noise")
    source = Path(measurements) if isinstance(measurements, str | os.PathLike) else measurements
    data = read_measurements(source, case, case.plan.model_steps(model), share)
    name = name or Path(data.source).stem
    if not re.fullmatch(NAME_PATTERN, name):
        raise CaseError(f"{quoted(name)} is not a valid name for files; give one with --name")
    target = workspace.fit(name, data.digest, share)
    must_make = workspace.must_make(target)
    workspace.require(workspace.operators())
    box = box_of(studies.fit_ranges(case, model), studies.fit_values(case, model))
    fitted = fit(model_of(workspace, model), box, data, {})
    if must_make:
        with workspace.create(target) as artifact:
            write_record(artifact, fitted)
        write_csv(target.path.with_suffix(".csv"), fitted.estimates)
        fitted.draw(target.path.with_suffix(".png"), studies.place_of(case, model.name))
    show(context.report, fitted)
    context.report.info(f"a table and a figure are in {target.path.with_suffix('')}.csv, .png")


def show(report: Reporter, fit: Fit) -> None:
    """Show the estimates, their correlation, the histories, and the warnings."""
    report.table(
        f"fit of {fit.model} to {fit.measurements}: 95 % intervals and standard deviations, with "
        "their parts due to noise and to the model's errors",
        ("parameter", "value", "from", "to", "deviation", "noise", "model", "[%]", ""),
        [_shown(estimate) for estimate in fit.estimates],
    )
    if len(fit.free) > 1:
        pairs = zip(fit.free, fit.correlation, strict=True)
        rows = [(name, *(f"{value:.3f}" for value in row)) for name, row in pairs]
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
        f"explain up to {fit.expected_chi_square / dof:.3g}; "
        f"{fit.starts_led_here} of {fit.starts} starts led to this minimum"
    )
    for problem in fit.problems:
        report.warn(problem)


def _shown(estimate: Estimate) -> tuple[str, ...]:
    unit = UNITS.get(estimate.parameter, "")
    name = f"{estimate.parameter} [{unit}]" if unit else estimate.parameter
    values = (estimate.value, estimate.low, estimate.high)
    deviation = estimate.standard_deviation
    share = 100.0 * deviation / abs(estimate.value) if estimate.value else None
    parts = (deviation, estimate.by_noise, estimate.by_model, share)
    shown = *(format_figure(v, SHOWN_DIGITS) for v in values), *(format_figure(p, 2) for p in parts)
    return name, *shown, estimate.remark


def fit(
    fast: Model[Any],
    box: studies.Box,
    measurements: Measurements,
    known: TrainingDifferences,
) -> Fit:
    """Estimate parameters of a model from measured histories.

    Parameters
    ----------
    known : a cache of differences in training runs, shared by fits of the model.

    Raises CaseError unless there are more values than parameters, UnstableError without a start.
    """
    case = fast.workspace.case
    values = measurements.values
    if len(values) <= len(box.names):
        raise CaseError(
            f"{measurements.source}: {len(values)} values can't determine {len(box.names)} "
            f"parameters ({', '.join(box.names)}); give values for some of them in fit.parameters"
        )
    model = fitted_model(fast, box, measurements.histories)
    from scipy.stats import chi2, qmc

    exponent = int(np.ceil(np.log2(case.fit.starts)))
    starts = list(qmc.Sobol(len(box.names), rng=0).random_base2(exponent)[: case.fit.starts])
    model.prepare(starts)
    weights = Weights(measurements.noise, np.zeros((0, len(values))))
    first = minima(model, values, weights, starts)
    if not first:
        still = f", or has {NO_OSCILLATION}," * bool(case.plan.oscillations)
        raise UnstableError(f"{fast.section.name} is unstable{still} at all starts of the search")
    start = first[0].place
    samples = model.error_samples(start, known)
    refined = first
    if samples is not None:
        time = model.times(start)
        errors = np.stack([model.at_instants(time, sample) for sample in samples])
        weights = Weights(measurements.noise, errors)
        refined = minima(model, values, weights, [m.place for m in first[:MOST_MINIMA]]) or first
    best = refined[0]
    likely = nearly_as_good(refined)
    spread = uncertainty(best.derivatives, weights)
    shares = undetermined_shares(likely, weights)
    slopes = box.slopes(best.place)
    dof = len(values) - len(box.names)
    bound = float(chi2.ppf(SURE, dof)) + weights.expected
    doubt = "interval too narrow" * (best.chi_square > bound)
    estimates = list(_estimates(model, best, spread, shares, doubt))
    histories = {str(k): h for k, h in enumerate(_histories(model, best, spread, samples))}
    fitted = Fit(
        **{name: np.array([getattr(e, name) for e in estimates]) for name in NUMBERS},
        covariance=spread.covariance * np.outer(slopes, slopes),
        correlation=spread.correlation,
        eigenvalues=spread.eigenvalues,
        directions=spread.directions,
        time=model.times(best.place),
        history=histories,
        estimate_names=",".join(estimate.parameter for estimate in estimates),
        remarks=",".join(estimate.remark for estimate in estimates),
        parameter_names=",".join(box.names),
        point=model.point(best.place).as_dict(),
        model=fast.section.name,
        measurements=measurements.source,
        warnings="",
        chi_square=best.chi_square,
        expected_chi_square=bound,
        degrees_of_freedom=dof,
        starts_led_here=first[0].n_starts,
        starts=case.fit.starts,
    )
    problems = (
        *_about_the_case(model, samples),
        *_about_the_search(box, likely, shares),
        *_about_the_fit(fitted, weights.expected),
    )
    return replace(fitted, warnings="\n".join(problems))


def _estimates(
    model: FittedModel, best: Minimum, spread: Uncertainty, shares: Array, doubt: str
) -> Iterator[Estimate]:
    box = model.box
    values = model.box.values(best.place)
    slopes = box.slopes(best.place)
    for k, name in enumerate(box.names):
        at_bound = "at its bound" if best.at_bound[k] else doubt
        remark = "not determined" if shares[k] > SHOWN_SHARE else at_bound
        noise, error = (float(slopes[k] * np.sqrt(c[k, k])) for c in (spread.noise, spread.model))
        reach = best.place[k] + spread.half_width[k] * np.array([-1.0, 1.0])
        low, high = (box.value(name, end) for end in np.clip(reach, 0.0, 1.0).tolist())
        deviation = math.hypot(noise, error)
        yield Estimate(name, values[name], deviation, noise, error, low, high, remark)
        if name == REYNOLDS:  # it also determines the viscosity
            point = model.point(best.place)
            viscosity = model.fast.workspace.case.plan.kinematic_viscosity(point)
            share, scale = viscosity / values[name], viscosity * values[name]
            deviation, noise, error = (share * part for part in (deviation, noise, error))
            low, high = scale / high, scale / low
            yield Estimate(VISCOSITY, viscosity, deviation, noise, error, low, high, remark)


def _histories(
    model: FittedModel, best: Minimum, spread: Uncertainty, samples: Array | None
) -> Iterator[FittedHistory]:
    found = model.over_time(best.place)
    assert found is not None  # the search has evaluated this place
    _, curves, slopes = found
    samples = np.zeros((0, *curves.shape)) if samples is None else samples
    ends = np.cumsum([len(history.time) for history in model.histories])
    parts = np.split(best.values, ends[:-1])
    for k, (history, fitted) in enumerate(zip(model.histories, parts, strict=True)):
        variance = history_variance(slopes[:, k], spread, samples[:, :, k])
        yield FittedHistory(
            instant=history.time,
            measured=history.value,
            noise=history.noise,
            fitted=fitted,
            curve=curves[:, k],
            half_width=Z * np.sqrt(variance),
            name=history.name,
            units=history.units,
        )


def _about_the_case(model: FittedModel, samples: Array | None) -> Iterator[str]:
    case = model.fast.workspace.case
    box = model.box
    for name, (low, high) in studies.trained_ranges(case, model.fast.section).items():
        ends = box.ranges[name] if name in box.ranges else (box.fixed[name],)
        if min(ends) < low or max(ends) > high:
            yield (
                f"fit.parameters.{name}: goes beyond the trained range, {exact(low)} to "
                f"{exact(high)}, so the model extrapolates"
            )
    if samples is None:
        yield (
            "intervals include the noise only: the errors of the model need error estimates "
            "(operators.error_estimate) and the full training runs"
        )
    if case.time.spin_up > 0.0:
        yield (
            "runs start from the spin-up of the nearest training run: the fit ignores how the "
            "spin-up changes with the parameters"
        )


def _about_the_search(box: studies.Box, likely: Sequence[Minimum], shares: Array) -> Iterator[str]:
    """Yield warnings about other minima that the noise can't distinguish from the fit."""
    best = likely[0]
    if not best.converged:
        yield "the search has not converged: chi^2 may have a lower minimum"
    combined = [
        name for name, s in zip(box.names, shares, strict=True) if SHOWN_SHARE < s <= WHOLLY
    ]
    for name, share, on_it in zip(box.names, shares, best.at_bound, strict=True):
        if share > WHOLLY or combined == [name]:
            yield f"the data do not determine {name} within its range"
        if on_it:
            value = exact(float(f"{box.values(best.place)[name]:.6g}"))
            yield (
                f"{name} is at the bound of its range, {value}: the best value may be beyond it, "
                "and the intervals are not valid"
            )
    if len(combined) > 1:
        yield f"the data determine only a combination of {' and '.join(combined)}"
    if len(likely) > 1 and shares.min() <= WHOLLY:
        fits = [
            ", ".join(f"{name}={box.values(other.place)[name]:.4g}" for name in box.names)
            for other in likely[1:]
        ]
        yield f"other fits are nearly as good: {'; '.join(fits)}"


def _about_the_fit(fitted: Fit, by_model: float) -> Iterator[str]:
    from scipy.stats import chi2

    dof = fitted.degrees_of_freedom
    ratio = fitted.chi_square / dof
    bound = fitted.expected_chi_square
    if (beyond := fitted.chi_square - bound) > 0.0:
        worst = max(fitted.histories, key=lambda history: history.residual)
        bad = beyond > (TRUSTED - 1.0) * by_model
        larger = "far" if bad else f"{100.0 * (math.sqrt(1.0 + beyond / by_model) - 1.0):.2g} %"
        yield (
            f"{'the fit is bad: ' * bad}chi^2 per degree of freedom is {ratio:.3g}, above the "
            f"{bound / dof:.3g} that noise and the model's errors explain, so the intervals are "
            f"too narrow. Possible reasons: the noise is {worst.residual:.2g} times as large as "
            f"stated, the model's errors are {larger} larger than estimated, or the measured flow "
            f"is not that of the case. {worst.name} fits worst: check its unit, place and noise, "
            "or fit without it"
        )
    elif fitted.chi_square < chi2.ppf(1.0 - SURE, dof):
        yield (
            f"chi^2 per degree of freedom is {ratio:.3g}, so the noise is smaller than stated, or "
            "its values are not independent"
        )
