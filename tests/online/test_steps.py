"""The steps that a model's section asks for."""

from __future__ import annotations

import pytest

from sphrom.case.sections import ReducedModelSection
from sphrom.online import basis_model
from sphrom.online.basis_model import steps_of


class Reduced:
    """As much of a model as says how long it runs."""

    class output_times:
        n_snapshots = 11
        interval = 0.5


@pytest.mark.parametrize(
    ("time_step", "n_steps"), [("fom", 70), (0.5, 10), (0.01, 500), (0.5 / 333, 3330)]
)
def test_given_steps_divide_the_time_between_snapshots(monkeypatch, time_step, n_steps) -> None:
    monkeypatch.setattr(basis_model.reference_model, "runge_kutta", lambda model, n: n)
    section = ReducedModelSection(name="fast", evaluation="operators", time_step=time_step)
    assert steps_of(section, Reduced(), full_steps=7) == n_steps
