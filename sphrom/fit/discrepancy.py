"""What a fast model may be wrong by in measured histories, from its training runs.

The model repeats each training run without that run's own correction. Its histories then differ
from those of the full run as they do where no full run is, with the correlations over time and from
place to place that errors of this model have. The differences are scaled by the model's estimated
error at the fitted parameters over that of the training run, both root mean squares over the fluid
and the run: those of velocities and flow rates by the velocity's, of pressures by the pressure's,
of forces by the larger of both.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.plan import has_error_estimate, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.fit.histories import FittedModel
from sphrom.fit.measurements import UNNAMED
from sphrom.metrics.measures import PLACED, Quantities
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.setup.places import places_of
from sphrom.store.measured_quantities import read_quantities
from sphrom.store.trajectory import snapshot_fields

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


TrainingDifferences = dict[Hashable, tuple[Array, Array]]
"""Of histories in training runs, by basis and histories, with the sizes of errors over the fluid.
Fits of one model share them."""


class TrainingErrors:
    """The errors of a model's histories in the training runs of its bases, found once."""

    def __init__(self, model: FittedModel, known: TrainingDifferences) -> None:
        self._model = model
        self._case = model.fast.workspace.case
        self._known = known
        plan = step_plan(self._case)
        self._compared = compared_snapshots(plan.n_snapshots)
        self._time = plan.start_time + plan.snapshot_interval * self._compared

    def samples(self, place: Array) -> Array | None:
        """Return what histories may be wrong by (n_samples, n_snapshots, n_histories) at a place.

        None where the case wants no estimates of errors or can't have them, or full training runs
        are no longer there.
        """
        model = self._model
        point = model.point(place)
        name = model.fast.basis_at(point)
        full_runs = map(model.fast.workspace.full_run, self._case.bases[name])
        if not has_error_estimate(self._case, name) or not all(t.path.exists() for t in full_runs):
            return None
        reduced = model.reduced(point)
        run = model.fast.run(point, reduced, model.integrator(reduced))
        found = run.estimate
        if found is None or found.errors is None:
            return None
        key = (name, tuple((h.measure, h.place, h.quantity, h.component) for h in model.histories))
        if key not in self._known:
            self._known[key] = self._differences(name)
        differences, sizes = self._known[key]
        ratios = np.sqrt(np.mean(found.errors**2, axis=0) / np.mean(sizes**2, axis=1))
        factors = np.stack([self._of_histories(each) for each in ratios])
        scaled = differences * factors[:, None]
        return np.stack(
            [[np.interp(run.time, self._time, h) for h in each.T] for each in scaled]
        ).transpose(0, 2, 1)

    def _of_histories(self, by_field: Array) -> Array:
        """Return for every history (n_histories,) the value of its field (2,)."""
        of = {"velocity": by_field[0], "flow_rate": by_field[0], "pressure": by_field[1]}
        return np.array([of.get(h.quantity, by_field.max()) for h in self._model.histories])

    def _differences(self, name: str) -> tuple[Array, Array]:
        """Return the differences of histories, and the sizes of errors over the fluid.

        They are (n_runs, n_compared, n_histories) and (n_runs, n_compared, 2) [m/s]; runs that
        diverged are left out.
        """
        model, compared = self._model, self._compared
        points, taught = self._case.bases[name], model.fast.on_basis(name)
        trained, correction = taught.trained(), taught.correction
        places = places_of(self._case, points)
        differences, sizes = [], []
        for k, (there, run) in enumerate(trained):
            if not np.isfinite(run).all():
                continue
            own = run if correction is None else run + correction.held_out(places[k])
            # A model may end earlier or later than its training runs.
            reduced = replace(model.reduced_in(points[k], name), output_times=there.output_times)
            given = model.stacked(model.quantities(points[k], reduced, own))[compared]
            differences.append(self._recorded(points[k]) - given)
            sizes.append(taught.products.errors(k, own[compared]))
        return np.array(differences), np.array(sizes)

    def _recorded(self, point: ParameterPoint) -> Array:
        """Return the histories (n_compared, n_histories) of a full run."""
        workspace = self._model.fast.workspace
        with workspace.open(workspace.full_run(point)) as run:
            there = {name: read_quantities(run, name) for name in self._case.scene.measure}
            recorded: dict[str, Quantities] = {
                name: {q: v[self._compared] for q, v in each.items()}
                for name, each in there.items()
            }
            recorded |= self._sampled(run)
        return self._model.stacked(recorded)

    def _sampled(self, run: Artifact) -> dict[str, Quantities]:
        """Return velocity and pressure of a full run at the places that have no name."""
        fields = self._model.fields_at_places()
        if fields is None:
            return {}
        found = [fields(*snapshot_fields(run, k))[UNNAMED] for k in self._compared]
        return {UNNAMED: {q: np.stack([each[q] for each in found]) for q in PLACED}}
