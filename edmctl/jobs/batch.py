"""Many simulated runs over the cores of this computer, summed up; their rows let an interrupted series continue."""

from __future__ import annotations

import math
import shlex
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.core.library import library
from edmctl.csv_text import table_text
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import Interrupted, ProfileError, RunFileError
from edmctl.exitcodes import error_exit_code
from edmctl.files import user_path
from edmctl.jobs.job import Report, carry_out
from edmctl.jobs.parallel import Lost, Program, cores, process_pool
from edmctl.jobs.parallel import perform as side_by_side
from edmctl.jobs.plan import SIMULATOR, JobRequest, Plan, check
from edmctl.jobs.run_header import name_run, plain_name, run_path
from edmctl.jobs.surroundings import Surroundings, Unobserved
from edmctl.jobs.sweep import grid_of, of_sweep
from edmctl.jsonout import to_json_value
from edmctl.labels import Basis, basis_of
from edmctl.profile.folders import is_path
from edmctl.record.disk import refuse_place
from edmctl.record.json_rows import RowWriter, read_lines, record_of
from edmctl.results.declared import shared
from edmctl.results.job import (
    Case,
    ChannelResult,
    SimulatedRun,
    SimulatedSite,
    SiteResult,
    SiteTruth,
    Statistics,
)
from edmctl.results.progress import Observer, SeriesObserver
from edmctl.start_up import collect_garbage

_SITE_QUANTITIES = ("depth_um", "wear_um", "depth_error_um", "wear_error_um")
_RUN_QUANTITIES = ("machining_time_s", "time_s", "mrr_mm3_min", "wear_ratio_lin", "arc_share")
_TRUE_QUANTITIES = ("depth_um", "wear_um")


def run_of(seed: int, exit_code: int, report: Report) -> SimulatedRun:
    """Reduce a report to one row."""
    message = report.error.message if report.error else None
    model = report.model.text if report.model else ""
    made, channel = _made(report), report.job.channel
    if not made:
        return SimulatedRun(
            seed, report.error is None, exit_code, message, time_s=report.job.time_s, calibration=model
        )
    site, truth = made[0]
    values = shared(SimulatedRun, site) | shared(SimulatedRun, report.job)
    values |= {
        "ok": report.error is None,
        "exit_code": exit_code,
        "error": message,
        "truth": truth,
        "arc_share": site.ratios.arc,
        "cuts": channel.passes if channel else sum(one.cuts for one in report.job.sites),
        "calibration": model,
        "sites": tuple(SimulatedSite(**shared(SimulatedSite, one), truth=true) for one, true in made),
    }
    return SimulatedRun(seed, **values)


def _made(report: Report) -> list[tuple[SiteResult | ChannelResult, SiteTruth]]:
    channel, truth = report.job.channel, report.channel_truth
    if channel is not None:
        return [(channel, SiteTruth(truth.depth_um, truth.wear_um) if truth else SiteTruth())]
    return list(zip(report.job.sites, report.truths, strict=True)) if report.truths else []


def summarize(label: str, overrides: tuple[str, ...], runs: Sequence[SimulatedRun]) -> Case:
    """Sum up the runs of one set of values; those that made nothing count as failed only."""
    made = [run for run in runs if run.sites]
    sites = [site for run in made for site in run.sites]
    return Case(
        label=label,
        overrides=overrides,
        runs=tuple(runs),
        failed=sum(not run.ok for run in runs),
        spreads={**_of_basis(sites, Basis.TOUCHED), **_statistics_of(made, _RUN_QUANTITIES)},
        by_model=_of_basis(sites, Basis.MODEL),
        estimated=_of_basis(sites, Basis.ESTIMATED),
        truth=_statistics_of([site.truth for site in sites], _TRUE_QUANTITIES),
        coverage=_coverage(sites),
    )


def _of_basis(sites: Sequence[SimulatedSite], basis: Basis) -> dict[str, Statistics]:
    """Return statistics of the sites with one basis; an estimated depth equals its target and has no scatter."""
    found: dict[str, Statistics] = {}
    for key in _SITE_QUANTITIES:
        of_basis = [site for site in sites if basis_of(key, site.depth_basis, site.wear_basis) == basis]
        found |= _statistics_of(of_basis, (key,))
    return found


def _statistics_of(
    rows: Sequence[SimulatedRun] | Sequence[SimulatedSite] | Sequence[SiteTruth], keys: Sequence[str]
) -> dict[str, Statistics]:
    found = {key: [v for row in rows if math.isfinite(v := getattr(row, key))] for key in keys}
    return {key: _statistics(values) for key, values in found.items() if values}


def _statistics(values: Sequence[float]) -> Statistics:
    sd = statistics.stdev(values) if len(values) > 1 else math.nan
    return Statistics(statistics.fmean(values), sd, min(values), max(values))


def _coverage(sites: Sequence[SimulatedSite]) -> dict[str, float]:
    """Return the share of 95 % intervals that contain the true value."""
    held = {
        "depth": [abs(s.depth_error_um) <= s.depth_u95_um for s in sites if math.isfinite(s.depth_error_um)],
        "wear": [abs(s.wear_error_um) <= s.wear_u95_um for s in sites if math.isfinite(s.wear_error_um)],
    }
    return {name: statistics.fmean(found) for name, found in held.items() if found}


def csv_of(cases: Sequence[Case]) -> bytes:
    """Return one row a case: its label, numbers of runs, and of every quantity mean and standard deviation."""
    groups = {"": "spreads", "by_model.": "by_model", "estimated.": "estimated", "truth.": "truth"}
    rows = []
    for case in cases:
        row: dict[str, object] = {"case": case.label}
        for override in case.overrides:
            key, _, value = override.partition("=")
            row[key] = value
        row |= {"runs": len(case.runs), "failed": case.failed}
        for prefix, name in groups.items():
            for key, found in getattr(case, name).items():
                row[f"{prefix}{key}"] = found.mean
                row[f"{prefix}{key}_sd"] = found.sd
        row |= {f"{name}_coverage": share for name, share in case.coverage.items()}
        rows.append(row)
    return table_text(rows).encode()


@dataclass(frozen=True, slots=True)
class Task:
    """One run: request, seed, and the folder of its run file, if any."""

    request: JobRequest
    seed: int
    out: Path | None
    run_id: str
    recipes: tuple[str, ...] = ("",)
    """Hashes of the recipe and of the `[sim]` table in effect, also as earlier versions made them."""


@dataclass(frozen=True, slots=True)
class CheckedCase:
    """One combination of swept values, checked."""

    label: str
    request: JobRequest
    plan: Plan


def cases_of(
    request: JobRequest, sweeps: Sequence[str], runs: int, surroundings: Surroundings
) -> list[CheckedCase]:
    """Check a job with every combination of swept values, before anything runs.

    Raises UsageError E2003 for an invalid sweep, and the errors of `check`; an error of a swept value names the
    sweep.
    """
    grid = grid_of(sweeps, runs)
    plan = check(request, surroundings)  # what is wrong without the sweeps is not theirs
    if not sweeps:
        return [CheckedCase(plan.loaded.path.stem, request, plan)]
    requests = [replace(request, overrides=(*request.overrides, *steps)) for steps in grid]
    try:
        plans = [check(one, surroundings) for one in requests]
    except ProfileError as error:
        raise ProfileError(tuple(of_sweep(one, sweeps) for one in error.diagnostics)) from error
    labels = [" ".join(steps) for steps in grid]
    return [CheckedCase(*one) for one in zip(labels, requests, plans, strict=True)]


def tasks_of(cases: Sequence[CheckedCase], first_seed: int, runs: int, out: Path | None) -> list[Task]:
    """Return one task per run, case after case, with the same seeds."""
    return [
        Task(
            case.request,
            seed,
            out,
            f"{plain_name(case.label)}-seed{seed}",
            (" ".join(case.plan.loaded.recipe),),
        )
        for case in cases
        for seed in range(first_seed, first_seed + runs)
    ]


def command_of(request: JobRequest, seed: int) -> str:
    """Return the command of one run alone."""
    words = ["edmctl", "machine", "--seed", str(seed)]
    for option, value in (
        ("--profile", request.profile),
        ("--setup", request.setup),
        ("--calibration", request.calibration),
        *(("--set", override) for override in request.overrides),
    ):
        words += [option, str(value)] if value is not None else []
    return shlex.join([*words, *(["--allow-model"] if request.allow_model else [])])


def check_names(tasks: Sequence[Task]) -> None:
    """Raise RunFileError (E9001, E9002) when a run file of `tasks` cannot be, before hours of runs find out.

    UsageError E2005 where two of them were the same.
    """
    paths = [run_path(task.out, task.run_id) for task in tasks if task.out is not None]
    for path, runs in Counter(paths).items():
        if runs > 1:
            raise failures.run_twice(again=path.stem)
        try:
            refuse_place(path)
        except RunFileError as refused:
            if refused.code == "E9001":
                refused.hint = "Choose another folder with --out, or another --seed. Nothing was run."
            raise


def perform_all(
    tasks: Sequence[Task],
    program: Program,
    observer: SeriesObserver,
    keep: Callable[[int, SimulatedRun], None],
) -> None:
    """Perform `tasks` in parallel; `keep` gets the number and the result of each finished task.

    A failed run is a result too; a run whose worker died is repeated. Raises Interrupted for a stop, RunFileError
    if a disk refuses, PreconditionError E8093 or E8094 if the library cannot be built.
    """
    library()  # built by this process, once
    workers = min(len(tasks), cores())
    if workers <= 1:
        for number, task in enumerate(tasks):
            if len(tasks) > 1:
                observer.runs(number, len(tasks))
            keep(number, perform(task, program, observer if len(tasks) == 1 else Unobserved()))
        return
    done = 0

    def on_result(number: int, found: SimulatedRun | Lost) -> None:
        nonlocal done
        done += 1
        if isinstance(found, Lost):
            found = SimulatedRun(tasks[number].seed, ok=False, exit_code=1, error=str(found))
        keep(number, found)
        observer.runs(done, len(tasks))

    observer.runs(0, len(tasks))
    side_by_side(partial(perform, program=program), tasks, process_pool(workers, program), on_result)


def perform(task: Task, program: Program, observer: Observer | None = None) -> SimulatedRun:
    """Perform one task. Raises Interrupted and RunFileError; every other error is in the run."""
    collect_garbage()
    plan = check(task.request, program.surroundings())
    name = name_run(task.out, task.run_id, plan.loaded, datetime.now(UTC)) if task.out else None
    if name is not None:
        for left in (name.path, name.partial):
            left.unlink(missing_ok=True)  # of a worker that died; a file of another series was refused before
    report = carry_out(plan, task.seed, observer or Unobserved(), name)
    if isinstance(report.error, Interrupted | RunFileError):
        raise report.error
    exit_code = error_exit_code(report.error) if report.error else 0
    return run_of(task.seed, exit_code, report)


ROWS = "series"
"""Subfolder of the rows."""
BEGUN, DONE = "series", "run"


@dataclass(frozen=True, slots=True)
class Series:
    """The request of a series: job, sweeps, runs per combination, first seed."""

    request: JobRequest
    sweeps: tuple[str, ...]
    runs: int
    first_seed: int


class SeriesRows:
    """The rows of a series in its folder, and the writer that adds to them. A context manager."""

    def __init__(self, folder: Path) -> None:
        self._writer = RowWriter(folder / ROWS)
        self._lines, _ = read_lines(folder / ROWS)

    def begin(self, series: Series) -> None:
        """Write the request, before the first run."""
        request = asdict(series.request)
        if request["profile"] is not None and is_path(request["profile"]):
            request["profile"] = str(user_path(request["profile"]).resolve())
        for name in ("setup", "calibration"):
            request[name] = str(request[name].resolve()) if request[name] else None
        self._writer.append(BEGUN, {**asdict(series), "request": request})

    def keep(self, task: Task, run: SimulatedRun) -> None:
        """Write down a run that is finished."""
        values = {"run_id": task.run_id, "recipe": task.recipes[0], "run": to_json_value(run, is_exact=True)}
        self._writer.append(DONE, values)

    def finished(self, tasks: Sequence[Task]) -> dict[int, SimulatedRun]:
        """Return the runs of these tasks that are there, by the number of the task.

        Raises PreconditionError E8213 where one was made by another recipe.
        """
        recipes = {task.run_id: task.recipes for task in tasks}
        found: dict[str, SimulatedRun] = {}
        for line in self._lines:
            if line.get("row") != DONE or line.get("run_id") not in recipes:
                continue
            if line.get("recipe") not in recipes[line["run_id"]]:
                raise failures.recipe_of_series_differs(line=line["run_id"])
            try:
                found[str(line["run_id"])] = record_of(SimulatedRun, line["run"])
            except (KeyError, TypeError, ValueError):
                continue
        return {number: found[task.run_id] for number, task in enumerate(tasks) if task.run_id in found}

    def refuse_begun(self, folder: Path) -> None:
        """Raise UsageError E2112 if the folder contains a series already."""
        if any(line.get("row") == BEGUN for line in self._lines):
            raise failures.folder_has_series(folder=folder, quoted_folder=shlex.quote(str(folder)))

    def series(self, folder: Path) -> Series:
        """Return the request. Raises UsageError E2111 if the folder contains no series."""
        begun = [line for line in self._lines if line.get("row") == BEGUN]
        try:
            last: dict[str, Any] = begun[-1]
            request = JobRequest(**last["request"])
        except (IndexError, KeyError, TypeError):
            raise failures.folder_without_series(folder=folder) from None
        request = replace(
            request,
            overrides=tuple(request.overrides),
            port=SIMULATOR,
            setup=Path(request.setup) if request.setup else None,
            calibration=Path(request.calibration) if request.calibration else None,
        )
        return Series(request, tuple(last["sweeps"]), int(last["runs"]), int(last["first_seed"]))

    def __enter__(self) -> SeriesRows:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()
