"""A model from operators as constant arrays, for programs that run it without this package.

All arrays of the equations are affine in a few products of the parameters, so their values at the
corners of a box of parameters determine them everywhere. What is not affine in them is refused by
name. `docs/portable.md` describes the arrays, and how to evaluate them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NoReturn

import numpy as np

from sphrom.arrays import Array
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import trained_ranges
from sphrom.errors import CaseError
from sphrom.metrics.measures import Samples
from sphrom.metrics.quantities import COEFFICIENT, MEASURABLE, component_names
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.fast_model import FastModel
from sphrom.reduction.affine import VISCOSITY
from sphrom.reduction.correction import Correction
from sphrom.reduction.error_calibration import field_of
from sphrom.reduction.exponential_steps import ExponentialModel
from sphrom.reduction.reduced_operators import Polynomial, pack
from sphrom.reduction.reference_model import Steps
from sphrom.reduction.trained_basis import ALL_MODES, LEADING
from sphrom.setup.assembly import amplitude_of, field_measures
from sphrom.sph.fluid import Factors

MISFIT = 1e-12
"""Largest difference of exported arrays from the model's, over their largest values."""
N_COMPARED = 8
"""Random points in the trained ranges at which arrays are compared."""
N_SCANNED = 5
"""Values of each parameter at which time steps are chosen."""
MOST_SCANNED = 125
"""Most points at which time steps are chosen."""
FINEST_DRIVING = 8
"""Least number of stored amplitudes per snapshot."""

Numbers = dict[str, Any]
"""Arrays, numbers, texts, lists, and dictionaries of them."""


def parts(model: FastModel) -> Numbers:
    """Return the arrays of a model; raises CaseError that names what they can't represent."""
    return _Export(model).parts()


def mode_samples(model: FastModel, points: Array) -> Samples:
    """Return the fields of the constant part of states, and of each coordinate, at points."""
    basis = model.on_basis(_basis_name(model))
    n_states = basis.whole.n_modes
    states = np.vstack((np.zeros(n_states), np.eye(n_states)))
    samples = basis.sampled(points, np.zeros(len(states)), states, 0.0)
    fields = samples.velocity, samples.pressure
    velocity, pressure = (np.concatenate((x[:1], x[1:] - x[:1])) for x in fields)
    return replace(samples, velocity=velocity, pressure=pressure)


def _basis_name(model: FastModel) -> str:
    """Return the name of the only basis. Raises CaseError if there are several."""
    names = model.workspace.case.plan.bases_for(model.section)
    if len(names) != 1:
        _refuse(f"it has several bases ({', '.join(names)})")
    return names[0]


def _refuse(reason: str) -> NoReturn:
    raise CaseError(f"export: {reason}; such a model can't be exported")


@dataclass(frozen=True)
class Products:
    """The products of parameters in which arrays are affine."""

    ranges: Mapping[str, tuple[float, float]]
    """The trained range of each factor, the viscosity [m2/s] first."""

    @property
    def names(self) -> list[list[str]]:
        """The names of the factors of each product."""
        drives = [[], *([name] for name in list(self.ranges)[1:])]
        return [[*viscous, *drive] for drive in drives for viscous in ([], [VISCOSITY])]

    def at(self, values: Mapping[str, float]) -> Array:
        """Return the products (n_products,) of values."""
        return np.array([math.prod(values[name] for name in names) for names in self.names])

    def of(
        self, name: str, array: Callable[[Mapping[str, float]], Array], zero: bool = True
    ) -> Array:
        """Return the array of each product (n_products, ...), whose sum is an array at any values.

        With `zero` it is computed where factors are zero, else only near their trained ranges.

        Raises CaseError that names the array if it is not affine in the products.
        """
        high = {n: max(map(abs, ends)) or 1.0 for n, ends in self.ranges.items()}
        low = dict.fromkeys(high, 0.0)
        if not zero:
            low = {n: ends[0] for n, ends in self.ranges.items()}
            high = {n: b if b > a else a + (abs(a) or 1.0) for n, (a, b) in self.ranges.items()}
        corners = [low | {n: high[n] for n in names} for names in self.names]
        values = np.stack([np.asarray(array(corner), dtype=float) for corner in corners])
        scales = self.at(high)
        rows = np.stack([self.at(corner) for corner in corners]) / scales
        flat = np.linalg.solve(rows, values.reshape(len(rows), -1)) / scales[:, None]
        random = np.random.default_rng(0)
        for _ in range(N_COMPARED):
            some = {n: random.uniform(*ends) for n, ends in self.ranges.items()}
            known = np.asarray(array(some), dtype=float).ravel()
            _require_fit(name, self.at(some) @ flat, known)
        return flat.reshape(values.shape)


def _require_fit(name: str, found: Array, known: Array) -> None:
    size = float(np.abs(known).max(initial=0.0)) or 1.0
    misfit = float(np.abs(found - known).max(initial=0.0)) / size
    if not misfit <= MISFIT:
        raise CaseError(
            f"export: {name} is not affine in the parameters (misfit {misfit:.1g}), so it can't be "
            "exported; other parameters in parameters.train may be"
        )


def stacked(polynomial: Polynomial, n_powers: int | None = None) -> Array:
    """Return the coefficients (n_powers, n_rows, n_monomials) of a polynomial."""
    rows = [pack(tensors) for tensors in polynomial.powers][:n_powers]
    width = max(row.shape[1] for row in rows)
    return np.stack([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows])


def kriging(correction: Correction | None, rows: Array) -> Numbers | None:
    """Return the interpolation of `rows` (n_rows, n) times a correction of n (or 2 n) values.

    Values (n_runs, n_snapshots, n_entries) times exp(-distance / length) are to be added.
    """
    if correction is None:
        return None
    places = correction.places
    between = np.linalg.norm(places[:, None] - places, axis=2)
    entries: dict[tuple[float, int], Array] = {}
    for column, length in enumerate(correction.lengths.tolist()):
        if length == 0.0:
            continue
        defects = correction.defects[..., column]
        solved = np.linalg.solve(np.exp(-between / length), defects)
        for row in np.flatnonzero(rows[:, column % rows.shape[1]]).tolist():
            share = rows[row, column % rows.shape[1]] * solved
            entries[length, row] = entries.get((length, row), 0.0) + share
    if not entries:
        return None
    return {
        "places": places,
        "lengths": np.array([length for length, _ in entries]),
        "targets": [row for _, row in entries],
        "values": np.stack([*entries.values()], axis=-1),
    }


class _Export:
    """The arrays of a model, as they are made one after the other."""

    def __init__(self, model: FastModel) -> None:
        case = model.workspace.case
        section = model.section
        if case.plan.model_steps(section) != case.plan.steps:
            _refuse("its runs end at another time than the training runs (until)")
        if section.time_step != "auto":
            _refuse(f"its time_step is {section.time_step}, and only automatic ones are exported")
        self.case = case
        self.model = model
        self.basis: BasisModel = model.on_basis(_basis_name(model))
        self.trained = self.basis.trained
        self.rates = self.trained.rates[ALL_MODES]
        if any(rates.memory is not None for rates in self.trained.rates.values()):
            _refuse("it has a closure with a memory length")
        if self.basis.problem is not None:
            raise self.basis.problem
        self.ranges = trained_ranges(case, section)
        low, high = self.ranges["reynolds"]
        self.flow_scale = case.plan.kinematic_viscosity(self._point({"reynolds": 1.0}))
        others = {name: ends for name, ends in self.ranges.items() if name != "reynolds"}
        viscosities = self.flow_scale / high, self.flow_scale / low
        self.products = Products({VISCOSITY: viscosities, **others})
        self.own = self.trained.own_pressure
        self.first = self.model.at(self._point({n: a for n, (a, _) in self.ranges.items()}))
        self.n_powers = 1 if self.first.amplitude is None else None

    def _point(self, values: Mapping[str, float]) -> ParameterPoint:
        return self.case.plan.point(values)

    def _polynomials(self, name: str, of: Callable[[float, Factors], Polynomial]) -> Array:
        """Return the coefficients (n_products, n_powers, n_rows, n_monomials) of polynomials."""

        def array(values: Mapping[str, float]) -> Array:
            factors = {n: x for n, x in values.items() if n != VISCOSITY}
            return stacked(of(values[VISCOSITY], factors), self.n_powers)

        return self.products.of(name, array)

    def parts(self) -> Numbers:
        """Return all of them."""
        case = self.case
        times = self.first.output_times
        modes = np.eye(self.basis.basis.n_modes)
        steps = self._steps()
        outputs, linear = self._linear()
        forces = self._forces(outputs)
        leading = self.trained.rates.get(LEADING, self.rates)
        pressure = None
        if (own := self.own) is not None:
            pressure = {
                "coefficients": self._polynomials(
                    "the pressure of own modes",
                    lambda nu, factors: own.at(self._rates(nu, factors), nu, factors),
                ),
                "correction": kriging(own.correction, np.eye(len(own.modes))),
            }
        return {
            "density": case.fluid.reference_density,
            "sound_speed": case.plan.sound_speed,
            "viscosity": self.flow_scale,
            "products": self.products.names,
            "times": {
                "start": times.start_time,
                "interval": times.interval,
                "n_snapshots": times.n_snapshots,
            },
            "n_integrated": self.basis.n_integrated,
            "n_modes": len(modes),
            "n_own": 0 if self.own is None else len(self.own.modes),
            "driving": self._driving(steps),
            "starts": self._starts(),
            "runs": {"places": self.trained.places, "steps": steps},
            "dynamics": self._polynomials(
                "the system of equations", lambda nu, factors: leading.at(nu, factors)[0]
            ),
            "largest_norm": self.first.leading.output_times.largest_norm
            if self.first.leading is not None
            else times.largest_norm,
            "correction": kriging(self.trained.correction, modes),
            "pressure": pressure,
            "outputs": outputs,
            "linear": linear,
            "forces": forces,
            "errors": self._errors(outputs),
            "cycles": None,
        }

    def _rates(self, viscosity: float, factors: Factors) -> Polynomial:
        return self.rates.at(viscosity, factors)[0]

    # Time

    def _steps(self) -> list[Numbers]:
        """Return the time steps near each training run: the most that a point near it needs."""
        axes = [np.unique(np.linspace(*ends, N_SCANNED)).tolist() for ends in self.ranges.values()]
        grid = list(product(*axes))
        random = np.random.default_rng(0)
        if len(grid) > MOST_SCANNED:
            grid = [grid[k] for k in random.choice(len(grid), MOST_SCANNED, replace=False)]
        points = [
            *self.basis.points,
            *(self._point(dict(zip(self.ranges, p, strict=True))) for p in grid),
        ]
        most: dict[int, Steps] = {}
        for point in points:
            nearest = self.trained.nearest(self.basis.place(point))
            steps = self.basis.integrator(self.model.at(point)).steps
            if nearest not in most or steps.n_steps > most[nearest].n_steps:
                most[nearest] = steps
        leading = self.trained.rates.get(LEADING, self.rates)
        return [self._matrices(most[k], leading.linear[k]) for k in range(len(leading.linear))]

    def _matrices(self, steps: Steps, linear: Array) -> Numbers:
        times = steps.model.output_times
        assert isinstance(steps.system, ExponentialModel)
        (stages, links, ends), ratio = steps.system.method(steps.n_steps, times)
        return {
            "linear": steps.system.linear.matrix,
            "stages": stages,
            "links": links,
            "ends": ends,
            "snapshots_per_step": ratio.snapshots_per_step,
            "steps_per_snapshot": ratio.steps_per_snapshot,
        }

    def _driving(self, steps: Iterable[Numbers]) -> Numbers | None:
        """Return the amplitude at the half steps of all runs, and between them."""
        if self.first.amplitude is None:
            return None
        times = self.first.output_times
        halves = [2 * each["steps_per_snapshot"] for each in steps]
        every = math.lcm(*halves)
        every *= math.ceil(FINEST_DRIVING / every)
        longest = max(each["snapshots_per_step"] for each in steps)
        n_instants = (times.n_snapshots - 1 + longest) * every + 1
        instants = times.start_time + times.interval / every * np.arange(n_instants)

        def amplitude(values: Mapping[str, float]) -> Array:
            factors = {n: x for n, x in values.items() if n != VISCOSITY}
            point = self._point({"reynolds": self.flow_scale / values[VISCOSITY], **factors})
            found = amplitude_of(self.case, point)
            assert found is not None
            return found(instants)

        array = self.products.of("the driving over time", amplitude, zero=False)
        return {"per_snapshot": every, "amplitude": array}

    def _starts(self) -> Numbers:
        """Return the starts of runs, by the nearest training run if they have spin-ups."""
        plan = self.case.plan
        largest = plan.largest_values
        scales = np.where(largest > 0.0, largest, 1.0)
        points = plan.train_points if self.case.time.spin_up > 0.0 else plan.train_points[:1]
        found = [self.model.at(point) for point in points]
        starts = np.stack([(reduced.leading or reduced).start for reduced in found])
        random = np.random.default_rng(1)
        if self.case.time.spin_up == 0.0:
            for _ in range(N_COMPARED):
                some = {n: random.uniform(*ends) for n, ends in self.ranges.items()}
                other = self.model.at(self._point(some))
                _require_fit("the initial state", starts[0], (other.leading or other).start)
        return {
            "places": np.array([[*point.as_dict().values()] for point in points]) / scales,
            "coordinates": starts,
            "mean": np.array([reduced.mean_density_fluctuation for reduced in found]),
        }

    # Measurements

    def _linear(self) -> tuple[list[Numbers], Array]:
        """Return the measurements that are linear in states, and their factors of all terms."""
        outputs = list[Numbers]()
        rows = list[Array]()
        places = field_measures(self.case)
        n_terms = 2 + self.basis.whole.n_modes
        for name, measure in self.trained.measures.items():
            for quantity, terms in measure.quantities.items():
                about = MEASURABLE[quantity]
                for index in np.ndindex(terms.shape[:-1]):
                    at = places[name].position[index[0]].tolist() if about.is_placed else None
                    several = about.is_placed and len(places[name].position) > 1
                    place = f"[{index[0]}]" if several else ""
                    component = index[-1] if about.is_vector else None
                    outputs.append(_output(name, quantity, component, at, place))
                    rows.append(np.pad(terms[index], (0, n_terms - terms.shape[-1])))
        return outputs, np.array(rows).reshape(-1, n_terms)

    def _forces(self, outputs: list[Numbers]) -> list[Numbers]:
        """Return the forces, and append their rows to the outputs."""
        total = np.hstack((np.eye(3), np.eye(3)))
        forces = []
        driven = self.rates.operators.walls_driven
        for name, force in self.trained.forces.items():
            rows = total
            loads = [("force", 0), ("force", 1), ("torque", None)]
            if (factor := self.case.plan.coefficients.get(name)) is not None:
                rows = np.vstack((total, factor * total[:2]))
                loads += [(COEFFICIENT, 0), (COEFFICIENT, 1)]
            outputs += [_output(name, quantity, component) for quantity, component in loads]

            def polynomial(
                nu: float, factors: Factors, rows: Array = rows, force: Any = force
            ) -> Polynomial:
                local = force.projected.at(nu, driven, factors)
                rates = self._rates(nu, factors)
                own = _times(rows, local.polynomial)
                return own.plus(_times(rows @ local.momentum, rates))

            def uniform(
                values: Mapping[str, float], rows: Array = rows, force: Any = force
            ) -> Array:
                factors = {n: x for n, x in values.items() if n != VISCOSITY}
                return force.projected.at(values[VISCOSITY], driven, factors).uniform @ rows.T

            own = force.projected.own
            forces.append(
                {
                    "measure": name,
                    "coefficients": self._polynomials(f"the force {name}", polynomial),
                    "uniform": self.products.of(f"the force {name}", uniform),
                    "own": None if own is None else rows[:, :3] @ own,
                    "correction": kriging(force.correction, rows),
                }
            )
        return forces

    # Estimates

    def _errors(self, outputs: list[Numbers]) -> Numbers | None:
        """Return the data of error estimates; None without any."""
        errors = self.trained.errors
        if errors is None or errors.fitted is None:
            return None
        fitted = errors.fitted
        n_snapshots = self.first.output_times.n_snapshots
        noise = np.full((n_snapshots, len(outputs)), np.nan)
        shares = np.full(len(outputs), np.nan)
        known = self.basis.output_errors
        counts: dict[tuple[str, str], int] = {}
        for column, output in enumerate(outputs):
            key = output["measure"], output["quantity"]
            place = counts.get(key, 0)
            counts[key] = place + 1
            if (of := known.get(key[0], {}).get(key[1])) is not None:
                noise[:, column] = of.noise.reshape(n_snapshots, -1)[:, place]
                shares[column] = of.share.ravel()[place]

        def residual(values: Mapping[str, float]) -> Array:
            factors = {n: x for n, x in values.items() if n != VISCOSITY}
            powers = errors.factor.at(values[VISCOSITY], factors)[: self.n_powers]
            width = max(rows.shape[1] for rows in powers)
            return np.stack([np.pad(rows, ((0, 0), (0, width - rows.shape[1]))) for rows in powers])

        closure = self.rates.closure
        return {
            "places": fitted.places,
            "constants": fitted.constants,
            "decay_rate": fitted.decay_rate,
            "expected": fitted.coordinates,
            "shares": fitted.shares.parameters,
            "units": errors.units,
            "gram": errors.products.gram,
            "residual": self.products.of("the residual", residual),
            "closure": None
            if closure is None
            else self._polynomials("the closure", lambda nu, factors: closure.at(nu, factors)),
            "noise": noise,
            "output_shares": shares,
        }


def _times(rows: Array, polynomial: Polynomial) -> Polynomial:
    """Return rows (n_rows, n) times a polynomial of n values."""
    return Polynomial(
        tuple(tuple(np.tensordot(rows, t, 1) for t in tensors) for tensors in polynomial.powers)
    )


def _output(
    name: str,
    quantity: str,
    component: int | None = None,
    at: list[float] | None = None,
    place: str = "",
) -> Numbers:
    column = component_names(quantity)[component or 0]
    return {
        "name": f"{name}_{column}{place}",
        "measure": name,
        "quantity": quantity,
        "component": component,
        "at": at,
        "unit": MEASURABLE[quantity].unit,
        "field": field_of(quantity),
    }
