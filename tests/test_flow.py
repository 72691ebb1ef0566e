"""Flows with functions of Python, and terms that a user adds to the acceleration."""

from __future__ import annotations

import numpy as np
import pytest

import sphrom
from sphrom.case import functions
from sphrom.case.loader import case_of_text
from sphrom.case.models import inputs_digest, section_inputs
from sphrom.errors import CaseError
from sphrom.reduction.forms import Inertia, PointFields
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fixed_points import EVERYWHERE, FixedPoints
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional

BOX = {"periodic": ["x", "y"]}
SPACING = 0.1
STREAM = (n for n in range(3))
"""It can't be pickled."""
TURN = sphrom.Term(linear=lambda at: np.array([[0, 1], [-1, 0]]) * (1 + at[:, :1, None]))
PRODUCTS = np.random.default_rng(1).standard_normal((2, 2, 2))
SQUARE = sphrom.Term(quadratic=lambda at: np.multiply.outer(np.sin(at[:, 0]), PRODUCTS))


def study(tmp_path, *, rom=(), sweep=None, **keys) -> sphrom.Study:
    flow = sphrom.Flow(**{"box": BOX, **keys})
    return sphrom.Study(flow, rom=rom, sweep=sweep, resolution=10, out=tmp_path, quiet=True)


@pytest.mark.parametrize("periodic", [(True, True), (False, True), (False, False)])
def test_a_term_is_the_same_in_both_models(periodic) -> None:
    """Its heads at walls included. The state is a sum of two fields, which tests products."""
    domain = BoxDomain((0.0, 0.0), (1.0, 1.0), periodic)
    cut = Discretization(SPACING, 2.0 * SPACING, shifting=False)
    fluid = Fluid(3.0, 1e5, 0.01, 1.0)  # ghosts give way to heads, which the points neglect
    position = domain.fill(SPACING)
    walls = domain.ghosts(SPACING, cut.n_layers) if domain.has_walls else None
    velocity = np.random.default_rng(0).standard_normal((2, len(position), 2))
    q = np.zeros(velocity.shape[1:])
    found, expected = [], []
    for terms in ((), (TURN, SQUARE)):
        full = Functional(fluid, cut, domain, walls, terms=terms)
        expected.append(full.evaluate(position.T.copy(), q[:, 0], velocity.sum(axis=2)).velocity)
        points = FixedPoints(position, fluid, cut, domain, walls, terms=terms)
        slopes = np.zeros((3, 2, *q.shape))
        fields = PointFields(points, q, velocity, lambda rows, s=slopes: s[:, :, rows])
        part, at = Inertia(points), fields.at(EVERYWHERE)
        one, other = at.some(0, 0), at.some(1, 1)
        squares = part.bilinear(at, at).sum(axis=1) + part.products(one, other)[:, 0]
        found.append((part.linear(at).sum(axis=1) + squares)[2:])
    change = np.subtract(*expected)
    assert np.abs(np.subtract(*found) - change).max() <= 1e-8 * np.abs(change).max()


def test_functions_can_take_the_place_of_expressions(tmp_path) -> None:
    texts = {"initial": {"u": "sin(2*pi*y)"}, "body_force": ["cos(y)*sin(3*t)", "x*sin(3*t)"]}
    given = {
        "initial": {"u": lambda y: np.sin(2 * np.pi * y)},
        "functions": {"rise": lambda t: np.sin(3 * t), "gust": lambda y: np.cos(y)},
        "body_force": ["gust(y)*rise(t)", "x*rise(t)"],
    }
    at = np.random.default_rng(0).random((50, 2))
    found = []
    for keys in (given, texts):
        plan = study(tmp_path, **keys).case.plan
        flow = plan.flow(plan.points[0])
        force = flow.body_force
        found.append((flow.initial_velocity(at), force(at.T, 0.4), force.over(at[:, 0])))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)


def test_a_function_is_part_of_the_case_s_identity(tmp_path) -> None:
    def digest(strength: float, profile=np.sin) -> str:
        case = study(tmp_path, body_force=lambda y: (strength * profile(6 * y), 0)).case
        return inputs_digest(section_inputs(case, ["scene"]))

    assert digest(1.0) == digest(1.0)
    assert len({digest(1.0), digest(2.0), digest(1.0, np.cos)}) == 3


def test_other_processes_refuse_a_function(tmp_path, monkeypatch) -> None:
    sweep = {"reynolds": [100, 120], "model": "full"}
    force = [lambda y: np.sin(6 * y), 0]
    of_functions = study(tmp_path, sweep=sweep, body_force=force, terms={"turn": TURN})
    with pytest.raises(CaseError, match="--workers: other processes don't have the functions"):
        of_functions.run_stage("sweep", workers=2)
    text = of_functions.case.text
    assert case_of_text(text) == of_functions.case
    monkeypatch.setattr(functions, "_FUNCTIONS", {})
    with pytest.raises(CaseError, match=r"scene.functions.body_force_0: is a Python function"):
        case_of_text(text)


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"initial": {"u": lambda x: x[:3]}}, r"initial_u: must return values of the shape"),
        ({"initial": {"u": lambda x: 1 / (x - x)}}, r"scene.initial.u: is not a finite number"),
        ({"initial": {"u": lambda z: z}}, "initial.u: z is not a known name"),
        ({"functions": {"f": lambda x, y: x}, "initial": {"u": "f(x)"}}, "f takes x, y; got 1"),
        ({"initial": {"u": lambda x, of=STREAM: x}}, "initial.u: the function uses a value"),
        ({"body_force": lambda x, t: (x * t, 0)}, "must be a field times an amplitude"),
        ({"terms": {"a": sphrom.Term(linear=lambda at: at)}}, r"scene.terms.a: linear: must"),
        ({"terms": {"a": sphrom.Term(linear=lambda at: np.inf)}}, r"scene.terms.a: is not a fin"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero")
def test_refused_functions(tmp_path, keys, reason: str) -> None:
    with pytest.raises(CaseError, match=reason):
        study(tmp_path, **keys)


def test_models_refuse_terms_that_they_lack(tmp_path) -> None:
    fast = [{"name": "fast", "n_modes": 2, "evaluation": "operators"}]
    drag = sphrom.Term(acceleration=lambda at, velocity, time: -velocity)
    with pytest.raises(CaseError, match=r"scene.terms.drag: its acceleration is any function"):
        study(tmp_path, rom=fast, initial={"u": 1.0}, terms={"drag": drag})
    keys = {
        "box": {},
        "walls": {"top": {"velocity": [1, 0]}},
        "measure": {"lid": {"force_on": "top"}},
    }
    with pytest.raises(CaseError, match=r"scene.terms.turn: would be missing in the forces"):
        study(tmp_path, rom=fast, terms={"turn": TURN}, **keys)
    tank = {"box": {}, "fluid": {"level": 0.5}, "slip": "free"}
    with pytest.raises(CaseError, match=r"scene.terms: is not for reduced models of a free surf"):
        study(tmp_path, rom=fast, terms={"turn": TURN}, **tank)
    with pytest.raises(ValueError, match="a term needs functions"):
        sphrom.Term()
