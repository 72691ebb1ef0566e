"""The artifacts of one case: their files and dependencies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

from sphrom.artifacts import open_artifact
from sphrom.case.fields import Section
from sphrom.case.loader import case_of_text
from sphrom.case.model_sections import ALL, ReducedModelSection
from sphrom.case.models import VERSIONS, inputs_digest, section_inputs, stated
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import fast_section, sweep_model, sweep_name
from sphrom.errors import ArtifactError, CaseError
from sphrom.setup.context import KnownArtifacts, StageContext
from sphrom.store.artifact_folder import ArtifactFolder, Target
from sphrom.version import __version__

FULL_RUN = ("scene", "fluid", "discretization", "time", "snapshots")
"""The sections that a full run depends on."""


@dataclass(frozen=True)
class Kind:
    """One kind of artifacts."""

    schema: str
    stage: str
    name: str
    """The name of its file; `{}` is the label of a point, a model or a study."""
    sections: tuple[str, ...]
    """The sections of the case that it depends on as a whole."""
    partly: tuple[str, ...] = ()
    """The sections of which it depends on some keys; they are part of its `about`."""


KINDS: Mapping[str, Kind] = {
    "packing": Kind("packing", "fom", "packing.h5", ("scene", "discretization")),
    "spin-up": Kind("state", "fom", "spin-up-{}.h5", FULL_RUN[:3], ("time",)),
    "fom": Kind("trajectory", "fom", "fom-{}.h5", FULL_RUN),
    "map": Kind("reference-snapshots", "map", "map-{}.h5", ("scene", "reference")),
    "pod": Kind("basis", "pod", "pod.h5", ("basis",), ("parameters", "rom")),
    "psi": Kind("spline", "fit-psi", "psi.h5", ("psi",)),
    "psi on a lattice": Kind("b-spline", "fit-psi", "psi.h5", ("psi",)),
    "operators": Kind("operators", "operators", "operators.h5", ("operators",), ("rom",)),
    "model": Kind("model", "operators", "model-{}.h5", FULL_RUN, ("rom",)),
    "model of a surface": Kind("surface-model", "operators", "model-{}.h5", FULL_RUN, ("rom",)),
    "rom": Kind("coordinates", "rom", "rom-{}.h5", FULL_RUN, ("rom", "compare")),
    "map of a surface": Kind("surface-snapshots", "map", "map-{}.h5", ("scene",)),
    "pod of a surface": Kind("surface-basis", "pod", "pod.h5", ("basis",), ("parameters", "rom")),
    "operators of a surface": Kind("surface-operators", "operators", "operators.h5", (), ("rom",)),
    "rom of a surface": Kind("surface-run", "rom", "rom-{}.h5", FULL_RUN, ("rom",)),
    "rom on particles": Kind("trajectory", "rom", "rom-{}.h5", FULL_RUN, ("rom",)),
    "compare": Kind("comparison", "compare", "compare.h5", ("compare", "parameters", "rom")),
    "sweep": Kind("sweep", "sweep", "sweep-{}.h5", FULL_RUN, ("rom", "sweep")),
    "fit": Kind("fit", "fit", "fit-{}.h5", FULL_RUN, ("rom", "fit")),
}
"""The kinds of artifacts by the stage that makes them; some stages make two."""


@dataclass(frozen=True)
class ModelFiles:
    """The artifacts of one family of reduced models."""

    suffix: str
    """Prefix of the names of its kinds."""
    modes: str
    """The dataset of a basis with a row for each mode."""
    bases: tuple[str, ...]
    """The artifacts of the modes."""
    parents: tuple[str, ...]
    """The artifacts from which its models are built."""
    of_bases: Mapping[str, str] = field(default_factory=dict)
    """Statements in its bases; bases with other statements are made again."""


MODEL_FILES: Mapping[str, ModelFiles] = {
    "points": ModelFiles("", "modes/density", ("basis", "splines"), ("basis", "operators")),
    "particles": ModelFiles(
        " on particles", "modes/density", ("basis", "splines"), ("basis", "splines")
    ),
    "surface": ModelFiles(
        " of a surface",
        "stream_modes",
        ("basis",),
        ("basis", "operators"),
        {"noise": "of one direction"},
    ),
}
"""The artifacts of reduced models by the family that a plan names."""


class Workspace(ArtifactFolder):
    """The folder of a case's artifacts, with their names and dependencies."""

    def __init__(self, context: StageContext) -> None:
        super().__init__(context)
        # Requested figures change no artifact, and figures of measurements change no run.
        measure = {name: one.of_runs for name, one in self.case.scene.recorded.items()}
        scene = self.case.scene.model_copy(update={"measure": measure})
        compare = self.case.compare.model_copy(update={"figures": (), "plots": None})
        self._without_figures = self.case.model_copy(update={"compare": compare, "scene": scene})
        self._inputs: dict[str, dict[str, object]] = {}
        self._files = MODEL_FILES[self.case.plan.family()]

    def unphysical(self, point: ParameterPoint) -> list[str]:
        """Return the unphysical effects in the full run at a point."""
        return str(self.attributes(self.full_run(point)).get("unphysical", "")).splitlines()

    def shorter_run(self, point: ParameterPoint) -> Target | None:
        """Return the finished run that a full run continues beyond its final time, or None.

        Raises ArtifactError without `force` if there is one, but `resume` is not set, or the longer
        case has other steps or another speed of sound.
        """
        target = self.full_run(point)
        context = self.context
        if not target.path.exists() or self.imported(target) or not self.reason_to_make(target):
            return None
        finished = self._finished(target)
        if finished is None or finished.case.time.spin_up != self.case.time.spin_up:
            return None
        found = finished.full_run(point)
        old = finished.case.plan
        new = self.case.plan
        if finished.reason_to_make(found) or old.steps.end_time >= new.steps.end_time:
            return None
        ends = f"{target.path} ends at {old.steps.end_time:g} s"
        step = old.steps.time_step
        version = str(self.attributes(target)["softwareVersion"])
        for name, there, here, remedy in (
            ("speed of sound", old.sound_speed, new.sound_speed, ""),
            ("step", step, new.steps.time_step, f"`--set time.step={step!r}` keeps it, "),
            ("version of sphrom", version, __version__, ""),
        ):
            if there != here and context.resume and not context.force:
                raise ArtifactError(
                    f"{ends}, and can't be continued: the {name} is {there} there, {here} here; "
                    f"{remedy}`--force` makes it again"
                )
            if there != here:
                return None
        if not context.resume and not context.force:
            raise ArtifactError(f"{ends}: `--resume` continues it, `--force` makes it again")
        return found if context.resume else None

    def _finished(self, target: Target) -> Workspace | None:
        """Return the workspace of this case with the times of a complete run; None without one."""
        with (
            suppress(ArtifactError, CaseError),
            open_artifact(target.path, target.schema, made_by=target.made_by) as run,
        ):
            if run.text("status") == "complete":
                time = case_of_text(run.case_text).time
                case = self.case.model_copy(update={"time": time})
                return Workspace(replace(self.context, case=case, known=KnownArtifacts()))
        return None

    def packing(self) -> Target:
        """Packed starting positions."""
        return self._target("packing", "", {}, {})

    def spin_up(self, point: ParameterPoint) -> Target:
        """The state at the end of a spin-up, at a parameter point."""
        steps = self.case.plan.steps
        about = {
            "point": point.as_dict(),
            "time step": steps.time_step,
            "spin-up steps": steps.n_spin_up_steps,
        }
        return self._target("spin-up", point.file_label, about, self._packed())

    def full_run(self, point: ParameterPoint) -> Target:
        """The full-order trajectory at a parameter point."""
        about = {"point": point.as_dict(), "steps": self._steps()}
        return self._target("fom", point.file_label, about, self._start(point))

    def mapped(self, point: ParameterPoint) -> Target:
        """The reference snapshots at a parameter point."""
        parents = {"trajectory": self.full_run(point)}
        about: dict[str, object] = {"point": point.as_dict(), **self.case.plan.map_settings}
        if self.case.plan.relaxed_points:
            parents["points"] = self.full_run(self.case.plan.train_points[0])
        return self._target(f"map{self._files.suffix}", point.file_label, about, parents)

    def basis(self) -> Target:
        """The trial bases."""
        plan = self.case.plan
        parents = self._mapped(plan.train_points)
        if self.case.basis.lagrangian:
            parents |= self._full_runs(plan.train_points)
        modes = {f"bases/{n}/{self._files.modes}": plan.basis_size(n) for n in plan.bases}
        about = self._files.of_bases
        return self._target(f"pod{self._files.suffix}", "", about, parents, modes)

    def splines(self) -> Target:
        """The splines of the modes."""
        # The points may determine the kind, not the section alone.
        kind = "psi on a lattice" if self.case.plan.lattice_splines else "psi"
        return self._target(kind, "", {}, {"basis": self.basis()})

    def operators(self) -> Target:
        """The projected operators on the reference points, or trained models with a surface."""
        plan = self.case.plan
        kind = f"operators{self._files.suffix}"
        if "splines" not in self._files.bases:
            parents = {"basis": self.basis(), **self._mapped(plan.train_points)}
            if plan.has_error_estimate(ALL):  # it takes fields and measurements
                parents |= self._full_runs(plan.train_points)
            return self._target(kind, "", {"sizes": plan.surface_sizes}, parents)
        trained = dict.fromkeys(p for name in plan.reference_bases for p in plan.bases[name])
        parents = {"basis": self.basis(), **self._mapped(trained)}
        if self.case.scene.measure:
            parents |= self._full_runs(trained)
        parents["splines"] = self.splines()
        about = {
            "bases": plan.reference_bases,
            "closures": plan.memory_models,
            "calibrated": plan.corrected_bases,
            "sized": plan.sized_bases,
            "varied": plan.parameter_names[1:],
        }
        return self._target(kind, "", about, parents)

    def model(self, model: ReducedModelSection) -> Target:
        """A trained model from operators, which runs without them."""
        about = _about(model, "parameters")
        made_from = self._trained(model)
        return self._target(f"model{self._files.suffix}", model.name, about, made_from)

    def reduced_run(self, model: ReducedModelSection, point: ParameterPoint) -> Target:
        """The run of a reduced model at a parameter point."""
        kind = f"rom{MODEL_FILES[self.case.plan.family(model)].suffix}"
        parents = self._trained(model) | self._start(self.case.plan.start_point(point))
        about = {"point": point.as_dict(), **_about(model, "parameters")}
        return self._target(kind, f"{model.name}-{point.file_label}", about, parents)

    def comparison(self) -> Target:
        """The figures of merit of the case."""
        plan = self.case.plan
        parents = self._full_runs(plan.points)
        if self.case.rom:
            parents |= self._mapped(plan.points) | self._named(self._files.bases)
        for model in filter(plan.ends_with_case, self.case.rom):
            for point in filter(plan.points.__contains__, plan.rom_points(model)):
                parents[f"rom-{model.name}-{point.file_label}"] = self.reduced_run(model, point)
        return self._target("compare", "", {}, parents)

    def sweep(self) -> Target:
        """The runs of the case's sweep, at any values of the parameters; readers check these."""
        model = sweep_model(self.case)
        about: dict[str, object] = {
            "sweep": _without(self.case.sweep.of_any_values, "name", "model")
        }
        parents = self._packed() if model is None or self.case.time.spin_up == 0.0 else {}
        if model is None:
            about["steps"] = self._steps()
        else:
            about |= _about(model, "parameters", "output")
            parents |= self._trained(model)
        return self._target("sweep", sweep_name(self.case), about, parents)

    def fit(self, name: str, measurements: str, noise: float | None) -> Target:
        """The parameters estimated from measurements, by the digest of their file."""
        model = fast_section(self.case, self.case.fit.model)
        about = {
            "fit": _without(self.case.fit, "model", "noise"),
            "noise": noise,
            "measurements": measurements,
            **({} if model is None else _about(model, "parameters", "output")),
        }
        made_from = {"basis": self.basis(), "operators": self.operators()}
        return self._target("fit", name, about, made_from)

    def _trained(self, model: ReducedModelSection) -> dict[str, Target]:
        """Return the artifacts from which a reduced model is built."""
        return self._named(MODEL_FILES[self.case.plan.family(model)].parents)

    def bases(self) -> list[Target]:
        """The trial bases, and the splines of their modes if there are any."""
        return list(self._named(self._files.bases).values())

    def made_from(self, model: ReducedModelSection) -> list[Target]:
        """The artifacts of all training runs from which a model is made, each once."""
        files = MODEL_FILES[self.case.plan.family(model)]
        return list(self._named((*files.bases, *files.parents)).values())

    def _named(self, names: Iterable[str]) -> dict[str, Target]:
        return {name: getattr(self, name)() for name in names}

    def _full_runs(self, points: Iterable[ParameterPoint]) -> dict[str, Target]:
        return {f"fom-{point.file_label}": self.full_run(point) for point in points}

    def _mapped(self, points: Iterable[ParameterPoint]) -> dict[str, Target]:
        return {f"map-{point.file_label}": self.mapped(point) for point in points}

    def _steps(self) -> dict[str, float]:
        names = ("time_step", "n_steps", "every", "n_spin_up_steps")
        return {name: getattr(self.case.plan.steps, name) for name in names}

    def _start(self, point: ParameterPoint) -> dict[str, Target]:
        """Return the artifacts that contain the start of a run at a point."""
        if self.case.time.spin_up > 0.0:
            return {"spin-up": self.spin_up(point)}
        return self._packed()

    def _packed(self) -> dict[str, Target]:
        return {"packing": self.packing()} if self.case.plan.packed else {}

    def _target(
        self,
        name: str,
        label: str,
        about: Mapping[str, object],
        parents: Mapping[str, Target],
        at_least: Mapping[str, int] | None = None,
    ) -> Target:
        """Return a target; `about` are the dependencies beyond the whole sections."""
        kind = KINDS[name]
        plan = self.case.plan
        about = dict(about)
        if name in ("compare", "sweep", "fit", "rom"):
            figures: dict[str, Mapping[str, object]] = {
                "means from": {n: t for n, t in plan.means_from.items() if t > 0.0}
            }
            if name != "rom":
                figures["oscillations"] = {n: vars(each) for n, each in plan.oscillations.items()}
                figures["coefficients"] = plan.coefficients
            about |= {key: each for key, each in figures.items() if each}
        if "fluid" in kind.sections:
            about["largest speed"] = plan.max_speed
            if plan.sound_speed > plan.max_speed / self.case.fluid.mach_number:
                about["sound speed"] = plan.sound_speed
            if (strip := plan.strip) is not None and strip != self.case.scene.strip:
                about["strip speed"] = strip.speed
        if name not in self._inputs:
            self._inputs[name] = section_inputs(self._without_figures, kind.sections)
        inputs = {
            "sections": self._inputs[name],
            "about": stated(about),
            # In their order; they may have been deleted, or be fewer now.
            "inputs": [[role, parent.inputs_digest] for role, parent in parents.items()],
            "schema": kind.schema,
        }
        sections = frozenset({*kind.sections, *kind.partly})
        return Target(
            path=self.context.folders.get(kind.schema, self.out) / kind.name.format(label),
            schema=f"sphrom/{kind.schema}",
            stage=kind.stage,
            made_by=f"sphrom {kind.stage} {self.context.words}",
            inputs_digest=inputs_digest(inputs),
            parents=parents,
            sections=sections.union(*(parent.sections for parent in parents.values())),
            at_least=at_least or {},
        )


def _about(model: ReducedModelSection, *names: str) -> dict[str, object]:
    """Return the values of a reduced model's section, without some keys, and its version."""
    return {"model": _without(model, *names), "rom version": VERSIONS["rom"]}


def _without(section: Section, *names: str) -> dict[str, object]:
    """Return the values of a section, without some keys."""
    values = stated(section)
    assert isinstance(values, dict)
    return {name: value for name, value in values.items() if name not in names}
