"""Writers that die: `python benchmarks/record_kills.py [--kills 200] [--copies 300] [--seed 1]`.

A process writes a run file as a machine at 1 kHz with every pulse would, in real time, and is killed (SIGKILL) at a
random instant. `recover` must make a complete file of what it left, in which every row is what was handed over,
without a gap, up to at most 1 s before the kill. Then the same with copies of the file that is being written, taken
at random instants as a loss of power would leave it. Exit code 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edmctl.errors import RunFileError
from edmctl.record.background import BackgroundWriter
from edmctl.record.reader import open_run
from edmctl.record.recovery import recover
from edmctl.record.rows import EventLevel, EventRow, ServoBlock, TouchRow
from edmctl.record.run_meta import RunMeta
from edmctl.results.telemetry import PulseTrain

SERVO_HZ, PULSE_HZ = 1000, 2300
BLOCK_S = 0.1
LONGEST_S = 4.0
LOSS_BAR_S = 1.0
COPY_BAR = 0.99


@dataclass(frozen=True, slots=True)
class Found:
    """What was wrong with a recovered file, if anything, and how old its newest row was at the kill."""

    wrong: str
    loss_s: float


def meta() -> RunMeta:
    return RunMeta(
        run_id="kills",
        title="benchmark",
        start_time="2025-01-01T00:00:00+00:00",
        command=("benchmark",),
        host="host",
        simulated=True,
        seed=1,
        profile_text="",
        profile_sha256="",
        edmctl_version="0",
    )


def servo_at(row: np.ndarray) -> np.ndarray:
    """What the column `v_cmd` holds in row number `row`."""
    return (row % 9973).astype(np.float32)


def write_for_ever(path: Path) -> None:
    """Hand over rows in real time; `time` is this machine's monotonic clock, in every process the same."""
    writer = BackgroundWriter.create(path, meta())
    start_s = time.monotonic()
    rows, pulses = int(SERVO_HZ * BLOCK_S), int(PULSE_HZ * BLOCK_S)
    block = 0
    while True:
        row = np.arange(block * rows, (block + 1) * rows)
        pulse = np.arange(block * pulses, (block + 1) * pulses)
        time_s = start_s + row / SERVO_HZ
        value = servo_at(row)
        writer.append(ServoBlock(time_s, value, value, value, value, value, value, row % 3, row % 10))
        train = PulseTrain(
            block * pulses, start_s + block * BLOCK_S, 1 / PULSE_HZ, pulse % 4, 0.1 * (pulse % 1300),
            0.2 * (pulse % 600), 0.5 * (pulse % 80),
        )  # fmt: skip
        writer.append(train)
        writer.append(EventRow(start_s + block * BLOCK_S, block % 60000, EventLevel.INFO, f"block {block}"))
        if block % 7 == 0:
            writer.append(TouchRow(start_s + block * BLOCK_S, "Z2", "A1", 1.0, block, 0.0, 1, 0.0, 0.0, 1.0))
        block += 1
        time.sleep(max(0.0, start_s + block * BLOCK_S - time.monotonic()))


def start(path: Path) -> int:
    """Fork a writer of `path`; returns its process."""
    child = os.fork()
    if child == 0:
        try:
            write_for_ever(path)
        finally:
            os._exit(1)
    return child


def judge(path: Path, died_s: float) -> Found:
    """Recover `path` and look at every row."""
    try:
        made = recover(path, path.with_name("recovered.h5"))
    except RunFileError as error:
        return Found(f"{error.code} {error.message}", float("nan"))
    try:
        with open_run(made.path) as run:
            servo, pulses = run.columns("/entry/servo"), run.columns("/entry/pulses/full")
            events, touches = run.table("/entry/events"), run.table("/entry/touches")
            status = run.text("/entry/status")
    finally:
        made.path.unlink()
    row, pulse = np.arange(len(servo["time"])), np.arange(len(pulses["td"]))
    block = np.arange(len(events))
    checks = {
        "status": status == "recovered",
        "servo values": np.array_equal(servo["v_cmd"], servo_at(row)),
        "servo times": bool(np.allclose(np.diff(servo["time"]), 1 / SERVO_HZ, atol=1e-6)),
        "pulses": np.allclose(pulses["td"], 0.1 * (pulse % 1300), atol=1e-4),
        "events": np.array_equal(events["code"], block),
        "touches": np.array_equal(touches["z_sensor"], 7.0 * np.arange(len(touches))),
    }
    newest_s = [
        servo["time"][-1] if len(row) else np.nan,
        events["time"][-1] + BLOCK_S if len(block) else np.nan,
        touches["time"][-1] + 7 * BLOCK_S if len(touches) else np.nan,
    ]
    loss_s = float(died_s - np.nanmin(newest_s)) if len(row) else float("nan")
    return Found(", ".join(name for name, well in checks.items() if not well), loss_s)


def kill_writers(folder: Path, kills: int, chance: random.Random) -> list[Found]:
    """Kill writers one by one; those killed before their first rows have no loss to tell."""
    found = []
    for number in range(kills):
        path = folder / f"k{number}.h5"
        left = folder / f"k{number}.h5.partial"
        child = start(path)
        while not left.exists():
            time.sleep(0.001)
        time.sleep(chance.uniform(0.0, LONGEST_S))
        died_s = time.monotonic()
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        found.append(judge(left, died_s))
        left.unlink()
    return found


def copy_from_writers(folder: Path, copies: int, chance: random.Random) -> list[Found]:
    """Copy the files of living writers at random instants; each writer lives for some copies."""
    found: list[Found] = []
    while len(found) < copies:
        path = folder / "cut.h5"
        child = start(path)
        time.sleep(1.0)
        for _ in range(min(25, copies - len(found))):
            time.sleep(chance.uniform(0.0, 0.3))
            copy = folder / "copy.h5.partial"
            cut_s = time.monotonic()
            shutil.copyfile(path.with_name("cut.h5.partial"), copy)
            found.append(judge(copy, cut_s))
            copy.unlink()
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        path.with_name("cut.h5.partial").unlink()
    return found


def main() -> int:
    """Run both and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--copies", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        killed = kill_writers(Path(folder), arguments.kills, chance)
        copied = copy_from_writers(Path(folder), arguments.copies, chance)
    wrong = [one.wrong for one in killed if one.wrong]
    losses_s = [one.loss_s for one in killed if one.loss_s == one.loss_s]
    torn = [one.wrong for one in copied if one.wrong]
    share = 1.0 - len(torn) / max(1, len(copied))
    whole = len(killed) - len(wrong)
    print(f"{len(killed)} writers killed: {whole} files recovered with every row exact (bar: all)")
    print(
        f"newest row at the kill: median {np.median(losses_s):.2f} s old, oldest {max(losses_s):.2f} s "
        f"(bar {LOSS_BAR_S:.0f} s)"
    )
    print(
        f"{len(copied)} copies of a file under way: {100 * share:.1f} % recovered exactly "
        f"(bar {100 * COPY_BAR:.0f} %)"
    )
    for line in [*wrong, *torn]:
        print(f"  {line}")
    return 1 if wrong or max(losses_s) > LOSS_BAR_S or share < COPY_BAR else 0


if __name__ == "__main__":
    sys.exit(main())
