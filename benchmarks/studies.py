"""What studies promise, measured on whole virtual jobs: error rates, intervals, optima, kills, throughput.

    python -m benchmarks.studies WHAT [--seed 1] [--studies 200] [--holes 66] [--repeats 8] [--runs 400] …

null: a factor that does nothing is flagged at 5 % in 2 to 9 % of the studies.
intervals: of a response surface over few runs, and of the Gaussian processes of an optimisation near and away from
what it recommends, at new settings and on new machines: at least 88 % of 60 holes or more.
points: of the shipped array, at the settings that it recommends and at others: at least 88 % on new machines.
optimum: the shortest time with arcs of at most 2 % from 24 runs over reference, duty and frequency: of the repeats
that truly keep the bound the median regret is at most 10 %, and at most one in eight does not keep it, by many runs
and a search that is refined where it is best.
kills: parent, worker or worker of a dask cluster killed, or Ctrl-C, at random instants: the table after `resume` is
that of an undisturbed study (dask is needed).
throughput: two idle cores make at least 18 000 holes of 10 µm an hour, and 90 % of what the CPU of one hole allows,
with at most 5 % of CPU besides.
planning: 1 000 runs in 5 s.

The exit code is 1 where a bar is missed; a line without a bar says `no bar`.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import logging
import math
import os
import random
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import time
import tomllib
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

import edmctl
from edmctl.errors import ProfileError
from edmctl.jobs.plan import check
from edmctl.profile.folders import shipped_studies
from edmctl.study.analysis import analysis_of, expected_at, predicted
from edmctl.study.design import coded, value_at
from edmctl.study.folder import open_folder
from edmctl.study.planning import plan_study, request_of
from edmctl.study.responses import responses_of
from edmctl.study.statistics.designs import sobol_points
from edmctl.study.study_file import read_study
from edmctl.study.table import OF_EXECUTION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from concurrent.futures import Executor

    from edmctl.study.results import Interval, Recommendation, Value

HURRIED = (
    'set = ["target.depth_um={depth:g}", "log.pulses=\'off\'", "approach.speed_um_s=5", "measure.fast_um_s=50", '
    '"measure.settle_s=0.2", "measure.dwell_s=0.1", "limits.arc_ratio=0.99", "limits.short_ratio=0.99"]\n'
)


def study_text(depth_um: float, body: str) -> str:
    """A study of shallow holes of the 270 µm copper tool."""
    return f'[study]\nname = "benchmark"\nprofile = "cu270"\n{HURRIED.format(depth=depth_um)}\n{body}'


KEYS = {"reference": "servo.reference", "duty": "pulse.duty", "nothing": "measure.site_dx_um"}


def body(factors: Mapping[str, Sequence[float]], design: str, responses: str, more: str = "") -> str:
    """Tables of a study: factors with levels (a list) or bounds (a tuple), and responses, `*` for a logarithm."""
    tables = [f"[design]\n{design}", more]
    for name, values in factors.items():
        given = f"levels = {values}" if isinstance(values, list) else f"low = {values[0]}\nhigh = {values[1]}"
        tables.append(f'[[factors]]\nkey = "{KEYS[name]}"\nname = "{name}"\n{given}')
    for name in responses.split():
        is_log = str(name.endswith("*")).lower()
        tables.append(f'[[responses]]\nname = "{name.rstrip("*")}"\nlog = {is_log}')
    return "\n".join(tables)


def told(rows: Sequence[tuple[bool | None, str]]) -> int:
    """Print each line with its mark, None for one without a bar; 1 where one missed its bar."""
    for met, line in rows:
        print(f"{' !' if met is False else '  '} {'no bar: ' if met is None else ''}{line}", flush=True)
    return int(any(met is False for met, _ in rows))


@contextmanager
def started(text: str) -> Iterator[tuple[edmctl.Study, Path]]:
    """A study in a temporary folder, none of its runs made yet."""
    with TemporaryDirectory() as place:
        file, out = Path(place, "study.toml"), Path(place, "out")
        file.write_text(text, encoding="utf-8")
        yield edmctl.Study.load(file).start(out), out


def shipped_text(name: str, seed: int) -> str:
    """A shipped study with another seed."""
    path = shipped_studies()[name]
    text = path.read_text(encoding="utf-8")
    assert text.count("seed = 1\n") == 1
    return text.replace("seed = 1\n", f"seed = {seed}\n")


LEAST_SHARE = 0.88
Hits = dict[str, bool | None]
"""By response: whether an interval held a hole; None for a hole without a value."""


def hits(expected: Mapping[str, Interval | None], new: Mapping[str, float]) -> Hits:
    """Compare the responses of a new hole with the intervals that were expected."""
    found: Hits = {}
    for name, interval in expected.items():
        if interval is not None:
            _, low, high = interval
            found[name] = bool(low <= new[name] <= high) if name in new else None
    return found


def held_lines(
    title: str, found: Sequence[Hits], least_holes: int = 60, *, has_bar: bool = True
) -> list[tuple[bool | None, str]]:
    """How many holes the intervals of each response held."""
    rows: list[tuple[bool | None, str]] = []
    for name in dict.fromkeys(name for one in found for name in one):
        held = [one[name] for one in found if name in one]
        values = [one for one in held if one is not None]
        share = sum(values) / max(1, len(values))
        without = f", {len(held) - len(values)} without a value" if len(values) < len(held) else ""
        line = f"{title}, {name}: held {sum(values)} of {len(values)}, {100 * share:.1f} %{without}"
        if has_bar:
            bar = f"{100 * LEAST_SHARE:.0f} % of {least_holes} or more"
            rows.append((share >= LEAST_SHARE and len(values) >= least_holes, f"{line} ({bar})"))
        else:
            rows.append((None, line))
    return rows


# --- null -----------------------------------------------------------------------------------------------------

NULL_RESPONSES = ("machining_time_s", "wear_ratio_lin", "depth_um")


def null_p(case: tuple[int, str]) -> dict[str, float]:
    """The p of a factor without effect, by response."""
    seed, seeds = case
    factors = {"reference": [0.74, 0.80], "nothing": [500.0, 520.0]}
    design = f'kind = "full"\nreplicates = 3\nseed = {seed}\nseeds = "{seeds}"\n'
    responses = "machining_time_s* wear_ratio_lin depth_um"
    text = study_text(6.0, body(factors, design, responses, '[analysis]\nmodel = "main"'))
    with started(text) as (study, _):
        study.run()
        found = {}
        for name in NULL_RESPONSES:
            table = study.fit(name).anova
            assert table is not None
            found[name] = next(row.p for row in table.rows if row.name == "nothing")
        return found


def null(args: argparse.Namespace) -> int:
    """A factor without effect is flagged about as often as 5 % says."""
    rows = []
    with ProcessPoolExecutor() as pool:
        for seeds in ("run", "replicate"):
            cases = [(args.seed * 1_000_000 + 20 * n, seeds) for n in range(args.studies)]
            found = list(pool.map(null_p, cases))
            for name in found[0]:
                share = sum(one[name] < 0.05 for one in found) / len(found)
                line = f"a machine a {seeds}, {name}: flagged in {100 * share:.1f} % of {len(found)}"
                rows.append((0.02 <= share <= 0.09, f"{line} (2 to 9 %)"))
    return told(rows)


# --- intervals ------------------------------------------------------------------------------------------------

BOUNDS = {"reference": (0.62, 0.88), "duty": (0.12, 0.55)}
ONE_MACHINE = "18 points of a hypercube on one machine"
DESIGNS = {
    "18 points of a hypercube on 6 machines": 'kind = "lhs"\nruns = 18\nblocks = 6',
    ONE_MACHINE: 'kind = "lhs"\nruns = 18',
    "face-centred composite, 2 machines": 'kind = "ccd"\ncenter_points = 1\nreplicates = 2',
}


OPTIMISED = 4
"""Optimised studies whose intervals are tried: one alone would tell of its own luck."""
NEAR = 0.2
"""New settings near a recommendation: so far off at most in each factor, coded to −1 … 1."""


def one_hole(case: tuple[float, dict[str, float], int], *, hurried: bool = True) -> dict[str, float]:
    """Responses of one hole on a machine of its own; none of one that failed."""
    depth_um, settings, seed = case
    overrides = [
        *(
            tomllib.loads(study_text(depth_um, ""))["study"]["set"]
            if hurried
            else [f"target.depth_um={depth_um:g}"]
        ),
        *(f"{key}={value!r}" for key, value in settings.items()),
    ]
    report = edmctl.connect("sim:", seed=seed).machine("cu270", overrides=overrides, warn=lambda _: None)
    values = responses_of(report.to_dict(), depth_um)["responses"]
    return {name: value for name, value in values.items() if value is not None and report.error is None}


def after_suggestions(case: tuple[int, int]) -> list[tuple[bool, Hits]]:
    """Whether the intervals of an optimised study hold new holes, near what it recommends and anywhere."""
    seed, holes = case
    rng, found = random.Random(seed), []
    with started(shipped_text("fastest-clean-hole", 1000 * seed)) as (study, out):
        best, factors = study.optimize(), study.plan().factors
        state = open_folder(out).read()
        for n in range(2 * holes):
            is_near, settings = n < holes, {}
            for factor in factors:
                place = coded(factor, best.settings[factor.key])
                low, high = (max(place - NEAR, -1.0), min(place + NEAR, 1.0)) if is_near else (-1.0, 1.0)
                settings[factor.key] = float(value_at(factor, rng.uniform(low, high)))
            new = one_hole((20.0, settings, 1000 * seed + 100 + n), hurried=False)
            found.append((is_near, hits(expected_at(state, (), settings), new)))
    return found


def intervals(args: argparse.Namespace) -> int:
    """Intervals of predictions hold new holes on new machines."""
    rng = random.Random(args.seed)
    places = [
        {KEYS[name]: round(rng.uniform(*bounds), 4) for name, bounds in BOUNDS.items()}
        for _ in range(args.holes)
    ]
    rows: list[tuple[bool | None, str]] = []
    with ProcessPoolExecutor() as pool:
        new = list(pool.map(one_hole, [(20.0, s, 50_000 * args.seed + n) for n, s in enumerate(places)]))
        for title, design in DESIGNS.items():
            responses = "machining_time_s* wear_ratio_lin arc_share* energy_j"
            text = body(BOUNDS, f"{design}\nseed = {args.seed}", responses)
            with started(study_text(20.0, text)) as (study, out):
                study.run(workers=2)
                models = {
                    one.name: one.model for one in analysis_of(open_folder(out).read()).responses if one.model
                }
                found = []
                for one, settings in zip(new, places, strict=True):
                    expected = {
                        name: predicted(study.plan(), model, settings) for name, model in models.items()
                    }
                    found.append(hits(expected, one))
            is_one = title == ONE_MACHINE
            why = " (the interval is of that machine alone)" if is_one else ""
            rows += held_lines(f"{title}{why}", found, has_bar=not is_one)
        cases = [(args.seed + n, -(-args.holes // OPTIMISED)) for n in range(OPTIMISED)]
        processes = [one for of_study in pool.map(after_suggestions, cases) for one in of_study]
    for is_near, place in ((True, "near the recommendation"), (False, "anywhere")):
        found = [one for near, one in processes if near is is_near]
        rows += held_lines(f"{OPTIMISED} optimised studies, {place}", found)
    return told(rows)


# --- points ---------------------------------------------------------------------------------------------------


def at_own_points(case: tuple[int, int]) -> list[tuple[bool, Hits]]:
    """Whether the intervals of one study's points hold new holes, at the recommended point and at others."""
    seed, holes = case
    found = []
    with started(shipped_text("taguchi-l9", 1000 * seed)) as (study, out):
        study.run()
        state = open_folder(out).read()
        analyses, best = analysis_of(state).responses, study.recommend()
        others = {run.point: run.settings for run in study.plan().runs if run.settings != best.settings}
        chosen = [best.settings, *(random.Random(seed).choice(list(others.values())) for _ in range(2))]
        for n, settings in enumerate(chosen):
            expected, plain = expected_at(state, analyses, settings), plain_settings(settings)
            for hole in range(holes):
                new = one_hole((20.0, plain, 1000 * seed + 100 + 10 * n + hole), hurried=False)
                found.append((n == 0, hits(expected, new)))
    return found


def plain_settings(settings: Mapping[str, Value]) -> dict[str, float]:
    """Settings of numbers."""
    return {key: float(value) for key, value in settings.items()}


def points(args: argparse.Namespace) -> int:
    """Intervals at points that were run hold new holes on new machines, also where the point was chosen."""
    with ProcessPoolExecutor() as pool:
        results = pool.map(at_own_points, [(args.seed + n, 4) for n in range(args.repeats)])
        found = [one for of_study in results for one in of_study]
    rows = []
    for is_best, title in ((True, "recommended"), (False, "another point")):
        rows += held_lines(title, [one for best, one in found if best is is_best], 1)
    return told(rows)


# --- optimum --------------------------------------------------------------------------------------------------


MOST_ARCS = 0.02
SCOUTS = 2
"""Machines on which every point of the dense simulation is made."""
REFINED = ((5, 0.3), (5, 0.12))
"""Rounds of refinement: so many of the best points, and how far around them it goes, coded to −1 … 1."""
AROUND = 10
FINALISTS = 12
"""Points that every judge judges: the best of the dense simulation."""


def fastest(seed: int) -> Recommendation:
    """What one repeat of the shipped study of the fastest hole with few arcs recommends after its 24 runs."""
    with started(shipped_text("fastest-clean-hole", seed)) as (study, _):
        best = study.optimize()
        assert len(study.table()) == 24
        return best


def plain_hole(case: tuple[Mapping[str, Value], int]) -> tuple[float, float]:
    """Machining time and share of arcs of a hole of the shipped study; one that fails takes for ever."""
    found = one_hole((20.0, plain_settings(case[0]), case[1]), hurried=False)
    return found.get("machining_time_s", math.inf), found.get("arc_share", 1.0)


class Dense:
    """The dense simulation: means over machines, at any settings that the rules of recipes allow."""

    def __init__(self, pool: Executor) -> None:
        path = shipped_studies()["fastest-clean-hole"]
        planned = plan_study(read_study(path))
        self._pool, self._base, self.factors = pool, planned.base, planned.plan.factors
        self.found: list[tuple[float, float, dict[str, Value]]] = []
        """Mean time, mean share of arcs, settings."""

    def at(self, settings: Sequence[Mapping[str, Value]], seeds: Sequence[int]) -> list[tuple[float, float]]:
        """Mean time and share of arcs over machines, by settings."""
        cases = [(one, seed) for one in settings for seed in seeds]
        holes = np.array(list(self._pool.map(plain_hole, cases, chunksize=4))).reshape(-1, len(seeds), 2)
        return [(float(time_s), float(arcs)) for time_s, arcs in holes.mean(axis=1)]

    def scout(self, points: Iterable[Sequence[float]], seeds: Sequence[int]) -> None:
        """Add coded points, those that are allowed."""
        settings = [
            {factor.key: value_at(factor, x) for factor, x in zip(self.factors, point, strict=True)}
            for point in points
        ]
        allowed = [one for one in settings if self._is_allowed(one)]
        self.found += [(*truth, one) for truth, one in zip(self.at(allowed, seeds), allowed, strict=True)]

    def best(self, count: int) -> list[dict[str, Value]]:
        """The fastest that keep the bound."""
        kept = sorted((one for one in self.found if one[1] <= MOST_ARCS), key=lambda one: one[0])
        return [settings for _, _, settings in kept[:count]]

    def around(self, count: int, reach: float, rng: np.random.Generator) -> list[list[float]]:
        """Points around each of the best, within the bounds."""
        centers = [[coded(factor, one[factor.key]) for factor in self.factors] for one in self.best(count)]
        return [
            np.clip(np.add(center, rng.uniform(-reach, reach, len(center))), -1, 1).tolist()
            for center in centers
            for _ in range(AROUND)
        ]

    def _is_allowed(self, settings: Mapping[str, Value]) -> bool:
        try:
            check(request_of(self._base, settings))
        except ProfileError:
            return False
        return True


def optimum(args: argparse.Namespace) -> int:
    """Regret and truth of what is recommended.

    The best that there is comes from a dense simulation on a few machines, refined around its best points; those
    that are best then, and what is recommended, are judged on the same machines, which no choice has seen.
    """
    rng = np.random.default_rng(99)
    scouts = [800_000 + n for n in range(SCOUTS)]
    judges = [900_000 + n for n in range(args.judges)]
    with ProcessPoolExecutor() as pool:
        repeats = list(pool.map(fastest, [1000 * args.seed + n for n in range(args.repeats)]))
        dense = Dense(pool)
        dense.scout(sobol_points(len(dense.factors), args.dense, 99).tolist(), scouts)
        for count, reach in REFINED:
            dense.scout(dense.around(count, reach, rng), scouts)
        judged = dense.at(dense.best(FINALISTS), judges)
        at = dense.at([repeat.settings for repeat in repeats], judges)
    best_s = _fastest_s([*judged, *at])
    kept = sum(arcs <= MOST_ARCS for _, arcs in judged)
    for n, (repeat, (time_s, arcs)) in enumerate(zip(repeats, at, strict=True)):
        words = ", ".join(f"{key.partition('.')[2]} {value:g}" for key, value in repeat.settings.items())
        says = "feasible" if repeat.is_feasible else "not feasible"
        is_kept = f"regret {100 * (time_s / best_s - 1):.1f} %" if arcs <= MOST_ARCS else "infeasible"
        truth = f"{time_s:.1f} s, arcs {100 * arcs:.2f} %: {is_kept}"
        print(f"   repeat {n}: {words}, said to be {says}: {truth}")
    searched = f"{len(dense.found)} settings on {SCOUTS} machines"
    print(f"   best known: {best_s:.1f} s, of {searched} and of the repeats; judged on {len(judges)} others")
    regrets = [time_s / best_s - 1 for time_s, arcs in at if arcs <= MOST_ARCS]
    infeasible = len(at) - len(regrets)
    median, worst = (statistics.median(regrets), max(regrets)) if regrets else (math.inf, math.inf)
    words = f"median regret of {len(regrets)} truly feasible repeats {100 * median:.1f} % (10 %)"
    return told(
        [
            (kept > 0, f"of the {len(judged)} best settings of the search {kept} keep the bound (1 or more)"),
            (median <= 0.10, f"{words}, worst {100 * worst:.1f} %"),
            (infeasible <= args.repeats // 8, f"truly infeasible {infeasible} of {args.repeats} (1 of 8)"),
        ]
    )


def _fastest_s(found: Iterable[tuple[Any, ...]]) -> float:
    """The shortest time that keeps the bound."""
    return min((time_s for time_s, arcs, *_ in found if arcs <= MOST_ARCS), default=math.inf)


# --- kills ----------------------------------------------------------------------------------------------------

LIMITED = """
[[constraints]]
response = "arc_share"
at_most = 0.1

[[objectives]]
response = "machining_time_s"

[optimize]
runs = 22
"""
KILLED = body(
    {"reference": [0.7, 0.75, 0.8], "duty": [0.2, 0.3, 0.4]},
    'kind = "full"\nreplicates = 2',
    "machining_time_s* arc_share",
    LIMITED,
)
EDMCTL = (sys.executable, "-m", "edmctl", "study")


def table_text(folder: Path) -> str:
    """The sorted table less time and host."""
    said = subprocess.run([*EDMCTL, "export", str(folder)], capture_output=True, text=True, check=True).stdout
    rows = list(csv.DictReader(io.StringIO(said)))
    kept = [{name: value for name, value in row.items() if name not in OF_EXECUTION} for row in rows]
    return "\n".join(map(repr, sorted(kept, key=lambda row: int(row["run"]))))


def rows_of(folder: Path) -> set[str]:
    """Every whole line of the rows."""
    texts = [file.read_text(encoding="utf-8") for file in (folder / "rows").glob("*.jsonl")]
    return {line for text in texts for line in text.splitlines() if line.endswith("}")}


def runs_in(folder: Path) -> list[tuple[int, int]]:
    """Run and attempt of every row of a run; the same twice where it was made twice."""
    rows = map(json.loads, rows_of(folder))
    return [(int(row["number"]), int(row["attempt"])) for row in rows if row["row"] == "run"]


def workers_of(pid: int) -> list[int]:
    """Process ids of the workers of a process; its tracker of resources is none."""
    found = []
    with suppress(OSError):
        for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            with suppress(OSError):
                if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes():
                    found.append(int(one))
    return found


@dataclass(frozen=True)
class Case:
    """A victim, how the study runs then, and how it continues.

    victim : parent or worker (kill -9), or Ctrl-C, which a terminal sends to all processes of the command
    is_optimised : the design is made undisturbed, and the suggestions are disturbed
    """

    victim: str
    making: str
    again: str
    is_optimised: bool = False

    def options(self, how: str, address: str) -> list[str]:
        """The options of a command that makes runs so."""
        return ["--dask", address] if how == "dask" else ["--workers", how]

    @property
    def title(self) -> str:
        """The case in words."""
        optimise = "optimize " if self.is_optimised else ""
        return f"{self.victim}, {optimise}workers: {self.making}, then {self.again}"


CASES = [
    Case("parent", "1", "1"),
    Case("parent", "2", "2"),
    Case("worker", "2", "2"),
    Case("Ctrl-C", "1", "2"),
    Case("Ctrl-C", "2", "1"),
    Case("parent", "dask", "dask"),
    Case("parent", "dask", "2"),
    Case("worker", "dask", "dask"),
    Case("Ctrl-C", "dask", "2"),
    Case("parent", "1", "1", is_optimised=True),
    Case("worker", "2", "2", is_optimised=True),
    Case("Ctrl-C", "2", "1", is_optimised=True),
    Case("worker", "dask", "2"),
]


class Disturbance:
    """A study that is run in a folder, disturbed at an instant, and gone on with."""

    def __init__(self, case: Case, file: Path, folder: Path, cluster: Any) -> None:
        self._case, self._folder, self._cluster = case, folder, cluster
        first = ["optimize", str(folder)] if case.is_optimised else ["run", str(file), "--out", str(folder)]
        then = "optimize" if case.is_optimised else "resume"
        address = str(cluster.scheduler_address)
        self._begin = [*first, *case.options(case.making, address)]
        self._again = [then, str(folder), *case.options(case.again, address)]
        self.was_disturbed = self.was_orderly = self.was_kept = self.went_on = False
        self.at = 0
        """Rows at the instant."""

    def run(self, rng: random.Random, total: int) -> None:
        """Begin, disturb, go on. It counts as disturbed where the signal met a victim before all runs were made."""
        first = len(runs_in(self._folder))
        rows, more_s = first + rng.randrange(total - first), rng.uniform(0.0, 0.6)
        told = self._folder.with_suffix(".stderr")
        running = _begun(self._begin, told)
        while running.poll() is None and len(runs_in(self._folder)) < rows:
            time.sleep(0.02)
        time.sleep(more_s)
        was_sent = self._disturb(running, rng)
        at_once = rows_of(self._folder)
        self.at = len(runs_in(self._folder))
        code = running.wait(300)
        victim, is_quiet = self._case.victim, b"Traceback" not in told.read_bytes()
        self.was_disturbed = was_sent and self.at < total and (victim == "worker" or code != 0)
        allowed = {"parent": (0, -signal.SIGKILL), "worker": (0,), "Ctrl-C": (0, -signal.SIGINT)}[victim]
        self.was_orderly = code in allowed and is_quiet
        if not self.was_orderly:
            print(f"   exit code {code}: {told.read_text(errors='replace')}", flush=True)
        before = rows_of(self._folder)
        self.went_on = self._go_on()
        after = runs_in(self._folder)
        self.was_kept = at_once <= before <= rows_of(self._folder) and sorted(after) == [
            (number, 1) for number in range(1, total + 1)
        ]

    def _disturb(self, running: subprocess.Popen[bytes], rng: random.Random) -> bool:
        """Send the signal; whether there was somebody to get it."""
        while running.poll() is None:
            with suppress(ProcessLookupError):
                if self._case.victim == "Ctrl-C":
                    os.killpg(running.pid, signal.SIGINT)
                    return True
                victims = [running.pid] if self._case.victim == "parent" else self._workers(running.pid)
                if victims:
                    os.kill(rng.choice(victims), signal.SIGKILL)
                    return True
            time.sleep(0.005)  # no worker is there yet
        return False

    def _workers(self, pid: int) -> list[int]:
        if self._case.making == "dask":
            return [one.pid for one in self._cluster.workers.values() if one.pid]
        return workers_of(pid)

    def _go_on(self) -> bool:
        """Go on with it, as soon as orphans of the killed one have ended; begin again what was not yet there."""
        for _ in range(50):
            is_there = (self._folder / "plan.json").exists()
            command = [*EDMCTL, *(self._again if is_there else self._begin), "-q"]
            done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
            if (
                b"E8201" not in done.stderr
            ):  # else a worker of the killed one still holds the lock for a moment
                if done.returncode:
                    print(done.stderr.decode(errors="replace"), flush=True)
                return done.returncode == 0
            time.sleep(0.2)
        return False


def _begun(command: Sequence[str], told: Path) -> subprocess.Popen[bytes]:
    """A command in a session of its own, as a terminal's foreground job: a signal reaches all of its processes."""
    with told.open("ab") as stderr:
        return subprocess.Popen(
            [*EDMCTL, *command, "-q"], stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True
        )


def kills(args: argparse.Namespace) -> int:
    """Disturb studies at random instants, and compare their tables with an undisturbed one."""
    import distributed

    rng = random.Random(args.seed)
    made: Any = distributed.LocalCluster
    with (
        TemporaryDirectory() as place,
        made(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        cluster.get_client() as client,
    ):
        file = Path(place, "study.toml")
        file.write_text(study_text(8.0, KILLED), encoding="utf-8")
        calm, best = Path(place, "calm"), Path(place, "best")
        _finished("run", str(file), "--out", str(calm), "--workers", "1")
        shutil.copytree(calm, best)
        _finished("optimize", str(best), "--workers", "1")
        wanted = {False: table_text(calm), True: table_text(best)}
        totals = {False: len(runs_in(calm)), True: len(runs_in(best))}
        counts, n = Counter[str](), 0
        while counts["disturbed"] < args.kills and n < 2 * args.kills:
            case, folder = CASES[n % len(CASES)], Path(place, f"study{n}")
            if case.is_optimised:
                shutil.copytree(calm, folder)
            client.wait_for_workers(2)
            one = Disturbance(case, file, folder, cluster)
            one.run(rng, totals[case.is_optimised])
            is_same = one.went_on and table_text(folder) == wanted[case.is_optimised]
            counts.update(
                disturbed=one.was_disturbed, orderly=one.was_orderly, kept=one.was_kept, same=is_same
            )
            n += 1
            mark = "same" if one.was_kept and is_same else "DIFFERS"
            late = "" if one.was_disturbed else " (it had ended)"
            print(f"   {case.title}, after {one.at} rows: {mark}{late}", flush=True)
    return told(
        [
            (counts["disturbed"] >= args.kills, f"disturbed under way: {counts['disturbed']} (of {n} tried)"),
            (
                counts["orderly"] == n,
                f"no traceback, a lost worker is no failure: {counts['orderly']} of {n}",
            ),
            (counts["kept"] == n, f"rows kept, every run made once: {counts['kept']} of {n}"),
            (counts["same"] == n, f"same table: {counts['same']} of {n}"),
        ]
    )


def _finished(*command: str) -> None:
    subprocess.run([*EDMCTL, *command, "-q"], check=True, stdout=subprocess.DEVNULL)


# --- throughput -----------------------------------------------------------------------------------------------

HOLES_PER_HOUR = 18_000.0


def many(runs: int) -> str:
    """A hypercube of ordinary holes."""
    bounds = {"reference": (0.75, 0.85), "duty": (0.25, 0.35)}
    return body(bounds, f'kind = "lhs"\nruns = {runs}', "machining_time_s")


def throughput(args: argparse.Namespace) -> int:
    """Two processes side by side against the CPU of a hole in one process."""
    head = '[study]\nname = "many"\nprofile = "cu270"\nset = ["target.depth_um=10"]\n'
    few = head + many(12)
    with started(few) as (study, _):
        study.run()  # compiles
    with started(few) as (study, _):
        begin_s = time.process_time()
        study.run()
        alone_s = (time.process_time() - begin_s) / 12
    with started(head + many(args.runs)) as (study, _):
        before, own_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.process_time()
        begin_s = time.monotonic()
        study.run(workers=2)
        wall_s, own_s = time.monotonic() - begin_s, time.process_time() - own_s
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime + own_s
    per_hour, possible = 3600 * args.runs / wall_s, 2 * 3600 / alone_s
    share, extra = per_hour / possible, cpu_s / (args.runs * alone_s) - 1
    return told(
        [
            (per_hour >= HOLES_PER_HOUR, f"{per_hour:.0f} holes an hour ({HOLES_PER_HOUR:.0f})"),
            (share >= 0.9, f"{100 * share:.1f} % of the {possible:.0f} that their CPU allows (90 %)"),
            (extra <= 0.05, f"CPU besides the holes: {100 * extra:.1f} % (5 %); a hole {alone_s:.3f} s"),
        ]
    )


def planning(args: argparse.Namespace) -> int:
    """A thousand different runs are planned."""
    with TemporaryDirectory() as place:
        file = Path(place, "study.toml")
        file.write_text(f'[study]\nname = "many"\nprofile = "cu270"\n{many(1000)}', encoding="utf-8")
        found = []
        for _ in range(3):
            begin_s = time.monotonic()
            edmctl.Study.load(file)
            found.append(time.monotonic() - begin_s)
    return told([(min(found) <= 5.0, f"1 000 runs planned in {min(found):.1f} s (5 s)")])


COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    one.__name__: one for one in (null, intervals, points, optimum, kills, throughput, planning)
}
NUMBERS = {
    "seed": 1,
    "studies": 200,
    "holes": 66,
    "repeats": 8,
    "dense": 300,
    "judges": 6,
    "kills": 20,
    "runs": 400,
}


def main() -> int:
    """Measure one of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=list(COMMANDS))
    for name, default in NUMBERS.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    args = parser.parse_args()
    return COMMANDS[args.what](args)


if __name__ == "__main__":
    sys.exit(main())
