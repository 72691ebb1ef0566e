"""The contents of fits of parameters to measurements."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.runs import TIME
from sphrom.declaration import Record, attribute, dataset, labelled, part


class FittedHistory(Record):
    """One measured history and that of the fitted model."""

    instant: Array = dataset("measurement", "s", "times of the measured values", "t")
    measured: Array = dataset("measurement", "of the quantity", "measured values")
    noise: Array = dataset("measurement", "of the quantity", "standard deviations of the noise")
    fitted: Array = dataset("measurement", "of the quantity", "values of the fitted model")
    curve: Array = dataset("snapshot", "of the quantity", "the fitted model at its snapshots")
    half_width: Array = dataset(
        "snapshot",
        "of the quantity",
        "half-width of the 95 % interval around the curve, for the true history",
    )
    name: str = attribute("", "measurement, with its place if the case does not name it")
    units: str = attribute("", "units of the quantity", at="quantity_units")

    @property
    def residual(self) -> float:
        """Root mean square of the residuals over the noise."""
        return float(np.sqrt(np.mean(((self.measured - self.fitted) / self.noise) ** 2)))


class Fit(Record, kind="sphrom/fit"):
    """Parameters of a model, estimated from measured histories, with their uncertainty."""

    value: Array = dataset("estimate", "of the parameters", "estimated values", "mu")
    standard_deviation: Array = dataset(
        "estimate", "of the parameters", "standard deviations of the estimates"
    )
    by_noise: Array = dataset(
        "estimate", "of the parameters", "part of the deviations due to measurement noise"
    )
    by_model: Array = dataset(
        "estimate", "of the parameters", "part of the deviations due to model errors"
    )
    low: Array = dataset("estimate", "of the parameters", "lower ends of the 95 % intervals")
    high: Array = dataset("estimate", "of the parameters", "upper ends of the 95 % intervals")
    covariance: Array = dataset(
        "parameter parameter", "of the parameters", "covariance of the estimated parameters"
    )
    correlation: Array = dataset("parameter parameter", "1", "correlation of the estimates")
    eigenvalues: Array = dataset(
        "parameter", "1", "eigenvalues of the Fisher matrix for parameters over their ranges"
    )
    directions: Array = dataset("parameter parameter", "1", "eigenvectors of that matrix, in rows")
    time: Array = labelled("snapshot", TIME)
    history: Mapping[str, FittedHistory] = part()
    estimate_names: str = attribute("", "names of the estimates, separated by commas")
    remarks: str = attribute("", "why an interval is invalid, by estimate, separated by commas")
    parameter_names: str = attribute("", "names of the estimated parameters, separated by commas")
    point: Mapping[str, float] = attribute(
        "of the parameters", "values of all parameters, fixed ones too", at="parameters"
    )
    model: str = attribute("", "the fitted model")
    measurements: str = attribute("", "name of the file of measurements")
    warnings: str = attribute(
        "", "reasons for caution with the results, one per line", at="problems"
    )
    chi_square: float = attribute("1", "chi^2 of the fit")
    expected_chi_square: float = attribute(
        "1", "largest chi^2 that noise, with a probability of 99.9 %, and model errors explain"
    )
    degrees_of_freedom: int = attribute("", "number of values minus that of estimated parameters")
    starts_led_here: int = attribute("", "number of starts of the search that led to this fit")
    starts: int = attribute("", "number of starts of the search")
