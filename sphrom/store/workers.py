"""Workers that make runs at many points: processes of this machine, or those of a Dask cluster.

Both are executors of `concurrent.futures`. If a process runs out of memory, it is killed and the
tasks of all processes are lost; they are started again by fewer processes. A terminated process
first removes the file that it is writing, and a process ends with its parent.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from typing import Any

from sphrom.case.loader import case_of_text
from sphrom.case.points import ParameterPoint
from sphrom.console import Reporter
from sphrom.errors import ArtifactError, CaseError, ResourceError, UnstableError
from sphrom.kernels import asked_for, when_compiling
from sphrom.kernels.code_cache import CodeCacheWarning
from sphrom.machine import one_blas_thread
from sphrom.setup.context import StageContext
from sphrom.signals import Terminated, interrupts_come_again, termination_interrupts
from sphrom.store.artifact_folder import Target, make_folder
from sphrom.store.checkpoints import left
from sphrom.store.tasks import (
    CASE,
    Answer,
    Do,
    Failure,
    Files,
    Line,
    Task,
    attempt,
    do_elsewhere,
    failures,
    files_of,
    files_of_case,
)
from sphrom.store.workspace import Workspace
from sphrom.whole_files import explained, write_whole

FEWER = 4
"""Factor that reduces the number of processes after one was lost."""
MOST_AHEAD = 4
"""Largest number of processes that compile ahead; more would wait for each other."""
CLEANING = 10.0
"""Time for a process to clean up before it is killed [s]."""
PATIENCE = 15.0
"""Time for a scheduler to answer [s]."""
LOST = ResourceError("its process was lost repeatedly, probably out of memory")
INSTALL = "pip install 'sphrom[cluster]'"
Run = tuple[ParameterPoint, str]
"""The point of a run and the name of its reduced model, empty for the full one."""
Needs = Callable[[Task], Iterable[Path]]
"""A function that returns the files that a task needs on another machine."""


class Workers:
    """Does tasks in this process, in several processes of this machine, or on a Dask cluster."""

    def __init__(self, number: int, report: Reporter, client: Any = None) -> None:
        self._report = report
        self._client = client
        self.number = number if client is None else self._joined()
        """Number of parallel tasks; workers that join a cluster later add to it."""

    def _joined(self) -> int:
        return max(1, len(self._client.nthreads()))

    @property
    def alone(self) -> bool:
        """Whether this process does all tasks."""
        return self.number == 1 and self._client is None

    def run(
        self,
        name: str,
        workspace: Workspace,
        points: Iterable[tuple[Sequence[ParameterPoint], str]],
        do: Do,
        needs: Needs,
        threads: int | None = 1,
    ) -> list[Failure]:
        """Do a task for each of some points with a model's name, and return the failures.

        With `threads` None, workers of this machine share its cores, and those of a cluster the
        cores of theirs.
        """
        case = workspace.case
        context = workspace.context
        if case.scene.has_functions and not self.alone:
            raise CaseError("--workers: other processes don't have the functions of a flow; set 1")
        if self.alone:
            threads = workspace.threads
        elif threads is None and self._client is None:
            threads = max(1, len(os.sched_getaffinity(0)) // self.number)
        options = {
            "keep_valid": context.keep_valid,
            "resume": context.resume or not context.force,
            # Nobody can insist on a run that continues after its worker died.
            "bitwise": context.bitwise or not context.resume,
            "checkpoint_every": context.checkpoint_every,
            "words": context.words,
        }
        out = workspace.out.resolve()
        command = str(uuid.uuid4())
        common = Task(
            case_text=case.text,
            case_folder=str(case.folder),
            out=str(out),
            points=(),
            threads=threads,
            force=context.force,
            command=command,
            token="" if self._client is None else str(out / f".{command}.command"),
            options=tuple(options.items()),
        )
        tasks = [replace(common, points=tuple(some), model=model) for some, model in points]
        failed: list[Failure] = []
        # On any exception, the processes end immediately.
        with (
            self._report.progress(name, sum(len(task.points) for task in tasks)) as advance,
            _shown(common),
            closing(self.done(tasks, do, needs)) as done,
        ):
            for task, told in done:
                failed += told
                advance(len(task.points))
        return failed

    def done(
        self, tasks: Sequence[Task], do: Do, needs: Needs = lambda task: ()
    ) -> Generator[tuple[Task, list[Failure]], None, None]:
        """Yield completed tasks in any order, and restart those of lost processes.

        Tasks come with their files only to workers that have asked for them, as many at once as
        there are workers, because this process holds the files.
        """
        if self.alone:
            yield from ((task, self._taken(task, Answer(attempt(do, task)))) for task in tasks)
            return
        undone = dict.fromkeys(tasks)
        number = self.number
        while undone:
            with suppress(BrokenExecutor), self._executor(number) as executor:
                running = {executor.submit(_attempt_there, do, task): task for task in undone}
                with_files: set[Future[Answer]] = set()
                waiting: list[Task] = []
                while running:
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        task = running.pop(future)
                        with_files.discard(future)
                        answer = _result(future, task)
                        if answer is not None and answer.lacks_files and task.is_shared:
                            waiting.append(task)
                        elif answer is not None:
                            del undone[task]
                            yield task, self._taken(task, answer)
                    while waiting and len(with_files) < self._joined():
                        task = waiting.pop(0)
                        files = _contents(task, needs)
                        future = executor.submit(_attempt_there, do, task, files)
                        with_files.add(future)
                        running[future] = task
            if undone and number == 1:  # the first task has killed the only process
                task = next(iter(undone))
                del undone[task]
                yield task, list(failures(task, LOST))
            number = self.number if number == 1 else max(1, number // FEWER)

    def _taken(self, task: Task, answer: Answer) -> list[Failure]:
        """Write the artifacts of a task, show its lines, and return its failures."""
        for line in answer.told:
            if isinstance(line, Line):
                line.show(self._report)
        if answer.lacks_files:
            removed = ArtifactError(f"{task.out} was removed while runs were made for it")
            return list(failures(task, removed))
        try:
            for name, content in answer.files.items():
                path = Path(task.out, name)
                with explained(path):
                    path.parent.mkdir(exist_ok=True)
                write_whole(path, content)
        except ArtifactError as error:
            return list(failures(task, error))
        return [failure for failure in answer.told if isinstance(failure, Failure)]

    @contextmanager
    def _executor(self, number: int) -> Iterator[Executor]:
        if self._client is not None:
            executor = self._client.get_executor(pure=False)
            try:
                yield executor
            finally:
                executor.shutdown(wait=False)
            return
        # Imported late, because many commands start no processes.
        from sphrom.kernels.jit import code_cache

        code_cache()  # warns if processes can't share compiled code
        # Processes are spawned, because a process with threads can't be forked.
        context = get_context("spawn")
        theirs, ours = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(number, context, _begin, (theirs,))
        try:
            yield pool
        except BaseException:
            ours.close()  # this ends the processes during their tasks
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            ours.close()


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """Let other processes compile kernels that are needed later, in a block.

    They start when the block first has to compile a kernel, one for each thread but at most
    `MOST_AHEAD`, and none if there is a single thread. They end with their work or with the block.
    """
    with ExitStack() as block:

        def start() -> None:
            from sphrom.kernels.jit import threads_for

            number = min(threads_for(asked_for()), MOST_AHEAD)
            # Not by multiprocessing, which would run a program without a guard once more. With -P,
            # no file of the working folder is taken for a module.
            command = [sys.executable or "", "-P", "-m", "sphrom.kernels.ahead", str(number)]
            for share in range(number if number > 1 else 0):
                words = [*command, str(share)]
                with suppress(OSError):  # the kernels are then compiled when they are called
                    process = Popen(words, stdin=PIPE, stdout=DEVNULL, stderr=DEVNULL)
                    block.enter_context(process)
                    block.callback(process.kill)
                    threading.Thread(target=process.wait, daemon=True).start()

        when_compiling.append(start)
        try:
            yield
        finally:
            when_compiling.remove(start)


@contextmanager
def _shown(task: Task) -> Iterator[None]:
    """Provide the file by which workers of a cluster know the folder of the artifacts."""
    if not task.token:
        yield
        return
    path = Path(task.token)
    make_folder(path.parent)
    with explained(path):
        path.touch()
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _contents(task: Task, needs: Needs) -> Files:
    """Return the files that a task needs, by names relative to the folder of the artifacts."""
    files = {path.name: path.read_bytes() for path in needs(task)}
    case = case_of_text(task.case_text, task.case_folder)
    tables = ((name, Path(task.case_folder, name)) for name in files_of_case(case))
    return files | {f"{CASE}/{name}": path.read_bytes() for name, path in tables}


def _result(future: Future[Answer], task: Task) -> Answer | None:
    """Return the answer to an ended task; None if a process died, because that ends all tasks."""
    try:
        return future.result()
    except BrokenExecutor:
        return None
    except CancelledError:
        return Answer(failures(task, ResourceError("the scheduler was lost")))
    except Exception as error:
        killed = type(error).__name__ == "KilledWorker"  # raised after Dask has tried it again
        return Answer(failures(task, LOST if killed else error))


def _begin(parent: Connection) -> None:
    """Make a new process end with its parent, or when the parent closes the connection."""
    # An interrupt from the keyboard ends the parent, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for kind in (CodeCacheWarning, RuntimeWarning):  # the parent shows them
        warnings.simplefilter("ignore", kind)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    with suppress(EOFError, OSError):
        parent.recv()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(CLEANING)
    os.kill(os.getpid(), signal.SIGKILL)


def _attempt_there(do: Do, task: Task, files: Files | None = None) -> Answer:
    """Do a task in a process of its own, which ends when it is terminated."""
    try:
        with one_blas_thread(), termination_interrupts(), interrupts_come_again():
            if task.is_shared:
                return Answer(attempt(do, task))
            return Answer(lacks_files=True) if files is None else do_elsewhere(do, task, files)
    except Terminated:
        os._exit(128 + signal.SIGTERM)


@contextmanager
def start_workers(number: int, scheduler: str | None, report: Reporter) -> Iterator[Workers]:
    """Provide workers on this machine, or on the Dask cluster with a scheduler's address.

    Raises CaseError without the library, or if no scheduler answers at tcp://node:8786 or the like.
    """
    if scheduler is None:
        yield Workers(number, report)
        return
    try:
        from distributed import Client

        client = Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except ImportError as error:
        raise CaseError(f"--scheduler: needs the library distributed: {INSTALL}") from error
    except (OSError, ValueError) as error:
        raise CaseError(
            f"--scheduler: no scheduler answers at {scheduler}; start one with `dask scheduler`, "
            f"and workers with `dask worker {scheduler} --nworkers auto --nthreads 1`"
        ) from error
    with client:
        if not client.nthreads():
            report.warn(f"--scheduler: {scheduler} has no workers yet; runs wait for workers")
        yield Workers(number, report, client)


def made_by_workers(
    workspace: Workspace, name: str, do: Do, targets: Mapping[Run, Target]
) -> tuple[StageContext, list[Failure]]:
    """Let workers make the missing artifacts of runs, if the context has any workers.

    Runs that nobody may start, such as stopped ones without `resume`, are left to the stage.

    Returns the context in which the stage keeps these artifacts, and the failures of runs that
    became unstable without an artifact. Raises SphromError when runs fail for other reasons.
    """
    context = workspace.context
    number = context.workers or 1
    again = context.force and not context.keep_valid
    missing = {
        run: target
        for run, target in targets.items()
        if (again or workspace.reason_to_make(target) is not None)
        and (context.force or context.resume or not (target.path.exists() or left(target)))
        and not workspace.imported(target)
    }
    if not missing or (min(number, len(missing)) == 1 and context.scheduler is None):
        return context, []

    def needs(task: Task) -> Iterator[Path]:
        return files_of(workspace, missing[task.points[0], task.model])

    with start_workers(min(number, len(missing)), context.scheduler, context.report) as workers:
        tasks = (((point,), model) for point, model in missing)
        failed = workers.run(name, workspace, tasks, do, needs, context.threads)
    for target in missing.values():
        context.known.forget(target.path)
    known = {(each.point, each.model): each for each in failed}
    lost = [e for run, e in known.items() if workspace.reason_to_make(missing[run]) is not None]
    if other := [failure for failure in lost if failure.kind is not UnstableError]:
        raise other[0].kind("\n".join(failure.text for failure in other))
    return replace(context, keep_valid=True), lost
