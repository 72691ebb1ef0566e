"""A model from operators as constant arrays, for programs that run it without this package.

All arrays of the equations are affine in a few products of the parameters, so their values at the
corners of a box of parameters determine them everywhere. Other arrays are refused by name.
`docs/portable.md` describes the arrays, and how to evaluate them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from sphrom.arrays import Array
from sphrom.case.points import REYNOLDS, ParameterPoint
from sphrom.case.studies import trained_ranges
from sphrom.errors import CaseError
from sphrom.metrics.measures import Samples
from sphrom.metrics.quantities import COEFFICIENT, MEASURABLE, component_names, unit_of
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.fast_model import FastModel
from sphrom.reduction.affine import VISCOSITY
from sphrom.reduction.correction import Correction
from sphrom.reduction.error_calibration import field_of
from sphrom.reduction.exponential_steps import ExponentialModel
from sphrom.reduction.reduced_operators import Polynomial, pack
from sphrom.reduction.reference_model import Steps
from sphrom.reduction.trained_basis import ALL_MODES, LEADING, TrainedForce
from sphrom.setup.assembly import amplitude_of, field_measures
from sphrom.sph.fluid import Factors

MISFIT = 1e-12
"""Largest difference of exported arrays from the model's, relative to their largest values."""
N_COMPARED = 8
"""Random points in the trained ranges at which arrays are compared."""
N_SCANNED = 32
"""Random points at which time steps are chosen, besides those of training runs."""
FINEST_DRIVING = 8
"""Least number of stored amplitudes per snapshot."""

Numbers = dict[str, Any]
"""Arrays, numbers, texts, lists, and dictionaries of them."""


def parts(model: FastModel) -> Numbers:
    """Return the arrays of a model. Raises CaseError with a reason if it can't be exported."""
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


Of = Callable[[float, Factors], Any]
"""An array or a polynomial at a viscosity [m2/s] and values of the other parameters."""
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Products:
    """The products of parameters in which arrays are affine."""

    ranges: Ranges
    """The trained range of each factor, the viscosity [m2/s] first."""

    @property
    def names(self) -> list[list[str]]:
        """The names of the factors of each product."""
        viscosity, *others = ([name] for name in self.ranges)
        return [own + drive for drive in ([], *others) for own in ([], viscosity)]

    def at(self, values: Mapping[str, float]) -> Array:
        """Return the products (n_products,) of values."""
        return np.array([math.prod(values[name] for name in names) for names in self.names])

    def of(self, name: str, of: Of, within_ranges: bool = False) -> Array:
        """Return the array of each product (n_products, ...), whose sum is an array at any values.

        It is computed where factors are zero or, `within_ranges`, in their trained ranges only.

        Raises CaseError that names the array if it is not affine in the products.
        """
        high = {n: max(map(abs, ends)) or 1.0 for n, ends in self.ranges.items()}
        low = dict.fromkeys(high, 0.0)
        if within_ranges:
            low = {n: a for n, (a, _) in self.ranges.items()}
            high = {n: b if b > a else 2.0 * b or 1.0 for n, (a, b) in self.ranges.items()}

        def array(values: Mapping[str, float]) -> Array:
            factors = {n: x for n, x in values.items() if n != VISCOSITY}
            return np.asarray(of(values[VISCOSITY], factors), dtype=float)

        corners = [low | {n: high[n] for n in names} for names in self.names]
        values = np.stack(list(map(array, corners)))
        scales = self.at({n: max(abs(low[n]), abs(high[n])) or 1.0 for n in high})
        rows = np.stack(list(map(self.at, corners))) / scales
        flat = np.linalg.solve(rows, values.reshape(len(rows), -1)) / scales[:, None]
        for some in sampled(self.ranges, N_COMPARED):
            missed = misfit(self.at(some) @ flat, array(some).ravel())
            if not missed <= MISFIT:
                _refuse(f"{name} is not affine in the parameters (misfit {missed:.1g})")
        return flat.reshape(values.shape)


def sampled(ranges: Ranges, n: int) -> list[dict[str, float]]:
    """Return random points in ranges, the same each time."""
    shares = np.random.default_rng(0).random((n, len(ranges)))
    low, high = np.array([*ranges.values()]).T
    return [dict(zip(ranges, row, strict=True)) for row in (low + shares * (high - low)).tolist()]


def misfit(found: Array, known: Array) -> float:
    """Return the largest difference of two arrays, relative to the largest value of the second."""
    size = float(np.abs(known).max(initial=0.0)) or 1.0
    return float(np.abs(found - known).max(initial=0.0)) / size


def padded(rows: Sequence[Array]) -> Array:
    """Return arrays (n, ...) of different widths as one, with zeros at their ends."""
    width = max(row.shape[1] for row in rows)
    return np.stack([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows])


def kriging(correction: Correction | None, rows: Array) -> Numbers | None:
    """Return the interpolation of `rows` (n_rows, n) times a correction of n (or 2 n) values.

    Values (n_runs, n_snapshots, n_entries) times exp(-distance / length) are to be added.
    """
    entries: dict[tuple[float, int], Array] = {}
    lengths = [] if correction is None else correction.lengths.tolist()
    for column, length in enumerate(lengths):
        if correction is not None and length > 0.0:
            places = correction.places
            alike = np.exp(-np.linalg.norm(places[:, None] - places, axis=2) / length)
            solved = np.linalg.solve(alike, correction.defects[..., column])
            for row, factor in enumerate(rows[:, column % rows.shape[1]].tolist()):
                if factor != 0.0:
                    entries[length, row] = entries.get((length, row), 0.0) + factor * solved
    if correction is None or not entries:
        return None
    return {
        "places": correction.places,
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
        if self.rates.cycles is not None:
            _refuse("it settles on limit cycles (calibrated: cycle), which are not affine")
        first = self.basis.points[0]
        self.first = model.at(first)
        self.scale = case.plan.kinematic_viscosity(first) * first.reynolds
        self.ranges = trained_ranges(case, section)
        low, high = self.ranges[REYNOLDS]
        others = {name: ends for name, ends in self.ranges.items() if name != REYNOLDS}
        self.products = Products({VISCOSITY: (self.scale / high, self.scale / low), **others})
        self.n_powers = 1 if self.first.amplitude is None else None

    def _point(self, values: dict[str, float]) -> ParameterPoint:
        return self.case.plan.point(values)

    def _polynomials(self, name: str, of: Of) -> Array:
        """Return the coefficients (n_products, n_powers, n_rows, n_monomials) of polynomials."""

        def array(viscosity: float, factors: Factors) -> Array:
            return padded([pack(t) for t in of(viscosity, factors).powers[: self.n_powers]])

        return self.products.of(name, array)

    def parts(self) -> Numbers:
        """Return all of them."""
        times = self.first.output_times
        leading = self.trained.rates.get(LEADING, self.rates)

        def rates(viscosity: float, factors: Factors) -> Polynomial:
            return leading.at(viscosity, factors)[0]

        n_modes = self.basis.basis.n_modes
        steps = self._steps()
        outputs, linear = self._linear()
        forces = [self._force(name, force, outputs) for name, force in self.trained.forces.items()]
        return {
            "density": self.case.fluid.reference_density,
            "sound_speed": self.case.plan.sound_speed,
            "viscosity": self.scale,
            "products": self.products.names,
            "times": {
                "start": times.start_time,
                "interval": times.interval,
                "n_snapshots": times.n_snapshots,
            },
            "n_integrated": self.basis.n_integrated,
            "n_modes": n_modes,
            "n_own": self.basis.whole.n_modes - n_modes,
            "driving": self._driving(steps),
            "starts": self._starts(),
            "runs": {"places": self.trained.places, "steps": steps},
            "dynamics": self._polynomials("the system of equations", rates),
            "largest_norm": (self.first.leading or self.first).output_times.largest_norm,
            "correction": kriging(self.trained.correction, np.eye(n_modes)),
            "pressure": self._pressure(),
            "outputs": outputs,
            "linear": linear,
            "forces": forces,
            "errors": self._errors(outputs),
        }

    def _pressure(self) -> Numbers | None:
        if (own := self.trained.own_pressure) is None:
            return None

        def coordinates(viscosity: float, factors: Factors) -> Polynomial:
            return own.at(self.rates.at(viscosity, factors)[0], viscosity, factors)

        return {
            "coefficients": self._polynomials("the separate pressure modes", coordinates),
            "correction": kriging(own.correction, np.eye(len(own.modes))),
        }

    # Time

    def _steps(self) -> list[Numbers]:
        """Return the time steps near each training run: the most that a point near it needs."""
        others = [self._point(values) for values in sampled(self.ranges, N_SCANNED)]
        most: dict[int, Steps] = {}
        for point in (*self.basis.points, *others):
            nearest = self.trained.nearest(self.basis.place(point))
            steps = self.basis.integrator(self.model.at(point)).steps
            if nearest not in most or steps.n_steps > most[nearest].n_steps:
                most[nearest] = steps
        found = []
        for _, steps in sorted(most.items()):
            assert isinstance(steps.system, ExponentialModel)
            matrices, ratio = steps.system.method(steps.n_steps, steps.model.output_times)
            named = dict(zip(("stages", "links", "ends"), matrices, strict=True))
            found.append({"linear": steps.system.linear.matrix, **named, **vars(ratio)})
        return found

    def _driving(self, steps: Sequence[Numbers]) -> Numbers | None:
        """Return the amplitude at the half steps of all runs, and between them."""
        if self.first.amplitude is None:
            return None
        times = self.first.output_times
        every = 2 * math.lcm(*[each["steps_per_snapshot"] for each in steps])
        every *= math.ceil(FINEST_DRIVING / every)
        longest = max(each["snapshots_per_step"] for each in steps)
        numbers = np.arange((times.n_snapshots - 1 + longest) * every + 1)
        instants = times.start_time + times.interval / every * numbers

        def amplitude(viscosity: float, factors: Factors) -> Array:
            point = self._point({REYNOLDS: self.scale / viscosity, **factors})
            found = amplitude_of(self.case, point)
            assert found is not None
            return found(instants)

        array = self.products.of("the driving over time", amplitude, within_ranges=True)
        return {"per_snapshot": every, "amplitude": array}

    def _starts(self) -> Numbers:
        """Return the starts of runs, by the nearest training run if they have spin-ups."""
        plan = self.case.plan
        scales = np.where(plan.largest_values > 0.0, plan.largest_values, 1.0)
        spun_up = self.case.time.spin_up > 0.0
        points = plan.train_points if spun_up else plan.train_points[:1]
        found = [self.model.at(point) for point in points]
        for values in () if spun_up else sampled(self.ranges, N_COMPARED):
            other = self.model.at(self._point(values))
            if not misfit(found[0].start, other.start) <= MISFIT:
                _refuse("its initial state depends on a parameter")
        return {
            "places": np.array([[*point.as_dict().values()] for point in points]) / scales,
            "coordinates": np.stack([(each.leading or each).start for each in found]),
            "mean": np.array([each.mean_density_fluctuation for each in found]),
        }

    # Measurements

    def _linear(self) -> tuple[list[Numbers], Array]:
        """Return the measurements that are linear in states, and their factors of all terms."""
        outputs = list[Numbers]()
        rows = list[Array]()
        fields = field_measures(self.case)
        n_terms = 2 + self.basis.whole.n_modes
        for name, measure in self.trained.measures.items():
            position = fields[name].position
            for quantity, terms in measure.quantities.items():
                about = MEASURABLE[quantity]
                for index in np.ndindex(terms.shape[:-1]):
                    component = index[-1] if about.is_vector else None
                    output = _output(name, quantity, component, self.case.scene.domain.n_dim)
                    if about.is_placed:
                        output["at"] = position[index[0]].tolist()
                        output["name"] += f"[{index[0]}]" * (len(position) > 1)
                    outputs.append(output)
                    rows.append(np.pad(terms[index], (0, n_terms - terms.shape[-1])))
        return outputs, np.array(rows).reshape(-1, n_terms)

    def _force(self, name: str, force: TrainedForce, outputs: list[Numbers]) -> Numbers:
        """Return a force, and append its rows to the outputs."""
        rows = np.hstack((np.eye(3), np.eye(3)))
        n_dim = self.case.scene.domain.n_dim
        loads: list[tuple[str, int | None]] = [("force", axis) for axis in range(n_dim)]
        loads += [("torque", None)] * (n_dim == 2)
        if (factor := self.case.plan.coefficients.get(name)) is not None:
            rows = np.vstack((rows, factor * rows[:n_dim]))
            loads += [(COEFFICIENT, axis) for axis in range(n_dim)]
        outputs += [_output(name, quantity, component, n_dim) for quantity, component in loads]
        driven = self.rates.operators.walls_driven
        projected = force.projected

        def polynomial(viscosity: float, factors: Factors) -> Polynomial:
            local = projected.at(viscosity, driven, factors)
            rates = self.rates.at(viscosity, factors)[0]
            return _times(rows, local.polynomial).plus(_times(rows @ local.momentum, rates))

        def uniform(viscosity: float, factors: Factors) -> Array:
            return projected.at(viscosity, driven, factors).uniform @ rows.T

        return {
            "measure": name,
            "coefficients": self._polynomials(f"the force {name}", polynomial),
            "uniform": self.products.of(f"the force {name}", uniform),
            "own": None if projected.own is None else rows[:, :3] @ projected.own,
            "correction": kriging(force.correction, rows),
        }

    # Estimates

    def _errors(self, outputs: Sequence[Numbers]) -> Numbers | None:
        """Return the data of error estimates; None without any."""
        errors = self.trained.errors
        if errors is None or errors.fitted is None:
            return None
        fitted = errors.fitted
        noise = np.full((self.first.output_times.n_snapshots, len(outputs)), np.nan)
        shares = np.full(len(outputs), np.nan)
        names = [(each["measure"], each["quantity"]) for each in outputs]
        for column, (name, quantity) in enumerate(names):
            known = self.basis.output_errors.get(name, {}).get(quantity)
            if known is not None:
                place = names[:column].count((name, quantity))
                noise[:, column] = known.noise.reshape(len(noise), -1)[:, place]
                shares[column] = known.share.ravel()[place]

        def residual(viscosity: float, factors: Factors) -> Array:
            return padded(errors.factor.at(viscosity, factors)[: self.n_powers])

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
            "closure": closure and self._polynomials("the closure", closure.at),
            "noise": noise,
            "output_shares": shares,
        }


def _times(rows: Array, polynomial: Polynomial) -> Polynomial:
    """Return rows (n_rows, n) times a polynomial of n values."""
    powers = ([np.tensordot(rows, t, 1) for t in tensors] for tensors in polynomial.powers)
    return Polynomial(tuple(map(tuple, powers)))


def _output(name: str, quantity: str, component: int | None, n_dim: int) -> Numbers:
    return {
        "name": f"{name}_{component_names(quantity, n_dim)[component or 0]}",
        "measure": name,
        "quantity": quantity,
        "component": component,
        "at": None,
        "unit": unit_of(quantity, n_dim),
        "field": field_of(quantity),
    }
