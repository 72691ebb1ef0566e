"""A case with the folder of its artifacts: run stages, get models, open artifacts."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sphrom import stages
from sphrom.api.flow import Flow
from sphrom.api.model import Model
from sphrom.arguments import checked
from sphrom.artifacts import open_artifact, read_record
from sphrom.artifacts.records.reduced_models import TrainedModel, TrainedSurfaceModel
from sphrom.case.loader import case_of_text, load_case
from sphrom.case.models import Case
from sphrom.case.tables import remember
from sphrom.console import Reporter
from sphrom.errors import ArtifactError, CaseError
from sphrom.signals import guarded
from sphrom.text import nearest, quoted

if TYPE_CHECKING:
    import xarray


class Study:
    """A case with the folder of its artifacts, which it shares with the command line.

    Parameters
    ----------
    case : a case file, the content of a case as a mapping, or a `Flow`. A flow is the scene of a
        case with the name `flow`; `keys` gives other sections, such as `rom=[...]`.
    set : values by dotted key, such as `{"rom.0.n_modes": 5}`, like `--set`.
    out : folder of the artifacts, by default `runs/CASE` in the working directory.
    force : whether to overwrite artifacts and to accept a time step above its limit.
    threads : number of threads; by default all cores.
    quiet : whether to print warnings and results only.
    report : a function that takes each line of output, instead of the standard output.
    keys : values by the last segment of a key, such as `resolution=50`, if it is unique in the
        case, or by a key at the top level, such as `name="coarse"`.

    Raises CaseError with one line per problem of the case or of arguments, and with suggestions for
    unknown or ambiguous keys and names; ArtifactError when an artifact is missing, damaged, or of
    another case and may not be overwritten; UnstableError when a run became unstable; ResourceError
    when the case does not fit this machine.
    """

    @guarded()
    @checked
    def __init__(
        self,
        case: str | os.PathLike[str] | Mapping[str, Any],
        *,
        set: Mapping[str, Any] | None = None,
        out: str | os.PathLike[str] | None = None,
        force: bool = False,
        threads: int | None = None,
        quiet: bool = False,
        report: Callable[[str], object] | None = None,
        **keys: Any,
    ) -> None:
        self._context = stages.context_of(
            load_case(
                {"name": "flow", "scene": case} if isinstance(case, Flow) else case,
                {**({} if set is None else set), **keys},
                force,
            ),
            Reporter(quiet=quiet, write=report),
            out=None if out is None else Path(out),
            force=force,
            threads=threads,
        )

        # The last model, by name and number of written artifacts, each of which may change it.
        self._models: dict[tuple[str, int], Model] = {}

    def __repr__(self) -> str:
        return f"Study({self.case.name!r}, out={str(self.folder)!r}, models={[*self.models]})"

    @property
    def case(self) -> Case:
        """The checked case, with all defaults filled in."""
        return self._context.case

    @property
    def folder(self) -> Path:
        """The folder of the artifacts."""
        return self._context.out

    @property
    def models(self) -> tuple[str, ...]:
        """The names of the case's reduced models."""
        return tuple(model.name for model in self.case.rom)

    @guarded()
    @checked
    def run(
        self,
        until: str | None = None,
        *,
        resume: bool = False,
        checkpoint_every: float = 60.0,
        workers: int | None = None,
        scheduler: str | None = None,
    ) -> None:
        """Run all stages that the case needs, keeping valid artifacts, like `sphrom run`.

        Long runs that are interrupted leave checkpoints, and continue with `resume=True`.

        Parameters
        ----------
        until : the last stage to run: fom, map, pod, fit-psi, operators, rom, or by default
            compare.
        checkpoint_every : time between checkpoints [s].
        workers : number of processes that make the runs and maps.
        scheduler : address of a Dask scheduler, whose workers make them instead.
        """
        context = stages.with_checkpoints(self._context, resume=resume, every=checkpoint_every)
        stages.run_all(stages.with_workers(context, workers, scheduler), until)

    @guarded()
    @checked
    def run_stage(
        self,
        stage: str,
        *,
        only: Sequence[str] = (),
        resume: bool = False,
        checkpoint_every: float = 60.0,
        **options: Any,
    ) -> None:
        """Run one stage like its command, such as `run_stage("sweep", workers=2)`.

        Parameters
        ----------
        stage : fom, map, pod, fit-psi, operators, rom, compare, figures, trade, extremes, sweep,
            train, fit, export, report, check or draw.
        only : parameter values to run at, such as `["reynolds=100"]`, or `["lid=0.8"]` for all
            points with that value; for rom and export also names of models.
        options : the command's own options: `workers` and `scheduler` of fom, map, rom, trade,
            sweep and train; `tolerance` of trade and train; `quick` of extremes; `shard` and
            `collect` of sweep; `budget` and `write_case` of train; `measurements`, `noise` and
            `name` of fit; `to`, `into`, `at` and `columns` of export.
        """
        names = [name for name in stages.STAGES if name != "import"]
        name = stage.replace("_", "-")
        if name not in names:
            raise CaseError(f"no stage is called {quoted(stage)}; {nearest(name, names)}")
        context = stages.with_checkpoints(self._context, resume=resume, every=checkpoint_every)
        context = stages.selected(context, name, only)
        stages.run_stage(name, context, **options)

    @guarded()
    @checked
    def model(self, name: str, **parameters: float) -> Model:
        """Return a reduced model at parameter values, which may differ from the trained ones.

        A model on the reference points needs the operators, from `run(until="operators")`.

        Parameters
        ----------
        name : name of a model in the case's section `rom`.
        parameters : parameter values, such as `reynolds=137`. By default, a parameter has the value
            of all training runs, or the scene's own value if they differ. The scene has no Reynolds
            number, so it is necessary if training runs have several.
        """
        sections = {section.name: section for section in self.case.rom}
        if name not in sections:
            raise CaseError(f"no model has the name {quoted(name)}; {nearest(str(name), sections)}")
        key = name, len(self._context.known.written)
        if key not in self._models:
            context = replace(self._context, keep_valid=True)
            self._models = {key: Model(context, sections[name])}
        return self._models[key].at(**parameters)


@guarded(solves=False)
@checked
def load(path: str | os.PathLike[str]) -> Model:
    """Open a trained model from its artifact, such as `model-fast.h5`, and nothing else.

    The file has the data for runs at any parameters: no case, full run, basis or operators are
    read. The model is at the parameter values of the first training run; `at` changes them.

        sphrom.load("model-fast.h5").at(reynolds=137).run()

    Raises ArtifactError when the file is missing, damaged, foreign, or of another major version.
    """
    made_by = "sphrom operators CASE"
    stored: TrainedModel | TrainedSurfaceModel
    with open_artifact(Path(path), None, made_by=made_by) as artifact:
        kind = artifact.schema
        text = artifact.case_text
        if kind == "sphrom/model":
            stored = read_record(artifact, TrainedModel)
        elif kind == "sphrom/surface-model":
            stored = read_record(artifact, TrainedSurfaceModel)
        else:
            raise ArtifactError(
                f"{path} is a {kind}, not a model; `{made_by}` writes model-NAME.h5"
            )
    for history in stored.histories.values():
        remember(**vars(history))
    try:
        case = case_of_text(text)
    except CaseError as error:
        raise ArtifactError(f"{path} was made with a case that is invalid now: {error}") from error
    section = next((model for model in case.rom if model.name == stored.model), None)
    if section is None:
        raise ArtifactError(f"{path} is damaged: its case has no model {quoted(stored.model)}")
    context = stages.context_of(case, Reporter(), Path(path).parent, force=False, threads=None)
    return Model(context, section, stored).at(**case.plan.train_points[0].as_dict())


@guarded(computes=False)
@checked
def open(path: str | os.PathLike[str], group: str = "") -> xarray.Dataset:
    """Open an artifact, or a group of one such as `bases/all`, as a dataset with named axes.

    Variables have the names of `sphrom/artifacts.md`, with `_` instead of `/`, and attributes with
    units and meaning. Select snapshots by time with `run.velocity.sel(time=0.1, method="nearest")`.
    The attribute `groups` lists the groups of an artifact, if any; each group includes the
    variables that are common to all groups.

    Opening checks that the artifact is complete, and verifies datasets of up to 1 MiB. Larger ones
    are verified block by block at the first use of their values. Values are read when they are
    used, so the file stays open until the dataset is closed; use `with`, or `load`.

    Raises ArtifactError when the file is missing, damaged or foreign, CaseError for no such group.
    """
    from sphrom.artifacts.labelled import open_labelled

    return open_labelled(Path(path), group)
