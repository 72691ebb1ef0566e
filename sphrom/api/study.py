"""A case with the folder of its artifacts: run its stages, take models, open artifacts."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sphrom import stages
from sphrom.api.model import Model
from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.console import Reporter
from sphrom.errors import CaseError
from sphrom.signals import guarded
from sphrom.text import nearest, quoted

if TYPE_CHECKING:
    import xarray


class Study:
    """A case, and the folder of its artifacts, which the command line reads and writes as well.

    Parameters
    ----------
    case : a case file, or a case's content as a mapping.
    set : values by dotted key, such as `{"rom.0.n_modes": 5}`; what `--set` does.
    out : folder of the artifacts, by default `runs/<name of the case>` in the working directory.
    force : write over artifacts, and insist on a step beyond its limit.
    threads : threads to compute on; None is all cores.
    quiet : print warnings and results only.
    report : a function that takes each line that is told, in place of the standard output.
    keys : values by a key's last segment, such as `resolution=50`, where only one key of the case
        has it, or by a key at the top, such as `name="coarse"`.

    Raises CaseError with a line for each problem of the case or of arguments; of a key or a name
    that is unknown or ambiguous, with those that may be meant. ArtifactError when an artifact is
    missing, damaged, or of another case and may not be written over, UnstableError when a run
    became unstable, ResourceError when the case would not fit this machine.
    """

    @guarded()
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
        if threads is not None and not (isinstance(threads, int) and threads >= 1):
            raise CaseError(f"--threads: must be a whole number from 1 on; got {quoted(threads)}")
        if out is not None and not os.fspath(out):
            raise CaseError("out: is empty: give a folder")
        self._context = stages.context_of(
            load_case(case, {**(set or {}), **keys}, force),
            Reporter(quiet=quiet, write=report),
            out=None if out is None else Path(out),
            force=force,
            threads=threads,
        )

        # The last one, by its name and how many artifacts had been written: each may change it.
        self._models: dict[tuple[str, int], Model] = {}

    def __repr__(self) -> str:
        return f"Study({self.case.name!r}, out={str(self.folder)!r}, models={[*self.models]})"

    @property
    def case(self) -> Case:
        """The checked case, with every default filled in."""
        return self._context.case

    @property
    def folder(self) -> Path:
        """Where the artifacts are."""
        return self._context.out

    @property
    def models(self) -> tuple[str, ...]:
        """The names of the case's reduced models."""
        return tuple(model.name for model in self.case.rom)

    @guarded()
    def run(
        self, until: str | None = None, *, resume: bool = False, checkpoint_every: float = 60.0
    ) -> None:
        """Run all stages that are needed, keeping what is there and valid; as `sphrom run`.

        Stopped by an interrupt, long runs leave checkpoints, and continue with `resume=True`.

        Parameters
        ----------
        until : the last stage to run: fom, map, pod, fit-psi, operators, rom or compare, the
            default.
        checkpoint_every : seconds from one checkpoint of a run to the next.
        """
        context = stages.with_checkpoints(self._context, resume=resume, every=checkpoint_every)
        stages.run_all(context, until)

    @guarded()
    def run_stage(
        self,
        stage: str,
        *,
        only: Sequence[str] = (),
        resume: bool = False,
        checkpoint_every: float = 60.0,
        **options: Any,
    ) -> None:
        """Run one stage as its command does, such as `run_stage("sweep", workers=2)`.

        Parameters
        ----------
        stage : fom, map, pod, fit-psi, operators, rom, compare, trade, sweep, train, fit, export,
            report or check.
        only : parameter values to run at, such as `["reynolds=100"]`, or `["lid=0.8"]` for all
            points with that value; of rom also names of models.
        options : what else the command can be told: `tolerance` of trade and train; `workers` and
            `scheduler` of sweep and train; `shard` and `collect` of sweep; `budget` and
            `write_case` of train; `measurements`, `noise` and `name` of fit; `to`, `into` and `at`
            of export.
        """
        known = [name for name in stages.STAGES if name != "import"]
        name = stage.replace("_", "-")
        if name not in known:
            raise CaseError(f"no stage is called {quoted(stage)}; {nearest(name, known)}")
        context = stages.with_checkpoints(self._context, resume=resume, every=checkpoint_every)
        context = stages.selected(context, name, only)
        stages.run_stage(name, context, **options)

    @guarded()
    def model(self, name: str, **parameters: float) -> Model:
        """Return a reduced model at parameter values, which need not be trained.

        A model on the reference points needs the operators: `run(until="operators")`.

        Parameters
        ----------
        name : of a model in the case's section `rom`.
        parameters : the value of each parameter, such as `reynolds=137`; one that isn't given has
            the scene's own value.
        """
        sections = {section.name: section for section in self.case.rom}
        if name not in sections:
            raise CaseError(f"no model has the name {quoted(name)}; {nearest(str(name), sections)}")
        key = name, len(self._context.known.written)
        if key not in self._models:
            context = replace(self._context, keep_valid=True)
            self._models = {key: Model(context, sections[name])}
        return self._models[key].at(**parameters)


@guarded(computes=False)
def open(path: str | os.PathLike[str], group: str = "") -> xarray.Dataset:
    """Open an artifact, or a group of one such as `bases/all`, as a dataset with named axes.

    Variables are called as in `sphrom/artifacts.md`, `_` in place of `/`, and carry their units
    and meaning. Snapshots can be selected by time: `run.velocity.sel(time=0.1, method="nearest")`.
    The attribute `groups` lists the groups of an artifact that has some; a group comes with what
    belongs to all of them.

    Opening checks that the file is a whole artifact, and verifies datasets of up to 1 MiB. A larger
    one is verified, block by block, when values of it are first used. Values are read when they
    are used, so the file stays open until the dataset is closed; use `with`, or `load`.

    Raises ArtifactError when the file is missing, damaged or no artifact, CaseError when it has no
    such group.
    """
    from sphrom.artifacts.labelled import open_labelled

    return open_labelled(Path(path), group)
