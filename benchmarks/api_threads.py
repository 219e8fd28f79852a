"""Jobs from threads of one process give the same bytes as commands in processes of their own.

    python -m benchmarks.api_threads [--jobs 30] [--threads 8]

Other profiles, seeds and depths side by side: results as JSON, and the rows of every table of the run file.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.api.threads import Job, made_in_a_process, made_in_threads

SHALLOW: tuple[tuple[str, dict[str, object]], ...] = (
    ("cu270", {"target.depth_um": 8}),
    ("cu270", {"target.depth_um": 12, "log.pulses": "full"}),
    ("cu150", {"target.depth_um": 9}),
    ("w252", {"target.depth_um": 8, "servo.reference": 0.75}),
    ("foil-through", {}),
    ("array-3x3", {"target.depth_um": 8}),
)


def main() -> int:
    """Do the jobs both ways, and print how many are the same."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=30)
    parser.add_argument("--threads", type=int, default=8)
    options = parser.parse_args()
    jobs = [
        Job(profile, seed, overrides)
        for seed in range(options.jobs)
        for profile, overrides in [SHALLOW[seed % len(SHALLOW)]]
    ]
    with tempfile.TemporaryDirectory() as folder:
        here, apart = Path(folder, "threads"), Path(folder, "processes")
        here.mkdir()
        apart.mkdir()
        begin_s = time.perf_counter()
        by_thread = made_in_threads(jobs, here, options.threads)
        threads_s = time.perf_counter() - begin_s
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            by_process = list(pool.map(lambda job: made_in_a_process(job, apart), jobs))
        processes_s = time.perf_counter() - begin_s - threads_s
    results = sum(a.result == b.result for a, b in zip(by_thread, by_process, strict=True))
    rows = sum(a.rows == b.rows for a, b in zip(by_thread, by_process, strict=True))
    print(f"the same result        {results} of {len(jobs)}")
    print(f"the same rows          {rows} of {len(jobs)}, in {len(by_thread[0].rows)} tables each")
    print(
        f"wall time              {threads_s:.1f} s in {options.threads} threads, {processes_s:.1f} s in processes"
    )
    for job, a, b in zip(jobs, by_thread, by_process, strict=True):
        others = [name for name in a.rows if a.rows[name] != b.rows[name]]
        if others or a.result != b.result:
            print(f"differs: {job}: {', '.join(others) or 'result'}")
    return int(not results == rows == len(jobs))


if __name__ == "__main__":
    sys.exit(main())
