"""Reduced models that others offer, from the coordinates that `bench_rivals.py` writes.

It runs in an environment of its own with opinf, ezyrb, pydmd and pysindy. It reads training runs in
generalized coordinates and writes predictions of each rival, with the seconds that it took to learn
and to predict. Each rival chooses its own settings by leaving training runs out, where there are
three or more, and otherwise by how well it repeats them.

    python scripts/rival_models.py INPUT.npz OUTPUT.npz
"""

from __future__ import annotations

import itertools
import sys
import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np

Array = np.ndarray
Predict = Callable[[float], Array]
"""Coordinates (n_snapshots, n_modes) of a run at 1 / Re."""

REGULARIZERS = np.geomspace(1e-8, 1e2, 6)
"""Of operator inference: of the linear part and of the quadratic one, every pair of them."""
THRESHOLDS = (0.0, 1e-3, 1e-2, 1e-1)
"""Of sparse regression: coefficients below are zero, of states and values of order one."""
RIDGES = np.geomspace(1e-8, 1e2, 6)
"""Of sparse regression."""
ESCAPED = 1e3
"""Size of scaled states at which an integration ends as unstable."""
SPREAD = 0.2
"""Of the training values over the time of a run, as regressions see them."""


def operator_inference(
    places: Array,
    runs: Array,
    step: float,
    starts: dict[float, Array],
    n_predicted: int,
    discrete: bool,
) -> Predict:
    """Learn rates (or a map from snapshot to snapshot) at the training runs; interpolate them."""
    import opinf

    scale = np.abs(runs).max(axis=(0, 1))
    scaled = runs / scale
    models = opinf.models
    kind = models.InterpolatedDiscreteModel if discrete else models.InterpolatedContinuousModel
    n_snapshots = runs.shape[1]
    times = step * np.arange(n_snapshots)

    def fitted(penalties: tuple[float, float]):
        n_modes = runs.shape[2]
        n_squares = n_modes * (n_modes + 1) // 2
        penalty = np.concatenate(
            ([penalties[0]], np.full(n_modes, penalties[0]), np.full(n_squares, penalties[1]))
        )
        model = kind("cAH", solver=opinf.lstsq.TikhonovSolver(penalty))
        states = [run.T for run in scaled]
        if discrete:
            return model.fit(places, [s[:, :-1] for s in states], [s[:, 1:] for s in states])
        return model.fit(places, states, [np.gradient(s, times, axis=1) for s in states])

    def predicted(model, place: float, start: Array, n: int) -> Array:
        out = np.full((n, len(start)), np.nan)
        try:
            if discrete:
                found = model.predict(place, start / scale, n)
            else:
                found = model.predict(place, start / scale, step * np.arange(n), method="BDF")
        except (ValueError, FloatingPointError):
            return out
        out[: found.shape[1]] = found.T[:n] * scale
        return out

    def error(penalties: tuple[float, float]) -> float:
        model = fitted(penalties)
        found = [
            predicted(model, place, run[0], n_snapshots)
            for place, run in zip(places, runs, strict=True)
        ]
        missed = float(np.linalg.norm(np.array(found) - runs))
        return missed if np.isfinite(missed) else np.inf

    best = min(itertools.product(REGULARIZERS, REGULARIZERS), key=error)
    model = fitted(best)
    return lambda place: predicted(model, place, starts[place], n_predicted)


def sparse_dynamics(
    places: Array, runs: Array, step: float, starts: dict[float, Array], n_predicted: int
) -> Predict:
    """Find few terms of rates that are quadratic in the state and linear in the parameter."""
    import pysindy
    from scipy.integrate import solve_ivp

    scale, largest = np.abs(runs).max(axis=(0, 1)), np.abs(places).max()
    states = list(runs / scale)
    n_snapshots, n_modes = runs.shape[1:]
    times = step * np.arange(n_snapshots)
    values = [np.full((n_snapshots, 1), place / largest) for place in places]
    rates = [np.gradient(each, times, axis=0) for each in states]

    def fitted(settings: tuple[float, float]):
        terms = pysindy.ParameterizedLibrary(
            feature_library=pysindy.PolynomialLibrary(degree=2),
            parameter_library=pysindy.PolynomialLibrary(degree=1),
            num_features=n_modes,
            num_parameters=1,
        )
        threshold, ridge = settings
        # Else the terms that are left are fitted again without the ridge.
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=ridge, unbias=False)
        model = pysindy.SINDy(feature_library=terms, optimizer=optimizer)
        return model.fit(states, t=times, x_dot=rates, u=values)

    def predicted(model, place: float, start: Array, n: int) -> Array:
        # Rates are quadratic: their values at some states are all coefficients, which are quicker.
        unit = np.eye(n_modes)
        first, second = np.triu_indices(n_modes, 1)
        at = np.concatenate((0.0 * unit[:1], unit, -unit, unit[first] + unit[second]))
        values = np.asarray(model.predict(at, u=np.full((len(at), 1), place / largest)))
        constant, above, below, mixed = np.split(values, np.cumsum([1, n_modes, n_modes]))
        linear, squares = 0.5 * (above - below), 0.5 * (above + below) - constant
        mixed = mixed - constant - sum((linear + squares)[k] for k in (first, second))

        def rate(_: float, state: Array) -> Array:
            of_pairs = (state[first] * state[second]) @ mixed
            return constant[0] + state @ linear + state**2 @ squares + of_pairs

        def escaped(_: float, state: Array) -> float:
            return ESCAPED - np.abs(state).max()

        escaped.terminal = True
        until = step * np.arange(n)
        found = solve_ivp(rate, (0.0, until[-1]), start / scale, t_eval=until, events=escaped)
        out = np.full((n, n_modes), np.nan)
        out[: found.y.shape[1]] = found.y.T * scale
        return out

    def error(settings: tuple[float, float]) -> float:
        model = fitted(settings)
        found = [predicted(model, p, r[0], n_snapshots) for p, r in zip(places, runs, strict=True)]
        missed = float(np.linalg.norm(np.array(found) - runs))
        return missed if np.isfinite(missed) else np.inf

    best = min(itertools.product(THRESHOLDS, RIDGES), key=error)
    model = fitted(best)
    return lambda place: predicted(model, place, starts[place], n_predicted)


def regression(places: Array, runs: Array, step: float, kind: str) -> Predict:
    """Regress coordinates on the parameter and time."""
    from ezyrb import GPR, RBF
    from sklearn.gaussian_process import kernels

    n_snapshots, n_modes = runs.shape[1:]
    times = np.linspace(0.0, 1.0, n_snapshots)
    low, width = places.min(), np.ptp(places)

    def inputs(some: Array) -> Array:
        # Training values are few and instants many: distances in time count for more.
        scaled = SPREAD * (np.asarray(some) - low) / width
        return np.column_stack((np.repeat(scaled, n_snapshots), np.tile(times, len(scaled))))

    scale = np.abs(runs).max(axis=(0, 1))
    values = (runs / scale).reshape(-1, n_modes)

    def fitted(mode: int):
        # Lengths of the default kernel are never fitted, and noise of one mode is not another's.
        # Few training values can't tell a length below their distance.
        lengths = kernels.RBF([5.0 * SPREAD, 0.1], [(SPREAD, 1e2), (1e-2, 1e1)])
        smooth = kernels.ConstantKernel() * lengths + kernels.WhiteKernel(1e-4, (1e-8, 1.0))
        one = GPR(kern=smooth, optimization_restart=1) if kind == "gpr" else RBF()
        one.fit(inputs(places), values[:, [mode]])
        return one

    each = [fitted(mode) for mode in range(n_modes)]
    return lambda place: (
        scale
        * np.column_stack(
            [np.asarray(one.predict(inputs([place]))).reshape(n_snapshots) for one in each]
        )
    )


def dynamic_modes(places: Array, runs: Array, step: float) -> Predict:
    """Parametric dynamic mode decomposition, partitioned, its reduced states interpolated."""
    from ezyrb import POD, RBF
    from pydmd import DMD, ParametricDMD

    n_snapshots, n_modes = runs.shape[1:]
    # Amplitudes of all snapshots: a flow that starts from rest has none at first.
    parts = [DMD(svd_rank=-1, opt=True) for _ in places]
    model = ParametricDMD(parts, POD(rank=n_modes), RBF())
    model.fit(runs.transpose(0, 2, 1), places[:, None])
    model.dmd_time["t0"] = model.original_time["t0"]
    model.dmd_time["tend"] = model.original_time["tend"]

    def predict(place: float) -> Array:
        model.parameters = np.array([[place]])
        return np.asarray(model.reconstructed_data)[0].real.T[:n_snapshots]

    return predict


def rivals(
    places: Array, runs: Array, step: float, starts: dict[float, Array], n_predicted: int
) -> Iterator[tuple[str, Callable[[], Predict]]]:
    """Yield the name of each rival and a function that makes it."""
    about = places, runs, step, starts, n_predicted
    yield "operator inference", lambda: operator_inference(*about, False)
    yield "discrete operator inference", lambda: operator_inference(*about, True)
    yield "sparse identification", lambda: sparse_dynamics(*about)
    yield "radial basis functions", lambda: regression(places, runs, step, "rbf")
    yield "Gaussian process", lambda: regression(places, runs, step, "gpr")
    yield "parametric DMD", lambda: dynamic_modes(places, runs, step)


def main(source: str, target: str) -> None:
    """Make all rivals, predict, write."""
    given = np.load(source)
    places, runs, step = given["places"], given["runs"], float(given["step"])
    tested = given["tested"]
    starts = {
        float(place): start
        for place, start in zip(
            np.append(places, tested), np.concatenate((runs[:, 0], given["starts"])), strict=True
        )
    }
    out: dict[str, Array] = {}
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    for name, make in rivals(places, runs, step, starts, int(given["n_predicted"])):
        began = time.perf_counter()
        try:
            predict = make()
            offline = time.perf_counter() - began
            began = time.perf_counter()
            found = np.array([predict(float(place)) for place in tested])
        except Exception as error:
            print(f"{name}: {type(error).__name__}: {error}", file=sys.stderr)
            continue
        out[f"{name}/coordinates"] = found
        out[f"{name}/seconds"] = np.array([offline, (time.perf_counter() - began) / len(tested)])
    np.savez(target, **out)


if __name__ == "__main__":
    main(*sys.argv[1:3])
