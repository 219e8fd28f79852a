"""Running a study on virtual machines: what is left of it, side by side, row after row."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from edmctl.core.library import library
from edmctl.dataclasses import dataclass
from edmctl.errors import UsageError
from edmctl.jobs.parallel import Lost, Pool, Program, perform
from edmctl.jobs.plan import FRESH
from edmctl.results.progress import SeriesObserver
from edmctl.study.evaluate import RunTask, evaluate, lost_row
from edmctl.study.on_machine import refuse_mixture
from edmctl.study.planning import request_of
from edmctl.study.results import RunRow, RunState, StudyRun

if TYPE_CHECKING:
    from edmctl.study.folder import StudyFolder, StudyState


@dataclass(frozen=True, slots=True)
class Shard:
    """Part `index`, from 1, of `count` parts of the runs of a study: what one computer of several does."""

    index: int = 1
    count: int = 1

    def __contains__(self, number: int) -> bool:
        return number % self.count == self.index % self.count

    @property
    def name(self) -> str:
        """Name of the part's lock."""
        return "all" if self.count == 1 else f"shard-{self.index}-of-{self.count}"


def parse_shard(text: str | None) -> Shard:
    """Return the part that `K/N` means; all of it without. Raises UsageError E2102."""
    if text is None:
        return Shard()
    index, slash, count = text.partition("/")
    if slash and index.isascii() and index.isdigit() and count.isascii() and count.isdigit():
        found = Shard(int(index), int(count))
        if 1 <= found.index <= found.count <= 10_000:
            return found
    raise UsageError(
        f"--shard {text} is no part K/N of a study.",
        hint="Say --shard 1/2 on one computer and --shard 2/2 on the other.",
        code="E2102",
    )


def open_runs(state: StudyState, shard: Shard) -> list[StudyRun]:
    """Return the runs of a part that are left to make, in their order."""
    return [run for run in state.runs if run.state is RunState.OPEN and run.planned.number in shard]


def task_of(folder: StudyFolder, run: StudyRun) -> RunTask:
    """Return the next attempt at a run as a task for any worker."""
    keep = folder.source.file.study.run_files
    return RunTask(
        run.planned,
        run.attempts + 1,
        request_of(folder.base, run.planned.settings),
        folder.recipes.get(run.planned.point),
        folder.runs if keep else None,
    )


def run_virtual(
    folder: StudyFolder,
    shard: Shard,
    observer: SeriesObserver,
    program: Program | None = None,
    pool: Pool | None = None,
) -> int:
    """Make the runs of a part that are left, each on a fresh virtual machine; return how many were made.

    Rows are on disk when they are counted. `pool` takes them side by side; without, this process makes them.

    Raises UsageError E2108 where runs of the study are on a machine that lasts, PreconditionError E8201 where
    another command runs the part, E8093 or E8094 where the library cannot be built, and what `evaluate` raises.
    """
    with folder.claimed(shard.name), folder.writer() as writer:
        state = folder.read()
        refuse_mixture(state, FRESH)
        left = open_runs(state, shard)
        if not left:
            return 0
        library()  # built by this process, once
        tasks = [task_of(folder, run) for run in left]
        if tasks[0].folder is not None:
            tasks[0].folder.mkdir(exist_ok=True)
        done = 0

        def keep(number: int, row: RunRow | Lost) -> None:
            nonlocal done
            writer.run(
                lost_row(tasks[number].run, tasks[number].attempt, f"E1000: {row}")
                if isinstance(row, Lost)
                else row
            )
            done += 1
            observer.runs(done, len(tasks))

        observer.runs(0, len(tasks))
        if pool is None:
            for number, task in enumerate(tasks):
                keep(number, evaluate(task, program))
        else:
            perform(partial(evaluate, program=program), tasks, pool, keep)
        return done
