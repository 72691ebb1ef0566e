"""What fits of parameters to measurements hold."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.runs import TIME
from sphrom.declaration import Record, attribute, dataset, part


class FittedHistory(Record):
    """One measured history beside the fitted model's."""

    instant: Array = dataset("measurement", "s", "when values were measured", "t")
    measured: Array = dataset("measurement", "of the quantity", "measured values")
    noise: Array = dataset("measurement", "of the quantity", "standard deviations of the noise")
    fitted: Array = dataset("measurement", "of the quantity", "values of the fitted model")
    curve: Array = dataset("snapshot", "of the quantity", "the fitted model at its snapshots")
    half_width: Array = dataset(
        "snapshot", "of the quantity",
        "half-width of the 95 % interval about the curve that the flow's own history is in",
    )
    name: str = attribute("", "what was measured, and where the case doesn't name it the place")
    units: str = attribute("", "units of the quantity", at="quantity_units")

    @property
    def residual(self) -> float:
        """Root mean square of the residuals over the noise."""
        return float(np.sqrt(np.mean(((self.measured - self.fitted) / self.noise) ** 2)))


class Fit(Record, kind="sphrom/fit"):
    """Parameters of a model from measured histories, with what is known of them."""

    value: Array = dataset("estimate", "of the parameters", "estimated values", "mu")
    standard_deviation: Array = dataset(
        "estimate", "of the parameters", "standard deviations of the estimates"
    )
    by_noise: Array = dataset(
        "estimate", "of the parameters", "their part by the noise of the measurements"
    )
    by_model: Array = dataset("estimate", "of the parameters", "their part by the model's errors")
    low: Array = dataset("estimate", "of the parameters", "where the 95 % intervals begin")
    high: Array = dataset("estimate", "of the parameters", "where the 95 % intervals end")
    covariance: Array = dataset(
        "parameter parameter", "of the parameters", "covariance of the estimated parameters"
    )
    correlation: Array = dataset("parameter parameter", "1", "their correlation")
    eigenvalues: Array = dataset(
        "parameter", "1", "eigenvalues of the Fisher matrix for parameters over their ranges"
    )
    directions: Array = dataset("parameter parameter", "1", "its eigenvectors, in rows")
    time: Array = dataset("snapshot", *TIME)
    history: Mapping[str, FittedHistory] = part()
    estimate_names: str = attribute("", "names of the estimates, with commas")
    remarks: str = attribute("", "why an interval doesn't hold, of each estimate, with commas")
    parameter_names: str = attribute("", "names of the estimated parameters, with commas")
    point: Mapping[str, float] = attribute(
        "of the parameters", "values of all parameters, known ones too", at="parameters"
    )
    model: str = attribute("", "the fitted model")
    measurements: str = attribute("", "name of the file of measurements")
    warnings: str = attribute(
        "", "what to know before these figures are used, one a line", at="problems"
    )
    chi_square: float = attribute("1", "chi^2 of the fit")
    expected_chi_square: float = attribute(
        "1", "chi^2 that noise, with a probability of 99.9 %, and the model's errors stay below"
    )
    degrees_of_freedom: int = attribute("", "values less estimated parameters")
    starts_led_here: int = attribute("", "starts of the search that led to this fit")
    starts: int = attribute("", "starts of the search")
