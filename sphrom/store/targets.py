"""The artifacts of one case: where they are, and what each depends on.

An artifact depends on some sections of the case and on the artifacts it was made from. The first
are compared by a digest, the second by their uuid and content (`sphrom.artifacts`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from sphrom.case.fields import Section
from sphrom.case.identity import (
    VERSIONS,
    default_case,
    inputs_digest,
    section_inputs,
    stated,
)
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import fit_model, sweep_model, sweep_name

FULL_RUN = ("scene", "fluid", "discretization", "time", "snapshots")
"""The sections that a full run depends on."""
OF_SNAPSHOTS = ("trajectory", "coordinates", "reference-snapshots")
"""Schemas of what has all snapshots of a run."""
PACKING = ("scene", "discretization")
"""Those that packed positions depend on in part."""


@dataclass(frozen=True)
class Target:
    """One artifact of a case: its file, and what it must have been made with and from."""

    path: Path
    schema: str
    stage: str
    made_by: str
    inputs_digest: str
    parents: Mapping[str, Target]
    sections: frozenset[str]
    """Those of the case that it or a parent depends on, wholly or in part."""
    at_least: Mapping[str, int]
    """Lengths that datasets in it have at least: one that holds more serves as well."""
    n_snapshots: int | None = None
    """How many it has, where it holds a run."""


class Targets:
    """Every artifact that a case can have.

    Parameters
    ----------
    out : the folder of the artifacts.
    folders : of the kinds of artifacts, such as `operators`, that are elsewhere.
    """

    def __init__(self, case: Case, out: Path, folders: Mapping[str, Path]) -> None:
        self.case = case
        # Figures that a case asks for change no artifact.
        self._without_figures = case.model_copy(
            update={"compare": case.compare.model_copy(update={"figures": ()})}
        )
        self.out = out
        self._folders = folders
        self._known: dict[frozenset[str], dict[str, object]] = {}

    def packing(self) -> Target:
        """Packed starting positions."""
        section = self.case.discretization
        about = {
            "domain": self.case.scene.domain,
            "resolution": section.resolution,
            "smoothing length ratio": section.smoothing_length_ratio,
            "packing": section.packing,
        }
        return self._target("packing.h5", "packing", "fom", (), about, partly=PACKING)

    def spin_up(self, point: ParameterPoint) -> Target:
        """The state at the end of a spin-up, at a parameter point."""
        plan = self.case.plan.steps
        return self._target(
            f"spin-up-{point.file_label}.h5",
            "state",
            "fom",
            ("scene", "fluid", "discretization"),
            {
                "point": point.as_dict(),
                "time step": plan.time_step,
                "spin-up steps": plan.n_spin_up_steps,
            },
            self._packed(),
            ("time",),
        )

    def full_run(self, point: ParameterPoint) -> Target:
        """The full-order trajectory at a parameter point."""
        return self._target(
            f"fom-{point.file_label}.h5",
            "trajectory",
            "fom",
            FULL_RUN,
            {"point": point.as_dict(), "steps": self._steps()},
            self._start(point),
        )

    def mapped(self, point: ParameterPoint) -> Target:
        """The reference snapshots at a parameter point."""
        parents = {"trajectory": self.full_run(point)}
        if self.case.reference.points == "relaxed":
            parents["points"] = self.full_run(self.case.plan.train_points[0])
        return self._target(
            f"map-{point.file_label}.h5",
            "reference-snapshots",
            "map",
            ("scene", "reference"),
            {"point": point.as_dict()},
            parents,
        )

    def basis(self) -> Target:
        """The trial bases."""
        parents = {f"map-{p.file_label}": self.mapped(p) for p in self.case.plan.train_points}
        if self.case.basis.lagrangian:
            trained = self.case.plan.train_points
            parents |= {f"fom-{p.file_label}": self.full_run(p) for p in trained}
        return self._target(
            "pod.h5",
            "basis",
            "pod",
            ("basis",),
            {},
            parents,
            ("parameters", "rom"),
            {f"bases/{name}/modes/density": self._n_stored(name) for name in self.case.plan.bases},
        )

    def _n_stored(self, basis: str) -> int:
        """Return how many modes of a basis are stored at least."""
        return self.case.plan.basis_size(basis) * (2 if self.case.basis.fields == "separate" else 1)

    def splines(self) -> Target:
        """The splines of the modes."""
        kind, about = "spline", dict[str, object]()
        if self.case.plan.lattice_splines:
            # The section alone may leave the choice to the points.
            kind, about = "b-spline", {"kind": "b-spline"}
        return self._target("psi.h5", kind, "fit-psi", ("psi",), about, {"basis": self.basis()})

    def operators(self) -> Target:
        """The projected operators on the reference points."""
        bases = self.case.plan.reference_bases
        trained = {point: None for name in bases for point in self.case.plan.bases[name]}
        parents = {"basis": self.basis()}
        parents |= {f"map-{p.file_label}": self.mapped(p) for p in trained}
        if self.case.scene.measured_walls:
            parents |= {f"fom-{p.file_label}": self.full_run(p) for p in trained}
        parents["splines"] = self.splines()
        about: dict[str, object] = {
            "bases": bases,
            "closures": self.case.plan.memory_models,
            "calibrated": self.case.plan.taught_bases,
        }
        if sized := self.case.plan.sized_bases:
            about["sized"] = sized
        if varied := self.case.plan.parameter_names[1:]:
            about["varied"] = varied
        return self._target(
            "operators.h5",
            "operators",
            "operators",
            ("operators",),
            about,
            parents,
            ("rom",),
        )

    def reduced_run(self, model: ReducedModelSection, point: ParameterPoint) -> Target:
        """What a reduced model gave at a parameter point."""
        on_particles = model.on_particles
        made_from = {} if on_particles else {"operators": self.operators()}
        if on_particles or model.tracers or model.output == "probes":
            made_from["splines"] = self.splines()
        about = {"point": point.as_dict(), **_about(model, "parameters")}
        if model.output == "probes":
            where = self.case.compare
            about |= {"line": where.line, "line points": where.line_points, "grid": where.grid}
        return self._target(
            f"rom-{model.name}-{point.file_label}.h5",
            "trajectory" if on_particles else "coordinates",
            "rom",
            FULL_RUN,
            about,
            {"basis": self.basis(), **made_from, **self._start(self.case.plan.start_point(point))},
            ("rom", "compare") if model.output == "probes" else ("rom",),
            model=model,
        )

    def comparison(self) -> Target:
        """The figures of merit of the case."""
        parents = {f"fom-{p.file_label}": self.full_run(p) for p in self.case.plan.points}
        if self.case.rom:
            parents |= {f"map-{p.file_label}": self.mapped(p) for p in self.case.plan.points}
            parents |= {"basis": self.basis(), "splines": self.splines()}
        for model in self.case.rom:
            if not self.case.plan.ends_with_case(model):
                continue
            plan = self.case.plan
            for point in filter(plan.points.__contains__, plan.rom_points(model)):
                name = f"rom-{model.name}-{point.file_label}"
                parents[name] = self.reduced_run(model, point)
        return self._target(
            "compare.h5", "comparison", "compare", ("compare", "parameters", "rom"), {}, parents
        )

    def sweep(self) -> Target:
        """The runs of the case's sweep; which values it has is for who reads it to compare."""
        model, section = sweep_model(self.case), self.case.sweep
        values = ("reynolds", "parameters", "points", "sample", "quantiles")
        kept = _without(section, "name", "model", *values)
        name = f"sweep-{sweep_name(self.case)}.h5"
        if model is None:
            steps = {"steps": self._steps(), "sweep": kept}
            return self._target(name, "sweep", "sweep", FULL_RUN, steps, self._packed(), ("sweep",))
        made_from = {"basis": self.basis()}
        if model.from_operators:
            made_from["operators"] = self.operators()
        if model.on_particles or section.probes:
            made_from["splines"] = self.splines()
        if self.case.time.spin_up == 0.0:
            made_from |= self._packed()
        about = {"sweep": kept, **_about(model, "parameters", "output", "tracers")}
        return self._target(name, "sweep", "sweep", FULL_RUN, about, made_from, ("rom", "sweep"))

    def fit(self, name: str, measurements: str, noise: float | None) -> Target:
        """The parameters that measurements tell, by the digest of their file."""
        model, section = fit_model(self.case), self.case.fit
        about: dict[str, object] = {
            "fit": _without(section, "model", "noise"),
            "noise": noise,
            "measurements": measurements,
        }
        if model is not None:
            about |= _about(model, "parameters", "output", "tracers")
        made_from = {"basis": self.basis(), "operators": self.operators()}
        return self._target(
            f"fit-{name}.h5", "fit", "fit", FULL_RUN, about, made_from, ("rom", "fit")
        )

    def _steps(self) -> dict[str, float]:
        """Return the full model's steps; those of a spin-up only where there are any."""
        plan = self.case.plan.steps
        names = ("time_step", "n_steps", "every", "n_spin_up_steps")
        return {name: value for name in names if (value := getattr(plan, name))}

    def _start(self, point: ParameterPoint) -> dict[str, Target]:
        """Return what a run starts from that has its start at a point."""
        if self.case.time.spin_up > 0.0:
            return {"spin-up": self.spin_up(point)}
        return self._packed()

    def _packed(self) -> dict[str, Target]:
        return {"packing": self.packing()} if self.case.plan.packed else {}

    def _inputs_of(self, sections: frozenset[str]) -> dict[str, object]:
        """Return what sections of the case say, worked out once."""
        if sections not in self._known:
            found = section_inputs(self._without_figures, sections, self._default)
            self._known[sections] = found
        return self._known[sections]

    @cached_property
    def _default(self) -> Case:
        """The case with all defaults; its geometry takes long to check."""
        return default_case(self.case)

    def _target(
        self,
        name: str,
        schema: str,
        stage: str,
        sections: Iterable[str],
        about: Mapping[str, object],
        parents: Mapping[str, Target] | None = None,
        partly: Iterable[str] = (),
        at_least: Mapping[str, int] | None = None,
        model: ReducedModelSection | None = None,
    ) -> Target:
        """Return a target of whole `sections`, and of what `about` has of those in `partly`."""
        parents, case = parents or {}, self.case
        if "fluid" in sections and case.plan.max_speed != case.fluid.reference_speed:
            about = {**about, "largest speed": case.plan.max_speed}
        inputs = {
            "sections": self._inputs_of(frozenset(sections)),
            "about": stated(about),
            # In their order; they may have been deleted since, or be fewer now.
            "inputs": [[role, parent.inputs_digest] for role, parent in parents.items()],
        }
        return Target(
            path=self._folders.get(schema, self.out) / name,
            schema=f"sphrom/{schema}",
            stage=stage,
            made_by=f"sphrom {stage} CASE",
            inputs_digest=inputs_digest(inputs),
            parents=parents,
            sections=frozenset({*sections, *partly}).union(*(p.sections for p in parents.values())),
            at_least=at_least or {},
            n_snapshots=self._n_snapshots(schema, model),
        )

    def _n_snapshots(self, schema: str, model: ReducedModelSection | None) -> int | None:
        if schema not in OF_SNAPSHOTS:
            return None
        plan = self.case.plan.steps if model is None else self.case.plan.model_steps(model)
        return plan.n_snapshots


def _about(model: ReducedModelSection, *names: str) -> dict[str, object]:
    """Return what a reduced model's section says, but for some keys, and its version."""
    return {"model": _without(model, *names), "rom version": VERSIONS["rom"]}


def _without(section: Section, *names: str) -> dict[str, object]:
    """Return what a section says, but for some keys."""
    said = stated(section)
    assert isinstance(said, dict)
    return {name: value for name, value in said.items() if name not in names}
