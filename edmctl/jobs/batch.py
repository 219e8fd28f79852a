"""Many simulated runs over the cores of this computer, summed up."""

from __future__ import annotations

import math
import shlex
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from edmctl import failures
from edmctl.core.library import library
from edmctl.csv_text import table_text
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Interrupted, ProfileError, RunFileError, error_exit_code
from edmctl.jobs.job import Report, carry_out
from edmctl.jobs.parallel import Lost, Program, cores, process_pool
from edmctl.jobs.parallel import perform as side_by_side
from edmctl.jobs.plan import JobRequest, Plan, check
from edmctl.jobs.run_header import name_run, plain_name, run_path
from edmctl.jobs.surroundings import Surroundings, Unobserved
from edmctl.jobs.sweep import at_sweep, grid_of
from edmctl.labels import Basis, basis_of
from edmctl.record.disk import refuse_place
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


def _run_of(seed: int, report: Report) -> SimulatedRun:
    """Reduce a report to one row; depth, wear and feed are those of the first hole, or of the channel."""
    job, error = report.job, report.error
    channel, truth = job.channel, report.channel_truth
    made: list[tuple[SiteResult | ChannelResult, SiteTruth]] = []
    if channel is not None:
        made = [(channel, SiteTruth(truth.depth_um, truth.wear_um) if truth else SiteTruth())]
    elif report.truths:
        made = list(zip(job.sites, report.truths, strict=True))
    run = SimulatedRun(
        seed,
        ok=error is None,
        exit_code=error_exit_code(error) if error else 0,
        error=error.message if error else None,
        time_s=job.time_s,
        calibration=report.model.text if report.model else "",
    )
    if not made:
        return run
    first, first_truth = made[0]
    values = shared(SimulatedRun, first) | shared(SimulatedRun, job)
    values |= {
        "truth": first_truth,
        "arc_share": first.ratios.arc,
        "cuts": channel.passes if channel else sum(site.cuts for site in job.sites),
        "sites": tuple(SimulatedSite(**shared(SimulatedSite, site), truth=true) for site, true in made),
    }
    return replace(run, **values)


def summarize(label: str, overrides: tuple[str, ...], runs: Sequence[SimulatedRun]) -> Case:
    """Sum up the runs of one set of values; those that made nothing count as failed only."""
    made = [run for run in runs if run.sites]
    sites = [site for run in made for site in run.sites]

    def of_basis(basis: Basis) -> dict[str, Statistics]:
        found: dict[str, Statistics] = {}
        for key in _SITE_QUANTITIES:
            rows = [site for site in sites if basis_of(key, site.depth_basis, site.wear_basis) == basis]
            found |= _statistics(rows, (key,))
        return found

    covered = {
        "depth": [abs(s.depth_error_um) <= s.depth_u95_um for s in sites if math.isfinite(s.depth_error_um)],
        "wear": [abs(s.wear_error_um) <= s.wear_u95_um for s in sites if math.isfinite(s.wear_error_um)],
    }
    return Case(
        label=label,
        overrides=overrides,
        runs=tuple(runs),
        failed=sum(not run.ok for run in runs),
        spreads={**of_basis(Basis.TOUCHED), **_statistics(made, _RUN_QUANTITIES)},
        by_model=of_basis(Basis.MODEL),
        estimated=of_basis(Basis.ESTIMATED),
        truth=_statistics([site.truth for site in sites], _TRUE_QUANTITIES),
        coverage={name: statistics.fmean(shares) for name, shares in covered.items() if shares},
    )


def _statistics(rows: Sequence[object], keys: Sequence[str]) -> dict[str, Statistics]:
    """Return the statistics of each key that has finite values."""
    found = {}
    for key in keys:
        if values := [v for row in rows if math.isfinite(v := getattr(row, key))]:
            sd = statistics.stdev(values) if len(values) > 1 else math.nan
            found[key] = Statistics(statistics.fmean(values), sd, min(values), max(values))
    return found


def csv_of(cases: Sequence[Case]) -> bytes:
    """Return one row a case: its label, numbers of runs, and of every quantity mean and standard deviation."""
    rows = []
    for case in cases:
        row: dict[str, object] = {"case": case.label}
        row |= {key: value for key, _, value in (one.partition("=") for one in case.overrides)}
        row |= {"runs": len(case.runs), "failed": case.failed}
        for prefix, group in (
            ("", case.spreads),
            ("by_model.", case.by_model),
            ("estimated.", case.estimated),
            ("truth.", case.truth),
        ):
            for key, found in group.items():
                row |= {f"{prefix}{key}": found.mean, f"{prefix}{key}_sd": found.sd}
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


def cases_of(
    request: JobRequest, sweeps: Sequence[str], runs: int, surroundings: Surroundings
) -> list[tuple[str, Plan]]:
    """Return label and plan of a job with every combination of swept values, checked before anything runs.

    Raises UsageError E2003 for an invalid sweep, and the errors of `check`; an error of a swept value names the
    sweep.
    """
    grid = grid_of(sweeps, runs)
    plan = check(request, surroundings)  # an error without the sweeps is not theirs
    if not sweeps:
        return [(plan.loaded.path.stem, plan)]
    cases = []
    try:
        for steps in grid:
            swept = replace(request, overrides=(*request.overrides, *steps))
            cases.append((" ".join(steps), check(swept, surroundings)))
    except ProfileError as error:
        raise ProfileError(tuple(at_sweep(one, sweeps) for one in error.diagnostics)) from error
    return cases


def tasks_of(cases: Sequence[tuple[str, Plan]], seeds: Sequence[int], out: Path | None) -> list[Task]:
    """Return one task per run, case after case, with the same seeds."""
    return [
        Task(plan.request, seed, out, f"{plain_name(label)}-seed{seed}")
        for label, plan in cases
        for seed in seeds
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
    """Raise RunFileError (E9001, E9002) before the first run if a run file cannot be written.

    UsageError E2005 if two of them were the same.
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
        for path in (name.path, name.partial):
            path.unlink(missing_ok=True)  # of a worker that died: `check_names` refused all other files
    report = carry_out(plan, task.seed, observer or Unobserved(), name)
    if isinstance(report.error, Interrupted | RunFileError):
        raise report.error
    return _run_of(task.seed, report)
