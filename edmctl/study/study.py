"""A study from Python: planned, run, and continued by jobs, people and other optimisers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from numbers import Real
from operator import index
from typing import TYPE_CHECKING, Any, Self, SupportsIndex

from edmctl import failures
from edmctl.dataclasses import replace
from edmctl.files import user_path
from edmctl.jobs.job import Report
from edmctl.jobs.parallel import pool_of, process_pool, silent_program
from edmctl.jobs.plan import check
from edmctl.jobs.surroundings import Unobserved, python_warnings
from edmctl.profile.folders import as_value, find_study
from edmctl.results.progress import SeriesObserver
from edmctl.results.result import need_pandas
from edmctl.study import responses
from edmctl.study.analysis import analysis_of
from edmctl.study.design import value_within
from edmctl.study.folder import ADDING_S, StudyFolder, StudyState, create_folder, open_folder
from edmctl.study.on_machine import without_port
from edmctl.study.planning import PlannedStudy, plan_study, request_of
from edmctl.study.results import PlannedRun, Recommendation, RunState, StudyPlan, Value
from edmctl.study.running import bare_row, row_of, run_virtual
from edmctl.study.study_file import read_study
from edmctl.study.suggestions import extension_runs, next_batch, recommended, suggested_runs, suggestions
from edmctl.study.table import Cell, check_bounds, in_words, table_of

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from os import PathLike

    import pandas

    from edmctl.study.statistics.response_analysis import ResponseAnalysis


class _Silent(Unobserved):
    def runs(self, done: int, total: int) -> None:
        """Ignore it."""


class Study:
    """A designed experiment: a study file that is planned, or a folder with the rows of its runs.

    `Study.load("taguchi-l9").start("out")` makes the folder, `Study.load("out")` opens it again. All that is known
    of a study is in its folder: two objects, or a command line at the same time, see the same rows.
    """

    def __init__(self, planned: PlannedStudy | None, folder: StudyFolder | None) -> None:
        self._planned, self._folder = planned, folder

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Load a study file, a shipped study by its name, or the folder of a study.

        Raises ProfileError for mistakes of the file, UsageError E2100 or E2101 if there is none, PreconditionError
        E8202 if the folder was changed.
        """
        folder = user_path(path)
        if folder.is_dir():
            return cls(None, open_folder(folder))
        file = find_study(path if isinstance(path, str) else as_value(folder))
        return cls(plan_study(read_study(file)), None)

    def __repr__(self) -> str:
        plan = self.plan()
        where = f", {in_words(self._state().runs)} in {self._folder.path}" if self._folder is not None else ""
        return f"<Study {plan.name}, {plan.kind}, {len(plan.runs)} runs{where}>"

    def plan(self) -> StudyPlan:
        """Return every run in its order, what the runs can tell and what they will take."""
        if self._folder is not None:
            return self._folder.plan
        assert self._planned is not None
        return self._planned.plan

    def start(self, out: str | PathLike[str]) -> Self:
        """Make the folder of the study. Raises RunFileError E9101 where one is there."""
        if self._planned is None:
            raise failures.study_has_folder(value=self)
        self._folder = create_folder(user_path(out), self._planned)
        return self

    def run(
        self,
        *,
        workers: int = 1,
        observer: SeriesObserver | None = None,
        executor: Callable[[], Executor] | None = None,
    ) -> Self:
        """Make the open runs, each on a virtual machine of its own; `workers` processes side by side.

        `executor` makes any executor of `concurrent.futures` with `workers` workers, and is called again if its
        workers died. A script that uses processes needs `if __name__ == "__main__":`, as Python requires.

        A study with a [machine] is warned of (W8215); one that has runs on a machine raises UsageError E2108:
        `edmctl study resume` continues there, or `ask` and `tell` with a machine of one's own.
        """
        if warnings := without_port(self._started()):
            python_warnings(warnings)
        pool = process_pool(workers, silent_program()) if workers > 1 else None
        if executor is not None:
            pool = pool_of(executor, workers)
        run_virtual(self._started(), observer or _Silent(), None, pool)
        return self

    def ask(self, count: int = 1) -> list[PlannedRun]:
        """Return the next runs to make: open runs of the study, then suggestions, which are added.

        Raises UsageError if `count` is below 1, PreconditionError E8209 to E8211 if nothing can be suggested.
        """
        if count < 1:
            raise failures.count_too_small(count=count)
        open_runs = [run.planned for run in self._state().runs if run.state is RunState.OPEN][:count]
        return open_runs or self._added(lambda state: suggestions(state, count))

    def job(self, run: PlannedRun) -> dict[str, Any]:
        """Return profile and overrides of a run, for a job of one's own: `machine.machine(**study.job(run))`."""
        request = request_of(self._started().base, run.settings)
        return {"profile": request.profile, "overrides": list(request.overrides)}

    def add(self, settings: Mapping[str, Value]) -> PlannedRun:
        """Add a run at settings of one's own, by factor key, such as those of another optimiser.

        Raises UsageError E2110 where a factor has no value or one beyond its bounds, ProfileError where the rules
        refuse the recipe.
        """
        folder = self._started()
        factors = folder.plan.factors
        keys = [factor.key for factor in factors]
        if sorted(settings) != sorted(keys):
            raise failures.settings_incomplete(keys=", ".join(keys))
        own = {factor.key: value_within(factor, settings[factor.key]) for factor in factors}
        check(request_of(folder.base, own))
        return self._added(lambda state: suggested_runs(state, [own]))[-1]

    def extend(self) -> list[PlannedRun]:
        """Add one more replicate of the design, in a block of its own; return its runs."""
        return self._added(extension_runs)

    def _added(self, runs_of: Callable[[StudyState], list[PlannedRun]]) -> list[PlannedRun]:
        """Add runs that follow from the rows."""
        return self._started().add(runs_of, ADDING_S)

    def tell(self, run: SupportsIndex | PlannedRun, result: Report | Mapping[str, float]) -> None:
        """Report the result of a run: the report of its job, or responses by name.

        To a run that was made, manual responses are added, as `edmctl study tell` does; reported values may be
        corrected, those measured by its job may not. Raises UsageError: E2104 there is no such run, E2105 a response
        is none of the study's, or was measured.
        """
        if isinstance(run, bool):
            raise TypeError("run has to be a number or a planned run, not a bool")
        folder = self._started()
        state = self._state().run(run.number if isinstance(run, PlannedRun) else index(run))
        if isinstance(run, PlannedRun) and run.settings != state.planned.settings:
            raise failures.run_has_other_settings(number=run.number)
        row = bare_row(state.planned, state.attempts + 1, None, datetime.now(UTC))
        if isinstance(result, Report):
            plan = check(request_of(folder.base, state.planned.settings))
            row = replace(row, seed=result.seed)
            row = row_of(row, plan, result.to_dict(), result.run_file, result.error)
        else:
            values = self._values(result)
            if state.row is not None and state.state is not RunState.OPEN:
                manual = {one.name for one in self.plan().responses if one.is_manual}
                for name in values:
                    if name not in manual and state.row.bases.get(name) != "told":
                        raise failures.response_measured_by_run(number=state.row.number, name=name)
                with folder.writer() as writer:
                    writer.told(state, values)
                return
            row = replace(row, responses=values, bases=dict.fromkeys(values, "told"))
        with folder.writer() as writer:
            writer.run(row)

    def table(self) -> list[dict[str, Cell]]:
        """Return a row a run, with a column a factor key and response."""
        return table_of(self._state())

    def to_frame(self) -> pandas.DataFrame:
        """Return the table as a frame of pandas. Raises ImportError without pandas."""
        frame: pandas.DataFrame = need_pandas().DataFrame(self.table())
        return frame

    def fit(self, response: str) -> ResponseAnalysis:
        """Return the analysis of a response: tables, model, what points that are left out say of it.

        Raises PreconditionError E8206 where no run is done, UsageError E2105 for none of the study's responses.
        """
        found = {one.name: one for one in analysis_of(self._state()).responses}
        if response not in found:
            raise failures.response_unknown(response=response, found=", ".join(found))
        return found[response]

    def recommend(self) -> Recommendation:
        """Return the settings that are expected best. Raises PreconditionError where the rows do not tell."""
        return recommended(self._state())

    def optimize(self, *, workers: int = 1, executor: Callable[[], Executor] | None = None) -> Recommendation:
        """Make the design and then suggested runs, up to the number in [optimize]; return what is recommended."""
        self.run(workers=workers, executor=executor)
        while self._added(next_batch):
            self.run(workers=workers, executor=executor)
        return self.recommend()

    def _started(self) -> StudyFolder:
        if self._folder is None:
            raise failures.study_without_folder(value=self)
        return self._folder

    def _state(self) -> StudyState:
        return self._started().read()

    def _values(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return responses as floats. Raises UsageError E2105 if one is unknown or not a possible number."""
        stated = {one.name: one for one in self._started().source.file.responses}
        names = ", ".join(sorted(stated))
        if not given:
            raise failures.no_response_given(asked=names)
        values: dict[str, float] = {}
        for name, value in given.items():
            number, (low, high) = math.nan, responses.range_of(name)
            if isinstance(value, Real) and not isinstance(value, bool):
                with suppress(OverflowError):
                    number = float(value)
            is_possible = abs(number) <= responses.LARGEST and low <= number <= high
            if (name not in stated and name not in responses.KNOWN) or not is_possible:
                raise failures.response_value_wrong(name=name, value=value, asked=names)
            if name in stated:
                check_bounds(stated[name], number)
            values[name] = number
        return values
