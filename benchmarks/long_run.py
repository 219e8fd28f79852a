"""What a run of eight hours on the virtual machine takes: `python -m benchmarks.long_run`.

Time, file, memory, open file descriptors and threads: `[--hours 8] [--pulses blocks|full|both] [--seed 1]`.

An array of deep holes with a tungsten tool that hardly wears (240 µm each, 17 minutes), the servo recorded at 1 kHz.
The job runs as the command `edmctl machine` in a process of its own. What it holds is read from /proc as it goes on.
Bars: memory in use (RSS) below 300 MB at any time; no more descriptors and threads in the last quarter of the job
than in the one before. Closing the file, which takes threads to compress it, is no part of the job.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.holding import Held, held_by, second_half

BAR_MB = 300.0
HOLE_S = 1050.0
COLUMNS = 6
LOOK_S = 0.2
PROFILE = """
extends = "{parent}"

[meta]
name = "long-run"

[target]
tolerance_um = 15.0

[wear]
expected_ratio = 0.00117

[[sites]]
kind = "grid"
name = "hole"
x_um = 600.0
y_um = 0.0
columns = {columns}
rows = {rows}
dx_um = 500.0
dy_um = 500.0

[limits]
max_time_s = 100000.0

[log]
servo_hz = 1000
pulses = "{pulses}"

[sim]
tool_wear = 0.003
"""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run: what it took, and what it held as it went and as its file was closed."""

    virtual_h: float
    wall_s: float
    held: list[Held]
    held_closing: list[Held]
    kernel_peak_mb: float
    file_mb: float


def perform(folder: Path, pulses: str, rows: int, seed: int) -> Outcome:
    """Run the job and look at what it holds until it ends."""
    profile = folder / f"{pulses}.toml"
    parent = Path(__file__).parents[1] / "profiles" / "w252.toml"
    profile.write_text(
        PROFILE.format(parent=parent, columns=COLUMNS, rows=rows, pulses=pulses), encoding="utf-8"
    )
    command = [sys.executable, "-m", "edmctl", "machine", "--profile", str(profile), "--seed", str(seed)]
    command += ["--out", str(folder), "--run-id", pulses, "--json", "--quiet"]
    answer_path = folder / f"{pulses}.json"
    closing = folder / f"{pulses}.h5.closing"
    start = time.monotonic()
    with answer_path.open("w") as answer:
        process = subprocess.Popen(command, stdout=answer, stderr=subprocess.DEVNULL)
        held: list[Held] = []
        held_closing: list[Held] = []
        while True:
            pid, _, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            now = held_by(process.pid)
            if now is not None:
                (held_closing if held_closing or closing.exists() else held).append(now)
            time.sleep(LOOK_S)
    wall_s = time.monotonic() - start
    document = json.loads(answer_path.read_text())
    if document["error"]:
        print(f"{pulses}: {document['error']['message']}")
    file = Path(document["run_file"])
    return Outcome(
        document["result"]["time_s"] / 3600.0,
        wall_s,
        held,
        held_closing,
        usage.ru_maxrss / 1024.0,
        file.stat().st_size / 1e6,
    )


def describe(pulses: str, outcome: Outcome) -> bool:
    """Print the figures of a run; whether it met the bars."""
    count = len(outcome.held)
    middle, late = outcome.held[count // 2].rss_mb, outcome.held[int(0.9 * count)].rss_mb
    descriptors = second_half([held.descriptors for held in outcome.held])
    threads = second_half([held.threads for held in outcome.held])
    most_descriptors = max((held.descriptors for held in outcome.held_closing), default=0)
    most_threads = max((held.threads for held in outcome.held_closing), default=0)
    print(
        f"{pulses:7} {outcome.virtual_h:.2f} h in {outcome.wall_s:.0f} s; peak {outcome.kernel_peak_mb:.0f} MB "
        f"(bar {BAR_MB:g}), {middle:.0f} MB half-way, {late:.0f} MB after 90 %; file {outcome.file_mb:.1f} MB\n"
        f"        in the second half: descriptors {descriptors}; threads {threads} (bar: no growth)\n"
        f"        as the file is closed: up to {most_descriptors} descriptors, {most_threads} threads",
        flush=True,
    )
    return outcome.kernel_peak_mb < BAR_MB and descriptors.growth <= 0 and threads.growth <= 0


def main() -> None:
    """Run, print, and exit with 1 when the bar was missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--pulses", choices=("blocks", "full", "both"), default="both")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rows = math.ceil(3600.0 * args.hours / (HOLE_S * COLUMNS))
    met = True
    for pulses in ("blocks", "full") if args.pulses == "both" else (args.pulses,):
        with tempfile.TemporaryDirectory() as folder:
            outcome = perform(Path(folder), pulses, rows, args.seed)
        met = describe(pulses, outcome) and met
    print("ok" if met else "MISSED")
    sys.exit(0 if met else 1)


if __name__ == "__main__":
    main()
