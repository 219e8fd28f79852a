"""Jobs from threads of one process, and the same jobs from the command line: what has to be the same bytes."""

from __future__ import annotations

import json
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import edmctl
from edmctl.report.export import TABLES
from edmctl.toml_text import toml_value
from tests.cli.commands import command, environment

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Job:
    """A job on a fresh virtual machine."""

    profile: str
    seed: int
    overrides: Mapping[str, object] = field(hash=False)

    @property
    def run_id(self) -> str:
        return f"{self.profile}-{self.seed}"


@dataclass(frozen=True, slots=True)
class Made:
    """The result as JSON, and the bytes of all rows of the run file by table."""

    result: str
    rows: Mapping[str, bytes]


def made_in_threads(jobs: Sequence[Job], folder: Path, threads: int) -> list[Made]:
    """Do all jobs in threads of this process."""

    def work(job: Job) -> Made:
        machine = edmctl.connect("sim:", seed=job.seed, home=folder / "home")
        report = machine.machine(job.profile, overrides=job.overrides, out=folder, run_id=job.run_id)
        return Made(json.dumps(report.to_dict(), sort_keys=True), rows_of(folder / f"{job.run_id}.h5"))

    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, jobs))


def made_in_a_process(job: Job, folder: Path) -> Made:
    """Do one job by a command in a process of its own."""
    settings = [f"{key}={toml_value(value)}" for key, value in job.overrides.items()]
    done = subprocess.run(
        command(
            *("machine", "-p", job.profile, "--seed", str(job.seed), "--json", "--quiet"),
            *("--out", str(folder), "--run-id", job.run_id),
            *(word for setting in settings for word in ("--set", setting)),
        ),
        cwd=folder,
        env=environment(EDMCTL_HOME=str(folder / "home")),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    result = json.loads(done.stdout)["result"]
    return Made(json.dumps(result, sort_keys=True), rows_of(folder / f"{job.run_id}.h5"))


def rows_of(path: Path) -> dict[str, bytes]:
    """Read the rows of every table."""
    with edmctl.open_run(path) as run:
        return {
            name: repr(run.table(table.path).tolist()).encode()
            if table.is_compound
            else b"".join(column.tobytes() for column in run.columns(table.path).values())
            for name, table in TABLES.items()
        }
