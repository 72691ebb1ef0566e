"""Parameter estimation by least squares from measured values, and the uncertainty of estimates.

The measured values y_i have independent noise of standard deviation sigma_i. At parameters x, a
place in the unit box, the model gives g_i(x). The model's own errors d are known by samples d_k,
k = 1 to K. They are correlated in time and space, so unlike noise they do not average out with more
data. They are treated as normally distributed with mean zero and the covariance of the samples (the
approximation errors of Kaipio and Somersalo 2007, J. Comput. Appl. Math. 198, 493-504), so that the
estimate minimises

    chi^2(x) = (y - g)^T S^-1 (y - g),    S = diag(sigma^2) + 1/K sum_k d_k d_k^T,

by a trust-region Levenberg-Marquardt method within the box, from several starts. With J = dg/dx at
the minimum, the Fisher matrix is F = J^T S^-1 J. To first order the estimate differs from the truth
by G (noise + d) with the gain G = F^-1 J^T S^-1. Its covariance is

    C = G diag(sigma^2) G^T + 1/K sum_k b_k b_k^T,    b_k = G_k d_k.

G_k is the gain without sample k, so b_k is the error of an estimate that did not know this model
error. K is small. The half-widths of intervals are therefore those of Student's distribution with
K (variance / variance of the samples)^2 degrees of freedom (Welch and Satterthwaite). The expected
chi^2 is that of the noise plus the mean over k of the chi^2 of d_k, in weights without sample k.

Along an eigenvector of F with too small an eigenvalue the data determine nothing; the standard
deviation there is at most the width of the box. Such minima form a valley, and the end of a search
depends on its start. Equally good minima are therefore ordered by their starts rather than by
rounding differences of chi^2, and all of them show which parameters are not determined.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.metrics.draws import CONFIDENCE

Model = Callable[[Array], tuple[Array, Array] | None]
"""Returns values (n_values,) and derivatives (n_values, n_parameters) at a place in the unit box
(n_parameters,), or None if the model has no values there."""

UNDETERMINED = 0.5
"""Standard deviation along a direction, over the box's width, that counts as undetermined."""
AT_BOUND = 1e-4
"""Largest distance of an estimate on a bound of the box, over the box's width."""
SAME = 1e-3
"""Largest distance of equal minima, over the box's width."""
EQUAL = 1e-3
"""Increase of chi^2 up to which fits are equally good; that of the earliest start is preferred."""
NEARLY = 9.0
"""Increase of chi^2, three standard deviations, up to which noise may explain a worse fit."""
MARGIN = 0.01
"""Distance of starts from the bounds, over the box's width."""
TOLERANCE = 1e-9
"""Tolerance of the search: relative changes of chi^2 and the place, norm of the gradient."""
NOWHERE = 1e8
"""Weighted residual where the model has no values."""
MOST_EVALUATIONS = 100
"""Largest number of evaluations of the model from one start."""


@dataclass(frozen=True)
class Weights:
    """The inverse square root of the covariance S of noise and model errors."""

    deviation: Array
    """(n_values,) of the noise."""
    samples: Array
    """(n_samples, n_values) of the model's errors; empty if they are unknown."""

    def __call__(self, values: Array) -> Array:
        """Return values (n_values, ...) times the inverse root, which have unit covariance."""
        shape = (-1,) + (1,) * (values.ndim - 1)
        scaled = values / self.deviation.reshape(shape)
        if not len(self.samples):
            return scaled
        errors = self.samples / self.deviation / np.sqrt(len(self.samples))
        # The principal axes of the samples, and the factors that reduce values along them.
        _, sizes, modes = np.linalg.svd(errors, full_matrices=False)
        shares = 1.0 - 1.0 / np.sqrt(1.0 + sizes**2)
        along = np.tensordot(modes, scaled, 1)
        return np.asarray(scaled - np.tensordot(modes.T, shares.reshape(shape) * along, 1))

    def without(self, k: int) -> Weights:
        """Return the weights without sample k."""
        return replace(self, samples=np.delete(self.samples, k, axis=0))

    def gain(self, derivatives: Array) -> Array:
        """Return G (n_parameters, n_values) for derivatives (n_values, n_parameters)."""
        weighted = self(derivatives)
        inverse, _, _ = _inverse(weighted.T @ weighted)
        # The inverse root is symmetric except for the deviations that are applied first.
        twice = Weights(np.ones(len(self.deviation)), self.samples / self.deviation)(weighted)
        return inverse @ (twice / self.deviation[:, None]).T

    @property
    def expected(self) -> float:
        """The expected chi^2 due to the model's errors, by leaving out one sample at a time."""
        n = len(self.samples)
        each = [np.sum(self.without(k)(self.samples[k]) ** 2) for k in range(n)]
        return float(np.mean(each)) if n else 0.0


def _inverse(fisher: Array) -> tuple[Array, Array, Array]:
    """Return a Fisher matrix's inverse, bounded by the box, its eigenvalues and vectors (rows)."""
    eigenvalues, vectors = np.linalg.eigh(fisher)
    inverse = (vectors / np.maximum(eigenvalues, 1.0)) @ vectors.T
    return inverse, np.maximum(eigenvalues, 0.0), vectors.T


@dataclass(frozen=True, eq=False)
class Minimum:
    """The end point of searches from one or several starts."""

    place: Array
    """(n_parameters,) in the unit box."""
    chi_square: float
    values: Array
    """(n_values,) of the model."""
    derivatives: Array
    """(n_values, n_parameters)."""
    converged: bool
    n_starts: int = 1
    """Number of starts that led here."""

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(n_parameters,) whether each parameter is on a bound of the box."""
        return np.asarray(np.minimum(self.place, 1.0 - self.place) < AT_BOUND)


def minima(model: Model, values: Array, weights: Weights, starts: Sequence[Array]) -> list[Minimum]:
    """Return the minima of chi^2 found from starts in the unit box, the least first.

    Equally good minima are in the order of their starts.

    Parameters
    ----------
    values : (n_values,) the data.
    starts : (n_parameters,) each; starts at which the model has no values are left out.
    """
    found: list[Minimum] = []
    for start in starts:
        if (minimum := _minimum(model, values, weights, start)) is not None:
            found = _with(found, minimum)
    ranked: list[Minimum] = []
    while len(ranked) < len(found):
        rest = [minimum for minimum in found if minimum not in ranked]
        most = min(minimum.chi_square for minimum in rest) + EQUAL
        ranked += [minimum for minimum in rest if minimum.chi_square <= most]
    return ranked


def _with(known: Sequence[Minimum], new: Minimum) -> list[Minimum]:
    """Return minima with a new one added, or merged with the one that it equals."""
    for k, each in enumerate(known):
        if np.abs(each.place - new.place).max() < SAME:
            better = new if new.chi_square < each.chi_square - EQUAL else each
            both = replace(better, n_starts=each.n_starts + new.n_starts)
            return [*known[:k], both, *known[k + 1 :]]
    return [*known, new]


def _minimum(model: Model, values: Array, weights: Weights, start: Array) -> Minimum | None:
    from scipy.optimize import least_squares  # importing it takes long

    @lru_cache(maxsize=1)
    def at(place: bytes) -> tuple[Array, Array] | None:
        return model(np.frombuffer(place))

    def residuals(place: Array) -> Array:
        found = at(place.tobytes())
        return np.full(len(values), NOWHERE) if found is None else weights(found[0] - values)

    def slopes(place: Array) -> Array:
        found = at(place.tobytes())
        return np.zeros((len(values), len(place))) if found is None else weights(found[1])

    inside = np.clip(start, MARGIN, 1.0 - MARGIN)
    if at(inside.tobytes()) is None:
        return None
    accuracy = dict.fromkeys(("ftol", "xtol", "gtol"), TOLERANCE)
    search = least_squares(
        residuals, inside, slopes, bounds=(0.0, 1.0), max_nfev=MOST_EVALUATIONS, **accuracy
    )
    ended = at(search.x.tobytes())
    if ended is None:
        return None
    return Minimum(
        place=search.x,
        chi_square=2.0 * float(search.cost),
        values=ended[0],
        derivatives=ended[1],
        converged=search.status > 0,
    )


@dataclass(frozen=True)
class Uncertainty:
    """The uncertainty of an estimate, in the unit box."""

    noise: Array
    """(n_parameters, n_parameters) covariance due to the noise."""
    model: Array
    """(n_parameters, n_parameters) covariance due to the model's errors."""
    half_width: Array
    """(n_parameters,) of the 95 % intervals."""
    eigenvalues: Array
    """(n_parameters,) of the Fisher matrix, ascending."""
    directions: Array
    """(n_parameters, n_parameters) its eigenvectors, in rows."""
    biases: Array
    """(n_samples, n_parameters) b_k."""

    @property
    def covariance(self) -> Array:
        """(n_parameters, n_parameters) of the estimate."""
        return self.noise + self.model

    @property
    def correlation(self) -> Array:
        """(n_parameters, n_parameters) of the estimate."""
        deviation = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(deviation, deviation))

    @property
    def undetermined(self) -> Array:
        """(n_parameters, n_parameters) projection onto directions the data do not determine."""
        directions = self.directions[self.eigenvalues * UNDETERMINED**2 < 1.0]
        return np.asarray(directions.T @ directions)


def uncertainty(derivatives: Array, weights: Weights) -> Uncertainty:
    """Return the uncertainty of an estimate with derivatives (n_values, n_parameters)."""
    weighted = weights(derivatives)
    n_samples = len(weights.samples)
    _, eigenvalues, directions = _inverse(weighted.T @ weighted)
    gain = weights.gain(derivatives)
    noise = (gain * weights.deviation**2) @ gain.T
    # A direction that the data do not determine has the uncertainty of the box's width.
    noise += (directions.T * np.maximum(0.0, 1.0 - eigenvalues)) @ directions
    biases = np.array(
        [weights.without(k).gain(derivatives) @ weights.samples[k] for k in range(n_samples)]
    ).reshape(n_samples, derivatives.shape[1])
    model = biases.T @ biases / max(1, n_samples)
    half_width = _half_width(np.diag(noise), np.diag(model), n_samples)
    return Uncertainty(noise, model, half_width, eigenvalues, directions, biases)


def nearly_as_good(found: Sequence[Minimum]) -> list[Minimum]:
    """Return the minima, including the first, whose difference from the first may be noise."""
    return [minimum for minimum in found if minimum.chi_square <= found[0].chi_square + NEARLY]


def undetermined_shares(found: Sequence[Minimum], weights: Weights) -> Array:
    """Return the shares (n_parameters,) of parameters in the undetermined directions.

    They are squared cosines: one for a parameter that is not determined at all. They are averaged
    over the minima `found`, weighted by their likelihood.
    """
    likelihood = np.exp([0.5 * (found[0].chi_square - each.chi_square) for each in found])
    shares = [np.diag(uncertainty(each.derivatives, weights).undetermined) for each in found]
    return np.asarray(np.average(shares, axis=0, weights=likelihood))


def _half_width(known: Array, sampled: Array, n_samples: int) -> Array:
    """Return half-widths of intervals from known variances and those of some samples."""
    from scipy.stats import t

    whole = known + sampled
    with np.errstate(divide="ignore"):
        freedom = n_samples * (whole / sampled) ** 2 if n_samples else np.full_like(whole, np.inf)
    return np.asarray(np.sqrt(whole) * t.ppf(0.5 * (1.0 + CONFIDENCE), np.maximum(freedom, 1.0)))


def history_variance(derivatives: Array, found: Uncertainty, samples: Array) -> Array:
    """Return the variance (n_values,) of the difference of true values from the fitted model's.

    Parameters
    ----------
    derivatives : (n_values, n_parameters) of the values.
    samples : (n_samples, n_values) of the model's errors in them.
    """
    by_noise = np.einsum("vp,pq,vq->v", derivatives, found.noise, derivatives)
    if not len(samples):
        return by_noise
    left = samples - found.biases @ derivatives.T
    return np.asarray(by_noise + np.square(left).mean(axis=0))
