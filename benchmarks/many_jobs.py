"""Commands on a bench that has done hundreds of jobs: `python -m benchmarks.many_jobs [--jobs 300] [--runs 5]`.

One job is done on a kept bench; then its ledger is made to tell of that many, each at a place of its own. Told is
how much processor time the forecast of the next job takes with and without that history, in turns, and `run list` of
as many files for each. Exit code 1 where the history costs the forecast more than a quarter.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import sys
import tempfile
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

from benchmarks.serving import start

BAR = 1.25
JOB = ("machine", "-p", "cu270", "--port", "sim:bench.h5", "--set", "target.depth_um=8", "--quiet")
PITCH_UM = 500.0


def took_s(home: Path, *arguments: str) -> float:
    """Processor time of a command, s. Raises where it fails."""
    before = getrusage(RUSAGE_CHILDREN)
    process = start(home, *arguments)
    _, err = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(err)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def history(ledger: str, jobs: int) -> str:
    """The ledger of one job as that of many, each with a new tool every twenty."""
    job, reference, site, end = (json.loads(line) for line in ledger.splitlines())
    lines = [job, reference, site, end]
    for number in range(1, jobs):
        x_um, run_file = site["x_um"] + PITCH_UM * number, f"job-{number}.h5"
        if number % 20 == 0:
            lines.append({**end, "kind": "tool", "tool": job["tool"]})
            for key in ("run_file", "status", "time_s"):
                del lines[-1][key]
        lines.append({**job, "run_file": run_file, "places": [[site["name"], x_um, 0.0]]})
        lines.append({**site, "run_file": run_file, "x_um": x_um})
        lines.append({**end, "run_file": run_file})
    return "".join(json.dumps(line) + "\n" for line in lines)


def main() -> int:
    """Measure, print, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=300)
    parser.add_argument("--runs", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        took_s(home, *JOB, "--seed", "7")
        ledger = home / "runs" / "ledger.jsonl"
        texts = {1: ledger.read_text(), arguments.jobs: history(ledger.read_text(), arguments.jobs)}
        times_s: dict[int, list[float]] = {1: [], arguments.jobs: []}
        for _ in range(arguments.runs):
            for jobs, text in texts.items():
                ledger.write_text(text)
                times_s[jobs].append(took_s(home, *JOB, "--dry-run"))
        few_s, many_s = (statistics.median(times) for times in times_s.values())
        print(
            f"forecast after 1 job {few_s:.2f} s, after {arguments.jobs} {many_s:.2f} s: {many_s / few_s:.2f} times"
        )
        (run,) = (home / "runs").glob("*.h5")
        one_s = took_s(home, "run", "list")
        for number in range(1, arguments.jobs):
            shutil.copyfile(run, run.with_name(f"job-{number}.h5"))
        all_s = took_s(home, "run", "list")
        print(f"run list of 1 run {one_s:.2f} s, of {arguments.jobs} {all_s:.2f} s")
    return int(many_s > BAR * few_s)


if __name__ == "__main__":
    sys.exit(main())
