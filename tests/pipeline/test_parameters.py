"""Cases of several parameters: operators at any point are those assembled there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sphrom
from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.metrics.series import kinetic_energy
from sphrom.models.points.fast_model import FastModel
from sphrom.models.points.quantities import quantities_of
from sphrom.models.points.sensitivities import tangents
from sphrom.reduction import reference_model
from sphrom.reduction.force_projection import project_forces
from sphrom.reduction.operator_projection import project_operators, residual_factor
from sphrom.reduction.reduced_operators import Polynomial, residual_norm
from sphrom.reduction.stokes_fields import StokesFields
from sphrom.reduction.trial_basis import TrialBasis, reconstruct
from sphrom.setup import assembly, particles
from sphrom.sph.fixed_points import FixedPoints
from sphrom.store.workspace import Workspace

LID = {
    "name": "lid",
    "scene": {
        "kind": "lid-driven-cavity",
        "measure": {
            "there": {"probe": [0.5, 0.8]},
            "flux": {"flow_rate": {"from": [0.5, 0.5], "to": [0.5, 1.0]}},
            "profile": {"line": {"from": [0.5, 0.0], "to": [0.5, 1.0], "points": 5}},
        },
    },
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 5},
    "parameters": {
        "train": {"reynolds": [50, 200], "lid": [0.5, 1.0]},
        "test": {"reynolds": [100], "lid": [0.8]},
    },
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
    "compare": {"plots": False},
    "trade": {"full_runs": False, "n_modes": [3], "repeats": 1},
}
DRIVEN = {
    "name": "driven",
    "scene": {
        "kind": "custom",
        "box": {"upper": [2, 2], "periodic": ["x"]},
        "solids": {"disc": {"circle": {"centre": [1, 1], "radius": 0.4}}},
        "constants": {"U": 0.5, "g": 2.0, "omega": 3.0},
        "walls": {"top": {"velocity": ["0.2 + U*(1 + 0.1*cos(pi*x))", 0]}, "disc": {"rotation": 1}},
        "body_force": ["(1 + g*sin(pi*y))*cos(omega*t)", 0],
        "measure": {"on_disc": {"force_on": "disc"}, "there": {"probe": [0.3, 1.7]}},
    },
    "discretization": {"resolution": 28},
    "parameters": {
        "train": {
            "points": [
                {"reynolds": 50, "U": 0.4, "g": 1.0, "disc": 0.5, "body_force": 2.0, "omega": 2.0}
            ]
        }
    },
}
N_MODES = 3
STEPS = 0.02
"""Of runs that are differentiated, over automatic ones: other steps then change nothing."""


def assembled(case: Case, point: ParameterPoint, position: np.ndarray) -> FixedPoints:
    """Return the fixed points of a scene as it is at a point, where nothing else varies."""
    flow = case.plan.flow(point)
    force = None if flow.body_force is None else flow.body_force.field(position.T)
    return FixedPoints(
        position,
        case.plan.fluid(point),
        case.plan.discretization,
        flow.domain,
        particles.walls(case, flow),
        force,
    )


def basis_at(case: Case, position: np.ndarray) -> TrialBasis:
    """Return smooth modes, orthonormal in the case's product."""
    x, y = position.T
    fields = [np.sin((k + 1) * x + k * y) * np.cos(k * x - y) for k in range(3 * N_MODES)]
    product = assembly.inner_product(case)
    weights = product.weights(np.full(len(position), case.plan.particle_spacing**2))
    root = np.sqrt(weights)
    states = (root * np.array(fields).reshape(N_MODES, 3, -1)).reshape(N_MODES, -1)
    modes = np.linalg.qr(states.T)[0].T.reshape(N_MODES, 3, -1) / root
    return TrialBasis(
        density_modes=modes[:, 0],
        velocity_modes=np.ascontiguousarray(modes[:, 1:].transpose(0, 2, 1)),
        singular_values={"joint": np.ones(N_MODES)},
        inner_product=product,
        weights=weights,
        gram_error=0.0,
    )


def difference(one: Polynomial, other: Polynomial) -> float:
    """Return the largest difference of coefficients over the largest coefficient."""
    (found, used), (expected, n) = one.packed(), other.packed()
    assert list(used) == list(n)
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def random_fields(n_points: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(6)
    return random.normal(size=(3, n_points, 2)), random.normal(size=(3, n_points, 2, 2))


@pytest.mark.parametrize("given", [LID, DRIVEN], ids=["lid", "driven"])
def test_operators_at_any_point_are_those_assembled_there(unprojected, given):
    case = load_case(given)
    position = case.scene.domain.fill(case.plan.particle_spacing)
    points, basis = particles.fixed_points(case, position), basis_at(case, position)
    operators = project_operators(points, basis)
    factor = residual_factor(points, basis, operators)
    values = {"reynolds": 137.0, "lid": -0.83, "U": 1.7, "g": -0.6, "disc": 2.3, "body_force": 0.7}
    point = case.plan.point({k: v for k, v in values.items() if k in case.plan.parameter_names})
    there = assembled(case, point, position)
    nu, factors = case.plan.kinematic_viscosity(point), point.factors
    expected = project_operators(there, basis)
    assert difference(operators.at(nu, factors=factors), expected.at(nu)) < 1e-12

    states, every = 0.1 * np.random.default_rng(0).normal(size=(4, N_MODES)), np.arange(N_MODES)
    amplitude = np.full(4, 1.3)
    whole, alone = factor.of_model(operators, every), residual_factor(there, basis, expected)
    norm = residual_norm(alone.of_model(expected, every), nu, states, amplitude)
    found = residual_norm(whole, nu, states, amplitude, factors)
    assert found == pytest.approx(norm, rel=1e-9)

    around = {"viscosity": nu, "amplitude": 1.3, "factors": factors}
    rates = unprojected(points, basis, order=1)(states[0], around)
    assert rates == pytest.approx(operators.at(nu, factors=factors)(states[0], 1.3), rel=1e-10)

    for name, (wall, circulations) in particles.driven_measured_walls(case).items():
        # The flows of the balance may be any fields.
        tested = StokesFields(np.ones(3, dtype=bool), *random_fields(len(position)))
        force = project_forces(points, basis, wall, circulations, (tested, None))
        own = particles.measured_walls(case, case.plan.flow(point))[name]
        local = [
            force.at(nu, points.walls_driven, factors),
            project_forces(there, basis, own, balance=(tested, None)).at(nu, points.walls_driven),
        ]
        loads = [each.at(np.zeros(4), states, states, amplitude, 0.01) for each in local]
        assert loads[0] == pytest.approx(loads[1], rel=1e-11, abs=1e-13)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> sphrom.Study:
    """A lid-driven cavity of two parameters, run to the end."""
    calibrated = {**LID["rom"][0], "name": "calibrated", "calibrated": True}
    listed = {**calibrated, "parameters": [{"reynolds": 80, "lid": 0.6}]}
    leading = {**listed, "name": "leading", "integrated_modes": 2}
    grid = {"reynolds": [60, 150], "parameters": {"lid": [0.6, 1.0]}}
    case = {
        **LID,
        "rom": [*LID["rom"], listed, leading, {**leading, "name": "longer", "until": 1.0}],
        "sweep": {"model": "fast", "sensitivities": True, **grid},
    }
    found = sphrom.Study(case, out=tmp_path_factory.mktemp("lid"), quiet=True, threads=1)
    found.run()
    return found


def test_a_model_in_python_is_that_of_the_command(study):
    found = study.model("fast", reynolds=100, lid=0.8).run()
    with sphrom.open(study.folder / "rom-fast-reynolds100-lid0.8.h5") as run:
        assert np.array_equal(run.generalized_coordinates, found.coordinates)
    assert found.error_estimate is not None
    assert not found.error_estimate.extrapolated
    with sphrom.open(study.folder / "fom-reynolds50-lid0.5.h5") as run:
        assert (run.attrs["parameters_lid"], run.attrs["sound_speed"]) == (0.5, 10.0)


def test_sweeps_and_trades_have_a_column_or_a_label_of_all_parameters(study):
    study.run_stage("sweep", workers=1)
    lines = (study.folder / "sweep-fast.csv").read_text().splitlines()
    assert lines[0].startswith("reynolds,lid,status,")
    assert [line.split(",")[:3] for line in lines[1:]] == [
        [f"{reynolds:.1f}", f"{lid:.1f}", "complete"] for reynolds in (60, 150) for lid in (0.6, 1)
    ]
    study.run_stage("trade", only=["lid=0.8"])
    first = dict(zip(lines[0].split(","), lines[1].split(","), strict=True))
    found = study.model("fast", reynolds=60, lid=0.6).sensitivities("lid")
    probe, flux = found.measured["there"], found.measured["flux"]["flow_rate"]
    for name, value in {
        "kinetic_energy": found.kinetic_energy[0, -1],
        "there_velocity_y": probe["velocity"][0, -1, 0, 1],
        "there_pressure": probe["pressure"][0, -1, 0],
        "flux_flow_rate": flux[0, -1],
    }.items():
        assert float(first[f"{name}_by_lid"]) == pytest.approx(value, rel=1e-12), name
    tables = [path.read_text() for path in (study.folder / "trade").rglob("*.csv")]
    assert any("reynolds=100, lid=0.8" in table for table in tables)


def test_derivatives_of_fields_are_differences_of_runs(study):
    model, points = study.model("fast", reynolds=60, lid=0.6), [[0.5, 0.8], [0.3, 0.4]]
    found = model.sensitivities("lid").fields(points).sel(parameter="lid")
    low, high = (model.at(reynolds=60, lid=lid).run().fields(points) for lid in (0.59, 0.61))
    for name in ("velocity", "pressure"):
        expected = (high[name] - low[name]) / 0.02
        error = np.abs(found[name] - expected).max() / np.abs(expected).max()
        assert error < 1e-3, name


def quantities(workspace: Workspace, models: FastModel, point: ParameterPoint) -> list[Any]:
    """Return coordinates, kinetic energy and forces of a run in steps that add nothing."""
    case, reduced = workspace.case, models.at(point)
    run = reference_model.automatic(reduced).with_steps(STEPS).run().coordinates
    _, velocity = reconstruct(reduced.basis, run)
    measured = quantities_of(case, reduced, reduced.output_times.time, run)
    histories = [values for each in measured.values() for values in each.values()]
    return [run, kinetic_energy(velocity, case.plan.mass), *histories]


def check_tangents(study: sphrom.Study, model: str, at: dict[str, float]) -> None:
    """Compare derivatives with differences of runs, extrapolated to none."""
    workspace = Workspace(study._context)
    (section,) = (each for each in study.case.rom if each.name == model)
    models, point = FastModel(workspace, section), study.case.plan.point(at)
    names = study.case.plan.parameter_names
    found = tangents(models, point, names, models.at(point), step_factor=STEPS)
    for k, name in enumerate(names):
        slopes = []
        for width in (4e-3, 2e-3):
            ends = at[name] * (1.0 + width / 2.0), at[name] * (1.0 - width / 2.0)
            runs = [
                quantities(workspace, models, study.case.plan.point({**at, name: e})) for e in ends
            ]
            slopes.append([(a - b) / (ends[0] - ends[1]) for a, b in zip(*runs, strict=True)])
        expected = [(4.0 * fine - wide) / 3.0 for wide, fine in zip(*slopes, strict=True)]
        given = [found.coordinates[k], found.kinetic_energy[k]]
        within = [1e-6, 1e-6]
        for each in found.measured.values():
            given += [values[k] for values in each.values()]
            # Own pressures are small differences, which amplify the errors of steps.
            within += [5e-5 if quantity == "pressure" else 1e-6 for quantity in each]
        for one, other, share in zip(given, expected, within, strict=True):
            assert np.abs(one - other).max() < share * np.abs(other).max(), name


@pytest.mark.parametrize("model", ["fast", "calibrated", "leading", "longer"])
def test_sensitivities_are_the_differences_of_runs(study, model):
    check_tangents(study, model, {"reynolds": 100.0, "lid": 0.8})


def test_sensitivities_of_a_driven_flow_and_its_forces(tmp_path):
    case = {
        **DRIVEN,
        "time": {"final_time": 0.1},
        "snapshots": {"every": 2},
        "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
        "operators": {"error_estimate": False},
    }
    study = sphrom.Study(case, out=tmp_path, quiet=True, threads=1)
    study.run(until="operators")
    at = {"reynolds": 60.0, "U": 0.5, "g": 1.2, "disc": 0.6, "body_force": 1.8, "omega": 2.2}
    check_tangents(study, "fast", at)


def test_sensitivities_in_python(study):
    model = study.model("fast", reynolds=100, lid=0.8)
    found = model.sensitivities("lid")
    assert (found.parameters, found.at) == (("lid",), {"reynolds": 100.0, "lid": 0.8})
    assert found.coordinates.shape == (1, *model.run().coordinates.shape)
    with pytest.raises(CaseError, match="'length': does not vary"):
        model.sensitivities("length")
