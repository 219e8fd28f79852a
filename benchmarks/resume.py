"""Interrupted jobs: `python -m benchmarks.resume [--count 50] [--power 10] [--profile cu150] [--jobs 2]`.

Each job is the whole profile on a served virtual controller of its own, with another actuator, tool and work. Its
host is killed (SIGKILL) at an instant of the machine's time drawn evenly over what the job takes; the controller
notices, retracts and latches its fault. `edmctl reset --ack`, and `edmctl machine --resume`, which is killed again
every other time, until the job is done. In `--power` more jobs the controller loses its power while it sparks, and
`--homed` vouches for the stages. The plant's own hole is compared with the target: within 1 % of the depth or
1.5 µm, whichever is larger, and the stated 95 % intervals of depth and wear with the truth. Exit code 1 where less
than 95 % are within it, less than 85 % of the intervals of either hold, or a job could not be finished.
"""

from __future__ import annotations

import math
import os
import random
import re
import signal
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING

from benchmarks.common import options
from benchmarks.serving import result, served, start
from edmctl.jobs.truth import channel_truth
from edmctl.record.bench_file import read_bench
from edmctl.simulator.saving import restored_bench

if TYPE_CHECKING:
    from typing import Any, NoReturn

    from edmctl.machine.interface import TelemetryBlock
    from edmctl.profile.model import Profile

BAR, HELD_BAR = 0.95, 0.85
LEAST_TOLERANCE_UM, TOLERANCE_SHARE = 1.5, 0.01
MOST_KILLS = 6
"""Then the job is left alone."""
ORPHANED_S = 2.5
"""After this a driven clock without a host has let the watchdog act."""
HOST_SILENT = "1001"
NOT_BEGUN = "E8050"
"""The host died before it moved anything: there is no journal, and nothing to take up."""


@dataclass(slots=True)
class Finished:
    """One job: how often it was interrupted and where, and what it came to (µm)."""

    seed: int
    phases: list[str] = field(default_factory=list)
    target_um: float = math.nan
    measured_um: float = math.nan
    u95_um: float = math.nan
    true_um: float = math.nan
    wear_um: float = math.nan
    wear_u95_um: float = math.nan
    true_wear_um: float = math.nan
    wrong: str = ""

    @property
    def error_um(self) -> float:
        """True depth less target."""
        return self.true_um - self.target_um

    @property
    def within(self) -> bool:
        """Whether the true depth is as close to the target as it has to be."""
        tolerance_um = max(LEAST_TOLERANCE_UM, TOLERANCE_SHARE * self.target_um)
        return not self.wrong and abs(self.error_um) <= tolerance_um

    @property
    def covered(self) -> bool:
        """Whether the stated interval holds the true depth."""
        return abs(self.measured_um - self.true_um) <= self.u95_um

    @property
    def wear_covered(self) -> bool:
        """Whether that of the wear holds the true one."""
        return abs(self.wear_um - self.true_wear_um) <= self.wear_u95_um

    def line(self) -> str:
        """One row of the table."""
        told = self.wrong or (
            f"target {self.target_um:.1f}, measured {self.measured_um:.2f} ± {self.u95_um:.2f}, true "
            f"{self.true_um:.2f} µm; wear {self.wear_um:.2f} ± {self.wear_u95_um:.2f}, "
            f"true {self.true_wear_um:.2f} µm"
            f"{'' if self.within else '  <-- off'}{'' if self.covered and self.wear_covered else '  <-- not held'}"
        )
        return f"  {self.seed:4d}: killed while {', '.join(self.phases) or 'nothing'}: {told}"


def die_at(time_s: float, arguments: list[str]) -> NoReturn:
    """Be `edmctl` with these arguments, and die by SIGKILL when the time of the run has come to `time_s`."""
    from edmctl.app import run
    from edmctl.procedures.run import JobStateKeeper

    take = JobStateKeeper.on_telemetry

    def until(journal: JobStateKeeper, block: TelemetryBlock) -> None:
        take(journal, block)
        if block.time_s[-1] >= time_s:
            # Some milliseconds later in another thread: in the middle of whatever comes next.
            Timer(random.uniform(0.0, 0.02), lambda: os.kill(os.getpid(), signal.SIGKILL)).start()

    JobStateKeeper.on_telemetry = until  # type: ignore[method-assign, assignment]
    sys.argv[1:] = arguments
    run()


def run_until(home: Path, time_s: float, *arguments: str) -> str:
    """Let a job run until that time of the machine; the phase in which it died, empty where it came to its end."""
    command = ("--die-at", f"{time_s:.3f}", *arguments, "--events")
    process = start(home, *command, module="benchmarks.resume")
    _, err = process.communicate()
    phases = re.findall(r'"phase": "(\w+)"', err)
    return phases[-1] if process.returncode == -signal.SIGKILL and phases else ""


def duration_s(home: Path, recipe: tuple[str, ...], seed: int) -> float:
    """How long a job takes from arming to its end when nobody kills it, s of the machine's time."""
    with served(home, *_bench(home, recipe[0], seed, "length"), name="length") as link:
        arguments = (*_order(recipe), "--port", str(link), "--out", "length-runs", "--json", "-q")
        code, document, err = result(start(home, "machine", *arguments))
    if code:
        raise RuntimeError(f"the job cannot be done: {err}")
    return float(document["result"]["time_s"])


def kill_and_resume(home: Path, recipe: tuple[str, ...], seed: int, takes_s: float) -> Finished:
    """One job with its kills, and what came of it."""
    chance, done, name = random.Random(seed), Finished(seed), f"j{seed}"
    with served(home, *_bench(home, recipe[0], seed, name), name=name) as link:
        arguments: tuple[str, ...] = (*_order(recipe), "--run-id", f"{name}-0")
        kill = True
        while True:
            if kill:
                phase = run_until(
                    home, chance.uniform(0.0, takes_s), "machine", *arguments, "--port", str(link)
                )
                kill = bool(phase) and len(done.phases) < MOST_KILLS and chance.random() < 0.5
                if phase:
                    done.phases.append(phase)
                    time.sleep(ORPHANED_S)
                    start(home, "reset", "--ack", HOST_SILENT, "--port", str(link)).communicate()
                arguments = ("--resume", f"{name}-0")
                continue
            code, document, err = result(
                start(home, "machine", *arguments, "--port", str(link), "--json", "-q")
            )
            error = document.get("error") or {}
            if error.get("code") == NOT_BEGUN:
                arguments = (*_order(recipe), "--run-id", f"{name}-1")
                continue
            if error.get("code") == "E8051":  # it came to its end before it could be killed
                document = {"result": _summary(home, name)}
            elif code:
                done.wrong = f"exit {code}: {err[-300:]}"
            break
    _take(done, document, home / f"{name}.bench.h5", recipe)
    return done


def lose_power(home: Path, recipe: tuple[str, ...], seed: int, sparks_s: float) -> Finished:
    """One job whose controller restarts after so long of a cut."""
    done, name = Finished(seed), f"p{seed}"
    fault = ("--fault", f"POWER_LOSS@sparks+{sparks_s:.1f}")
    with served(home, *_bench(home, recipe[0], seed, name), *fault, name=name) as link:
        arguments = (*_order(recipe), "--run-id", name, "--port", str(link), "--json", "-q")
        code, document, err = result(start(home, "machine", *arguments))
        if code:
            done.phases.append(f"power lost {sparks_s:.0f} s into the cut (exit {code})")
            resume = ("--resume", name, "--port", str(link), "--json", "-q")
            code, document, err = result(start(home, "machine", *resume))
            if code != 8 or document["error"]["code"] != "E8057":
                done.wrong = f"went on without anybody vouching for the stages: exit {code}: {err[-300:]}"
            else:
                code, document, err = result(start(home, "machine", *resume, "--homed"))
        if code and not done.wrong:
            done.wrong = f"exit {code}: {err[-300:]}"
    _take(done, document, home / f"{name}.bench.h5", recipe)
    return done


def _bench(home: Path, profile: str, seed: int, name: str) -> tuple[str, ...]:
    return (
        *("--profile", profile, "--seed", str(seed), "--speed", "max"),
        *("--bench", str(home / f"{name}.bench.h5")),
    )


def _order(recipe: tuple[str, ...]) -> tuple[str, ...]:
    profile, *overrides = recipe
    return ("-p", profile, *(word for text in overrides for word in ("--set", text)))


def _summary(home: Path, name: str) -> dict[str, Any]:
    """Result of the job's last run file."""
    from edmctl.record.reader import open_run

    last = max((home / "runs").glob(f"{name}-0*.h5"), key=lambda file: file.stat().st_mtime)
    with open_run(last) as run:
        return run.summary() or {}


def _take(done: Finished, document: dict[str, Any], bench_file: Path, recipe: tuple[str, ...]) -> None:
    """Put what was measured beside what the plant knows."""
    profile = _profile(recipe)
    target = profile.target
    done.target_um = target.depth_um if target.kind == "depth" else profile.work.thickness_um
    if done.wrong:
        return
    found = document["result"]["channel"] or document["result"]["sites"][0]
    done.measured_um, done.u95_um = found["depth_um"], found["depth_u95_um"]
    done.wear_um, done.wear_u95_um = found["wear_um"], found["wear_u95_um"]
    bench = restored_bench(read_bench(bench_file))
    done.true_wear_um = bench.tool_wear_um
    if found.get("through"):
        # The depth is how far the tip went: what counts is that the sheet is open.
        done.measured_um, done.u95_um = done.target_um, 0.0
    channel = channel_truth(profile, bench, done.true_wear_um)
    done.true_um = channel.depth_um if channel else max(hole.depth_um for hole in bench.truth())


def main() -> int:
    """Run both and return the exit code."""
    if sys.argv[1:2] == ["--die-at"]:
        die_at(float(sys.argv[2]), sys.argv[3:])
    arguments = options(__doc__, count=50, power=10, profile="cu150", set=[], jobs=2, seed=1)
    recipe = (arguments.profile, *arguments.set)
    chance = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(arguments.jobs) as pool:
        home = Path(folder)
        takes_s = duration_s(home, recipe, arguments.seed)
        print(f"{' '.join(recipe)}: {takes_s:.0f} s of the machine's time from arming to the end")
        seeds = range(arguments.seed, arguments.seed + arguments.count)
        jobs = [pool.submit(kill_and_resume, home, recipe, seed, takes_s) for seed in seeds]
        powers = [
            pool.submit(lose_power, home, recipe, 1000 + seed, chance.uniform(2.0, 80.0))
            for seed in range(arguments.seed, arguments.seed + arguments.power)
        ]
        killed = [job.result() for job in jobs]
        lost = [job.result() for job in powers]
    _tell("hosts killed", killed)
    _tell("controllers without power", lost)
    every = [*killed, *lost]
    good = [one for one in every if not one.wrong]
    return 0 if good == every and _share(every) >= BAR and min(_held(good)) >= HELD_BAR else 1


def _profile(recipe: tuple[str, ...]) -> Profile:
    from edmctl.planning.rules.load import load_profile

    return load_profile(recipe[0], recipe[1:]).profile


def _share(rows: list[Finished]) -> float:
    return sum(row.within for row in rows) / max(1, len(rows))


def _held(rows: list[Finished]) -> tuple[float, float]:
    """Shares of the depths and wears that their intervals hold."""
    n = max(1, len(rows))
    return sum(row.covered for row in rows) / n, sum(row.wear_covered for row in rows) / n


def _tell(what: str, rows: list[Finished]) -> None:
    if not rows:
        return
    good = [row for row in rows if not row.wrong]
    errors_um = sorted(abs(row.error_um) for row in good)
    print(f"{what}: {len(rows)} jobs, interrupted {sum(len(row.phases) for row in rows)} times")
    for row in rows:
        print(row.line())
    if errors_um:
        depth, wear = _held(good)
        print(
            f"  true depth within max({100 * TOLERANCE_SHARE:.0f} %, {LEAST_TOLERANCE_UM} µm) of the target: "
            f"{sum(row.within for row in rows)} of {len(rows)} ({100 * _share(rows):.0f} %, bar "
            f"{100 * BAR:.0f} %); median error {errors_um[len(errors_um) // 2]:.2f} µm, worst {errors_um[-1]:.2f} "
            f"µm; intervals hold {100 * depth:.0f} % of the depths and {100 * wear:.0f} % of the wears (bar "
            f"{100 * HELD_BAR:.0f} %)"
        )


if __name__ == "__main__":
    sys.exit(main())
